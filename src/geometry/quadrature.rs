//! Quadrature rules: nodes and weights as plain vectors.

use std::f64::consts::{PI, TAU};

use gauss_quad::GaussLegendre;
use nalgebra::Vector3;

use super::{Direction, Sample, Zone};

/// One node and its weight.
pub type Node<T> = (T, f64);

/// Gauss-Legendre rule with `n` >= 1 nodes on [lo, hi], nodes ascending: exact for polynomials of degree 2n - 1.
pub fn gauss_legendre(n: usize, lo: f64, hi: f64) -> Vec<Node<f64>> {
    let (half, mid) = ((hi - lo) / 2.0, (hi + lo) / 2.0);
    // The library has no rule of one node.
    let Ok(rule) = GaussLegendre::new(n) else { return vec![(mid, 2.0 * half)] };
    let mut nodes: Vec<_> = rule.as_node_weight_pairs().iter().map(|&(x, w)| (mid + half * x, half * w)).collect();
    nodes.sort_by(|p, q| p.0.total_cmp(&q.0));
    nodes
}

/// A rule in mu = cos(theta) over a zone that also integrates factors like sqrt(a - mu) and sqrt(1 - mu^2) to rounding.
///
/// Gauss-Legendre in the angle t of mu = (a+b)/2 + (a-b)/2 cos(t): the square roots at both ends become analytic, for
/// every zone, those that touch a pole included. 96 nodes give 1e-15 up to order 20.
pub fn zone_mu_angular(n: usize, zone: &Zone) -> Vec<Node<f64>> {
    let (a, b) = (zone.cos_min(), zone.cos_max());
    let (mid, half) = ((a + b) / 2.0, (a - b) / 2.0);
    gauss_legendre(n, 0.0, PI).into_iter().map(|(t, w)| (mid + half * t.cos(), w * half * t.sin())).collect()
}

/// A product rule over a zone: Gauss-Legendre in mu, midpoints in phi. Weights are solid angles and sum to |Z|.
pub fn zone_product(zone: &Zone, n_mu: usize, n_phi: usize) -> Vec<Node<Direction<Sample>>> {
    let dphi = TAU / n_phi as f64;
    gauss_legendre(n_mu, zone.cos_max(), zone.cos_min())
        .into_iter()
        .flat_map(|(mu, w)| (0..n_phi).map(move |j| (Direction::from_mu_phi(mu, (j as f64 + 0.5) * dphi), w * dphi)))
        .collect()
}

/// Nodes in polar coordinates about the mirror direction of `wo`: chi = pi u^3 away from it, zeta around it.
///
/// Midpoints, `n_chi` x `n_zeta`; weights are solid angles; nodes with theta > `theta_max` are left out. The cubic
/// spacing resolves lobes down to a GGX roughness of about 0.01, which grids in theta and phi alias.
pub fn polar_about_mirror(
    wo: &Direction<Sample>,
    n_chi: usize,
    n_zeta: usize,
    theta_max: f64,
) -> Vec<Node<Direction<Sample>>> {
    let mirror = wo.mirrored().vector();
    let (t, b) = tangents(&mirror);
    let cos_limit = theta_max.cos() + 1e-12;
    let mut nodes = Vec::with_capacity(n_chi * n_zeta);
    for i in 0..n_chi {
        let u = (i as f64 + 0.5) / n_chi as f64;
        let (sin_chi, cos_chi) = (PI * u * u * u).sin_cos();
        let weight = sin_chi * 3.0 * PI * u * u / n_chi as f64 * TAU / n_zeta as f64;
        for j in 0..n_zeta {
            let (sin_zeta, cos_zeta) = ((j as f64 + 0.5) * TAU / n_zeta as f64).sin_cos();
            let v = mirror * cos_chi + (t * cos_zeta + b * sin_zeta) * sin_chi;
            if v.z >= cos_limit {
                nodes.push((Direction::new_unchecked(v), weight));
            }
        }
    }
    nodes
}

/// Two unit vectors that complete the unit vector `axis` to an orthonormal frame.
pub fn tangents(axis: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let helper = if axis.y.abs() < 0.9 { Vector3::y() } else { Vector3::x() };
    let t = axis.cross(&helper).normalize();
    (t, axis.cross(&t))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_the_solid_angle() {
        let zone = Zone::from_degrees(9.0, 57.0).unwrap();
        let product: f64 = zone_product(&zone, 8, 16).iter().map(|n| n.1).sum();
        assert!((product - zone.solid_angle()).abs() < 1e-12);
        let angular: f64 = zone_mu_angular(64, &zone).iter().map(|n| n.1).sum();
        assert!((TAU * angular - zone.solid_angle()).abs() < 1e-12);
        // Midpoints in chi are second order: the whole sphere within 1e-3 at this size.
        let polar: f64 = polar_about_mirror(&Direction::from_angles(0.5, 0.2), 96, 64, PI).iter().map(|n| n.1).sum();
        assert!((polar / (4.0 * PI) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn angular_rule_is_exact_for_square_roots_at_the_ends() {
        let zone = Zone::from_degrees(9.0, 57.0).unwrap();
        let (a, b) = (zone.cos_min(), zone.cos_max());
        let got: f64 =
            zone_mu_angular(48, &zone).iter().map(|&(mu, w)| w * ((a - mu) * (mu - b)).max(0.0).sqrt()).sum();
        let want = PI / 8.0 * (a - b) * (a - b);
        assert!((got - want).abs() < 1e-14);
    }
}
