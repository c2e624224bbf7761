//! What the pupils of camera and projector add to their chief rays: footprints on the sample, blur, and light that is lost.

use std::f64::consts::TAU;

use super::{Arrival, Misaligned};
use crate::geometry::{Direction, Sample};

/// Rays along a pupil's edge.
const EDGE_RAYS: usize = 64;
/// Rings of the disc rule, with equal shares of its area.
const RINGS: usize = 4;
/// Azimuths of each ring.
const SPOKES: usize = 12;

/// Points of a disc of radius 1, of equal weight: second moments are those of the disc, fourth within 2%.
pub fn disc() -> impl Iterator<Item = [f64; 2]> {
    (0..RINGS * SPOKES).map(|i| {
        let (ring, spoke) = (i / SPOKES, i % SPOKES);
        let r = ((ring as f64 + 0.5) / RINGS as f64).sqrt();
        // Every other ring is turned by half a step.
        let (sin, cos) = ((spoke as f64 + 0.5 * (ring % 2) as f64) * TAU / SPOKES as f64).sin_cos();
        [r * cos, r * sin]
    })
}

/// The rays of one device that belong to one point of its image.
#[derive(Debug, Clone, PartialEq)]
pub struct Beam {
    /// The chief ray's direction at the sample.
    pub chief: Direction<Sample>,
    /// Edge of what the pupil covers of the sample's plane, mm, in turn.
    pub footprint: Vec<[f64; 2]>,
    /// Half of the footprint's extent along the meridian of the chief ray and across it, mm.
    pub semi_axes_mm: [f64; 2],
    /// RMS angle between the pupil's rays and their mean, radians.
    pub spread: f64,
    /// Angle between the mean of the pupil's rays and the chief ray, radians.
    pub shift: f64,
    /// Share of the pupil whose rays find nothing in their way.
    pub transmitted: f64,
}

impl Beam {
    /// The rays from (or to) a pupil of radius `pupil_mm` for the image point (u, v); `None` if one misses a mirror.
    pub fn new(device: &Misaligned, u: f64, v: f64, pupil_mm: f64) -> Option<Self> {
        let through = |p: [f64; 2]| device.through(u, v, p.map(|x| x * pupil_mm));
        let chief = through([0.0, 0.0])?.direction;
        let edge = |i: usize| {
            let (sin, cos) = (i as f64 * TAU / EDGE_RAYS as f64).sin_cos();
            Some(through([cos, sin])?.position_mm)
        };
        let footprint: Vec<[f64; 2]> = (0..EDGE_RAYS).map(edge).collect::<Option<_>>()?;
        let rays: Vec<Arrival> = disc().map(through).collect::<Option<_>>()?;
        let n = rays.len() as f64;
        let mean = rays.iter().map(|r| r.direction.vector()).sum::<nalgebra::Vector3<f64>>() / n;
        let square = rays.iter().map(|r| (r.direction.vector() - mean).norm_squared()).sum::<f64>() / n;
        let (sin, cos) = chief.phi().sin_cos();
        let extent = |x: f64, y: f64| {
            let along = footprint.iter().map(|p| p[0] * x + p[1] * y);
            let (lo, hi) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), a| (lo.min(a), hi.max(a)));
            0.5 * (hi - lo)
        };
        Some(Self {
            chief,
            semi_axes_mm: [extent(cos, sin), extent(-sin, cos)],
            spread: square.sqrt(),
            shift: (mean.normalize() - chief.vector()).norm(),
            transmitted: rays.iter().filter(|r| r.unhindered).count() as f64 / n,
            footprint,
        })
    }

    /// |Fp ∩ Fc| / |Fc| with `self` the projector's beam: the share of the camera's footprint that it lights.
    ///
    /// 1 is the design rule: then a pattern shows Z_k itself and no factor of (wi, wo) remains.
    pub fn lit_share(&self, camera: &Self) -> f64 {
        area(&clipped(&camera.footprint, &self.footprint)) / area(&camera.footprint)
    }
}

/// Area of a polygon, mm^2.
fn area(polygon: &[[f64; 2]]) -> f64 {
    let next = polygon.iter().cycle().skip(1);
    0.5 * polygon.iter().zip(next).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>().abs()
}

/// The part of a convex polygon inside another: Sutherland and Hodgman's method.
fn clipped(polygon: &[[f64; 2]], by: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let turn: f64 = by.iter().zip(by.iter().cycle().skip(1)).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum();
    let mut kept = polygon.to_vec();
    for (a, b) in by.iter().zip(by.iter().cycle().skip(1)) {
        let side = |p: &[f64; 2]| ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])) * turn.signum();
        let mut next = Vec::with_capacity(kept.len() + 2);
        for (i, p) in kept.iter().enumerate() {
            let q = &kept[(i + 1) % kept.len()];
            let (sp, sq) = (side(p), side(q));
            if sp >= 0.0 {
                next.push(*p);
            }
            if sp * sq < 0.0 {
                let t = sp / (sp - sq);
                next.push([p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])]);
            }
        }
        kept = next;
        if kept.len() < 3 {
            return Vec::new();
        }
    }
    kept
}

