//! What an isotropic sample tells of a rig that is out of place.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use rayon::prelude::*;

use super::isotropic::{Design, Ring};
use crate::geometry::ExitantGrid;

/// Rings at each edge of the zone whose slopes over theta_o are not those of their neighbours: the edge cuts their lobes.
const CUT: usize = 2;
/// Fewer rings show no change over theta_o.
pub(super) const LEAST_RINGS: usize = 2 * CUT + 3;
/// Powers of the place in the zone, -1 to 1 from edge to edge, with which a displacement varies.
const POWERS: usize = 3;
const PARAMETERS: usize = 4 * POWERS;
/// Standard deviation of each parameter before anything is known, radians: 0.05 deg, what a rig is aligned to.
const BEFORE: f64 = 8.7e-4;

/// By how much the directions in which a rig sees are off, where anything out of place to the side (a tilted sample, a shifted
/// mirror or device) moves them: along theta_o by (a cos(phi_o) + b sin(phi_o)), along phi_o by (-c sin(phi_o) + d cos(phi_o))
/// cot(theta_o), each of the four a polynomial of the place in the zone.
///
/// A mixture that is shown at one azimuth then leaks from m into m - 1 and m + 1: for sharp lobes by far more than noise. An
/// isotropic sample allows no such thing, and as there are two data for each coefficient, the leak is seen, and known from what is
/// measured itself: the field's own gradients. Least squares, with what is known of the rig before.
pub(super) struct Displacement(SVector<f64, PARAMETERS>);

impl Displacement {
    /// No displacement.
    pub fn none() -> Self {
        Self(SVector::zeros())
    }

    /// What the data of `measured` tell, with the gradients of `rings`, both `[channel * rings + ring]`.
    pub fn of(design: &Design, measured: &[Ring], rings: &[Ring]) -> Self {
        let told = (0..rings.len()).into_par_iter().map(|at| normal_equations(design, &measured[at], rings, at));
        let told: Vec<_> = told.collect();
        let mut matrix = SMatrix::identity() * BEFORE.powi(-2);
        let mut right = SVector::zeros();
        // In their order, so that a run gives the same bits again.
        for (normal, projected) in told.into_iter().flatten() {
            matrix += normal;
            right += projected;
        }
        Self(matrix.cholesky().map_or_else(SVector::zeros, |c| c.solve(&right)))
    }

    /// What it adds to the data of a ring; `None` without coefficients of the ring and of those beside it.
    pub fn effect(&self, design: &Design, rings: &[Ring], at: usize) -> Option<DVector<f64>> {
        Some(columns(design, rings, at)? * self.0)
    }

    /// RMS over the rings, radians.
    pub fn rms(&self, grid: &ExitantGrid) -> f64 {
        let square = |ring: usize| {
            let cot = grid.theta(ring).tan().recip();
            let of = |part: usize| {
                let powers = powers(grid, ring);
                (0..POWERS).map(|n| self.0[part * POWERS + n] * powers[n]).sum::<f64>()
            };
            // phi_o counts by its arc.
            let arc = cot * grid.theta(ring).sin();
            0.5 * (of(0).powi(2) + of(1).powi(2) + (of(2).powi(2) + of(3).powi(2)) * arc * arc)
        };
        ((0..grid.rings()).map(square).sum::<f64>() / grid.rings() as f64).sqrt()
    }
}

fn powers(grid: &ExitantGrid, ring: usize) -> [f64; POWERS] {
    let zone = grid.zone();
    let x = (2.0 * grid.theta(ring) - zone.theta_min() - zone.theta_max()) / (zone.theta_max() - zone.theta_min());
    std::array::from_fn(|n| x.powi(n as i32))
}

/// Change of a ring's data with each parameter.
fn columns(design: &Design, rings: &[Ring], at: usize) -> Option<DMatrix<f64>> {
    let grid = design.grid;
    let (ring, sectors) = (at % grid.rings(), grid.sectors());
    let zeta = |at: usize| rings[at].zeta.as_ref().map(|z| DVector::from_iterator(z.len(), z.iter().map(|z| z[0])));
    // One-sided at the zone's edges.
    let slope = match ring {
        0 => zeta(at + 1)? * 4.0 - zeta(at)? * 3.0 - zeta(at + 2)?,
        last if last + 1 == grid.rings() => zeta(at)? * 3.0 - zeta(at - 1)? * 4.0 + zeta(at - 2)?,
        _ => zeta(at + 1)? - zeta(at - 1)?,
    } / (2.0 * grid.ring_width());
    let (along_theta, along_phi) = (&design.shown * slope, &design.turned * zeta(at)?);
    let cot = grid.theta(ring).tan().recip();
    let powers = powers(&grid, ring);
    Some(DMatrix::from_fn(along_theta.len(), PARAMETERS, |i, parameter| {
        let (sin, cos) = grid.phi(i % sectors).sin_cos();
        let change = match parameter / POWERS {
            0 => along_theta[i] * cos,
            1 => along_theta[i] * sin,
            2 => -along_phi[i] * sin * cot,
            _ => along_phi[i] * cos * cot,
        };
        change * powers[parameter % POWERS]
    }))
}

/// Whether the zone's edge cuts a ring's lobes.
pub(super) fn is_cut(grid: &ExitantGrid, ring: usize) -> bool {
    ring < CUT || ring + CUT >= grid.rings()
}

/// Of the part of the data that no isotropic sample explains. Rings that are cut or saturated in places are passed over.
fn normal_equations(
    design: &Design,
    measured: &Ring,
    rings: &[Ring],
    at: usize,
) -> Option<(SMatrix<f64, PARAMETERS, PARAMETERS>, SVector<f64, PARAMETERS>)> {
    let data = &measured.data;
    if !measured.is_whole() || is_cut(&design.grid, at % design.grid.rings()) {
        return None;
    }
    let columns = design.unexplained(&columns(design, rings, at)?);
    let values = design.unexplained(&DVector::from_iterator(data.len(), data.iter().map(|d| d[0])));
    let weight = data.len() as f64 / data.iter().map(|d| d[1]).sum::<f64>();
    let normal = columns.tr_mul(&columns) * weight;
    let right = columns.tr_mul(&values) * weight;
    // Without noise (in tests) nothing can be weighed.
    weight.is_finite().then(|| (SMatrix::from_fn(|i, j| normal[(i, j)]), SVector::from_fn(|i, _| right[i])))
}
