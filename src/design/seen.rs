//! How a rig with errors sees a sample, when it is taken for the nominal one.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use crate::geometry::{Direction, Sample};
use crate::optics::{Device, Misaligned, Misalignment, PupilMap, Rig, cubic, disc};
use crate::reflectance::{Brdf, Towards};

/// Polar angles and azimuths of the table.
const RINGS: usize = 20;
const SECTORS: usize = 32;
/// Differences for the solid angle, radians.
const OFF: f64 = 1e-4;

/// True directions of one device by the directions that the nominal map takes them for.
pub struct Shift {
    theta_min: f64,
    step: f64,
    /// Difference of the unit vectors, and true solid angle over nominal, by `ring * SECTORS + sector`.
    nodes: Vec<[f64; 4]>,
}

impl Shift {
    /// Of a device of `rig` with the errors `m`; `None` if a ray misses a mirror.
    pub fn new(rig: &Rig, m: &Misalignment, device: Device) -> Option<Self> {
        let traced = Misaligned::new(rig, m, device);
        let map = match device {
            Device::Camera => rig.camera_map(),
            Device::Projector => rig.projector_map(),
        };
        let zone = rig.zone();
        let step = (zone.theta_max() - zone.theta_min()) / (RINGS - 3) as f64;
        let theta_min = zone.theta_min() - step;
        let truth = |theta: f64, phi: f64| {
            let (u, v) = map.pixel_beyond(&Direction::from_angles(theta.min(1.55), phi))?;
            traced.direction_beyond(u, v).map(|d| d.vector())
        };
        let node = |i: usize| {
            let (theta, phi) = (theta_min + (i / SECTORS) as f64 * step, (i % SECTORS) as f64 * TAU / SECTORS as f64);
            let along = (truth(theta + OFF, phi)? - truth(theta - OFF, phi)?) / (2.0 * OFF);
            let around = (truth(theta, phi + OFF)? - truth(theta, phi - OFF)?) / (2.0 * OFF * theta.sin());
            let nominal: Direction<Sample> = Direction::from_angles(theta, phi);
            let by = truth(theta, phi)? - nominal.vector();
            Some([by.x, by.y, by.z, along.cross(&around).norm()])
        };
        Some(Self { theta_min, step, nodes: (0..RINGS * SECTORS).map(node).collect::<Option<_>>()? })
    }

    /// The true direction, and true over nominal solid angle, of a direction in the zone.
    pub fn truth(&self, nominal: &Direction<Sample>) -> (Direction<Sample>, f64) {
        let x = ((nominal.theta() - self.theta_min) / self.step).clamp(0.0, (RINGS - 1) as f64);
        let y = nominal.phi().rem_euclid(TAU) / TAU * SECTORS as f64;
        let (i, j) = ((x as usize).clamp(1, RINGS - 3) - 1, y as usize + SECTORS - 1);
        let (wx, wy) = (cubic(x - i as f64 - 1.0), cubic(y.fract()));
        let mut sum = [0.0; 4];
        for (a, wx) in wx.iter().enumerate() {
            for (b, wy) in wy.iter().enumerate() {
                let node = &self.nodes[(i + a) * SECTORS + (j + b) % SECTORS];
                sum.iter_mut().zip(node).for_each(|(s, n)| *s += wx * wy * n);
            }
        }
        let by = Vector3::new(sum[0], sum[1], sum[2]);
        (Direction::new(nominal.vector() + by), sum[3])
    }

    /// RMS angle between true and nominal directions over the table, radians.
    pub fn rms(&self) -> f64 {
        let square = |n: &[f64; 4]| n[..3].iter().map(|x| x * x).sum::<f64>();
        (self.nodes.iter().map(square).sum::<f64>() / self.nodes.len() as f64).sqrt()
    }
}

/// RMS deviations of a device's rays about their chief ray, radians: along the meridian and across it, over polar angles.
#[derive(Default)]
pub struct Blur {
    /// From the pupil: terms per mm, and the radius, mm.
    pub pupil: Option<(PupilMap, f64)>,
    /// From rough surfaces, the same everywhere, radians.
    pub rough: f64,
}

