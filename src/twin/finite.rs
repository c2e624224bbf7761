//! Pupils of finite size: footprints on the sample, blur, and rays that are lost.
//!
//! A camera pixel is the mean over points p of the camera's pupil of the radiance that the point x(p) of the surface sends
//! into the direction wo(p). Light from wi that meets x has crossed the projector's pupil at some point q: x is lit if q lies
//! inside the pupil, by the panel's point whose chief direction is wi less what q adds to it. These maps are series in p and
//! q ([`PupilMap`]); chief rays are traced.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::TwinConfig;
use super::geometry::InverseMap;
use crate::geometry::{Direction, Sample};
use crate::optics::{Device, Mirrors, Misaligned, Misalignment, PupilMap, Rig};

/// What finite pupils do on the simulated rig `finite`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FiniteOptics {
    /// Whether points of the camera's footprint are dark where the projector's footprint does not reach.
    pub footprints: bool,
    /// Whether rays of a pupil differ in direction from their chief ray. A sample's height then acts through the pupils:
    /// chief rays go on through the rig's middle and meet the sample beside it.
    pub blur: bool,
    /// Whether rays of a pencil are lost inside the convex mirror's edge on their last leg, beyond that edge, and beyond
    /// the dome's end.
    pub vignetting: bool,
}

impl FiniteOptics {
    /// All effects.
    pub fn all() -> Self {
        Self { footprints: true, blur: true, vignetting: true }
    }

    /// None: chief rays alone, as on the rig `pinhole`.
    pub fn none() -> Self {
        Self { footprints: false, blur: false, vignetting: false }
    }
}

/// Polar angles beyond the dome's ends for which pupils are known, radians: more than blur reaches.
pub(super) const MARGIN: f64 = 0.035;
/// No linear map serves footprints nearer to the horizon, radians.
const GRAZING: f64 = 1.54;
/// Points of the camera's pupil that a share is taken over.
const SHARE_POINTS: usize = 2048;
/// The same for what is cut of a pencil.
const PENCIL_RAYS: usize = 144;

/// The pupils of both devices of a misaligned rig, and the mirrors' edges around their rays.
#[derive(Debug, Clone)]
pub struct Pupils {
    switches: FiniteOptics,
    camera: Pupil,
    projector: Pupil,
    /// Height of the sample, mm.
    height: f64,
    /// Middle (x, y, z) and radius of the convex mirror's edge, mm.
    trim: ([f64; 3], f64),
    edges: Edges,
}

#[derive(Debug, Clone)]
struct Pupil {
    radius: f64,
    focus: f64,
    map: PupilMap,
    landing: Landing,
}

impl Pupil {
    /// The direction at the sample of the ray through the point `p` (mm, in the meridian frame) that belongs to `chief`.
    fn ray(&self, chief: &Direction<Sample>, p: [f64; 2]) -> Direction<Sample> {
        let b = self.map.at(chief.theta()).direction;
        let ((sin_t, cos_t), (sin_p, cos_p)) = (chief.theta().sin_cos(), chief.phi().sin_cos());
        let along = Vector3::new(cos_t * cos_p, cos_t * sin_p, -sin_t);
        let across = Vector3::new(-sin_p, cos_p, 0.0);
        Direction::new(chief.vector() + along * (b[0] * p[0]) + across * (b[1] * p[1]))
    }
}

impl Pupils {
    /// Of a simulated rig; `None` where it follows chief rays alone.
    pub fn new(rig: &Rig, config: &TwinConfig) -> Option<Self> {
        let switches = config.finite.filter(|&finite| finite != FiniteOptics::none())?;
        let m = Misalignment { sample_height_mm: 0.0, ..config.perturbation };
        let theta_max = rig.dome.theta_max_deg.to_radians();
        let shadow = rig.mirrors().shadow(rig.paraboloid_radius_mm());
        let pupil = |device: Device, radius: f64, focus: f64| {
            let nominal = Misaligned::new(rig, &Misalignment::none(), device);
            let map = PupilMap::new(&nominal, (shadow - MARGIN).max(0.02), (theta_max + MARGIN).min(GRAZING));
            let landing = Landing::new(&Misaligned::new(rig, &m, device), theta_max.min(GRAZING));
            Pupil { radius, focus, map: map.expect("a checked rig's mirrors go on to the horizon"), landing }
        };
        let (trim, radius) = Misaligned::new(rig, &m, Device::Camera).trim();
        Some(Self {
            switches,
            camera: pupil(Device::Camera, rig.camera.pupil_mm(), rig.camera.focus_mm),
            projector: pupil(Device::Projector, rig.projector.pupil_mm(), rig.projector.focus_mm),
            height: config.perturbation.sample_height_mm,
            trim: ([trim.x, trim.y, trim.z], radius),
            edges: Edges::new(rig.mirrors(), radius, theta_max),
        })
    }

