//! From directions back to the pixels of a misaligned device, fast.

use std::f32::consts::{PI, TAU};

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::optics::{Mirrors, Misaligned};

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
    /// End of the paraboloid's nominal shadow, and of its shadow at `AZIMUTHS` azimuths from -pi on, radians.
    shadow: (f32, Vec<f32>),
}

/// Azimuths of the table of the shadow's end.
const AZIMUTHS: usize = 256;

/// Nodes along each side of the table of displacements.
const NODES: usize = 33;
/// Steps of the radial table.
const STEPS: usize = 1024;

impl InverseMap {
    /// Tabulates the inverse of a device's map up to polar angles of `theta_max` radians.
    pub fn new(device: &Misaligned, theta_max: f64) -> Self {
        let reach = theta_max * 1.05;
        let radial = RadialTable::new(device.mirrors());
        let scale = (0..=STEPS).map(|i| {
            let theta = (reach * reach * (i as f64 + 1e-9) / STEPS as f64).sqrt();
            (radial.slope(theta, 0.0).0 / theta * device.lens().focal_px) as f32
        });
        let mut map = Self {
            centre: [device.lens().centre_u as f32, device.lens().centre_v as f32],
            handedness: device.lens().arm.handedness() as f32,
            reach: reach as f32,
            scale: scale.collect(),
            shift: vec![[0.0; 2]; NODES * NODES],
            shadow: shadow(device),
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

    /// Whether a misaligned paraboloid shadows what a nominal one would not, at (theta cos phi, theta sin phi), radians.
    #[inline(always)]
    pub fn shadowed(&self, x: f32, y: f32) -> bool {
        let theta2 = x * x + y * y;
        let (nominal, table) = &self.shadow;
        // Few directions are as near to the pole: the others pay for one comparison.
        if theta2 > 4.0 * nominal * nominal || theta2 < nominal * nominal {
            return false;
        }
        let azimuth = (y.atan2(x) + PI) / TAU * AZIMUTHS as f32;
        let (i, f) = (azimuth as usize, azimuth.fract());
        let end = table[i % AZIMUTHS] + f * (table[(i + 1) % AZIMUTHS] - table[i % AZIMUTHS]);
        theta2 < end * end
    }

    /// Pixel coordinates of the direction at (theta cos phi, theta sin phi), radians, within the reach.
    #[inline(always)]
    pub fn pixel(&self, x: f32, y: f32) -> (f32, f32) {
        let r = ((x * x + y * y) * (STEPS as f32 / (self.reach * self.reach))).min(STEPS as f32 - 1.0);
        // By way of signed integers, which processors convert to in one step.
        let i = r as i32 as usize;
        let scale = self.scale[i] + (r - i as f32) * (self.scale[i + 1] - self.scale[i]);
        let to_node = (NODES - 1) as f32 / (2.0 * self.reach);
        let fx = ((x + self.reach) * to_node).clamp(0.0, (NODES - 2) as f32);
        let fy = ((y + self.reach) * to_node).clamp(0.0, (NODES - 2) as f32);
        let (ix, iy) = (fx as i32 as usize, fy as i32 as usize);
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

/// The end of the nominal shadow and, by azimuth, of the device's own.
fn shadow(device: &Misaligned) -> (f32, Vec<f32>) {
    let mut ends: Vec<(f64, f64)> = device.edges(AZIMUTHS).inner.into_iter().map(|(theta, phi)| (phi, theta)).collect();
    ends.sort_by(|a, b| a.0.total_cmp(&b.0));
    let at = |i: usize| {
        let phi = i as f64 / AZIMUTHS as f64 * std::f64::consts::TAU - std::f64::consts::PI;
        let after = ends.partition_point(|e| e.0 < phi);
        // Azimuths of the image and of directions differ by little: neighbours are a degree away.
        let (before, after) = (ends[(after + ends.len() - 1) % ends.len()], ends[after % ends.len()]);
        (0.5 * (before.1 + after.1)) as f32
    };
    (device.nominal_shadow() as f32, (0..AZIMUTHS).map(at).collect())
}

/// Finds the image point of a direction by correcting the nominal inverse until the traced ray agrees.
fn invert(device: &Misaligned, radial: &RadialTable, x: f64, y: f64) -> (f64, f64) {
    let wanted = radial.slope(x, y);
    let mut slope = wanted;
    for _ in 0..6 {
        let ray = Vector3::new(slope.0, slope.1, -1.0).normalize();
        let Some(d) = device.along(&ray) else { break };
        let (theta, phi) = (d.theta(), d.phi());
        let got = radial.slope(theta * phi.cos(), theta * phi.sin());
        slope = (slope.0 + wanted.0 - got.0, slope.1 + wanted.1 - got.1);
    }
    device.lens().pixel(&Vector3::new(slope.0, slope.1, -1.0))
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
                table.slope.push(rho / (mirrors.centre().z - mirrors.convex().height(rho)));
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
    use crate::optics::{Device, Misalignment, Rig};
    use crate::twin::TwinConfig;

    fn rig() -> Rig {
        Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap()
    }

    #[test]
    fn perturbations_move_directions_by_hundredths_of_a_degree() {
        let rig = rig();
        let device = Misaligned::new(&rig, &TwinConfig::pinhole(0).perturbation, Device::Camera);
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
        let far = Misalignment {
            projector_displacement_mm: [0.35, -0.35],
            projector_turn_deg: [0.15, 0.13],
            paraboloid_offset_mm: [0.3, 0.4],
            sample_tilt_deg: [0.0, 0.2],
            ..Misalignment::none()
        };
        for m in [TwinConfig::pinhole(0).perturbation, far] {
            let device = Misaligned::new(&rig, &m, Device::Projector);
            let inverse = InverseMap::new(&device, 57.5f64.to_radians());
            for (u, v) in [(400.0, 270.0), (480.0, 312.3), (310.0, 380.0), (520.0, 240.0), (535.0, 390.0)] {
                let d = device.direction(u, v).unwrap();
                let (theta, phi) = (d.theta(), d.phi());
                let (gu, gv) = inverse.pixel((theta * phi.cos()) as f32, (theta * phi.sin()) as f32);
                assert!((f64::from(gu) - u).hypot(f64::from(gv) - v) < 0.01, "{u} {v}: {gu} {gv}");
            }
        }
    }
}