impl Blur {
    fn at(&self, theta: f64) -> [f64; 2] {
        let pupil = self.pupil.as_ref().map_or([0.0; 2], |(map, r)| map.at(theta).direction.map(|b| 0.5 * r * b));
        // The mean square of one coordinate over a disc is a quarter of its radius squared.
        pupil.map(|b| b.hypot(self.rough))
    }

    fn is_none(&self) -> bool {
        self.pupil.is_none() && self.rough == 0.0
    }

    /// Directions about `d` whose mean has the second moments of the blur.
    fn around(&self, d: &Direction<Sample>) -> Vec<Direction<Sample>> {
        if self.is_none() {
            return vec![*d];
        }
        let (theta, phi) = (d.theta(), d.phi());
        let [along, across] = self.at(theta).map(|b| b * std::f64::consts::SQRT_2);
        let across = across / theta.sin();
        vec![
            Direction::from_angles(theta + along, phi),
            Direction::from_angles(theta - along, phi),
            Direction::from_angles(theta, phi + across),
            Direction::from_angles(theta, phi - across),
        ]
    }
}

/// What the projector lights of what the camera sees, to first order in the pupils.
pub struct Lit {
    /// Terms of the camera's pupil, and its radius, mm.
    pub camera: (PupilMap, f64),
    /// Terms of the projector's pupil, and its radius, mm.
    pub projector: (PupilMap, f64),
    /// Height of the sample above its place, mm.
    pub height_mm: f64,
}

impl Lit {
    /// Of a rig whose sample is `height_mm` too high; `None` if a ray of a pupil misses a mirror.
    pub fn new(rig: &Rig, height_mm: f64) -> Option<Self> {
        let zone = rig.zone();
        let of = |device, pupil_mm| {
            let traced = Misaligned::new(rig, &Misalignment::none(), device);
            Some((PupilMap::new(&traced, zone.theta_min(), zone.theta_max())?, pupil_mm))
        };
        let camera = of(Device::Camera, rig.camera.pupil_mm())?;
        Some(Self { camera, projector: of(Device::Projector, rig.projector.pupil_mm())?, height_mm })
    }

    /// |Fp ∩ Fc| / |Fc|: the share of the camera's pupil whose points of the sample send their light into the projector's.
    pub fn share(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> f64 {
        let radial = |d: &Direction<Sample>, along: f64, across: f64| {
            let (sin, cos) = d.phi().sin_cos();
            [along * cos - across * sin, along * sin + across * cos]
        };
        // Along either ray the raised surface is met off the middle.
        let (lift_o, lift_i) = (self.height_mm * wo.theta().tan(), self.height_mm * wi.theta().tan());
        let (seen, light) = (self.camera.0.at(wo.theta()).position, self.projector.0.at(wi.theta()).position);
        let lifted = radial(wi, lift_i, 0.0);
        let (sin, cos) = wi.phi().sin_cos();
        let lit = disc().filter(|p| {
            let x = radial(wo, self.camera.1 * seen[0] * p[0] + lift_o, self.camera.1 * seen[1] * p[1]);
            let (x, y) = (x[0] - lifted[0], x[1] - lifted[1]);
            let pupil = [(x * cos + y * sin) / light[0], (y * cos - x * sin) / light[1]];
            pupil[0].hypot(pupil[1]) <= self.projector.1
        });
        lit.count() as f64 / disc().count() as f64
    }
}

/// A sample as a rig with errors sees it: f_cos of nominal directions, with all that the errors do to it.
pub struct Seen<'a> {
    /// The sample.
    pub brdf: &'a dyn Brdf,
    /// Of the projector.
    pub projector: Shift,
    /// Of the camera.
    pub camera: Shift,
    /// Of the projector's light.
    pub projector_blur: Blur,
    /// Of the camera's view.
    pub camera_blur: Blur,
    /// What is lit; all of it if none.
    pub lit: Option<Lit>,
}

