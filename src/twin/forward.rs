//! What the sample sends into every exitant direction when a pattern is shown.

use std::f64::consts::TAU;

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::finite::{MARGIN, Pencil, Pupils};
use super::geometry::InverseMap;
use super::light::{BLOCK, PatternLight};
use crate::geometry::quadrature::tangents;
use crate::geometry::{Direction, Sample, Zone};
use crate::optics::cubic;
use crate::reflectance::Brdf;

/// Size of the quadrature and of the grid of exitant directions it is made on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Accuracy {
    /// Nodes over the dome: a Fibonacci number.
    pub dome_nodes: usize,
    /// Nodes about the mirror direction: a Fibonacci number.
    pub lobe_nodes: usize,
    /// Exitant sectors: 16 for each period of the finest azimuthal change of a pattern keep it to 0.05%.
    pub sectors: usize,
    /// Rings per half width of the lobe.
    pub rings_per_lobe: f64,
}

impl Default for Accuracy {
    /// Converged to 0.1% of DC on measured materials.
    fn default() -> Self {
        Self { dome_nodes: 4181, lobe_nodes: 2584, sectors: 96, rings_per_lobe: 2.0 }
    }
}

impl Accuracy {
    /// About twice the nodes in everything: what convergence is tested against.
    pub fn doubled() -> Self {
        Self { dome_nodes: 10946, lobe_nodes: 6765, sectors: 192, rings_per_lobe: 4.0 }
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
            let (peak, floor) = (value(0.0, &axis), value(0.6, &axis).min(value(0.3, &axis)));
            if peak <= floor {
                // It grows that way: what it ends as is not to be seen from here.
                continue;
            }
            let half = 0.5 * (peak + floor);
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

/// What lies between panel and sample.
#[derive(Clone, Copy)]
struct Optics<'a> {
    inverse: &'a InverseMap,
    pupils: Option<&'a Pupils>,
}

/// The exitant direction of each node: it differs between points of the camera's pupil.
type Exitant<'a> = dyn Fn(usize) -> Direction<Sample> + 'a;

/// A node's place in its lattice, its incident direction and solid angle.
type Placed = (usize, Direction<Sample>, f64);

/// The lit nodes of one exitant direction.
struct Nodes {
    nodes: Vec<Node>,
    /// One for each node; none through pinholes.
    pencils: Vec<Pencil>,
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
    pub fn new(brdf: &dyn Brdf, light: &PatternLight, inverse: &InverseMap, dome: Zone, accuracy: &Accuracy) -> Self {
        Self::through(brdf, light, inverse, None, dome, accuracy)
    }

    /// The same through finite pupils, if there are some: each node of the lattices has a point of the camera's pupil of its
    /// own, so that one sum runs over directions and over the pupil.
    pub fn through(
        brdf: &dyn Brdf,
        light: &PatternLight,
        inverse: &InverseMap,
        pupils: Option<&Pupils>,
        dome: Zone,
        accuracy: &Accuracy,
    ) -> Self {
        let width = lobe_width(brdf);
        let coarse = 3f64.to_radians() / accuracy.rings_per_lobe;
        let fine = (width / accuracy.rings_per_lobe).clamp(0.1f64.to_radians(), coarse);
        let optics = Optics { inverse, pupils };
        // Chief rays end with the dome; rays of pupils may not where chief rays do.
        let (wider, lobe_dome) = match pupils {
            None => (widened(&dome, 1f64.to_radians()), dome),
            Some(_) => (widened(&dome, MARGIN), widened(&dome, MARGIN)),
        };
        let blend = Blend { radius: (6.0 * width).clamp(8f64.to_radians(), 25f64.to_radians()) };
        let lobe = LobeLattice { nodes: accuracy.lobe_nodes, core: 0.3 * width, blend };
        let smooth = Grid::new(&dome, coarse, accuracy.sectors, light.patterns);
        let sharp = Grid::new(&dome, fine, accuracy.sectors, light.patterns);
        let parts = [
            smooth.fill(brdf, &light.coarsened(), optics, |wo| dome_lattice(&wider, accuracy.dome_nodes, wo, blend)),
            sharp.fill(brdf, light, optics, |wo| lobe.nodes(&lobe_dome, wo)),
        ];
        Self { parts, patterns: light.patterns }
    }