    /// Whether the convex mirror's edge is met by rays, not by chief rays.
    pub(super) fn vignettes(&self) -> bool {
        self.switches.vignetting
    }

    /// Point `i` of a sequence that fills the camera's pupil evenly: (along the meridian of wo, across it), mm.
    pub(super) fn camera_point(&self, i: usize) -> [f64; 2] {
        // Roberts' sequence in two dimensions: its steps have nothing to do with the golden ratio of lattices.
        let at = |step: f64| ((i as f64 + 0.5) * step).fract();
        let (r, phi) = (at(0.754_877_666_246_692_7).sqrt(), at(0.569_840_290_998_053_2) * std::f64::consts::TAU);
        [r * phi.cos(), r * phi.sin()].map(|x| x * self.camera.radius)
    }

    /// The direction at the sample of the ray through the point `p` of the camera's pupil that belongs to `wo`.
    pub(super) fn exitant(&self, wo: &Direction<Sample>, p: [f64; 2]) -> Direction<Sample> {
        if self.switches.blur { self.camera.ray(wo, p) } else { *wo }
    }

    /// The light from `wi` where the ray to `wo` through point `i` of the camera's pupil meets the sample.
    ///
    /// `None` if a mirror is missing on its way: there, displacements of chief rays are left out of account.
    pub(super) fn pencil(&self, i: usize, wo: &Direction<Sample>, wi: &Direction<Sample>) -> Option<Pencil> {
        let p = self.camera_point(i);
        let [along, across] = self.camera.map.at(wo.theta()).displacement(p);
        // A chief ray through the middle of the plane at height 0 meets a raised sample nearer to where it comes from.
        let x = turned([along + self.height * tan(wo.theta()), across], wo.phi());
        let (theta, phi) = (wi.theta(), wi.phi());
        let terms = self.projector.map.at(theta);
        let q = self.crossing(x, wi);
        // Light of pixels beyond the dome's end is dark, and means over pixels carry none of it there.
        let ends = self.switches.vignetting && theta - terms.direction[0] * q[0] <= self.edges.theta_max;
        if ends && !self.edges.reflect(theta, q, self.projector.focus, turned(x, -phi)) {
            return None;
        }
        let bend = if self.switches.blur { terms.direction } else { [0.0; 2] };
        Some(Pencil {
            crossing: turned(q, phi).map(|x| x as f32),
            to_pupil: symmetric(terms.position.map(f64::recip), phi),
            bend: symmetric([bend[0], bend[1] * theta / theta.sin().max(1e-9)], phi),
            past: self.past(x, wi).map(|x| x as f32),
        })
    }

    /// Where the ray between the point `x` of the sample and the direction `w` passes the height of the convex mirror's edge.
    fn past(&self, x: [f64; 2], w: &Direction<Sample>) -> [f64; 2] {
        let (v, rise) = (w.vector(), self.trim.0[2] - self.height);
        [x[0] + v.x / v.z * rise, x[1] + v.y / v.z * rise]
    }

    /// Share of the camera's pencil for `wo` that finds nothing in its way.
    ///
    /// It falls from 1 to 0 within a fraction of a degree and is no part of what is interpolated between directions.
    pub fn transmitted(&self, wo: &Direction<Sample>) -> f64 {
        let (theta, phi) = (wo.theta(), wo.phi());
        let clear = theta > self.edges.shadow + MARGIN && theta < self.edges.theta_max - MARGIN;
        if clear || !self.switches.vignetting {
            return 1.0;
        }
        let landing = self.camera.landing.at((theta * phi.cos()) as f32, (theta * phi.sin()) as f32);
        let terms = self.camera.map.at(theta);
        let passes = |&i: &usize| {
            let p = self.camera_point(i);
            let [along, across] = terms.displacement(p);
            let local = [along + self.height * tan(theta), across];
            let [x, y] = turned(local, phi);
            let x = [x + f64::from(landing[0]), y + f64::from(landing[1])];
            let past = self.past(x, &self.exitant(wo, p));
            let ([trim_x, trim_y, _], radius) = self.trim;
            (past[0] - trim_x).hypot(past[1] - trim_y) >= radius
                && self.edges.reflect(theta, p, self.camera.focus, local)
        };
        (0..PENCIL_RAYS).filter(passes).count() as f64 / PENCIL_RAYS as f64
    }

