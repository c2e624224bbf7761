//! What a reflectance model predicts for the measured coefficients.

use std::f64::consts::PI;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::Observations;
use crate::basis::{Harmonics, OrderError};
use crate::geometry::quadrature::gauss_legendre;
use crate::geometry::{Direction, ExitantGrid, Zone};
use crate::reflectance::Brdf;
use crate::reflectance::ggx::schlick;

/// Integrals of shapes against the zonal functions at every station of some observations.
///
/// Nodes are polar about the mirror direction and end exactly at the zone's edges: along each azimuth, Gauss-Legendre in
/// the cube root of the angle away from the mirror direction. Lobes down to a roughness of 0.01 are resolved.
pub struct Forward {
    rings: Vec<RingNodes>,
    stations: Vec<(usize, f64)>,
    terms: usize,
    folded: bool,
    /// Value of the constant zonal function.
    constant: f64,
}

/// Incident directions for one exitant direction at phi_o = 0.
struct RingNodes {
    wo: Vector3<f64>,
    nodes: Vec<Node>,
    /// Solid angle times zonal function: `node * terms + term`.
    zonal: Vec<f64>,
}

/// One pair of directions.
#[derive(Debug, Clone, Copy)]
pub struct Node {
    /// To the light.
    pub wi: Vector3<f64>,
    /// To the camera.
    pub wo: Vector3<f64>,
    /// Half vector.
    pub h: Vector3<f64>,
    /// (1 - cos(theta_d))^5.
    pub schlick: f64,
}

/// Fineness of the rule.
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

impl Fineness {
    /// What data deserve: single exitant directions are noisier than averages over a ring, and there are more of them.
    pub fn of(observations: &Observations) -> Self {
        if observations.folded { Self::default() } else { Self { radial: 24, around: 40 } }
    }
}

impl Forward {
    /// The rule for the stations of `observations`.
    ///
    /// # Errors
    /// [`OrderError`].
    pub fn new(observations: &Observations, fineness: Fineness) -> Result<Self, OrderError> {
        Self::over(observations, observations.grid.zone(), fineness)
    }

    /// The same integrals over another zone, for what a shift of its edges would change.
    ///
    /// # Errors
    /// [`OrderError`].
    pub fn over(observations: &Observations, zone: Zone, fineness: Fineness) -> Result<Self, OrderError> {
        let basis = Harmonics::zonal(zone, observations.order)?;
        let grid = observations.grid;
        let used: Vec<usize> =
            (0..grid.rings()).filter(|r| observations.stations.iter().any(|s| s.ring == *r)).collect();
        let rings = used
            .par_iter()
            .map(|&r| RingNodes::new(&grid, r, &basis, &observations.terms, observations.folded, fineness))
            .collect();
        let position = |ring: usize| used.iter().position(|&r| r == ring).expect("used");
        Ok(Self {
            rings,
            stations: observations.stations.iter().map(|s| (position(s.ring), s.phi_o)).collect(),
            terms: observations.terms.len(),
            folded: observations.folded,
            constant: zone.solid_angle().sqrt().recip(),
        })
    }

    /// Coefficients of `S` shapes at once: `shape` returns their f_cos / cos(theta_i) at a pair of directions; the result is
    /// `[shape][station * terms + term]`.
    pub fn project<const S: usize>(&self, shape: impl Fn(&Node) -> [f64; S] + Sync) -> [Vec<f64>; S] {
        let parts: Vec<Vec<[f64; S]>> = self
            .stations
            .par_iter()
            .map(|&(ring, phi_o)| {
                let ring = &self.rings[ring];
                let mut sums = vec![[0.0; S]; self.terms];
                for (node, zonal) in ring.nodes.iter().zip(ring.zonal.chunks_exact(self.terms)) {
                    let cos_i = node.wi.z;
                    let values = if self.folded { shape(node) } else { shape(&node.turned(phi_o)) }.map(|f| f * cos_i);
                    for (sum, z) in sums.iter_mut().zip(zonal) {
                        for (sum, value) in sum.iter_mut().zip(values) {
                            *sum += z * value;
                        }
                    }
                }
                sums
            })
            .collect();
        std::array::from_fn(|s| parts.iter().flatten().map(|v| v[s]).collect())
    }