/// What a point of the pupil, 1 mm off its middle, does to the ray of one image point: (along the meridian, across it).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PupilTerms {
    /// Displacement on the sample's plane, mm per mm.
    pub position: [f64; 2],
    /// What squares add to the displacement, mm per mm^2: p_r^2 and p_a^2 along the meridian, p_r p_a across it.
    pub coma: [f64; 3],
    /// Change of the direction at the sample, radians per mm: (of theta, of phi times sin theta).
    pub direction: [f64; 2],
}

/// [`PupilTerms`] of a device over polar angles.
#[derive(Debug, Clone, PartialEq)]
pub struct PupilMap {
    theta_min: f64,
    step: f64,
    terms: Vec<PupilTerms>,
}

/// Polar angles of the table.
const ANGLES: usize = 256;
/// Points of the pupil for differences, mm off its middle.
const OFF_MM: f64 = 0.05;
/// The same for second differences.
const FAR_MM: f64 = 2.0;

impl PupilMap {
    /// Of a device, from image points along its +x axis, for polar angles in [theta_min, theta_max], radians.
    ///
    /// `None` if a ray misses a mirror.
    pub fn new(device: &Misaligned, theta_min: f64, theta_max: f64) -> Option<Self> {
        let step = (theta_max - theta_min) / (ANGLES - 1) as f64;
        let terms = (0..ANGLES).map(|i| PupilTerms::new(device, theta_min + step * i as f64));
        Some(Self { theta_min, step, terms: terms.collect::<Option<_>>()? })
    }

    /// At the polar angle `theta`, radians; at the table's ends beyond it.
    pub fn at(&self, theta: f64) -> PupilTerms {
        let x = ((theta - self.theta_min) / self.step).clamp(0.0, (ANGLES - 1) as f64 - 1e-9);
        let (i, t) = (x as usize, x.fract());
        let (a, b) = (&self.terms[i], &self.terms[i + 1]);
        let mix = |a: [f64; 2], b: [f64; 2]| [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])];
        PupilTerms {
            position: mix(a.position, b.position),
            coma: [0, 1, 2].map(|i| a.coma[i] + t * (b.coma[i] - a.coma[i])),
            direction: mix(a.direction, b.direction),
        }
    }
}

impl PupilTerms {
    /// Displacement on the sample's plane for the point `p` of the pupil, mm: (along the meridian, across it).
    pub fn displacement(&self, p: [f64; 2]) -> [f64; 2] {
        let [along, across] = self.squares(p);
        [self.position[0] * p[0] + along, self.position[1] * p[1] + across]
    }

    /// The point of the pupil for the displacement `x`, mm: inverse of [`PupilTerms::displacement`] up to squares.
    pub fn point(&self, x: [f64; 2]) -> [f64; 2] {
        let linear = [x[0] / self.position[0], x[1] / self.position[1]];
        let [along, across] = self.squares(linear);
        [(x[0] - along) / self.position[0], (x[1] - across) / self.position[1]]
    }

    fn squares(&self, p: [f64; 2]) -> [f64; 2] {
        [self.coma[0] * p[0] * p[0] + self.coma[1] * p[1] * p[1], self.coma[2] * p[0] * p[1]]
    }