    /// Where light from `wi` that meets the point `x` of the sample crosses the projector's pupil, in the meridian frame of
    /// `wi`, mm.
    fn crossing(&self, x: [f64; 2], wi: &Direction<Sample>) -> [f64; 2] {
        let [along, across] = turned(x, -wi.phi());
        // Down along the ray to the plane that the terms are of.
        self.projector.map.at(wi.theta()).point([along - self.height * tan(wi.theta()), across])
    }

    /// What pencils made for the azimuth of `wo` less `by` meet when they are turned by `by`, radians.
    pub(super) fn turn(&self, wo: &Direction<Sample>, by: f64) -> Turn {
        let (theta, phi) = (wo.theta(), wo.phi());
        let landing = self.camera.landing.at((theta * phi.cos()) as f32, (theta * phi.sin()) as f32);
        let ([x, y, _], radius) = self.trim;
        let back = |v: [f64; 2]| turned(v, -by).map(|x| x as f32);
        let [dx, dy] = landing.map(f64::from);
        let reach = if self.switches.footprints { self.projector.radius } else { f64::INFINITY };
        Turn {
            cos: by.cos() as f32,
            sin: by.sin() as f32,
            landing: back([dx, dy]),
            trim: back([x - dx, y - dy]),
            reach2: (reach * reach) as f32,
            shadow2: (self.edges.shadow * self.edges.shadow) as f32,
            edge2: if self.switches.vignetting { (radius * radius) as f32 } else { 0.0 },
        }
    }

    /// |Fp ∩ Fc| / |Fc|: the share of what the camera sees of the sample in `wo` that is lit from `wi`.
    pub fn lit_share(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> f64 {
        let turn = self.turn(wo, 0.0);
        let (theta, phi) = (wi.theta(), wi.phi());
        let (x, y) = ((theta * phi.cos()) as f32, (theta * phi.sin()) as f32);
        let lit = |&i: &usize| self.pencil(i, wo, wi).is_some_and(|pencil| pencil.chief(x, y, &turn, self).is_some());
        (0..SHARE_POINTS).filter(lit).count() as f64 / SHARE_POINTS as f64
    }
}

/// A ray of light that meets a point of the sample which the camera sees, as linear terms; mm and radians.
pub(super) struct Pencil {
    /// Where the light crosses the projector's pupil if chief rays meet in the middle.
    crossing: [f32; 2],
    /// From displacements on the sample to displacements of that (xx, xy, yy).
    to_pupil: [f32; 3],
    /// From points of the pupil to what they add to the chief direction, on the disc of [`InverseMap`].
    bend: [f32; 3],
    /// Where the light passes the height of the convex mirror's edge.
    past: [f32; 2],
}

/// What does not turn with pencils, in their frame.
pub(super) struct Turn {
    cos: f32,
    sin: f32,
    /// Where the camera's chief ray meets the sample's plane.
    landing: [f32; 2],
    /// Middle of the convex mirror's edge, seen from there.
    trim: [f32; 2],
    /// Square of the projector's pupil.
    reach2: f32,
    /// Square of the convex mirror's edge.
    edge2: f32,
    /// Square of the polar angle at which its shadow ends.
    shadow2: f32,
}

impl Pencil {
    /// The chief direction of the panel's point that lights this pencil's ray from (x, y), on the disc of [`InverseMap`];
    /// `None` if nothing does.
    #[inline]
    pub fn chief(&self, x: f32, y: f32, turn: &Turn, pupils: &Pupils) -> Option<(f32, f32)> {
        let (cos, sin) = (turn.cos, turn.sin);
        let [dx, dy] = pupils.projector.landing.at(cos * x - sin * y, sin * x + cos * y);
        let off = [turn.landing[0] - (cos * dx + sin * dy), turn.landing[1] - (cos * dy - sin * dx)];
        let add = times(&self.to_pupil, off);
        let q = [self.crossing[0] + add[0], self.crossing[1] + add[1]];
        let past = [self.past[0] - turn.trim[0], self.past[1] - turn.trim[1]];
        let bent = times(&self.bend, q);
        let (x, y) = (x - bent[0], y - bent[1]);
        // What chief rays do not reach is dark; means over pixels at the zone's edge reach out there all the same.
        let cut = past[0] * past[0] + past[1] * past[1] < turn.edge2 && x * x + y * y > turn.shadow2;
        (q[0] * q[0] + q[1] * q[1] <= turn.reach2 && !cut).then_some((x, y))
    }
}

/// Steps along each side of the table of chief rays.
const LANDING_NODES: usize = 33;

/// Where chief rays of a misaligned device meet the sample's plane, over the disc of [`InverseMap`], mm.
#[derive(Debug, Clone)]
struct Landing {
    reach: f32,
    nodes: Vec<[f32; 2]>,
}

impl Landing {
    fn new(device: &Misaligned, theta_max: f64) -> Self {
        let (inverse, reach) = (InverseMap::new(device, theta_max), theta_max * 1.05);
        let at = |j: usize| (j as f64 / (LANDING_NODES - 1) as f64 * 2.0 - 1.0) * reach;
        let node = |i: usize| {
            let (x, y) = (at(i % LANDING_NODES), at(i / LANDING_NODES));
            let shrink = (theta_max / x.hypot(y)).min(1.0);
            let (u, v) = inverse.pixel((x * shrink) as f32, (y * shrink) as f32);
            let arrival = device.through(f64::from(u), f64::from(v), [0.0; 2]);
            arrival.map_or([0.0; 2], |a| a.position_mm.map(|x| x as f32))
        };
        Self { reach: reach as f32, nodes: (0..LANDING_NODES * LANDING_NODES).map(node).collect() }
    }

