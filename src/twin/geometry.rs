//! Rays through mirrors that are not quite where they should be.

use nalgebra::{Point3, Rotation3, Vector3};
use rayon::prelude::*;

use super::Perturbation;
use crate::geometry::{Direction, Rig as RigFrame, Sample};
use crate::optics::{Lens, Mirrors, Rig};

/// One device of the perturbed rig: real intersections with both mirrors, no closed form for the dome.
#[derive(Debug, Clone)]
pub struct PerturbedDevice {
    mirrors: Mirrors,
    lens: Lens,
    paraboloid: Vector3<f64>,
    dome: Vector3<f64>,
    rig_from_sample: Rotation3<f64>,
    sample_height_mm: f64,
    radius_mm: f64,
    theta_max: f64,
}

impl PerturbedDevice {
    /// The camera of a perturbed rig.
    pub fn camera(rig: &Rig, perturbation: &Perturbation) -> Self {
        Self::new(
            rig,
            perturbation,
            misplaced(rig.camera.lens(), perturbation.camera_offset_px, perturbation.camera_scale_rel),
        )
    }

    /// The projector of a perturbed rig.
    pub fn projector(rig: &Rig, perturbation: &Perturbation) -> Self {
        Self::new(
            rig,
            perturbation,
            misplaced(rig.projector.lens(), perturbation.projector_offset_px, perturbation.projector_scale_rel),
        )
    }

    fn new(rig: &Rig, perturbation: &Perturbation, lens: Lens) -> Self {
        let flat = |v: [f64; 2]| Vector3::new(v[0], v[1], 0.0);
        let tilt = perturbation.sample_tilt_deg.map(f64::to_radians);
        Self {
            mirrors: rig.mirrors(),
            lens,
            paraboloid: flat(perturbation.paraboloid_offset_mm),
            dome: flat(perturbation.dome_offset_mm),
            rig_from_sample: Rotation3::from_euler_angles(tilt[0], tilt[1], 0.0),
            sample_height_mm: perturbation.sample_height_mm,
            radius_mm: rig.paraboloid_radius_mm(),
            theta_max: rig.dome.theta_max_deg.to_radians(),
        }
    }

    /// The lens, its shift included.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// The direction at the sample of the image point (u, v); `None` where the ray misses a mirror as built.
    pub fn direction(&self, u: f64, v: f64) -> Option<Direction<Sample>> {
        let (direction, rho, theta) = self.trace(&self.lens.ray(u, v))?;
        (rho <= self.radius_mm && theta <= self.theta_max).then_some(direction)
    }

    /// Direction at the sample, radius on the paraboloid (mm) and polar angle of the point on the dome, of the ray `e`.
    fn trace(&self, e: &Vector3<f64>) -> Option<(Direction<Sample>, f64, f64)> {
        let origin = self.mirrors.centre() - self.paraboloid;
        let t = self.mirrors.hit_paraboloid(&origin, e)?;
        let p = origin + e * t;
        let rho = p.x.hypot(p.y);
        let d = self.mirrors.reflect(&p, e);
        let (hit, normal) = self.hit_dome(&(p + self.paraboloid - self.dome), &d, rho)?;
        let out = d - normal * (2.0 * d.dot(&normal));
        let theta = hit.x.hypot(hit.y).atan2(hit.z);
        // Of the pupil's rays from here, those that meet a raised sample on the axis leave a little steeper.
        let seen = -out - Vector3::z() * (self.sample_height_mm / hit.coords.norm());
        Some((Direction::<RigFrame>::new(seen).to_sample(&self.rig_from_sample), rho, theta))
    }

    /// Meets the ray with the dome as a surface of revolution, by Newton steps along the ray and along the profile, from
    /// the nominal point. Returns the point and the unit normal.
    fn hit_dome(&self, origin: &Point3<f64>, d: &Vector3<f64>, rho: f64) -> Option<(Point3<f64>, Vector3<f64>)> {
        const STEP_MM: f64 = 1e-3;
        let mut s = rho.max(1e-2);
        let mut t = (self.mirrors.profile(s)? - Point3::new(s, 0.0, self.mirrors.paraboloid_height(s))).norm();
        let mut found = None;
        for _ in 0..4 {
            let hit = origin + d * t;
            let at = self.mirrors.profile(s)?;
            let tangent = (self.mirrors.profile(s + STEP_MM)? - self.mirrors.profile(s - STEP_MM)?) / (2.0 * STEP_MM);
            let speed = tangent.norm();
            let (tr, tz) = (tangent.x / speed, tangent.z / speed);
            let r = hit.x.hypot(hit.y);
            let (cos_phi, sin_phi) = if r > 0.0 { (hit.x / r, hit.y / r) } else { (1.0, 0.0) };
            let normal = Vector3::new(-tz * cos_phi, -tz * sin_phi, tr);
            found = Some((hit, normal));
            let (dr, dz) = (r - at.x, hit.z - at.z);
            t -= (dr * -tz + dz * tr) / d.dot(&normal);
            s += (dr * tr + dz * tz) / speed;
        }
        found
    }
}

