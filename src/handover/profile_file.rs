//! Profiles as tables: the nominal one is written, a measured one is read.

use std::fmt::Write as _;

use thiserror::Error;

use super::{HandoverError, Parts};

/// Version of the profile file this program writes.
pub const FORMAT: u32 = 1;

/// Columns the reader needs.
const NEEDED: [&str; 2] = ["r_mm", "z_mm"];
/// Fewer points show no curve.
const LEAST_POINTS: usize = 8;
/// A spacing so many times the median is a gap.
const GAP: f64 = 5.0;
/// Longer than any dome, mm.
const LONGEST_MM: f64 = 1e6;

/// Why a text is no measured profile. Lines count from 1.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ProfileFileError {
    /// A column is missing, or there are two of its name.
    #[error(
        "line {line}: the header has {count} columns {column}, not one, in \"{header}\": name the columns r_mm and z_mm"
    )]
    Column {
        /// The header's line; the last one if the text has no header.
        line: usize,
        /// Name of the column.
        column: &'static str,
        /// How many have it.
        count: usize,
        /// The header as found.
        header: String,
    },
    /// A row ends before a needed column.
    #[error("line {line}: the row has {found} values and none in the column {column}: complete or remove it")]
    Short {
        /// The line.
        line: usize,
        /// The column without a value.
        column: &'static str,
        /// Values in the row.
        found: usize,
    },
    /// A value that is not a finite length.
    #[error(
        "line {line}: {column} = \"{value}\" is no length: give finite mm with a decimal point, of at most {LONGEST_MM:e}"
    )]
    Value {
        /// The line.
        line: usize,
        /// Its column.
        column: &'static str,
        /// The text found.
        value: String,
    },
    /// A point on the other side of the axis.
    #[error("line {line}: r_mm = {r_mm} lies across the axis: measure one side, or subtract the axis' place")]
    AcrossAxis {
        /// The line.
        line: usize,
        /// Distance from the axis, mm.
        r_mm: f64,
    },
    /// The point before once more.
    #[error("line {line}: the point ({r_mm}, {z_mm}) mm stands in the row before too: remove one of them")]
    Duplicate {
        /// The line.
        line: usize,
        /// Distance from the axis, mm.
        r_mm: f64,
        /// Height, mm.
        z_mm: f64,
    },
    /// The polar angle does not grow: the points are not sorted, or the profile crosses itself.
    #[error(
        "line {line}: the polar angle seen from the sample goes from {before_deg:.6} to {theta_deg:.6} deg: sort the points from \
         the opening to the rim, heights above the sample's plane; a profile that turns back or crosses itself is none"
    )]
    TurnsBack {
        /// The line.
        line: usize,
        /// Polar angle of the point before, degrees.
        before_deg: f64,
        /// Polar angle of the point, degrees.
        theta_deg: f64,
    },
    /// Points are missing.
    #[error(
        "line {line}: the point is {spacing_mm} mm from the one before, more than {GAP} times the median {median_mm} mm: measure \
         what is missing or remove strays"
    )]
    Gap {
        /// The line.
        line: usize,
        /// Distance from the point before, mm.
        spacing_mm: f64,
        /// Median distance, mm.
        median_mm: f64,
    },
    /// Too few points.
    #[error("line {line}: the profile ends after {found} points: measure at least {LEAST_POINTS}")]
    TooFew {
        /// The last line.
        line: usize,
        /// Points found.
        found: usize,
    },
}

/// The dome's profile from the opening to its end as a CSV table, its points evenly spaced along the arc by at most
/// `spacing_mm`. Lines that begin with `#` name rig, units and columns.
///
/// # Errors
/// [`HandoverError::Length`], [`HandoverError::TooFine`].
pub fn profile_csv(parts: &Parts, spacing_mm: f64) -> Result<String, HandoverError> {
    let points = parts.profile(spacing_mm)?;
    let chord = (points[1].r - points[0].r).hypot(points[1].z - points[0].z);
    let [opening, end] = [parts.opening(), parts.end()].map(|p| p.theta.to_degrees());
    let mut text = format!(
        "# zonal dome profile, format {FORMAT}\n# rig: {}\n# units: mm and degrees; r from the optical axis, z above the \
         sample's plane\n# range: theta {opening:.4} to {end:.4} deg, opening to rim; {} points, {chord:.4} mm apart along the \
         arc\n# theta: polar angle seen from the sample; normal: unit vector into the dome; radii of curvature: the centre \
         lies inside\n# draft: positive where a mandrel can be drawn out downwards; rho_convex: radius on the convex mirror \
         of the ray that comes here\ntheta_deg,r_mm,z_mm,normal_r,normal_z,meridional_radius_mm,sagittal_radius_mm,\
         draft_deg,rho_convex_mm\n",
        super::one_line(&parts.rig().name),
        points.len(),
    );
    for p in &points {
        let ([n_r, n_z], theta, draft) = (p.normal, p.theta.to_degrees(), p.draft().to_degrees());
        let (across, along) = (p.sagittal_radius, p.meridional_radius);
        writeln!(
            text,
            "{theta:.9},{:.10},{:.10},{n_r:.12},{n_z:.12},{along:.8},{across:.8},{draft:.8},{:.10}",
            p.r, p.z, p.rho
        )
        .expect("a string takes all text");
    }
    Ok(text)
}