    #[inline]
    fn at(&self, x: f32, y: f32) -> [f32; 2] {
        let to_node = (LANDING_NODES - 1) as f32 / (2.0 * self.reach);
        let place = |x: f32| ((x + self.reach) * to_node).clamp(0.0, (LANDING_NODES - 1) as f32 - 1e-3);
        let (fx, fy) = (place(x), place(y));
        let (ix, iy) = (fx as usize, fy as usize);
        let (tx, ty) = (fx - ix as f32, fy - iy as f32);
        let row = &self.nodes[iy * LANDING_NODES + ix..][..LANDING_NODES + 2];
        [0, 1].map(|k| {
            let top = row[0][k] + tx * (row[1][k] - row[0][k]);
            let bottom = row[LANDING_NODES][k] + tx * (row[LANDING_NODES + 1][k] - row[LANDING_NODES][k]);
            top + ty * (bottom - top)
        })
    }
}

/// Polar angles of the table of chief rays' ways.
const EDGE_ANGLES: usize = 256;

/// Where rays near a chief ray need mirrors.
#[derive(Debug, Clone)]
struct Edges {
    step: f64,
    /// Over polar angles from 0 on: radius on the convex mirror, its depth below the pupils, and the distance from the
    /// sample to the dome, mm.
    ways: Vec<[f64; 3]>,
    /// Of the convex mirror's edge, mm.
    radius: f64,
    /// Where its shadow ends, radians.
    shadow: f64,
    theta_max: f64,
}

impl Edges {
    fn new(mirrors: Mirrors, radius: f64, theta_max: f64) -> Self {
        let step = (theta_max + MARGIN) / (EDGE_ANGLES - 1) as f64;
        let way = |i: usize| {
            let rho = mirrors.rho_of(step * i as f64, mirrors.edge_radius()).unwrap_or(mirrors.edge_radius());
            let down = mirrors.centre().z - mirrors.convex().height(rho);
            [rho, down, mirrors.profile(rho).map_or(f64::INFINITY, |d| d.x.hypot(d.z))]
        };
        Self { step, ways: (0..EDGE_ANGLES).map(way).collect(), radius, shadow: mirrors.shadow(radius), theta_max }
    }