fn misplaced(lens: Lens, offset: [f64; 2], scale_rel: f64) -> Lens {
    let focal_px = lens.focal_px * (1.0 + scale_rel);
    Lens { centre_u: lens.centre_u + offset[0], centre_v: lens.centre_v + offset[1], focal_px, ..lens }
}

/// Directions back to a device's pixels: the nominal radial map and a small table of what the perturbation adds to it.
///
/// Arguments are points (theta cos phi, theta sin phi) of a disc, in radians; within 0.01 px.
#[derive(Debug, Clone)]
pub struct InverseMap {
    centre: [f32; 2],
    handedness: f32,
    reach: f32,
    /// Pixels per radian over theta^2, `STEPS + 1` values up to reach^2.
    scale: Vec<f32>,
    /// Displacement at `NODES` x `NODES` points over [-reach, reach]^2.
    shift: Vec<[f32; 2]>,
}

/// Nodes along each side of the table of displacements.
const NODES: usize = 33;
/// Steps of the radial table.
const STEPS: usize = 1024;

impl InverseMap {
    /// Tabulates the inverse of a device's map up to polar angles of `theta_max` radians.
    pub fn new(device: &PerturbedDevice, theta_max: f64) -> Self {
        let reach = theta_max * 1.05;
        let radial = RadialTable::new(&device.mirrors);
        let scale = (0..=STEPS).map(|i| {
            let theta = (reach * reach * (i as f64 + 1e-9) / STEPS as f64).sqrt();
            (radial.slope(theta, 0.0).0 / theta * device.lens.focal_px) as f32
        });
        let mut map = Self {
            centre: [device.lens.centre_u as f32, device.lens.centre_v as f32],
            handedness: device.lens.arm.handedness() as f32,
            reach: reach as f32,
            scale: scale.collect(),
            shift: vec![[0.0; 2]; NODES * NODES],
        };
        let nodes = (0..NODES * NODES).into_par_iter().map(|i| {
            let at = |j: usize| (j as f64 / (NODES - 1) as f64 * 2.0 - 1.0) * reach;
            // Corners of the square lie beyond the mirrors: take the displacement of the disc's edge there.
            let (x, y) = (at(i % NODES), at(i / NODES));
            let shrink = (theta_max / x.hypot(y)).min(1.0);
            let (x, y) = (x * shrink, y * shrink);
            let (u, v) = invert(device, &radial, x, y);
            let (nominal_u, nominal_v) = map.pixel(x as f32, y as f32);
            [u as f32 - nominal_u, v as f32 - nominal_v]
        });
        map.shift = nodes.collect();
        map
    }

    /// Pixel coordinates of the direction at (theta cos phi, theta sin phi), radians, within the reach.
    #[inline]
    pub fn pixel(&self, x: f32, y: f32) -> (f32, f32) {
        let r = ((x * x + y * y) * (STEPS as f32 / (self.reach * self.reach))).min(STEPS as f32 - 1.0);
        let i = r as usize;
        let scale = self.scale[i] + (r - i as f32) * (self.scale[i + 1] - self.scale[i]);
        let to_node = (NODES - 1) as f32 / (2.0 * self.reach);
        let fx = ((x + self.reach) * to_node).clamp(0.0, (NODES - 2) as f32);
        let fy = ((y + self.reach) * to_node).clamp(0.0, (NODES - 2) as f32);
        let (ix, iy) = (fx as usize, fy as usize);
        let (tx, ty) = (fx - ix as f32, fy - iy as f32);
        let row = &self.shift[iy * NODES + ix..][..NODES + 2];
        let mix = |k: usize| {
            let top = row[0][k] + tx * (row[1][k] - row[0][k]);
            let bottom = row[NODES][k] + tx * (row[NODES + 1][k] - row[NODES][k]);
            top + ty * (bottom - top)
        };
        (self.centre[0] + x * scale + mix(0), self.centre[1] - self.handedness * y * scale + mix(1))
    }
}

