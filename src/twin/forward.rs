//! What the sample sends into every exitant direction when a pattern is shown.

use std::f64::consts::TAU;

use rayon::prelude::*;

use super::geometry::InverseMap;
use crate::geometry::quadrature::tangents;
use crate::geometry::{Direction, Sample, Zone};
use crate::reflectance::Brdf;

/// Size of the quadrature and of the grid of exitant directions it is made on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Accuracy {
    /// Nodes over the dome: a Fibonacci number.
    pub dome_nodes: usize,
    /// Nodes about the mirror direction: a Fibonacci number.
    pub lobe_nodes: usize,
    /// Exitant sectors per azimuthal period of the highest order.
    pub sectors_per_order: usize,
    /// Rings per half width of the lobe.
    pub rings_per_lobe: f64,
}

impl Default for Accuracy {
    /// Converged to 0.1% of DC on measured materials.
    fn default() -> Self {
        Self { dome_nodes: 10946, lobe_nodes: 4181, sectors_per_order: 20, rings_per_lobe: 2.0 }
    }
}

impl Accuracy {
    /// About twice the nodes in everything: what convergence is tested against.
    pub fn doubled() -> Self {
        Self { dome_nodes: 28657, lobe_nodes: 10946, sectors_per_order: 40, rings_per_lobe: 4.0 }
    }
}

/// Light of every projector pixel in each of several patterns: row p holds one value per pattern.
pub struct PatternLight {
    /// Columns of the panel region.
    pub width: usize,
    /// Rows of the panel region.
    pub height: usize,
    /// First column and row of the region on the panel.
    pub origin: [usize; 2],
    /// Number of patterns.
    pub patterns: usize,
    /// `[pixel][pattern]`, in units of full white.
    pub light: Vec<f32>,
}

impl PatternLight {
    /// All patterns' light at a point of the panel; `None` beyond the region.
    #[inline]
    fn at(&self, u: f32, v: f32) -> Option<&[f32]> {
        let (i, j) = ((u.floor() as isize) - self.origin[0] as isize, (v.floor() as isize) - self.origin[1] as isize);
        if i < 0 || j < 0 || i as usize >= self.width || j as usize >= self.height {
            return None;
        }
        let p = (j as usize * self.width + i as usize) * self.patterns;
        Some(&self.light[p..p + self.patterns])
    }
}

/// Half width, in radians, of the sharpest lobe about the mirror direction, found on the curves of `brdf`.
pub fn lobe_width(brdf: &dyn Brdf) -> f64 {
    let mut width = 1.0f64;
    for (theta, phi) in [(15f64, 0.0), (35.0, 0.0), (35.0, 90.0), (55.0, 0.0)] {
        let wo = Direction::from_angles(theta.to_radians(), phi_of(phi));
        let mirror = wo.mirrored().vector();
        let (t, b) = tangents(&mirror);
        let value = |chi: f64, axis: &nalgebra::Vector3<f64>| {
            let v = mirror * chi.cos() + axis * chi.sin();
            if v.z <= 0.0 { 0.0 } else { brdf.eval_cos(&Direction::new(v), &wo).iter().sum::<f64>() }
        };
        for axis in [t, -t, b] {
            let floor = value(0.6, &axis).min(value(0.3, &axis));
            let half = 0.5 * (value(0.0, &axis) + floor);
            let mut chi = 2e-4;
            while chi < width && value(chi, &axis) > half {
                chi *= 1.15;
            }
            width = width.min(chi);
        }
    }
    width
}

fn phi_of(phi_deg: f64) -> f64 {
    phi_deg.to_radians()
}

/// Responses of a material to a set of patterns on a grid of exitant directions: radiance in units of white, per pattern.
///
/// Two parts with their own rings, because only light from near the mirror direction changes quickly with wo.
pub struct ResponseField {
    parts: [Grid; 2],
    patterns: usize,
}

/// One incident node as seen from phi_o = 0: position on the disc of [`InverseMap`] and f_cos times its solid angle.
struct Node {
    x: f32,
    y: f32,
    weight: [f32; 3],
}

struct Grid {
    theta0: f64,
    ring_step: f64,
    rings: usize,
    sectors: usize,
    /// `[ring][sector][channel][pattern]`
    values: Vec<f32>,
}

impl ResponseField {
    /// Integrates `brdf` over the light that reaches the sample from `dome` (the part of the dome that is there).
    ///
    /// The quadrature is a partition of one: a lattice over the dome for what is smooth, and a lattice in logarithmic
    /// polar coordinates about the mirror direction for the lobe. Isotropic materials are evaluated once per ring.
    pub fn new(
        brdf: &dyn Brdf,
        light: &PatternLight,
        inverse: &InverseMap,
        dome: Zone,
        order: usize,
        accuracy: &Accuracy,
    ) -> Self {
        let width = lobe_width(brdf);
        let sectors = (accuracy.sectors_per_order * order.max(4)).max(96);
        let coarse = 0.75f64.to_radians() * 2.0 / accuracy.rings_per_lobe;
        let fine = (width / accuracy.rings_per_lobe).clamp(0.1f64.to_radians(), coarse);
        let blend = Blend { radius: (6.0 * width).clamp(8f64.to_radians(), 25f64.to_radians()) };
        let lobe = LobeLattice { nodes: accuracy.lobe_nodes, core: 0.3 * width, blend };
        let smooth = Grid::new(&dome, coarse, sectors, light.patterns);
        let sharp = Grid::new(&dome, fine, sectors, light.patterns);
        let parts = [
            smooth.fill(brdf, light, inverse, |wo| dome_lattice(&dome, accuracy.dome_nodes, wo, blend)),
            sharp.fill(brdf, light, inverse, |wo| lobe.nodes(&dome, wo)),
        ];
        Self { parts, patterns: light.patterns }
    }

