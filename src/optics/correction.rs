//! What a calibrated map adds to the nominal one.

use super::{Misaligned, OpticalMap};

/// Nodes along each side of the table: with cubic interpolation misalignments of a millimetre leave less than 1e-3 deg.
const NODES: usize = 65;

/// A smooth table of pixel shifts over a device's panel: the direction of (u, v) is that of (u + du, v + dv) in the nominal
/// map.
#[derive(Debug, Clone, PartialEq)]
pub struct MapCorrection {
    /// Image point of the first node.
    origin: [f64; 2],
    /// Distance between nodes, px.
    step: f64,
    /// (du, dv) of `NODES` x `NODES` nodes, row by row.
    shifts: Vec<[f64; 2]>,
}

impl MapCorrection {
    /// The correction that makes the nominal map of a device that of the misaligned one.
    ///
    /// Nodes lie about the zone's image; beyond it, and where no ray reaches the sample, the nearest shift serves.
    pub fn new(nominal: &OpticalMap, device: &Misaligned) -> Self {
        let (c_u, c_v) = device.image_centre();
        // One node and a half beyond the image, so that all taps of its points lie on traced rays.
        let image = nominal.reach_px();
        let step = 2.0 * image / (NODES as f64 - 4.0);
        let half = step * (NODES - 1) as f64 / 2.0;
        let reach = image + 1.5 * step;
        let shift = |i: usize| {
            let (x, y) = ((i % NODES) as f64 * step - half, (i / NODES) as f64 * step - half);
            let shrink = (reach / x.hypot(y)).min(1.0);
            let (u, v) = (c_u + x * shrink, c_v + y * shrink);
            let seen = device.direction_beyond(u, v);
            let (nu, nv) = seen.and_then(|d| nominal.pixel_beyond(&d)).unwrap_or((u, v));
            [nu - u, nv - v]
        };
        Self { origin: [c_u - half, c_v - half], step, shifts: (0..NODES * NODES).map(shift).collect() }
    }

    /// The point of the nominal image that shows what (u, v) shows.
    #[inline]
    pub fn to_nominal(&self, u: f64, v: f64) -> (f64, f64) {
        let tap = |x: f64, origin: f64| {
            let x = ((x - origin) / self.step).clamp(1.0, (NODES - 2) as f64 - 1e-9);
            let first = x as usize;
            (first - 1, cubic(x - first as f64))
        };
        let ((i, wu), (j, wv)) = (tap(u, self.origin[0]), tap(v, self.origin[1]));
        let (mut du, mut dv) = (0.0, 0.0);
        for (row, wv) in wv.iter().enumerate() {
            let nodes = &self.shifts[(j + row) * NODES + i..][..4];
            for (node, wu) in nodes.iter().zip(&wu) {
                du += wu * wv * node[0];
                dv += wu * wv * node[1];
            }
        }
        (u + du, v + dv)
    }

    /// The point that shows what (u, v) shows in the nominal image: inverse of [`MapCorrection::to_nominal`] to 1e-10 px.
    pub fn from_nominal(&self, u: f64, v: f64) -> (f64, f64) {
        let (mut x, mut y) = (u, v);
        // The shift hardly varies: each step is some fifty times nearer.
        for _ in 0..16 {
            let (nu, nv) = self.to_nominal(x, y);
            (x, y) = (x + u - nu, y + v - nv);
        }
        (x, y)
    }
}

/// Weights of four nodes at -1, 0, 1, 2 for the position x, best within 0 <= x < 1: Lagrange's cubic.
pub(crate) fn cubic(x: f64) -> [f64; 4] {
    let (a, b, c) = (x + 1.0, x - 1.0, x - 2.0);
    [-x * b * c / 6.0, a * b * c / 2.0, -a * x * c / 2.0, a * x * b / 6.0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Direction;
    use crate::optics::{Device, Misalignment, Rig};

    /// Of the table, over a whole image: far below any pixel.
    const TABLE_DEG: f64 = 1e-3;

    #[test]
    fn weights_reproduce_cubics() {
        for x in [0.0, 0.3, 0.9, -0.8, 1.8] {
            let w = cubic(x);
            for power in 0..4 {
                let got: f64 = (0..4).map(|i| w[i] * (i as f64 - 1.0).powi(power)).sum();
                assert!((got - x.powi(power)).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn corrected_maps_are_those_of_misaligned_devices() {
        let m = Misalignment {
            camera_displacement_mm: [0.4, -0.3],
            camera_turn_deg: [-0.1, 0.2],
            projector_turn_deg: [0.2, 0.0],
            paraboloid_offset_mm: [-0.3, 0.4],
            dome_offset_mm: [0.0, 0.2],
            sample_tilt_deg: [0.1, -0.2],
            ..Misalignment::none()
        };
        for text in
            [include_str!("../../optics/ghosh-2007-built.toml"), include_str!("../../optics/ghosh-2007-full.toml")]
        {
            let rig = Rig::from_toml(text).unwrap();
            let maps = [(Device::Camera, rig.camera_map()), (Device::Projector, rig.projector_map())];
            for (device, nominal) in maps {
                let traced = Misaligned::new(&rig, &m, device);
                let map = nominal.clone().corrected(MapCorrection::new(&nominal, &traced));
                let (c_u, c_v) = traced.image_centre();
                let (mut worst, mut moved, mut seen) = (0.0f64, 0.0f64, 0);
                for i in 0..2000 {
                    let (r, phi) = (nominal.reach_px() * (f64::from(i) / 2000.0).sqrt(), f64::from(i) * 2.399963);
                    let (u, v) = (c_u + r * phi.cos(), c_v + r * phi.sin());
                    let (Some(want), Some(got)) = (traced.direction(u, v), map.direction(u, v)) else { continue };
                    seen += 1;
                    worst = worst.max((got.vector() - want.vector()).norm().to_degrees());
                    let without = nominal.direction(u, v).unwrap_or(Direction::from_angles(0.0, 0.0));
                    moved = moved.max((without.vector() - want.vector()).norm().to_degrees());
                    let (back_u, back_v) = map.pixel(&got).unwrap();
                    assert!((back_u - u).hypot(back_v - v) < 1e-6, "{u} {v}: {back_u} {back_v}");
                }
                assert!(
                    worst < TABLE_DEG && moved > 1.0 && seen > 1500,
                    "{} {device:?}: {worst} of {moved} over {seen} points",
                    rig.name
                );
            }
        }
    }
}
