//! What a shift of the zone's edges does to coefficients.

use nalgebra::DMatrix;

use crate::basis::{Harmonics, OrderError, index};
use crate::geometry::Zone;
use crate::geometry::quadrature::zone_mu_angular;

/// Nodes in mu.
const NODES: usize = 96;

/// The change of zonal coefficients if an edge of the zone really lies `by` radians further in: z' - z = E z.
///
/// Lobes are stretched with the zone, as a projector stretches them; the light is that of the zonal series. `inner` moves
/// theta_min, else theta_max. E is square, by index k, and couples equal m only.
///
/// # Errors
/// [`OrderError`].
///
/// # Panics
/// If nothing is left of the zone.
pub fn edge_shift(zone: Zone, order: usize, inner: bool, by: f64) -> Result<DMatrix<f64>, OrderError> {
    let (lo, hi) = (zone.theta_min(), zone.theta_max());
    let moved = if inner { Zone::new(lo + by, hi) } else { Zone::new(lo, hi - by) }.expect("a part of the zone");
    let (nominal, shown) = (Harmonics::zonal(zone, order)?, Harmonics::zonal(moved, order)?);
    let mut shift = DMatrix::zeros(nominal.len(), nominal.len());
    let nodes = zone_mu_angular(NODES, &moved);
    for m in 0..=order {
        let parts = |basis: &Harmonics| {
            let mut all = DMatrix::zeros(nodes.len(), order - m + 1);
            let mut parts = Vec::new();
            for (i, &(mu, _)) in nodes.iter().enumerate() {
                parts.clear();
                basis.polar_parts(m, mu, &mut parts);
                parts.iter().enumerate().for_each(|(j, p)| all[(i, j)] = *p);
            }
            all
        };
        let weighted = DMatrix::from_diagonal(&nalgebra::DVector::from_iterator(
            nodes.len(),
            nodes.iter().map(|n| n.1 * std::f64::consts::TAU),
        ));
        let overlap = parts(&shown).transpose() * weighted * parts(&nominal);
        for (i, l) in (m..=order).enumerate() {
            for (j, other) in (m..=order).enumerate() {
                let change = overlap[(i, j)] - if i == j { 1.0 } else { 0.0 };
                for m in [m as i32, -(m as i32)] {
                    shift[(index(l, m), index(other, m))] = change;
                }
            }
        }
    }
    Ok(shift)
}