impl Brdf for Seen<'_> {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        self.eval_cos(wi, wo).map(|f_cos| f_cos / wi.cos_theta().max(1e-9))
    }

    fn eval_cos(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        self.towards(wo)(wi)
    }

    fn towards<'a>(&'a self, wo: &Direction<Sample>) -> Towards<'a> {
        let (wo, _) = self.camera.truth(wo);
        let lit_share = move |wi: &Direction<Sample>| self.lit.as_ref().map_or(1.0, |lit| lit.share(wi, &wo));
        let views: Vec<Towards<'a>> = self.camera_blur.around(&wo).iter().map(|wo| self.brdf.towards(wo)).collect();
        Box::new(move |wi| {
            let (wi, solid_angle) = self.projector.truth(wi);
            let lit = self.projector_blur.around(&wi);
            let share = solid_angle * lit_share(&wi) / (views.len() * lit.len()) as f64;
            let mut sum = [0.0; 3];
            for view in &views {
                for wi in &lit {
                    sum.iter_mut().zip(view(wi)).for_each(|(s, f)| *s += share * f);
                }
            }
            sum
        })
    }

    fn is_isotropic(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig() -> Rig {
        Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap()
    }

    /// Figures of the derivation: equal pupils keep 40%, and the recommended projector holds to 0.2 mm.
    #[test]
    fn shares_are_those_of_footprints() {
        let mut rig = rig();
        let at = |theta_deg: f64, phi: f64| Direction::from_angles(theta_deg.to_radians(), phi);
        let wide = Lit::new(&rig, 0.2).unwrap();
        for (wi, wo, phi) in [(9.0, 57.0, 0.0), (9.0, 57.0, 3.1), (57.0, 57.0, 3.1), (57.0, 9.0, 1.0)] {
            assert_eq!(wide.share(&at(wi, phi), &at(wo, 0.0)), 1.0, "{wi} {wo} {phi}");
        }
        assert!(Lit::new(&rig, 2.0).unwrap().share(&at(57.0, 3.1), &at(57.0, 0.0)) < 0.5);
        rig.projector.f_number = rig.projector.focal_length_mm / (2.0 * rig.camera.pupil_mm());
        let equal = Lit::new(&rig, 0.0).unwrap().share(&at(9.15, 0.0), &at(57.0, 0.0));
        assert!((equal - 0.40).abs() < 0.03, "{equal}");
    }

    #[test]
    fn shifts_are_those_of_traced_rays() {
        let (rig, device) = (rig(), Device::Projector);
        let m = Misalignment { dome_offset_mm: [0.3, -0.2], paraboloid_tilt_deg: [0.1, 0.2], ..Misalignment::none() };
        let shift = Shift::new(&rig, &m, device).unwrap();
        let traced = Misaligned::new(&rig, &m, device);
        let mut moved = 0.0f64;
        for i in 0..300 {
            let d = Direction::from_angles((9.0 + 0.16 * f64::from(i)).to_radians(), 2.4 * f64::from(i));
            let (u, v) = rig.projector_map().pixel(&d).unwrap();
            let want = traced.direction_beyond(u, v).unwrap().vector();
            let (got, _) = shift.truth(&d);
            assert!((got.vector() - want).norm() < 2e-5, "{i}: {}", (got.vector() - want).norm());
            moved = moved.max((want - d.vector()).norm());
        }
        assert!(moved > 0.005, "{moved}");
    }

    /// The zone's solid angle as truly lit is the nominal one times the mean of the ratio.
    #[test]
    fn an_aligned_rig_changes_nothing_and_a_tilted_sample_no_solid_angle() {
        let rig = rig();
        let none = Shift::new(&rig, &Misalignment::none(), Device::Camera).unwrap();
        assert!(none.rms() < 1e-8, "{}", none.rms());
        let tilted = Misalignment { sample_tilt_deg: [0.5, 0.3], ..Misalignment::none() };
        let tilted = Shift::new(&rig, &tilted, Device::Camera).unwrap();
        let angle = 0.5f64.hypot(0.3).to_radians();
        assert!((tilted.rms() / angle - 1.0).abs() < 0.3, "{}", tilted.rms() / angle);
        for n in &tilted.nodes {
            assert!((n[3] - 1.0).abs() < 1e-5, "{}", n[3]);
        }
    }
}
