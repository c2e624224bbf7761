//! What small errors of directions do to coefficients.

use nalgebra::{DMatrix, DVector, Rotation3};

use crate::basis::{Harmonics, OrderError, index};
use crate::geometry::quadrature::{zone_mu_angular, zone_product};
use crate::geometry::{Direction, Zone};

/// Nodes in mu of the shift of an edge.
const EDGE_NODES: usize = 96;
/// Nodes in mu of a rotation: the answer is an error estimate.
const ROTATION_NODES: usize = 32;

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
    let nodes = zone_mu_angular(EDGE_NODES, &moved);
    let solid_angles = DVector::from_iterator(nodes.len(), nodes.iter().map(|n| n.1 * std::f64::consts::TAU));
    for m in 0..=order {
        let parts = |basis: &Harmonics| {
            let mut all = Vec::new();
            nodes.iter().for_each(|&(mu, _)| basis.polar_parts(m, mu, &mut all));
            DMatrix::from_row_slice(nodes.len(), order - m + 1, &all)
        };
        let overlap = parts(&shown).transpose() * DMatrix::from_diagonal(&solid_angles) * parts(&nominal);
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

/// The change of zonal coefficients if the sample is turned by a small `rotation`: z' - z = E z, E square, by index k.
///
/// The light is that of the zonal series, continued by as much as the rotation asks for.
///
/// # Errors
/// [`OrderError`].
pub fn rotation_shift(zone: Zone, order: usize, rotation: &Rotation3<f64>) -> Result<DMatrix<f64>, OrderError> {
    let basis = Harmonics::zonal(zone, order)?;
    let n = basis.len();
    let mut shift = DMatrix::zeros(n, n);
    for (d, w) in zone_product(&zone, ROTATION_NODES, 4 * order + 4) {
        let there = DVector::from_vec(basis.eval(&d));
        let back = DVector::from_vec(basis.eval(&Direction::new(rotation.inverse() * d.vector())));
        shift.ger(w, &there, &(back - &there), 1.0);
    }
    Ok(shift)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::basis::about_normal;
    use nalgebra::Vector3;

    #[test]
    fn turns_about_the_normal_are_known_exactly() {
        let zone = Zone::from_degrees(9.0, 57.0).unwrap();
        let phi = 1e-3;
        let shift = rotation_shift(zone, 3, &Rotation3::from_axis_angle(&Vector3::z_axis(), phi)).unwrap();
        for k in 0..16 {
            let mut one = vec![0.0; 16];
            one[k] = 1.0;
            let want = about_normal(&one, phi);
            // Of the shift itself, 3e-3: the rule has few nodes for the square roots of odd m.
            let off = (0..16).map(|i| (shift[(i, k)] + one[i] - want[i]).abs()).fold(0.0, f64::max);
            assert!(off < 1e-5, "{k}: {off:e}");
        }
    }

    /// A constant light in a smaller zone: z_00 falls with the root of the solid angle, the other coefficients stay 0.
    #[test]
    fn shifted_edges_show_in_the_constant() {
        let zone = Zone::from_degrees(9.0, 57.0).unwrap();
        for (inner, moved) in [(true, Zone::from_degrees(10.0, 57.0)), (false, Zone::from_degrees(9.0, 56.0))] {
            let shift = edge_shift(zone, 4, inner, 1f64.to_radians()).unwrap();
            let want = (moved.unwrap().solid_angle() / zone.solid_angle()).sqrt() - 1.0;
            assert!((shift[(0, 0)] - want).abs() < 1e-12);
            assert!((1..25).all(|k| shift[(k, 0)].abs() < 1e-12));
        }
    }
}