    /// Of the image point in the device's half plane phi = 0 that shows `theta` in the nominal rig; `None` if it misses a mirror.
    pub fn new(device: &Misaligned, theta: f64) -> Option<Self> {
        let (u, v) = device.nominal_image(theta)?;
        let at = |x: f64, y: f64| device.through(u, v, [x, y]);
        let (east, west) = (at(OFF_MM, 0.0)?, at(-OFF_MM, 0.0)?);
        let (north, south) = (at(0.0, OFF_MM)?, at(0.0, -OFF_MM)?);
        let per_mm = 0.5 / OFF_MM;
        let far = |x: f64, y: f64| Some(at(x * FAR_MM, y * FAR_MM)?.position_mm);
        let middle = far(0.0, 0.0)?[0];
        let mean = |a: [f64; 2], b: [f64; 2]| (0.5 * (a[0] + b[0]) - middle) / FAR_MM.powi(2);
        let twist = (far(1.0, 1.0)?[1] - far(1.0, -1.0)?[1]) - (far(-1.0, 1.0)?[1] - far(-1.0, -1.0)?[1]);
        let coma = [
            mean(far(1.0, 0.0)?, far(-1.0, 0.0)?),
            mean(far(0.0, 1.0)?, far(0.0, -1.0)?),
            0.25 * twist / FAR_MM.powi(2),
        ];
        Some(Self {
            coma,
            position: [
                (east.position_mm[0] - west.position_mm[0]) * per_mm,
                (north.position_mm[1] - south.position_mm[1]) * per_mm,
            ],
            direction: [
                (east.direction.theta() - west.direction.theta()) * per_mm,
                (north.direction.vector().y - south.direction.vector().y) * per_mm,
            ],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Device, Misalignment, Rig};

    fn rig() -> Rig {
        Rig::from_toml(include_str!("../../optics/ghosh-2007-full.toml")).unwrap()
    }

    fn device(device: Device) -> Misaligned {
        Misaligned::new(&rig(), &Misalignment::none(), device)
    }

    /// Figures of the derivation for the thesis rig, which gives two digits of the blur and three of the footprints.
    #[test]
    fn footprints_and_blur_of_the_thesis_rig() {
        let camera = device(Device::Camera);
        for (theta_deg, radial, azimuthal) in [(9.15f64, 0.0367, 0.0363), (57.0, 0.0748, 0.0446), (85.0, 0.542, 0.059)]
        {
            let terms = PupilTerms::new(&camera, theta_deg.to_radians()).unwrap();
            assert!((terms.position[0].abs() / radial - 1.0).abs() < 0.02, "{theta_deg}: {:?}", terms.position);
            assert!((terms.position[1].abs() / azimuthal - 1.0).abs() < 0.02, "{theta_deg}: {:?}", terms.position);
        }
        for (theta_deg, blur) in [(10.0f64, 0.13), (40.0, 0.02), (57.0, -0.09), (70.0, -0.20), (88.0, -0.36)] {
            let terms = PupilTerms::new(&camera, theta_deg.to_radians()).unwrap();
            let got = terms.direction[0].to_degrees();
            assert!((got - blur).abs() < 0.006, "{theta_deg}: {got}");
        }
    }

    #[test]
    fn traced_beams_are_what_linear_terms_say() {
        let camera = device(Device::Camera);
        let r = rig().camera.pupil_mm();
        for theta_deg in [12f64, 30.0, 57.0] {
            let (u, v) = camera.nominal_image(theta_deg.to_radians()).unwrap();
            let beam = Beam::new(&camera, u, v, r).unwrap();
            let terms = PupilTerms::new(&camera, theta_deg.to_radians()).unwrap();
            for i in 0..2 {
                assert!((beam.semi_axes_mm[i] / (r * terms.position[i].abs()) - 1.0).abs() < 0.02, "{theta_deg}");
            }
            // The mean square of one coordinate over a disc is a quarter of its radius squared.
            let spread = 0.5 * r * terms.direction[0].hypot(terms.direction[1]);
            assert!((beam.spread / spread - 1.0).abs() < 0.03, "{theta_deg}: {} {spread}", beam.spread);
            assert_eq!(beam.transmitted, 1.0);
        }
    }

    #[test]
    fn discs_and_polygons_are_as_large_as_they_should_be() {
        let square = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];
        let turned = [[1.0, 0.0], [1.0, 3.0], [-1.0, 3.0], [-1.0, 0.0]]; // the other way round, too
        assert!((area(&clipped(&square, &turned)) - 2.0).abs() < 1e-12);
        assert!((area(&clipped(&turned, &square)) - 2.0).abs() < 1e-12);
        let far = square.map(|p| [p[0] + 5.0, p[1]]);
        assert_eq!(area(&clipped(&square, &far)), 0.0);
        let second: f64 = disc().map(|p| p[0] * p[0]).sum::<f64>() / disc().count() as f64;
        assert!((second - 0.25).abs() < 1e-12, "{second}");
    }

    /// Where projector and camera have pupils of the same size, a wide camera footprint is lit in part.
    #[test]
    fn equal_pupils_leave_forty_percent() {
        let (camera, projector) = (device(Device::Camera), device(Device::Projector));
        let beam = |d: &Misaligned, theta_deg: f64| {
            let (u, v) = d.nominal_image(theta_deg.to_radians()).unwrap();
            Beam::new(d, u, v, 1.5625).unwrap()
        };
        let share = beam(&projector, 9.15).lit_share(&beam(&camera, 57.0));
        assert!((share - 0.40).abs() < 0.01, "{share}");
        let wide = {
            let (u, v) = projector.nominal_image(9.15f64.to_radians()).unwrap();
            Beam::new(&projector, u, v, 12.5).unwrap()
        };
        assert_eq!(wide.lit_share(&beam(&camera, 57.0)), 1.0);
    }
}
