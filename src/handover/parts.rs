//! The parts of a rig as they are made: outlines of their sections.

use thiserror::Error;

use crate::optics::{Mirrors, ProfilePoint, Rig};

/// Curves are measured on so many pieces: those of a hundred millimetres to 1e-6 of it.
const PIECES: usize = 20_000;
/// A curve has at least so many steps: what a measured profile must have, less one.
const LEAST_STEPS: usize = 7;
/// More points than any machine reads.
const MOST_POINTS: f64 = 1e6;

/// Why parts cannot be made or described.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum HandoverError {
    /// A length outside its range.
    #[error("{name} = {value:?} mm is out of range: choose more than {above:.3} and less than {below:.3} mm")]
    Length {
        /// What the length is of.
        name: &'static str,
        /// The value given, mm.
        value: f64,
        /// What it must exceed, mm.
        above: f64,
        /// What it must stay below, mm.
        below: f64,
    },
    /// The dome is to end beyond what the mirrors can light.
    #[error("the dome ends at {theta_deg} deg, which no ray reaches: lower dome.theta_max_deg")]
    End {
        /// Polar angle of the dome's end, degrees.
        theta_deg: f64,
    },
    /// A ray that does not meet the dome.
    #[error(
        "the ray at {rho_mm} mm on the convex mirror misses the dome: flatten the convex mirror or enlarge the rim"
    )]
    Misses {
        /// Its distance from the axis on the convex mirror, mm.
        rho_mm: f64,
    },
    /// A spacing or chord error that asks for too many points.
    #[error("{name} = {value:?} mm makes {points:.1e} points, more than {MOST_POINTS:e}: choose a larger one")]
    TooFine {
        /// What is too small.
        name: &'static str,
        /// Its value, mm.
        value: f64,
        /// How many points it makes.
        points: f64,
    },
}

/// What is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// The dome: a shell of even thickness behind the mirror.
    Dome,
    /// The solid on which the dome is electroformed, from the height of the opening to that of the dome's end.
    Mandrel,
    /// The convex mirror, solid from its vertex to the height of its edge.
    ConvexMirror,
}

impl Part {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Dome, Self::Mandrel, Self::ConvexMirror];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Dome => "dome",
            Self::Mandrel => "mandrel",
            Self::ConvexMirror => "convex-mirror",
        }
    }
}

/// The mirrors of a rig with what the workshop adds: the dome's opening and its wall.
#[derive(Debug, Clone, PartialEq)]
pub struct Parts {
    rig: Rig,
    mirrors: Mirrors,
    wall: f64,
    opening: ProfilePoint,
    end: ProfilePoint,
    undercut: Option<ProfilePoint>,
}

impl Parts {
    /// Of a rig that was checked when read, with an opening that leaves the zone whole and a wall of up to 1 m.
    ///
    /// # Errors
    /// [`HandoverError::Length`] for an opening or wall out of range, [`HandoverError::End`] and [`HandoverError::Misses`]
    /// where the dome is not lit.
    pub fn new(rig: &Rig, opening_radius_mm: f64, wall_mm: f64) -> Result<Self, HandoverError> {
        within("the wall", wall_mm, 0.0, 1e3)?;
        let mirrors = rig.mirrors();
        let at = |rho: f64| mirrors.profile_point(rho).ok_or(HandoverError::Misses { rho_mm: rho });
        let rho_of = |theta_deg: f64| {
            mirrors.rho_of(theta_deg.to_radians(), mirrors.edge_radius()).ok_or(HandoverError::End { theta_deg })
        };
        let end = at(rho_of(rig.dome.theta_max_deg)?)?;
        let undercut = mirrors.undercut().filter(|p| p.rho < end.rho);
        // The radius grows with rho up to the widest point.
        let zone_begins = rho_of(rig.zone.theta_min_deg)?;
        let (mut lo, mut hi) = (0.0, zone_begins.min(undercut.map_or(end.rho, |p| p.rho)));
        within("the radius of the opening", opening_radius_mm, 0.0, at(hi)?.r)?;
        for _ in 0..60 {
            let mid = 0.5 * (lo + hi);
            if at(mid)?.r < opening_radius_mm { lo = mid } else { hi = mid }
        }
        Ok(Self { rig: rig.clone(), mirrors, wall: wall_mm, opening: at(hi)?, end, undercut })
    }