    /// Whether both mirrors are there for the ray of direction theta at the point `x` of the sample that crosses the pupil of a
    /// device focused at `focus` (mm) at `p`, both in the ray's meridian frame.
    fn reflect(&self, theta: f64, p: [f64; 2], focus: f64, x: [f64; 2]) -> bool {
        let at = (theta / self.step).clamp(0.0, (EDGE_ANGLES - 1) as f64 - 1e-9);
        let (a, b) = (&self.ways[at as usize], &self.ways[at as usize + 1]);
        let [rho, down, distance] = [0, 1, 2].map(|k| a[k] + at.fract() * (b[k] - a[k]));
        // Rays of a pencil meet the chief ray in the plane in focus.
        let left = 1.0 - down / focus;
        let convex = (rho + left * p[0]).hypot(left * p[1]);
        convex <= self.radius && theta + x[0] * theta.cos() / distance <= self.theta_max
    }
}

fn tan(theta: f64) -> f64 {
    theta.min(GRAZING).tan()
}

fn turned([x, y]: [f64; 2], by: f64) -> [f64; 2] {
    let (sin, cos) = by.sin_cos();
    [cos * x - sin * y, sin * x + cos * y]
}

/// The matrix (xx, xy, yy) that multiplies by `factors` along and across the azimuth `phi`.
fn symmetric(factors: [f64; 2], phi: f64) -> [f32; 3] {
    let ((sin, cos), [a, b]) = (phi.sin_cos(), factors);
    [a * cos * cos + b * sin * sin, (a - b) * cos * sin, a * sin * sin + b * cos * cos].map(|x| x as f32)
}

#[inline]
fn times(m: &[f32; 3], [x, y]: [f32; 2]) -> [f32; 2] {
    [m[0] * x + m[1] * y, m[1] * x + m[2] * y]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Beam, disc};

    fn rig(projector_pupil_mm: f64) -> Rig {
        let mut rig = Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap();
        rig.projector.f_number = rig.projector.focal_length_mm / 2.0 / projector_pupil_mm;
        rig
    }

    fn raised(height_mm: f64) -> TwinConfig {
        let mut config = TwinConfig::finite(0);
        config.perturbation.sample_height_mm = height_mm;
        config
    }

    fn deg(theta: f64, phi: f64) -> Direction<Sample> {
        Direction::from_angles(theta.to_radians(), phi.to_radians())
    }

    /// A device and the image point whose chief ray comes from `w`.
    struct Traced {
        device: Misaligned,
        inverse: InverseMap,
    }

    impl Traced {
        fn new(rig: &Rig, config: &TwinConfig, device: Device) -> Self {
            let chief = Misaligned::new(rig, &config.of_chief_rays(), device);
            let inverse = InverseMap::new(&chief, 57.5f64.to_radians());
            Self { device: Misaligned::new(rig, &config.perturbation, device), inverse }
        }

        fn image(&self, w: &Direction<Sample>) -> (f64, f64) {
            let (theta, phi) = (w.theta(), w.phi());
            let (u, v) = self.inverse.pixel((theta * phi.cos()) as f32, (theta * phi.sin()) as f32);
            (f64::from(u), f64::from(v))
        }

        fn beam(&self, w: &Direction<Sample>, pupil_mm: f64) -> Beam {
            let (u, v) = self.image(w);
            Beam::new(&self.device, u, v, pupil_mm).unwrap()
        }
    }

    /// Against exact tracing of both pupils' edges, misalignment included.
    #[test]
    fn lit_shares_are_those_of_traced_beams() {
        let (mut worst, mut partly) = (0.0f64, 0);
        for pupil_mm in [1.5625, 3.0, 5.566, 12.5] {
            let rig = rig(pupil_mm);
            for height_mm in [0.0, 0.05, 0.2, 0.5, 1.0] {
                // What is cut of a beam is no matter of its footprint.
                let finite = Some(FiniteOptics { vignetting: false, ..FiniteOptics::all() });
                let config = TwinConfig { finite, ..raised(height_mm) };
                let pupils = Pupils::new(&rig, &config).unwrap();
                let [camera, projector] = [Device::Camera, Device::Projector].map(|d| Traced::new(&rig, &config, d));
                for (theta_i, theta_o, dphi) in
                    [(9.3, 56.5, 0.0), (9.3, 56.5, 180.0), (20.0, 50.0, 90.0), (40.0, 40.0, 180.0), (55.0, 12.0, 60.0)]
                {
                    let (wi, wo) = (deg(theta_i, 20.0 + dphi), deg(theta_o, 20.0));
                    let want = projector.beam(&wi, pupil_mm).lit_share(&camera.beam(&wo, rig.camera.pupil_mm()));
                    // A beam's rays differ in direction: it is the one that meets the camera's footprint that counts.
                    let x = turned([height_mm * wo.theta().tan(), 0.0], wo.phi());
                    let meets = pupils.projector.ray(&wi, pupils.crossing(x, &wi));
                    let got = pupils.lit_share(&meets, &wo);
                    let off = (got - want).abs();
                    if off > 0.003 {
                        println!("{pupil_mm} {height_mm} {theta_i} {theta_o} {dphi}: {got:.4} traced {want:.4}");
                    }
                    worst = worst.max(off);
                    partly += usize::from((0.02..0.98).contains(&want));
                }
            }
        }
        println!("lit shares: worst {worst:.4}, {partly} in part");
        assert!(worst < 0.01 && partly > 10, "{worst} {partly}");
    }