    /// Radiance towards `wo` in one channel for pattern `pattern`, in units of white.
    pub fn radiance(&self, wo: &Direction<Sample>, channel: usize, pattern: usize) -> f64 {
        self.taps(wo).map(|(grid, offset, weight)| weight * self.value(grid, offset, channel, pattern)).sum()
    }

    /// Grid, offset and weight of the samples that interpolate a direction.
    pub fn taps(&self, wo: &Direction<Sample>) -> impl Iterator<Item = (usize, usize, f64)> {
        let (theta, phi) = (wo.theta(), wo.phi());
        let taps = [self.parts[0].taps(theta, phi), self.parts[1].taps(theta, phi)];
        taps.into_iter().enumerate().flat_map(|(g, taps)| taps.into_iter().map(move |(o, w)| (g, o, w)))
    }

    /// The sample that a tap names.
    #[inline]
    pub fn value(&self, grid: usize, offset: usize, channel: usize, pattern: usize) -> f64 {
        f64::from(self.parts[grid].values[(offset * 3 + channel) * self.patterns + pattern])
    }
}

impl Grid {
    fn new(dome: &Zone, step: f64, sectors: usize, patterns: usize) -> Self {
        let span = dome.theta_max() - dome.theta_min();
        let rings = ((span / step).ceil() as usize + 1).max(8);
        let ring_step = span / (rings - 1) as f64;
        Self { theta0: dome.theta_min(), ring_step, rings, sectors, values: vec![0.0; rings * sectors * 3 * patterns] }
    }

    fn fill(
        mut self,
        brdf: &dyn Brdf,
        light: &PatternLight,
        inverse: &InverseMap,
        nodes: impl Fn(&Direction<Sample>) -> Vec<(Direction<Sample>, f64)> + Sync,
    ) -> Self {
        let (sectors, theta0, step) = (self.sectors, self.theta0, self.ring_step);
        let row = 3 * light.patterns;
        let evaluate = |wo: &Direction<Sample>| -> Vec<Node> {
            nodes(wo).into_iter().map(|(wi, w)| Node::new(&wi, brdf.eval_cos(&wi, wo).map(|f| f * w))).collect()
        };
        self.values.par_chunks_mut(sectors * row).enumerate().for_each(|(ring, out)| {
            let theta_o = theta0 + ring as f64 * step;
            let shared = brdf.is_isotropic().then(|| evaluate(&Direction::from_angles(theta_o, 0.0)));
            out.par_chunks_mut(row).enumerate().for_each(|(sector, out)| {
                let phi_o = sector as f64 * TAU / sectors as f64;
                match &shared {
                    Some(nodes) => accumulate(nodes, phi_o, light, inverse, out),
                    None => accumulate(&evaluate(&Direction::from_angles(theta_o, phi_o)), 0.0, light, inverse, out),
                }
            });
        });
        self
    }

    /// 4 x 4 samples with cubic Lagrange weights; phi wraps, theta is one-sided at the ends.
    fn taps(&self, theta: f64, phi: f64) -> [(usize, f64); 16] {
        let r = ((theta - self.theta0) / self.ring_step).clamp(0.0, (self.rings - 1) as f64);
        let r0 = (r as usize).clamp(1, self.rings - 3) - 1;
        let s = phi.rem_euclid(TAU) / TAU * self.sectors as f64;
        let (wr, ws) = (lagrange(r - r0 as f64), lagrange(s - s.floor() + 1.0));
        let s0 = s.floor() as usize + self.sectors - 1;
        std::array::from_fn(|i| {
            let (a, b) = (i / 4, i % 4);
            ((r0 + a) * self.sectors + (s0 + b) % self.sectors, wr[a] * ws[b])
        })
    }
}

impl Node {
    fn new(wi: &Direction<Sample>, weight: [f64; 3]) -> Self {
        let (theta, phi) = (wi.theta(), wi.phi());
        Self { x: (theta * phi.cos()) as f32, y: (theta * phi.sin()) as f32, weight: weight.map(|w| w as f32) }
    }
}