/// Reads a measured profile: points (r, z) in mm from the opening to the rim, in the columns `r_mm` and `z_mm` of a table
/// separated by commas. Other columns and lines that begin with `#` are passed over.
///
/// Polar angles seen from the sample grow from point to point, so the profile crosses neither itself nor the axis.
///
/// # Errors
/// [`ProfileFileError`], naming the line and what to do.
pub fn read_profile(text: &str) -> Result<Vec<[f64; 2]>, ProfileFileError> {
    let text = text.trim_start_matches('\u{feff}');
    let last = text.lines().count().max(1);
    let mut rows = (1..).zip(text.lines()).filter(|(_, row)| {
        let row = row.trim();
        !row.is_empty() && !row.starts_with('#')
    });
    let (line, header) = rows.next().unwrap_or((last, ""));
    let columns = [column(line, header, NEEDED[0])?, column(line, header, NEEDED[1])?];
    let mut points: Vec<(usize, [f64; 2])> = Vec::new();
    for (line, row) in rows {
        let values: Vec<&str> = row.split(',').map(bare).collect();
        let mut point = [0.0; 2];
        for ((x, at), column) in point.iter_mut().zip(columns).zip(NEEDED) {
            let value = *values.get(at).ok_or(ProfileFileError::Short { line, column, found: values.len() })?;
            let length = value.parse().ok().filter(|x: &f64| x.abs() <= LONGEST_MM);
            *x = length.ok_or_else(|| ProfileFileError::Value { line, column, value: value.to_owned() })?;
        }
        points.push((line, point));
    }
    check(&points, last)?;
    Ok(points.into_iter().map(|(_, point)| point).collect())
}

/// A value without what spreadsheets put round it.
fn bare(value: &str) -> &str {
    value.trim().trim_matches('"').trim()
}

fn column(line: usize, header: &str, column: &'static str) -> Result<usize, ProfileFileError> {
    let at: Vec<usize> = header.split(',').enumerate().filter(|c| bare(c.1) == column).map(|c| c.0).collect();
    match at[..] {
        [only] => Ok(only),
        _ => Err(ProfileFileError::Column { line, column, count: at.len(), header: header.trim().to_owned() }),
    }
}