    #[test]
    fn blur_is_that_of_traced_beams() {
        let (rig, config) = (rig(12.5), TwinConfig { perturbation: Misalignment::none(), ..raised(0.0) });
        let pupils = Pupils::new(&rig, &config).unwrap();
        let camera = Traced::new(&rig, &config, Device::Camera);
        for theta in [9.5, 20.0, 30.0, 50.0, 57.0] {
            let wo = deg(theta, 70.0);
            let rays: Vec<_> =
                (0..SHARE_POINTS).map(|i| pupils.exitant(&wo, pupils.camera_point(i)).vector()).collect();
            let n = rays.len() as f64;
            let mean = rays.iter().sum::<Vector3<f64>>() / n;
            let spread = (rays.iter().map(|r| (r - mean).norm_squared()).sum::<f64>() / n).sqrt();
            let want = camera.beam(&wo, rig.camera.pupil_mm()).spread;
            println!("{theta}: {:.4} deg, traced {:.4}", spread.to_degrees(), want.to_degrees());
            assert!((spread / want - 1.0).abs() < 0.03, "{theta}: {spread} {want}");
        }
    }

    /// A ray of the projector's pupil, traced to a raised sample, is found again: its point of the pupil and its pixel.
    #[test]
    fn light_comes_from_the_pixel_whose_ray_it_is() {
        let rig = rig(12.5);
        let mut worst = [0.0f64; 2];
        for height_mm in [0.0, 0.2, 1.0] {
            let mut config = TwinConfig { perturbation: Misalignment::none(), ..raised(0.0) };
            config.perturbation.sample_height_mm = height_mm;
            let pupils = Pupils::new(&rig, &config).unwrap();
            let projector = Traced::new(&rig, &config, Device::Projector);
            for (theta, phi) in [(10.0, 10.0), (30.0, 100.0), (56.0, 200.0)] {
                let chief = deg(theta, phi);
                let (u, v) = projector.image(&chief);
                // As far from the middle as the camera's footprint asks for.
                for p in disc().map(|p| p.map(|x| 4.0 * x)) {
                    let ray = projector.device.through(u, v, p).unwrap();
                    let q = pupils.crossing(ray.position_mm, &ray.direction);
                    let want = turned(p, -ray.direction.phi());
                    worst[0] = worst[0].max((q[0] - want[0]).hypot(q[1] - want[1]));
                    let (t, f) = (ray.direction.theta(), ray.direction.phi());
                    let bend = pupils.projector.map.at(t).direction;
                    let bent = turned([t - bend[0] * q[0], -bend[1] * q[1] * t / t.sin()], f);
                    let disc = turned([chief.theta(), 0.0], chief.phi());
                    worst[1] = worst[1].max((bent[0] - disc[0]).hypot(bent[1] - disc[1]).to_degrees());
                }
            }
        }
        println!("found again within {:.3} mm of the pupil and {:.4} deg", worst[0], worst[1]);
        assert!(worst[0] < 0.15 && worst[1] < 0.03, "{worst:?}");
    }

    /// At the end of the convex mirror's shadow the camera's pencils are cut.
    #[test]
    fn pencils_are_cut_where_traced_ones_are() {
        let (rig, config) = (rig(12.5), raised(0.05));
        let pupils = Pupils::new(&rig, &config).unwrap();
        let camera = Traced::new(&rig, &config, Device::Camera);
        let shadow = rig.mirrors().shadow(rig.paraboloid_radius_mm()).to_degrees();
        for off in [-0.06, -0.02, 0.0, 0.02, 0.06] {
            let wo = deg(shadow + off, 130.0);
            let got = pupils.transmitted(&wo);
            let want = camera.beam(&wo, rig.camera.pupil_mm()).transmitted;
            println!("{off}: {got:.3}, traced {want:.3}");
            // The traced ones are 48 rays.
            assert!((got - want).abs() < 0.06, "{off}: {got} {want}");
        }
        assert!(Pupils::new(&rig, &TwinConfig::pinhole(0)).is_none());
    }
}
