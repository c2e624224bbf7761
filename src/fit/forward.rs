//! What a reflectance model predicts for the measured coefficients.

use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::Observations;
use crate::basis::{Harmonics, OrderError};
use crate::geometry::quadrature::gauss_legendre;
use crate::geometry::{Direction, ExitantGrid, Fineness, Zone, zone_about_mirror};
use crate::reduce::EDGE_RING;
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

/// Incident directions for the exitant directions at phi_o = 0 that a ring stands for.
struct RingNodes {
    /// Exitant directions, each with the end of its share of `nodes`.
    wo: Vec<(Vector3<f64>, usize)>,
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

/// What data deserve: single exitant directions are noisier than averages over a ring, and there are more of them. Functions of
/// high degree turn faster towards the zone's edges: with nodes for order 6 those of order 10 err by 0.3% of z_00.
pub(super) fn fineness_of(observations: &Observations) -> Fineness {
    let more = |nodes: usize, order: usize| nodes + 4 * observations.order.saturating_sub(order);
    if observations.folded {
        let Fineness { radial, around } = Fineness::default();
        Fineness { radial: more(radial, 6), around }
    } else {
        Fineness { radial: more(24, 4), around: 40 }
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
        let arch = Arch::new();
        let parts: Vec<Vec<f64>> = self
            .stations
            .par_iter()
            .map(|&(ring, phi_o)| {
                let ring = &self.rings[ring];
                let value = |node: &Node| {
                    let cos_i = node.wi.z;
                    if self.folded { shape(node) } else { shape(&node.turned(phi_o)) }.map(|f| f * cos_i)
                };
                let mut sums = vec![0.0; S * self.terms];
                let several = ring.nodes.chunks(TOGETHER).zip(ring.zonal.chunks(TOGETHER * self.terms));
                for (nodes, zonal) in several {
                    let mut values = [[0.0; S]; TOGETHER];
                    values.iter_mut().zip(nodes).for_each(|(values, node)| *values = value(node));
                    arch.dispatch(Products { zonal, values: &values[..nodes.len()], sums: &mut sums });
                }
                sums
            })
            .collect();
        std::array::from_fn(|s| {
            parts.iter().flat_map(|sums| &sums[s * self.terms..(s + 1) * self.terms]).copied().collect()
        })
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
                let mut sums = vec![[0.0; 3]; self.terms];
                let mut begin = 0;
                for &(wo, end) in &ring.wo {
                    let f_cos = brdf.towards(&Direction::new_unchecked(wo).rotated_about_normal(phi_o));
                    let zonal = ring.zonal[begin * self.terms..end * self.terms].chunks_exact(self.terms);
                    for (node, zonal) in ring.nodes[begin..end].iter().zip(zonal) {
                        let values = f_cos(&Direction::new_unchecked(node.wi).rotated_about_normal(phi_o));
                        for (sum, z) in sums.iter_mut().zip(zonal) {
                            sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += z * value);
                        }
                    }
                    begin = end;
                }
                sums
            })
            .collect();
        std::array::from_fn(|c| parts.iter().flatten().map(|v| v[c]).collect())
    }
}

/// Nodes whose products are added while a sum stays in a register.
const TOGETHER: usize = 4;

/// Adds to each sum, `shape * terms + term`, the products of several nodes, `node * terms + term`, one after the other.
struct Products<'a, const S: usize> {
    zonal: &'a [f64],
    values: &'a [[f64; S]],
    sums: &'a mut [f64],
}

impl<const S: usize> WithSimd for Products<'_, S> {
    type Output = ();

    /// The compiler finds the vectors; here is only said of which width they may be.
    #[inline(always)]
    fn with_simd<V: Simd>(self, _simd: V) {
        let Self { zonal, values, sums } = self;
        let terms = sums.len() / S;
        let mut rows = zonal.chunks_exact(terms);
        if let &[a, b, c, d] = values {
            let [za, zb, zc, zd] = std::array::from_fn(|_| rows.next().expect("a row for each node"));
            for (s, sums) in sums.chunks_exact_mut(terms).enumerate() {
                for ((((sum, za), zb), zc), zd) in sums.iter_mut().zip(za).zip(zb).zip(zc).zip(zd) {
                    *sum = *sum + za * a[s] + zb * b[s] + zc * c[s] + zd * d[s];
                }
            }
            return;
        }
        for (zonal, values) in rows.zip(values) {
            for (sums, value) in sums.chunks_exact_mut(terms).zip(values) {
                sums.iter_mut().zip(zonal).for_each(|(sum, z)| *sum += z * value);
            }
        }
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
        let mut of_ring = Self { wo: Vec::new(), nodes: Vec::new(), zonal: Vec::new() };
        let mut functions = vec![0.0; basis.len()];
        let sides: &[f64] = if folded { &[1.0] } else { &[1.0, -1.0] };
        for (theta_o, part) in exitant(grid, ring) {
            let wo = Direction::<crate::geometry::Sample>::from_angles(theta_o, 0.0).vector();
            // An isotropic shape looks alike on both sides of the plane of wo.
            let share = part * 2.0 / sides.len() as f64;
            for (half, weight) in zone_about_mirror(theta_o, &basis.zone(), fineness) {
                for side in sides {
                    let wi = Vector3::new(half.x, side * half.y, half.z);
                    basis.eval_direction_into(&Direction::new_unchecked(wi), &mut functions);
                    of_ring.zonal.extend(terms.iter().map(|&k| share * weight * functions[k]));
                    let h = (wi + wo).normalize();
                    of_ring.nodes.push(Node { wi, wo, h, schlick: schlick(&wo, &h) });
                }
            }
            of_ring.wo.push((wo, of_ring.nodes.len()));
        }
        of_ring
    }
}

/// Angles, radians, whose values a ring stands for, with their weights: its centre. In the first and the last ring the zone's edge
/// cuts lobes narrower than a ring, the more the nearer a pixel lies to it: there it is all that the pixels about the centre see.
fn exitant(grid: &ExitantGrid, ring: usize) -> Vec<(f64, f64)> {
    let centre = grid.theta(ring);
    if ring != 0 && ring + 1 != grid.rings() {
        return vec![(centre, 1.0)];
    }
    let half = 0.5 * EDGE_WIDTH * grid.ring_width();
    let nodes = gauss_legendre(EDGE_NODES, centre - half, centre + half);
    nodes.into_iter().map(|(theta_o, w)| (theta_o, w / (2.0 * half))).collect()
}

/// Width over which a ring at the zone's edge is averaged, in rings: pixels whose centres lie within [`EDGE_RING`], and what a
/// camera's and a projector's own pixels of a fifth and a quarter of a ring add to its variance.
const EDGE_WIDTH: f64 = 1.14 * EDGE_RING;
/// Nodes across it.
const EDGE_NODES: usize = 3;
