//! A probe cut into directional lights.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;

use super::{Probe, View};
use crate::geometry::Direction;

/// A directional light that stands for a part of a probe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProbeLight {
    /// Towards the light.
    pub direction: Direction<View>,
    /// Irradiance of a surface that faces it, linear RGB: the integral of the part's radiance over its solid angle.
    pub irradiance: [f64; 3],
}

/// A rectangle of a probe, half-open, in pixels.
#[derive(Debug, Clone, Copy)]
struct Region {
    x: [usize; 2],
    y: [usize; 2],
}

impl Region {
    /// Height and width in radians, at the middle latitude.
    fn extent(&self, probe: &Probe) -> [f64; 2] {
        let row = PI / probe.height() as f64;
        let middle = 0.5 * (self.y[0] + self.y[1]) as f64 * row;
        let columns = (self.x[1] - self.x[0]) as f64;
        [(self.y[1] - self.y[0]) as f64 * row, columns * TAU / probe.width() as f64 * middle.sin()]
    }
}

/// Sums of luminance times solid angle over the rectangles from the first pixel on.
struct EnergyTable {
    width: usize,
    sums: Vec<f64>,
}

impl EnergyTable {
    fn new(probe: &Probe) -> Self {
        let width = probe.width() + 1;
        let mut sums = vec![0.0; width * (probe.height() + 1)];
        for y in 0..probe.height() {
            let mut row = 0.0;
            for x in 0..probe.width() {
                row += luminance(probe.radiance(x, y)) * probe.solid_angle(y);
                sums[(y + 1) * width + x + 1] = sums[y * width + x + 1] + row;
            }
        }
        Self { width, sums }
    }

    fn energy(&self, r: &Region) -> f64 {
        let at = |x: usize, y: usize| self.sums[y * self.width + x];
        at(r.x[1], r.y[1]) - at(r.x[0], r.y[1]) - at(r.x[1], r.y[0]) + at(r.x[0], r.y[0])
    }

    /// Both halves of the region, cut across its longer side where their energies are most alike.
    fn cut(&self, region: &Region, probe: &Probe) -> Option<[Region; 2]> {
        let [height, width] = region.extent(probe);
        let (rows, columns) = (region.y[1] - region.y[0], region.x[1] - region.x[0]);
        let along_x = columns > 1 && (width >= height || rows == 1);
        let side = if along_x { region.x } else { region.y };
        if side[1] - side[0] < 2 {
            return None;
        }
        let halves = |at: usize| {
            if along_x {
                [Region { x: [side[0], at], ..*region }, Region { x: [at, side[1]], ..*region }]
            } else {
                [Region { y: [side[0], at], ..*region }, Region { y: [at, side[1]], ..*region }]
            }
        };
        let half = 0.5 * self.energy(region);
        let imbalance = |at: usize| (self.energy(&halves(at)[0]) - half).abs();
        // The first half only gains energy as the cut moves on, so the imbalance has one minimum.
        let (mut lo, mut hi) = (side[0] + 1, side[1] - 1);
        while lo < hi {
            let at = (lo + hi) / 2;
            if self.energy(&halves(at)[0]) < half { lo = at + 1 } else { hi = at }
        }
        let best = if lo > side[0] + 1 && imbalance(lo - 1) < imbalance(lo) { lo - 1 } else { lo };
        Some(halves(best))
    }
}

fn luminance([r, g, b]: [f32; 3]) -> f64 {
    0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
}

impl Probe {
    /// At most `count` (at least one) directional lights that together carry the probe's energy.
    ///
    /// Median cut (Debevec 2005): a region is halved where its energy is, and becomes one light at its centroid. Here the
    /// region with the largest energy times squared extent is cut next, the leading term of the quadrature error, so that
    /// dim but wide parts of the probe do not fall apart into spots.
    pub fn lights(&self, count: usize) -> Vec<ProbeLight> {
        let table = EnergyTable::new(self);
        let spread = |r: &Region| {
            let [height, width] = r.extent(self);
            table.energy(r) * (height * height + width * width)
        };
        let whole = Region { x: [0, self.width()], y: [0, self.height()] };
        let mut open = vec![(spread(&whole), whole)];
        let mut done = Vec::new();
        while open.len() + done.len() < count {
            let Some(i) = (0..open.len()).max_by(|&i, &j| open[i].0.total_cmp(&open[j].0)) else { break };
            let (_, region) = open.swap_remove(i);
            match table.cut(&region, self) {
                Some(halves) => open.extend(halves.map(|h| (spread(&h), h))),
                None => done.push(region),
            }
        }
        done.extend(open.into_iter().map(|(_, region)| region));
        done.iter().filter_map(|region| self.light(region)).collect()
    }

    /// The region as one light; `None` if it is black.
    fn light(&self, region: &Region) -> Option<ProbeLight> {
        let mut irradiance = [0.0; 3];
        let mut centroid = Vector3::zeros();
        for y in region.y[0]..region.y[1] {
            let solid_angle = self.solid_angle(y);
            for x in region.x[0]..region.x[1] {
                let radiance = self.radiance(x, y);
                irradiance.iter_mut().zip(radiance).for_each(|(e, l)| *e += f64::from(l) * solid_angle);
                centroid += self.direction(x, y).vector() * (luminance(radiance) * solid_angle);
            }
        }
        let direction = Direction::new_unchecked(centroid.try_normalize(f64::MIN_POSITIVE)?);
        Some(ProbeLight { direction, irradiance })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_keep_the_energy() {
        let probe = Probe::studio();
        let mut want = [0.0; 3];
        for y in 0..probe.height() {
            for x in 0..probe.width() {
                want.iter_mut().zip(probe.radiance(x, y)).for_each(|(w, l)| *w += f64::from(l) * probe.solid_angle(y));
            }
        }
        for count in [2, 100, 512] {
            let lights = probe.lights(count);
            assert_eq!(lights.len(), count);
            for (c, want) in want.iter().enumerate() {
                let got: f64 = lights.iter().map(|l| l.irradiance[c]).sum();
                assert!((got / want - 1.0).abs() < 1e-9, "{got} instead of {want}");
            }
        }
    }

    #[test]
    fn a_constant_probe_is_cut_evenly() {
        let lights = Probe::constant([1.0; 3]).lights(512);
        let energies: Vec<f64> = lights.iter().map(|l| l.irradiance[1]).collect();
        let (least, most) =
            (energies.iter().copied().fold(f64::MAX, f64::min), energies.iter().copied().fold(0.0, f64::max));
        assert!(most < 3.0 * least, "{least} {most}");
        let mean = lights.iter().map(|l| l.direction.vector()).sum::<Vector3<f64>>() / 512.0;
        assert!(mean.norm() < 0.02, "{mean}");
    }

    #[test]
    fn one_bright_pixel_becomes_one_light_in_its_direction() {
        let mut pixels = vec![[0.0; 3]; 64 * 32];
        pixels[10 * 64 + 50] = [100.0; 3];
        let probe = Probe::new(64, 32, pixels).unwrap();
        let lights = probe.lights(16);
        assert_eq!(lights.len(), 1);
        assert!(lights[0].direction.dot(&probe.direction(50, 10)) > 1.0 - 1e-12);
        assert!(Probe::constant([0.0; 3]).lights(16).is_empty());
    }
}
