//! Quadrature over a zone along great circles from the mirror direction, where lobes are sharp.

use std::f64::consts::PI;

use nalgebra::Vector3;

use super::Zone;
use super::quadrature::{Node, gauss_legendre};

/// Fineness of [`zone_about_mirror`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fineness {
    /// Nodes per unit of the cube root of the angle away from the mirror direction.
    pub radial: usize,
    /// Azimuths on the half circle around it.
    pub around: usize,
}

impl Default for Fineness {
    fn default() -> Self {
        Self { radial: 32, around: 64 }
    }
}

/// Incident directions in a zone and their solid angles for the exitant direction (theta_o, 0), on the side phi_i >= 0 of
/// its plane; twice their weights sum to |Z|.
///
/// Nodes are polar about the mirror direction and end exactly at the zone's edges: along each azimuth, Gauss-Legendre in
/// the cube root of the angle away from the mirror direction. Lobes down to a roughness of 0.01 are resolved. `theta_o` in
/// radians, 0..pi/2; the mirror direction must not lie beyond the zone's outer edge.
pub fn zone_about_mirror(theta_o: f64, zone: &Zone, fineness: Fineness) -> Vec<Node<Vector3<f64>>> {
    let mut nodes = Vec::new();
    for (zeta, dzeta) in around(theta_o, zone, fineness.around) {
        for (chi, dchi) in along(theta_o, zeta, zone, fineness.radial) {
            nodes.push((away_from_mirror(theta_o, chi, zeta), chi.sin() * dchi * dzeta));
        }
    }
    nodes
}

/// The direction `chi` away from the mirror direction of (theta_o, 0), towards the azimuth `zeta` around it; zeta = 0 lies
/// on the horizon's side.
fn away_from_mirror(theta_o: f64, chi: f64, zeta: f64) -> Vector3<f64> {
    let ((sin_o, cos_o), (sin_c, cos_c), (sin_z, cos_z)) = (theta_o.sin_cos(), chi.sin_cos(), zeta.sin_cos());
    let down = sin_c * cos_z;
    Vector3::new(-sin_o * cos_c - cos_o * down, sin_c * sin_z, cos_o * cos_c - sin_o * down)
}

/// Azimuths in (0, pi) around the mirror direction and weights dzeta.
///
/// Great circles from the mirror direction touch the zone's inner edge at one azimuth, where the integrand has a square
/// root; the rule is split there and its nodes crowd at both ends, which makes it smooth again.
fn around(theta_o: f64, zone: &Zone, count: usize) -> Vec<(f64, f64)> {
    let touching = PI - (zone.theta_min().sin() / theta_o.sin()).min(1.0).asin();
    let mut nodes = Vec::new();
    for (lo, hi) in [(0.0, touching), (touching, PI)] {
        let half = (hi - lo) / 2.0;
        let n = (count as f64 * half / (PI / 2.0)).ceil() as usize + 4;
        for (t, w) in gauss_legendre(n, 0.0, PI) {
            nodes.push((lo + half * (1.0 - t.cos()), half * t.sin() * w));
        }
    }
    nodes
}

/// Nodes in chi and weights dchi along one azimuth, inside the zone.
fn along(theta_o: f64, zeta: f64, zone: &Zone, radial: usize) -> Vec<(f64, f64)> {
    // On this great circle mu = R cos(chi + delta).
    let (sin_o, cos_o) = theta_o.sin_cos();
    let (x, y) = (cos_o, sin_o * zeta.cos());
    let (r, delta) = (x.hypot(y), y.atan2(x));
    let end = ((zone.cos_max() / r).clamp(-1.0, 1.0).acos() - delta).clamp(0.0, PI);
    let hole = (zone.cos_min() / r).min(1.0).acos();
    let (hole_0, hole_1) = ((-hole - delta).clamp(0.0, end), (hole - delta).clamp(0.0, end));
    let mut nodes = Vec::new();
    for (chi_0, chi_1) in [(0.0, hole_0), (hole_1, end)] {
        if chi_1 <= chi_0 {
            continue;
        }
        let (u0, u1) = (chi_0.cbrt(), chi_1.cbrt());
        let (length, n) = (u1 - u0, ((u1 - u0) * radial as f64).ceil() as usize + 3);
        // Zonal functions of odd m end in a square root at the zone's edges; these steps make it smooth.
        for (t, w) in gauss_legendre(n, 0.0, 1.0) {
            let (u, du) = if chi_0 == 0.0 {
                (u0 + length * t * (2.0 - t), 2.0 * length * (1.0 - t))
            } else {
                (u0 + length * t * t * (3.0 - 2.0 * t), 6.0 * length * t * (1.0 - t))
            };
            nodes.push((u * u * u, 3.0 * u * u * du * w));
        }
    }
    nodes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Solid angle and integral of mu over zones of every kind.
    #[test]
    fn sums_are_those_of_the_zone() {
        for (theta_min, theta_max) in [(9.0, 57.0), (0.0, 90.0), (57.0, 90.0)] {
            let zone = Zone::from_degrees(theta_min, theta_max).unwrap();
            for theta_o in [10f64, 30.0, 56.0] {
                let nodes = zone_about_mirror(theta_o.to_radians(), &zone, Fineness::default());
                let sum: f64 = nodes.iter().map(|n| 2.0 * n.1).sum();
                let cosines: f64 = nodes.iter().map(|n| 2.0 * n.1 * n.0.z).sum();
                assert!((sum / zone.solid_angle() - 1.0).abs() < 1e-6, "{theta_min} {theta_o}: {sum}");
                assert!((cosines / zone.projected_solid_angle() - 1.0).abs() < 1e-6, "{theta_min} {theta_o}");
            }
        }
    }
}