fn check(points: &[(usize, [f64; 2])], last: usize) -> Result<(), ProfileFileError> {
    if let Some(&(line, [r_mm, _])) = points.iter().find(|(_, [r, _])| *r < 0.0) {
        return Err(ProfileFileError::AcrossAxis { line, r_mm });
    }
    let mut spacings = Vec::with_capacity(points.len());
    for w in points.windows(2) {
        let ((_, a), (line, b)) = (w[0], w[1]);
        if a == b {
            return Err(ProfileFileError::Duplicate { line, r_mm: b[0], z_mm: b[1] });
        }
        let [before_deg, theta_deg] = [a, b].map(|[r, z]| r.atan2(z).to_degrees());
        if theta_deg <= before_deg {
            return Err(ProfileFileError::TurnsBack { line, before_deg, theta_deg });
        }
        spacings.push((line, (b[0] - a[0]).hypot(b[1] - a[1])));
    }
    if points.len() < LEAST_POINTS {
        return Err(ProfileFileError::TooFew { line: last, found: points.len() });
    }
    let mut sorted: Vec<f64> = spacings.iter().map(|s| s.1).collect();
    sorted.sort_by(f64::total_cmp);
    let median_mm = sorted[sorted.len() / 2];
    match spacings.into_iter().find(|s| s.1 > GAP * median_mm) {
        Some((line, spacing_mm)) => Err(ProfileFileError::Gap { line, spacing_mm, median_mm }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::samples::thesis;
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_is_written_is_read() {
        for parts in thesis() {
            let text = profile_csv(&parts, 0.5).unwrap();
            let (points, read) = (parts.profile(0.5).unwrap(), read_profile(&text).unwrap());
            assert_eq!(points.len(), read.len());
            for (p, [r, z]) in points.iter().zip(read) {
                assert!((p.r - r).abs() < 1e-9 && (p.z - z).abs() < 1e-9);
            }
            assert!(text.starts_with("# zonal dome profile, format 1\n# rig: ghosh-2007-"));
            let width = 1 + text.lines().last().unwrap().matches(',').count();
            assert_eq!(width, 9);
        }
    }

    /// A quarter of a circle about the sample.
    fn rows() -> Vec<String> {
        let row = |i: i32| {
            let (sin, cos) = (f64::from(i) * 0.1).sin_cos();
            format!("x,{},{}", 100.0 * cos, 100.0 * sin)
        };
        std::iter::once("note, \"z_mm\" ,r_mm".to_owned()).chain((0..=12).map(row)).collect()
    }

    #[test]
    fn columns_are_found_by_name() {
        let read = read_profile(&format!("\u{feff}# measured\r\n\r\n{}\r\n", rows().join("\r\n"))).unwrap();
        assert_eq!((read.len(), read[0]), (13, [0.0, 100.0]));
    }

    #[test]
    fn each_fault_is_named_with_its_line() {
        type Edit = fn(&mut Vec<String>);
        let error = |edit: Edit| {
            let mut rows = rows();
            edit(&mut rows);
            read_profile(&rows.join("\n")).unwrap_err()
        };
        let starts = |edit: Edit, text: &str| {
            let said = error(edit).to_string();
            assert!(said.starts_with(text), "{said}");
        };
        starts(|r| r.clear(), "line 1: the header has 0 columns r_mm, not one, in \"\"");
        starts(|r| r[0] = "r_mm,z".into(), "line 1: the header has 0 columns z_mm, not one, in \"r_mm,z\"");
        starts(|r| r[0] += ",r_mm", "line 1: the header has 2 columns r_mm");
        starts(|r| r[3] = "x,1".into(), "line 4: the row has 2 values and none in the column r_mm");
        starts(|r| r[3] = "x,nan,1".into(), "line 4: z_mm = \"nan\" is no length");
        starts(|r| r[3] = "x,1,inf".into(), "line 4: r_mm = \"inf\" is no length");
        starts(|r| r[3] = "x,1,1e300".into(), "line 4: r_mm = \"1e300\" is no length");
        starts(|r| r[3] = "x,1,\"2\"mm".into(), "line 4: r_mm = \"2\"mm\" is no length");
        starts(|r| r[1] = "x,100,-0.5".into(), "line 2: r_mm = -0.5 lies across the axis");
        starts(|r| r[5] = r[4].clone(), "line 6: the point (");
        starts(|r| r.swap(5, 6), "line 7: the polar angle");
        starts(|r| r[1..].reverse(), "line 3: the polar angle");
        starts(|r| drop(r.drain(4..9)), "line 5: the point is 59.");
        starts(|r| r.truncate(8), "line 8: the profile ends after 7 points");
    }

    #[test]
    fn a_loop_is_refused() {
        let mut rows = rows();
        // Out along the arc, back below it, and on: the way back crosses the way on.
        rows[6..].rotate_left(3);
        assert!(matches!(read_profile(&rows.join("\n")), Err(ProfileFileError::TurnsBack { .. })));
    }

    proptest! {
        #[test]
        fn no_text_makes_it_panic(text in "[-+0-9.,eE#\"\\n\\r rz_mnaif\u{feff}\u{e9}]{0,200}", head in any::<bool>()) {
            let text = if head { format!("r_mm,z_mm\n{text}") } else { text };
            let _ = read_profile(&text);
        }

        #[test]
        fn arbitrary_text_does_not_either(text in any::<String>()) {
            let _ = read_profile(&text);
        }

        #[test]
        fn a_damaged_file_is_read_or_named(at in 0usize..2000, with in any::<char>()) {
            let [parts, _] = thesis();
            let mut text: Vec<char> = profile_csv(&parts, 10.0).unwrap().chars().collect();
            let at = at % text.len();
            text[at] = with;
            if let Err(e) = read_profile(&text.into_iter().collect::<String>()) {
                prop_assert!(e.to_string().starts_with("line "));
            }
        }

        #[test]
        fn profiles_survive_a_round_trip(
            radii in prop::collection::vec(50.0..60.0f64, 8..60), from in 0.0..0.5f64, digits in 12usize..17,
        ) {
            let n = radii.len() as f64;
            let point = |(i, l): (usize, &f64)| {
                let (sin, cos) = (from + i as f64 / n).sin_cos();
                [l * sin, l * cos]
            };
            let points: Vec<[f64; 2]> = radii.iter().enumerate().map(point).collect();
            let spacings: Vec<f64> =
                points.windows(2).map(|w| (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1])).collect();
            let mut sorted = spacings.clone();
            sorted.sort_by(f64::total_cmp);
            let even = spacings.iter().all(|&s| s <= GAP * sorted[sorted.len() / 2]);
            let rows = points.iter().map(|[r, z]| format!("{r:.digits$},{z:.digits$}\n")).collect::<String>();
            match read_profile(&format!("r_mm,z_mm\n{rows}")) {
                Ok(read) => for (a, b) in points.iter().zip(read) {
                    prop_assert!(even && (a[0] - b[0]).abs() < 1e-9 && (a[1] - b[1]).abs() < 1e-9);
                },
                Err(e) => prop_assert!(!even && matches!(e, ProfileFileError::Gap { .. }), "{}", e),
            }
        }
    }
}
