//! The grid of exitant directions on which coefficients are reported.

use std::f64::consts::TAU;

use super::{Direction, Sample, Zone};

/// Rings of equal width in theta times sectors of equal width in phi over a zone.
///
/// A direction's index is `ring * sectors + sector`; ring 0 lies next to theta_min, sector 0 next to phi = 0, and the
/// centre of sector s is phi = (s + 1/2) 2 pi / sectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExitantGrid {
    zone: Zone,
    rings: usize,
    sectors: usize,
}

impl ExitantGrid {
    /// A grid of `rings` x `sectors` cells over `zone`; both at least 1.
    pub fn new(zone: Zone, rings: usize, sectors: usize) -> Self {
        assert!(rings > 0 && sectors > 0, "a grid needs cells");
        Self { zone, rings, sectors }
    }

    /// The zone it covers.
    pub fn zone(&self) -> Zone {
        self.zone
    }

    /// Number of rings in theta.
    pub fn rings(&self) -> usize {
        self.rings
    }

    /// Number of sectors in phi.
    pub fn sectors(&self) -> usize {
        self.sectors
    }

    /// Number of directions.
    pub fn len(&self) -> usize {
        self.rings * self.sectors
    }

    /// Never true: a grid has cells.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Width of a ring, radians.
    pub fn ring_width(&self) -> f64 {
        (self.zone.theta_max() - self.zone.theta_min()) / self.rings as f64
    }

    /// Width of a sector, radians.
    pub fn sector_width(&self) -> f64 {
        TAU / self.sectors as f64
    }

    /// Polar angle at the centre of a ring, radians.
    pub fn theta(&self, ring: usize) -> f64 {
        self.zone.theta_min() + (ring as f64 + 0.5) * self.ring_width()
    }

    /// Azimuth at the centre of a sector, radians.
    pub fn phi(&self, sector: usize) -> f64 {
        (sector as f64 + 0.5) * self.sector_width()
    }

    /// The direction at the centre of a cell.
    pub fn direction(&self, index: usize) -> Direction<Sample> {
        Direction::from_angles(self.theta(index / self.sectors), self.phi(index % self.sectors))
    }

    /// The ring and sector of the cell that holds (theta, phi), if the zone does.
    pub fn cell(&self, theta: f64, phi: f64) -> Option<(usize, usize)> {
        if !self.zone.contains(theta) {
            return None;
        }
        let ring = ((theta - self.zone.theta_min()) / self.ring_width()) as usize;
        let sector = (phi.rem_euclid(TAU) / self.sector_width()) as usize;
        Some((ring.min(self.rings - 1), sector.min(self.sectors - 1)))
    }

    /// The four cells around (theta, phi) and their bilinear weights; theta is clamped to the centres of the first and
    /// last ring, phi wraps.
    pub fn bilinear(&self, theta: f64, phi: f64) -> [(usize, f64); 4] {
        let r = ((theta - self.zone.theta_min()) / self.ring_width() - 0.5).clamp(0.0, (self.rings - 1) as f64);
        let r0 = (r as usize).min(self.rings.saturating_sub(2));
        let fr = r - r0 as f64;
        let r1 = (r0 + 1).min(self.rings - 1);
        let s = (phi / self.sector_width() - 0.5).rem_euclid(self.sectors as f64);
        let s0 = (s as usize).min(self.sectors - 1);
        let fs = s - s0 as f64;
        let s1 = (s0 + 1) % self.sectors;
        let at = |r: usize, s: usize| r * self.sectors + s;
        [
            (at(r0, s0), (1.0 - fr) * (1.0 - fs)),
            (at(r0, s1), (1.0 - fr) * fs),
            (at(r1, s0), fr * (1.0 - fs)),
            (at(r1, s1), fr * fs),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn centres_lie_in_their_own_cell(rings in 1usize..40, sectors in 1usize..90, pick in 0usize..4000) {
            let grid = ExitantGrid::new(Zone::from_degrees(9.0, 57.0).unwrap(), rings, sectors);
            let index = pick % grid.len();
            let d = grid.direction(index);
            prop_assert_eq!(grid.cell(d.theta(), d.phi()), Some((index / sectors, index % sectors)));
        }

        #[test]
        fn bilinear_weights_are_a_partition_of_one(theta in 0.0..1.6f64, phi in -7.0..7.0f64, rings in 1usize..9) {
            let grid = ExitantGrid::new(Zone::from_degrees(9.0, 57.0).unwrap(), rings, 12);
            let taps = grid.bilinear(theta, phi);
            prop_assert!((taps.iter().map(|t| t.1).sum::<f64>() - 1.0).abs() < 1e-12);
            prop_assert!(taps.iter().all(|t| t.0 < grid.len() && t.1 >= 0.0));
        }
    }
}
