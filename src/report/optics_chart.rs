//! Ways to compute a dome's profile, and what a sample at the wrong height costs: picture, page and table.

use serde::Serialize;

use super::axis::Axis;
use super::chart::{Chart, Mark, Series};
use super::html::{document, heading, number_cells, provenance, table_head};
use super::sheet::Sheet;
use super::text::number;
use crate::design::HeightError;

/// One computation of a profile.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProfileRow {
    /// `closed form`, `Euler` or `RK4`.
    pub method: &'static str,
    /// Steps from rim to axis.
    pub steps: usize,
    /// Largest distance from the closed form, mm; of the closed form itself, by how much its optical path varies.
    pub distance_mm: f64,
    /// Largest angle between chords, arc seconds.
    pub slope_arcsec: f64,
    /// Time to compute it, s.
    pub seconds: f64,
}

/// Heights of one material on one rig.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeightRow {
    /// Name of the rig.
    pub rig: String,
    /// Name of the material.
    pub material: String,
    /// Errors, ascending heights.
    pub errors: Vec<HeightError>,
}

/// Both charts.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OpticsReport {
    /// Profiles.
    pub profiles: Vec<ProfileRow>,
    /// Heights.
    pub heights: Vec<HeightRow>,
}

impl OpticsReport {
    /// The picture.
    pub fn sheet(&self) -> Sheet {
        let mut methods: Vec<&'static str> = Vec::new();
        for row in &self.profiles {
            if !methods.contains(&row.method) {
                methods.push(row.method);
            }
        }
        let series = |x: fn(&ProfileRow) -> f64, y: fn(&ProfileRow) -> f64| -> Vec<Series> {
            let of = |(i, m): (usize, &&'static str)| {
                let points = self.profiles.iter().filter(|r| r.method == *m).map(|r| (x(r), y(r))).collect();
                Series::new(*m, points, Mark::Both, i + 1)
            };
            methods.iter().enumerate().map(of).collect()
        };
        let first = methods.len() + 1;
        let heights: Vec<Series> = self
            .heights
            .iter()
            .enumerate()
            .map(|(i, h)| {
                let points = h.errors.iter().map(|e| (e.height_mm, e.total_rel)).collect();
                // There are six colours, and black.
                Series::new(format!("{} on {}", h.material, h.rig), points, Mark::Both, (first + i) % 7)
            })
            .collect();
        let steps = |r: &ProfileRow| r.steps as f64;
        let legend = methods.iter().enumerate().map(|(i, m)| (i + 1, Mark::Both, (*m).to_owned()));
        let legend = legend.chain(heights.iter().map(|s| (s.style, Mark::Both, s.name.clone()))).collect();
        let panel = |title: &str, chart: Chart| Some((title.to_owned(), chart));
        Sheet {
            title: "A dome's profile by three methods, and samples that are too high".into(),
            columns: 3,
            panels: vec![
                panel(
                    "Distance from the true profile",
                    Chart::new(
                        "distance over steps",
                        Axis::log("steps"),
                        Axis::log("mm"),
                        series(steps, |r| r.distance_mm),
                    ),
                ),
                panel(
                    "Slope against the true profile",
                    Chart::new(
                        "slope over steps",
                        Axis::log("steps"),
                        Axis::log("arc seconds"),
                        series(steps, |r| r.slope_arcsec),
                    ),
                ),
                panel(
                    "Distance against time",
                    Chart::new(
                        "distance over time",
                        Axis::log("time / s"),
                        Axis::log("mm"),
                        series(|r| r.seconds, |r| r.distance_mm),
                    ),
                ),
                panel(
                    "Sample too high",
                    Chart::new(
                        "error of coefficients over height",
                        Axis::log("height / mm"),
                        Axis::log("RMS error / z₀₀"),
                        heights,
                    ),
                ),
                None,
            ],
            series: legend,
            notes: vec!["closed form: by how much its optical path varies".into()],
        }
    }

    /// The table.
    pub fn to_csv(&self) -> Vec<u8> {
        let mut csv = csv::Writer::from_writer(Vec::new());
        let mut write = |row: [String; 7]| csv.write_record(row).expect("memory takes any table");
        write(["kind", "name", "x", "error", "slope_arcsec", "lit_share", "seconds"].map(str::to_owned));
        for r in &self.profiles {
            let (steps, distance) = (r.steps.to_string(), r.distance_mm.to_string());
            let (slope, seconds) = (r.slope_arcsec.to_string(), r.seconds.to_string());
            write(["profile_mm".into(), r.method.into(), steps, distance, slope, String::new(), seconds]);
        }
        for h in &self.heights {
            for e in &h.errors {
                let name = format!("{} on {}", h.material, h.rig);
                let (height, error) = (e.height_mm.to_string(), e.total_rel.to_string());
                let lit = e.lit_share.to_string();
                write(["height_rel".into(), name, height, error, String::new(), lit, String::new()]);
            }
        }
        csv.into_inner().expect("memory takes any table")
    }

    /// The page.
    pub fn to_html(&self) -> String {
        let columns = ["Steps", "Distance / mm", "Slope / arc seconds", "Time / ms"];
        let profiles: String = self
            .profiles
            .iter()
            .map(|r| {
                let cells = [
                    r.steps.to_string(),
                    number(r.distance_mm, 2),
                    number(r.slope_arcsec, 2),
                    number(1e3 * r.seconds, 2),
                ];
                format!("<tr><th scope=\"row\">{}</th>{}</tr>\n", r.method, number_cells(&columns, &cells))
            })
            .collect();
        let height_columns = ["Height / mm", "Largest of a coefficient / z₀₀", "All / z₀₀", "Least lit share"];
        let heights: String = self
            .heights
            .iter()
            .flat_map(|h| h.errors.iter().map(move |e| (h, e)))
            .map(|(h, e)| {
                let cells = [e.height_mm, e.largest_rel, e.total_rel, e.lit_share].map(|x| number(x, 2));
                format!(
                    "<tr><th scope=\"row\">{} on {}</th>{}</tr>\n",
                    h.material,
                    h.rig,
                    number_cells(&height_columns, &cells)
                )
            })
            .collect();
        let table =
            |head: String, rows: String| format!("<table class=\"cards\">\n{head}<tbody>\n{rows}</tbody>\n</table>\n");
        let body = "<p class=\"summary\">The closed form has no error to speak of at any number of points; steps along tangent planes are off \
                    by millimetres.</p>\n<p class=\"note\">As files: <a href=\"optics.png\">optics.png</a>, <a href=\"optics.svg\">optics.svg</a>, \
                    <a href=\"optics.csv\">optics.csv</a>.</p>\n"
            .to_owned()
            + &self.sheet().to_html()
            + &heading("Profiles")
            + &table(table_head("Method", &columns, None), profiles)
            + &heading("Samples that are too high")
            + &table(table_head("Material and rig", &height_columns, None), heights)
            + &provenance([("Software", concat!("zonal ", env!("CARGO_PKG_VERSION")))]);
        document("A dome's profile, and a sample's height", &body)
    }
}