    /// Adds `scale` times the radiance towards `wo` in one channel, in units of white, to `out`, one value per pattern.
    pub fn add_radiance(&self, wo: &Direction<Sample>, channel: usize, scale: f64, out: &mut [f32]) {
        let (theta, phi) = (wo.theta(), wo.phi());
        for part in &self.parts {
            for (offset, weight) in part.taps(theta, phi) {
                let row = &part.values[(offset * 3 + channel) * self.patterns..][..self.patterns];
                let weight = (weight * scale) as f32;
                for (sum, value) in out.iter_mut().zip(row) {
                    *sum += weight * value;
                }
            }
        }
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
        optics: Optics<'_>,
        nodes: impl Fn(&Exitant<'_>) -> Vec<Placed> + Sync,
    ) -> Self {
        let (sectors, theta0, step) = (self.sectors, self.theta0, self.ring_step);
        let row = 3 * light.patterns;
        let arch = Arch::new();
        let evaluate = |wo: &Direction<Sample>| -> Nodes {
            let exitant = |i: usize| optics.pupils.map_or(*wo, |p| p.exitant(wo, p.camera_point(i)));
            let found = nodes(&exitant).into_iter().filter_map(|(i, wi, w)| {
                let pencil = match optics.pupils {
                    Some(pupils) => Some(pupils.pencil(i, wo, &wi)?),
                    None => None,
                };
                Some((Node::new(&wi, brdf.eval_cos(&wi, &exitant(i)).map(|f| f * w)), pencil))
            });
            let mut found: Vec<(Node, Option<Pencil>)> = found.collect();
            // Neighbours in memory for neighbours on the panel: a lattice's own order jumps about.
            found.sort_unstable_by_key(|(node, _)| node.tile());
            let (nodes, pencils): (_, Vec<_>) = found.into_iter().unzip();
            Nodes { nodes, pencils: pencils.into_iter().flatten().collect() }
        };
        self.values.par_chunks_mut(sectors * row).enumerate().for_each(|(ring, out)| {
            let theta_o = theta0 + ring as f64 * step;
            let shared = brdf.is_isotropic().then(|| evaluate(&Direction::from_angles(theta_o, 0.0)));
            out.par_chunks_mut(row).enumerate().for_each_init(Vec::new, |visits, (sector, out)| {
                let wo = Direction::from_angles(theta_o, sector as f64 * TAU / sectors as f64);
                let own;
                let (nodes, phi_o) = match &shared {
                    Some(nodes) => (nodes, sector as f64 * TAU / sectors as f64),
                    None => {
                        own = evaluate(&wo);
                        (&own, 0.0)
                    }
                };
                arch.dispatch(Sums { nodes, phi_o, wo: &wo, light, optics, visits, out });
            });
        });
        self
    }

    /// 4 x 4 samples with cubic Lagrange weights; phi wraps, theta is one-sided at the ends.
    fn taps(&self, theta: f64, phi: f64) -> [(usize, f64); 16] {
        let r = ((theta - self.theta0) / self.ring_step).clamp(0.0, (self.rings - 1) as f64);
        let r0 = (r as usize).clamp(1, self.rings - 3) - 1;
        let s = phi.rem_euclid(TAU) / TAU * self.sectors as f64;
        let (wr, ws) = (cubic(r - r0 as f64 - 1.0), cubic(s - s.floor()));
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

    /// Column and row of a 3 deg tile of the disc, then the place inside: a total order, so that sums are reproducible.
    fn tile(&self) -> (i32, i32, u32, u32) {
        let tile = |x: f32| (x * 20.0).floor() as i32;
        (tile(self.y), tile(self.x), self.y.to_bits(), self.x.to_bits())
    }
}

/// A lit node: the projector pixel that lights it, and its weight in each channel.
type Visit = (u32, [f32; 3]);

/// The patterns' light over what is lit of the nodes of `wo`, turned by `phi_o`: `out[channel][pattern]`.
struct Sums<'a> {
    nodes: &'a Nodes,
    phi_o: f64,
    wo: &'a Direction<Sample>,
    light: &'a PatternLight,
    optics: Optics<'a>,
    visits: &'a mut Vec<Visit>,
    out: &'a mut [f32],
}

impl WithSimd for Sums<'_> {
    type Output = ();

    /// The compiler finds the vectors; here is only said of which width they may be.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        visit(self.nodes, self.phi_o, self.wo, self.light, self.optics, self.visits);
        accumulate(self.visits, self.light, self.out);
    }
}

/// Collects what is lit of the nodes of `wo`, turned by `phi_o`.
#[inline(always)]
fn visit(
    nodes: &Nodes,
    phi_o: f64,
    wo: &Direction<Sample>,
    light: &PatternLight,
    optics: Optics<'_>,
    visits: &mut Vec<Visit>,
) {
    let Optics { inverse, pupils } = optics;
    let (sin, cos) = (phi_o.sin() as f32, phi_o.cos() as f32);
    let turn = pupils.map(|p| (p, p.turn(wo, phi_o)));
    // Rays of pencils meet the convex mirror's edge each for itself.
    let edge_of_chief_rays = !pupils.is_some_and(Pupils::vignettes);
    visits.clear();
    visits.reserve(nodes.nodes.len());
    for (i, node) in nodes.nodes.iter().enumerate() {
        let (mut x, mut y) = (node.x, node.y);
        if let Some((pupils, turn)) = &turn {
            let Some(chief) = nodes.pencils[i].chief(x, y, turn, pupils) else { continue };
            (x, y) = chief;
        }
        let (x, y) = (cos * x - sin * y, sin * x + cos * y);
        let (u, v) = inverse.pixel(x, y);
        if let Some(pixel) = light.pixel(u, v)
            && !(edge_of_chief_rays && inverse.shadowed(x, y))
        {
            visits.push((pixel, node.weight));
        }
    }
}