    /// Integrals over the zone, summed over stations, of products of f_cos of `S` shapes.
    pub fn gram<const S: usize>(&self, shape: impl Fn(&Node) -> [f64; S] + Sync) -> [[f64; S]; S] {
        let parts: Vec<[[f64; S]; S]> = self
            .stations
            .par_iter()
            .map(|&(ring, phi_o)| {
                let ring = &self.rings[ring];
                let mut sums = [[0.0; S]; S];
                for (node, zonal) in ring.nodes.iter().zip(ring.zonal.chunks_exact(self.terms)) {
                    // The first function is constant.
                    let solid_angle = zonal[0] / self.constant;
                    let values =
                        if self.folded { shape(node) } else { shape(&node.turned(phi_o)) }.map(|f| f * node.wi.z);
                    for (sums, a) in sums.iter_mut().zip(values) {
                        sums.iter_mut().zip(values).for_each(|(sum, b)| *sum += solid_angle * a * b);
                    }
                }
                sums
            })
            .collect();
        std::array::from_fn(|i| std::array::from_fn(|j| parts.iter().map(|p| p[i][j]).sum()))
    }

    /// Coefficients of any reflectance, by channel.
    pub fn predict(&self, brdf: &dyn Brdf) -> [Vec<f64>; 3] {
        let parts: Vec<Vec<[f64; 3]>> = self
            .stations
            .par_iter()
            .map(|&(ring, phi_o)| {
                let ring = &self.rings[ring];
                let wo = Direction::new_unchecked(ring.wo).rotated_about_normal(phi_o);
                let f_cos = brdf.towards(&wo);
                let mut sums = vec![[0.0; 3]; self.terms];
                for (node, zonal) in ring.nodes.iter().zip(ring.zonal.chunks_exact(self.terms)) {
                    let values = f_cos(&Direction::new_unchecked(node.wi).rotated_about_normal(phi_o));
                    for (sum, z) in sums.iter_mut().zip(zonal) {
                        sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += z * value);
                    }
                }
                sums
            })
            .collect();
        std::array::from_fn(|c| parts.iter().flatten().map(|v| v[c]).collect())
    }
}

impl Node {
    fn turned(&self, phi_o: f64) -> Self {
        let turn = |v: &Vector3<f64>| {
            let (s, c) = phi_o.sin_cos();
            Vector3::new(c * v.x - s * v.y, s * v.x + c * v.y, v.z)
        };
        Self { wi: turn(&self.wi), wo: turn(&self.wo), h: turn(&self.h), schlick: self.schlick }
    }
}

impl RingNodes {
    fn new(
        grid: &ExitantGrid,
        ring: usize,
        basis: &Harmonics,
        terms: &[usize],
        folded: bool,
        fineness: Fineness,
    ) -> Self {
        let theta_o = grid.theta(ring);
        let wo = Direction::<crate::geometry::Sample>::from_angles(theta_o, 0.0).vector();
        let mut nodes = Vec::new();
        let mut zonal = Vec::new();
        let mut functions = vec![0.0; basis.len()];
        let sides: &[f64] = if folded { &[1.0] } else { &[1.0, -1.0] };
        // An isotropic shape looks alike on both sides of the plane of wo.
        let share = 2.0 / sides.len() as f64;
        for (zeta, dzeta) in around(theta_o, &basis.zone(), fineness.around) {
            for (chi, dchi) in along(theta_o, zeta, &basis.zone(), fineness.radial) {
                for side in sides {
                    let wi = away_from_mirror(theta_o, chi, side * zeta);
                    basis.eval_direction_into(&Direction::new_unchecked(wi), &mut functions);
                    let solid_angle = share * chi.sin() * dchi * dzeta;
                    zonal.extend(terms.iter().map(|&k| solid_angle * functions[k]));
                    let h = (wi + wo).normalize();
                    nodes.push(Node { wi, wo, h, schlick: schlick(&wo, &h) });
                }
            }
        }
        Self { wo, nodes, zonal }
    }
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