    /// The rig.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Its mirrors.
    pub fn mirrors(&self) -> &Mirrors {
        &self.mirrors
    }

    /// Thickness of the dome, mm.
    pub fn wall_mm(&self) -> f64 {
        self.wall
    }

    /// The dome's edge at the opening.
    pub fn opening(&self) -> &ProfilePoint {
        &self.opening
    }

    /// The dome's edge at its end, the rim.
    pub fn end(&self) -> &ProfilePoint {
        &self.end
    }

    /// The dome's widest point if it lies above its end: a mandrel in one piece cannot leave such a dome.
    pub fn undercut(&self) -> Option<&ProfilePoint> {
        self.undercut.as_ref()
    }

    /// The dome's meridian from opening to end, in even steps along the arc of at most `spacing_mm`; at least eight points.
    ///
    /// # Errors
    /// [`HandoverError::Length`], [`HandoverError::TooFine`].
    pub fn profile(&self, spacing_mm: f64) -> Result<Vec<ProfilePoint>, HandoverError> {
        within("the spacing", spacing_mm, 0.0, 1e3)?;
        self.spaced(("the spacing", spacing_mm), |_| 1.0 / spacing_mm)
    }

    /// The curve of the part's mirror in (r, z), mm, from the axis outwards; chords are off it by less than `chord_mm`. A
    /// mandrel's is that of the dome.
    ///
    /// # Errors
    /// [`HandoverError::Length`], [`HandoverError::TooFine`].
    pub fn mirror(&self, part: Part, chord_mm: f64) -> Result<Vec<[f64; 2]>, HandoverError> {
        match part {
            Part::Dome | Part::Mandrel => Ok(self.meridian(chord_mm)?.iter().map(|p| [p.r, p.z]).collect()),
            Part::ConvexMirror => self.convex(chord_mm),
        }
    }

    /// The outline of the part's section on one side of the axis in (r, z), mm: closed from the last point to the first,
    /// counterclockwise. Chords are off curves by less than `chord_mm`.
    ///
    /// The dome's outer face is the offset of the mirror along its normals, as are its two edges.
    ///
    /// # Errors
    /// [`HandoverError::Length`], [`HandoverError::TooFine`].
    pub fn section(&self, part: Part, chord_mm: f64) -> Result<Vec<[f64; 2]>, HandoverError> {
        if part == Part::Dome {
            let meridian = self.meridian(chord_mm)?;
            let outer = |p: &ProfilePoint| [p.r - self.wall * p.normal[0], p.z - self.wall * p.normal[1]];
            return Ok(meridian.iter().map(|p| [p.r, p.z]).chain(meridian.iter().rev().map(outer)).collect());
        }
        let mut outline = self.mirror(part, chord_mm)?;
        let ends = [outline[0], outline[outline.len() - 1]];
        outline.reverse();
        outline.extend(ends.into_iter().filter(|end| end[0] > 0.0).map(|end| [0.0, end[1]]));
        Ok(outline)
    }

    /// The dome's meridian such that chords of mirror and outer face, whose radius is larger by the wall, keep the error.
    fn meridian(&self, chord_mm: f64) -> Result<Vec<ProfilePoint>, HandoverError> {
        within("the chord error", chord_mm, 0.0, 1e3)?;
        self.spaced(("the chord error", chord_mm), |p| {
            (1.0 + self.wall / p.meridional_radius).sqrt() / chord(p.meridional_radius, chord_mm)
        })
    }