/// Adds up the patterns' light over the nodes, turned by `phi_o`: `out[channel][pattern]`.
fn accumulate(nodes: &[Node], phi_o: f64, light: &PatternLight, inverse: &InverseMap, out: &mut [f32]) {
    let (sin, cos) = (phi_o.sin() as f32, phi_o.cos() as f32);
    let (red, rest) = out.split_at_mut(light.patterns);
    let (green, blue) = rest.split_at_mut(light.patterns);
    for node in nodes {
        let (u, v) = inverse.pixel(cos * node.x - sin * node.y, sin * node.x + cos * node.y);
        let Some(row) = light.at(u, v) else { continue };
        let [wr, wg, wb] = node.weight;
        for (((r, g), b), &l) in red.iter_mut().zip(green.iter_mut()).zip(blue.iter_mut()).zip(row) {
            *r += wr * l;
            *g += wg * l;
            *b += wb * l;
        }
    }
}

/// Weights of four samples at 0, 1, 2, 3 for the position x.
fn lagrange(x: f64) -> [f64; 4] {
    let (a, b, c, d) = (x, x - 1.0, x - 2.0, x - 3.0);
    [-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0]
}

/// Share of a direction's light that the lobe's lattice takes: 1 near the mirror direction, 0 beyond `radius`.
#[derive(Clone, Copy)]
struct Blend {
    radius: f64,
}

impl Blend {
    fn lobe(self, chi: f64) -> f64 {
        let t = (2.0 * (1.0 - chi / self.radius)).clamp(0.0, 1.0);
        t * t * t * (10.0 + t * (6.0 * t - 15.0))
    }
}

/// A Fibonacci lattice, uniform over the dome's solid angle, for all but the lobe's share.
fn dome_lattice(dome: &Zone, n: usize, wo: &Direction<Sample>, blend: Blend) -> Vec<(Direction<Sample>, f64)> {
    let mirror = wo.mirrored();
    let weight = dome.solid_angle() / n as f64;
    lattice(n)
        .filter_map(|(x, y)| {
            let wi = Direction::from_mu_phi(dome.cos_min() + (dome.cos_max() - dome.cos_min()) * x, y * TAU);
            let share = 1.0 - blend.lobe(angle(&wi, &mirror));
            (share > 0.0).then_some((wi, weight * share))
        })
        .collect()
}

#[derive(Clone, Copy)]
struct LobeLattice {
    nodes: usize,
    /// Scale below which nodes are evenly spaced, radians.
    core: f64,
    blend: Blend,
}

impl LobeLattice {
    /// A lattice about the mirror direction, spaced in proportion to core + chi; what misses the dome is left out.
    fn nodes(&self, dome: &Zone, wo: &Direction<Sample>) -> Vec<(Direction<Sample>, f64)> {
        let mirror = wo.mirrored().vector();
        let (t, b) = tangents(&mirror);
        let stretch = (1.0 + self.blend.radius / self.core).ln();
        lattice(self.nodes)
            .filter_map(|(x, y)| {
                let grown = self.core * (x * stretch).exp();
                let chi = grown - self.core;
                let weight = chi.sin() * grown * stretch * TAU / self.nodes as f64 * self.blend.lobe(chi);
                let (sin_zeta, cos_zeta) = (y * TAU).sin_cos();
                let v = mirror * chi.cos() + (t * cos_zeta + b * sin_zeta) * chi.sin();
                let wi = Direction::new(v);
                let inside = wi.cos_theta() <= dome.cos_min() && wi.cos_theta() >= dome.cos_max();
                inside.then_some((wi, weight))
            })
            .collect()
    }
}

/// The Fibonacci lattice of n points in the unit square, midpoints in x; n must be a Fibonacci number.
fn lattice(n: usize) -> impl Iterator<Item = (f64, f64)> {
    let (mut previous, mut current) = (1, 1);
    while current < n {
        (previous, current) = (current, previous + current);
    }
    (0..n).map(move |i| ((i as f64 + 0.5) / n as f64, (i * previous % n) as f64 / n as f64))
}

fn angle(a: &Direction<Sample>, b: &Direction<Sample>) -> f64 {
    a.vector().cross(&b.vector()).norm().atan2(a.dot(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_lattices_together_integrate_the_dome() {
        let dome = Zone::from_degrees(9.0, 57.5).unwrap();
        for theta in [12f64, 30.0, 50.0] {
            let wo = Direction::from_angles(theta.to_radians(), 0.3);
            let blend = Blend { radius: 0.2 };
            let lobe = LobeLattice { nodes: 4181, core: 0.003, blend };
            let nodes = dome_lattice(&dome, 10946, &wo, blend).into_iter().chain(lobe.nodes(&dome, &wo));
            let got: f64 = nodes.map(|(wi, w)| w * wi.cos_theta()).sum();
            // The lobe's lattice is cut by the dome's edge: of first order there, some 1e-4 of all.
            assert!((got / dome.projected_solid_angle() - 1.0).abs() < 5e-4, "{theta}: {got}");
        }
    }

    #[test]
    fn lagrange_weights_reproduce_cubics() {
        for x in [1.0, 1.3, 1.9, 0.2, 2.8] {
            let w = lagrange(x);
            for power in 0..4 {
                let got: f64 = (0..4).map(|i| w[i] * (i as f64).powi(power)).sum();
                assert!((got - x.powi(power)).abs() < 1e-12);
            }
        }
    }
}