/// Adds up the patterns' light over lit nodes.
#[inline(always)]
fn accumulate(visits: &[Visit], light: &PatternLight, out: &mut [f32]) {
    for (block, pixels) in light.blocks.iter().enumerate() {
        let mut sums = [[0.0f32; BLOCK]; 3];
        for (pixel, weight) in visits {
            let row = &pixels[*pixel as usize];
            for (sums, weight) in sums.iter_mut().zip(weight) {
                for (sum, light) in sums.iter_mut().zip(row) {
                    *sum += weight * light;
                }
            }
        }
        let first = block * BLOCK;
        let n = BLOCK.min(light.patterns - first);
        for (channel, sums) in sums.iter().enumerate() {
            out[channel * light.patterns + first..][..n].copy_from_slice(&sums[..n]);
        }
    }
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

/// The dome and what lies beyond it by `margin`, where nothing is lit: means over pixels at the zone's edge reach out there.
fn widened(dome: &Zone, margin: f64) -> Zone {
    Zone::new((dome.theta_min() - margin).max(0.0), dome.theta_max() + margin).expect("wider than a zone")
}

/// A Fibonacci lattice, uniform over the dome's solid angle, for all but the lobe's share.
fn dome_lattice(dome: &Zone, n: usize, wo: &Exitant<'_>, blend: Blend) -> Vec<Placed> {
    let weight = dome.solid_angle() / n as f64;
    lattice(n)
        .enumerate()
        .filter_map(|(i, (x, y))| {
            let wi = Direction::from_mu_phi(dome.cos_min() + (dome.cos_max() - dome.cos_min()) * x, y * TAU);
            let share = 1.0 - blend.lobe(angle(&wi, &wo(i).mirrored()));
            (share > 0.0).then_some((i, wi, weight * share))
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
    fn nodes(&self, dome: &Zone, wo: &Exitant<'_>) -> Vec<Placed> {
        let stretch = (1.0 + self.blend.radius / self.core).ln();
        lattice(self.nodes)
            .enumerate()
            .filter_map(|(i, (x, y))| {
                let mirror = wo(i).mirrored().vector();
                let (t, b) = tangents(&mirror);
                let grown = self.core * (x * stretch).exp();
                let chi = grown - self.core;
                let weight = chi.sin() * grown * stretch * TAU / self.nodes as f64 * self.blend.lobe(chi);
                let (sin_zeta, cos_zeta) = (y * TAU).sin_cos();
                let v = mirror * chi.cos() + (t * cos_zeta + b * sin_zeta) * chi.sin();
                let wi = Direction::new(v);
                let inside = wi.cos_theta() <= dome.cos_min() && wi.cos_theta() >= dome.cos_max();
                inside.then_some((i, wi, weight))
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
    use crate::reflectance::{Ggx, GgxLobe, Lambert};

    #[test]
    fn lobes_are_as_wide_as_they_are_and_a_diffuse_sample_has_none() {
        // Light of a diffuse sample grows towards the pole: that is no lobe that ends at once.
        assert!(lobe_width(&Lambert::gray(0.5)) > 0.2);
        let of = |alpha: f64| {
            let lobes = vec![GgxLobe { alpha: [alpha, alpha], f0: [0.9; 3], f90: [1.0; 3] }];
            lobe_width(&Ggx { kd: [0.1; 3], lobes })
        };
        let widths = [of(0.3), of(0.03), of(0.003)];
        for pair in widths.windows(2) {
            assert!((5.0..20.0).contains(&(pair[0] / pair[1])), "{widths:?}");
        }
    }

    #[test]
    fn both_lattices_together_integrate_the_dome() {
        let dome = Zone::from_degrees(9.0, 57.5).unwrap();
        for theta in [12f64, 30.0, 50.0] {
            let wo = Direction::from_angles(theta.to_radians(), 0.3);
            let blend = Blend { radius: 0.2 };
            let lobe = LobeLattice { nodes: 4181, core: 0.003, blend };
            let nodes = dome_lattice(&dome, 10946, &|_| wo, blend).into_iter().chain(lobe.nodes(&dome, &|_| wo));
            let got: f64 = nodes.map(|(_, wi, w)| w * wi.cos_theta()).sum();
            // The lobe's lattice is cut by the dome's edge: of first order there, some 1e-4 of all.
            assert!((got / dome.projected_solid_angle() - 1.0).abs() < 5e-4, "{theta}: {got}");
        }
    }
}