    /// The dome's meridian at a density of points per mm.
    fn spaced(
        &self,
        asked: (&'static str, f64),
        density: impl Fn(&ProfilePoint) -> f64,
    ) -> Result<Vec<ProfilePoint>, HandoverError> {
        let at = |rho: f64| self.mirrors.profile_point(rho).ok_or(HandoverError::Misses { rho_mm: rho });
        let curve = |rho: f64| at(rho).map(|p| ([p.r, p.z], density(&p)));
        spaced(asked, [self.opening.rho, self.end.rho], curve)?.into_iter().map(at).collect()
    }

    /// The convex mirror from the vertex to its edge.
    fn convex(&self, chord_mm: f64) -> Result<Vec<[f64; 2]>, HandoverError> {
        within("the chord error", chord_mm, 0.0, 1e3)?;
        let conic = self.mirrors.convex();
        let point = |rho: f64| [rho, conic.height(rho)];
        let curve = |rho: f64| Ok((point(rho), 1.0 / chord(conic.meridional_radius(rho), chord_mm)));
        let radii = spaced(("the chord error", chord_mm), [0.0, self.rig.paraboloid_radius_mm()], curve)?;
        Ok(radii.into_iter().map(point).collect())
    }
}

/// Length of a chord that is off a circle by 0.9 of the error asked for, since radii change along a chord.
fn chord(radius: f64, error: f64) -> f64 {
    (8.0 * radius * 0.9 * error).sqrt()
}

/// Checks that a length lies between two others.
pub(super) fn within(name: &'static str, value: f64, above: f64, below: f64) -> Result<(), HandoverError> {
    let inside = value > above && value < below;
    if inside { Ok(()) } else { Err(HandoverError::Length { name, value, above, below }) }
}

/// Parameters in equal steps of the density, integrated along the arc; each step holds at most one. `curve` gives the point
/// at a parameter and the density there, 1/mm.
fn spaced(
    (name, value): (&'static str, f64),
    [from, to]: [f64; 2],
    curve: impl Fn(f64) -> Result<([f64; 2], f64), HandoverError>,
) -> Result<Vec<f64>, HandoverError> {
    let at = |piece: f64| from + (to - from) * piece / PIECES as f64;
    let mut passed = vec![0.0];
    let mut before = curve(from)?;
    for i in 1..=PIECES {
        let next = curve(at(i as f64))?;
        let length = (next.0[0] - before.0[0]).hypot(next.0[1] - before.0[1]);
        passed.push(passed[i - 1] + 0.5 * length * (before.1 + next.1));
        before = next;
    }
    let total = passed[PIECES];
    if total.is_nan() || total >= MOST_POINTS {
        return Err(HandoverError::TooFine { name, value, points: total });
    }
    let steps = (total.ceil() as usize).max(LEAST_STEPS);
    let inner = (1..steps).map(|step| {
        let goal = total * step as f64 / steps as f64;
        let i = passed.partition_point(|&x| x < goal).clamp(1, PIECES);
        at(i as f64 - (passed[i] - goal) / (passed[i] - passed[i - 1]))
    });
    Ok(std::iter::once(from).chain(inner).chain([to]).collect())
}

#[cfg(test)]
mod tests {
    use super::super::samples::thesis;
    use super::*;

    /// Twice the area inside an outline, positive if it is counterclockwise.
    fn doubled_area(outline: &[[f64; 2]]) -> f64 {
        let next = outline.iter().cycle().skip(1);
        outline.iter().zip(next).map(|(a, b)| a[0] * b[1] - b[0] * a[1]).sum()
    }

    #[test]
    fn the_dome_begins_at_the_opening_and_ends_as_the_rig_says() {
        let [built, full] = thesis();
        for parts in [&built, &full] {
            assert!((parts.opening().r - 16.3).abs() < 1e-9);
            assert!((parts.end().theta.to_degrees() - parts.rig().dome.theta_max_deg).abs() < 1e-9);
        }
        assert!(built.undercut().is_none());
        assert!((full.undercut().unwrap().theta.to_degrees() - 64.8).abs() < 0.1);
        assert!(full.end().z.abs() < 1e-6 && (full.end().r - 126.5).abs() < 1e-6);
    }

    #[test]
    fn points_are_even_along_the_arc() {
        for parts in thesis() {
            let points = parts.profile(0.5).unwrap();
            let steps: Vec<f64> = points.windows(2).map(|w| (w[1].r - w[0].r).hypot(w[1].z - w[0].z)).collect();
            let (least, most) = steps.iter().fold((1e9f64, 0f64), |(lo, hi), &s| (lo.min(s), hi.max(s)));
            // A chord of 0.5 mm is 5e-7 mm shorter than its arc.
            assert!(most <= 0.5 && least > 0.49 && most - least < 2e-6, "{least} {most}");
        }
    }

    #[test]
    fn chords_stay_within_their_error() {
        for parts in thesis() {
            for chord_mm in [1e-3, 0.1] {
                let meridian = parts.meridian(chord_mm).unwrap();
                let convex = parts.convex(chord_mm).unwrap();
                let dome = |rho: f64, wall: f64| {
                    let p = parts.mirrors().profile_point(rho).unwrap();
                    [p.r - wall * p.normal[0], p.z - wall * p.normal[1]]
                };
                let off = |[a, b]: [[f64; 2]; 2], p: [f64; 2]| {
                    let (u, v) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
                    (u[0] * v[1] - u[1] * v[0]).abs() / u[0].hypot(u[1])
                };
                let mut worst = 0f64;
                for t in [0.25, 0.45, 0.5, 0.55, 0.75] {
                    for w in meridian.windows(2) {
                        let rho = w[0].rho + t * (w[1].rho - w[0].rho);
                        for wall in [0.0, parts.wall_mm()] {
                            let ends = [dome(w[0].rho, wall), dome(w[1].rho, wall)];
                            worst = worst.max(off(ends, dome(rho, wall)));
                        }
                    }
                    for w in convex.windows(2) {
                        let rho = w[0][0] + t * (w[1][0] - w[0][0]);
                        worst = worst.max(off([w[0], w[1]], [rho, parts.mirrors().convex().height(rho)]));
                    }
                }
                assert!(worst < chord_mm && worst > 0.7 * chord_mm, "{worst} of {chord_mm}");
            }
        }
    }

    #[test]
    fn outlines_run_counterclockwise_and_lie_beside_the_axis() {
        for parts in thesis() {
            for part in Part::ALL {
                let outline = parts.section(part, 0.01).unwrap();
                assert!(doubled_area(&outline) > 0.0, "{part:?}");
                assert!(outline.iter().all(|p| p[0] >= 0.0));
                let on_axis = outline.iter().filter(|p| p[0] == 0.0).count();
                assert_eq!(on_axis, if part == Part::Dome { 0 } else { 2 }, "{part:?}");
            }
        }
    }

    #[test]
    fn impossible_parts_are_named() {
        let [parts, _] = thesis();
        let rig = parts.rig();
        for radius in [0.0, -1.0, f64::NAN, 1e3, 60.0] {
            let error = Parts::new(rig, radius, 3.0).unwrap_err();
            assert!(matches!(error, HandoverError::Length { name: "the radius of the opening", .. }), "{error}");
        }
        assert!(matches!(Parts::new(rig, 16.3, 0.0), Err(HandoverError::Length { name: "the wall", .. })));
        assert!(matches!(parts.profile(f64::INFINITY), Err(HandoverError::Length { .. })));
        assert!(matches!(parts.profile(1e-5), Err(HandoverError::TooFine { .. })));
        assert!(matches!(parts.section(Part::Mandrel, -1.0), Err(HandoverError::Length { .. })));
    }
}