/// Finds the image point of a direction by correcting the nominal inverse until the traced ray agrees.
fn invert(device: &PerturbedDevice, radial: &RadialTable, x: f64, y: f64) -> (f64, f64) {
    let wanted = radial.slope(x, y);
    let mut slope = wanted;
    for _ in 0..3 {
        let ray = Vector3::new(slope.0, slope.1, -1.0).normalize();
        let Some((d, _, _)) = device.trace(&ray) else { break };
        let (theta, phi) = (d.theta(), d.phi());
        let got = radial.slope(theta * phi.cos(), theta * phi.sin());
        slope = (slope.0 + wanted.0 - got.0, slope.1 + wanted.1 - got.1);
    }
    device.lens.pixel(&Vector3::new(slope.0, slope.1, -1.0))
}

/// Slope of the nominal ray for a polar angle at the sample.
struct RadialTable {
    theta: Vec<f64>,
    slope: Vec<f64>,
}

impl RadialTable {
    fn new(mirrors: &Mirrors) -> Self {
        const SAMPLES: usize = 8192;
        let mut table = Self { theta: vec![0.0], slope: vec![0.0] };
        for i in 1..=SAMPLES {
            let rho = mirrors.edge_radius() * 1.03 * i as f64 / SAMPLES as f64;
            if let Some(p) = mirrors.profile(rho) {
                table.theta.push(p.x.atan2(p.z));
                table.slope.push(rho / (mirrors.centre().z - mirrors.paraboloid_height(rho)));
            }
        }
        table
    }

    fn slope(&self, x: f64, y: f64) -> (f64, f64) {
        let theta = x.hypot(y);
        if theta == 0.0 {
            return (0.0, 0.0);
        }
        let i = self.theta.partition_point(|&t| t <= theta).clamp(1, self.theta.len() - 1);
        let f = (theta - self.theta[i - 1]) / (self.theta[i] - self.theta[i - 1]);
        let slope = self.slope[i - 1] + f * (self.slope[i] - self.slope[i - 1]);
        (slope * x / theta, slope * y / theta)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::twin::TwinConfig;

    fn rig() -> Rig {
        Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap()
    }

    /// Two independent ways to the same direction: real intersections here, the closed form in `optics`.
    #[test]
    fn an_unperturbed_rig_is_the_nominal_one() {
        let rig = rig();
        let (traced, nominal) = (PerturbedDevice::camera(&rig, &Perturbation::none()), rig.camera_map());
        for (u, v) in [(680.0, 470.0), (800.0, 512.3), (610.0, 380.0), (880.0, 560.0)] {
            let (a, b) = (traced.direction(u, v).unwrap(), nominal.direction(u, v).unwrap());
            assert!((a.vector() - b.vector()).norm() < 1e-7, "{u} {v}");
        }
    }

    #[test]
    fn perturbations_move_directions_by_hundredths_of_a_degree() {
        let rig = rig();
        let device = PerturbedDevice::camera(&rig, &TwinConfig::pinhole(0).perturbation);
        let nominal = rig.camera_map();
        let mut worst = 0.0f64;
        for (u, v) in [(680.0, 470.0), (800.0, 512.3), (610.0, 380.0), (880.0, 560.0)] {
            let angle = (device.direction(u, v).unwrap().vector() - nominal.direction(u, v).unwrap().vector()).norm();
            worst = worst.max(angle.to_degrees());
        }
        assert!((0.005..0.1).contains(&worst), "{worst} deg");
    }

    #[test]
    fn the_inverse_map_undoes_the_trace() {
        let rig = rig();
        let device = PerturbedDevice::projector(&rig, &TwinConfig::pinhole(0).perturbation);
        let inverse = InverseMap::new(&device, 57.5f64.to_radians());
        for (u, v) in [(400.0, 270.0), (480.0, 312.3), (310.0, 380.0), (520.0, 240.0), (535.0, 390.0)] {
            let d = device.direction(u, v).unwrap();
            let (theta, phi) = (d.theta(), d.phi());
            let (gu, gv) = inverse.pixel((theta * phi.cos()) as f32, (theta * phi.sin()) as f32);
            assert!((f64::from(gu) - u).hypot(f64::from(gv) - v) < 0.01, "{u} {v}: {gu} {gv}");
        }
    }
}
