//! What the camera sees of the targets of `calibrate align` and `calibrate map`.
//!
//! Crosses are seen through finite pupils, because defocus is what makes them hard to find; the mirror and its border
//! through pinholes, as samples are.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use super::geometry::InverseMap;
use crate::optics::{Misaligned, Rig};

/// Diffuse albedo of screen and border.
const WHITE: f64 = 0.9;
/// Albedo of printed lines.
const BLACK: f64 = 0.05;
/// Reflectance of the front-surface mirror.
const MIRROR: f64 = 0.92;
/// Samples along each side of a camera pixel that sees the mirror.
const SIDE: usize = 3;
/// Points of the camera's pupil.
const CAMERA_POINTS: usize = 56;
/// Points of the projector's pupil.
const PROJECTOR_POINTS: usize = 1600;
/// Spacing of the screen's irradiance, mm: the projector's blur there is five times wider.
const SCREEN_STEP_MM: f64 = 1.0;

/// A rig's two devices and what is between them.
pub(super) struct View<'a> {
    pub rig: &'a Rig,
    pub camera: &'a Misaligned,
    pub projector: &'a Misaligned,
    pub inverse: &'a InverseMap,
}

/// Radiance towards a camera pixel as a weighted mean over projector pixels.
pub(super) struct Seen {
    pixel: usize,
    /// Projector pixels, in equal shares; `DARK` for what sees none.
    sources: [u32; SIDE * SIDE],
    weight: f64,
}

const DARK: u32 = u32::MAX;

/// A target whose image is known for every pattern.
pub(super) enum Target {
    Mirror(Vec<Seen>),
    Crosses {
        wires: bool,
        /// (sensor pixel, share of its light that comes from white screen, mean place of that on the screen).
        seen: Vec<(usize, f64, [f64; 2])>,
    },
}

impl Target {
    /// The mirror and its border, followed pixel by pixel.
    pub fn mirror(scene: &View<'_>) -> Self {
        let (width, height) = (scene.rig.camera.width_px, scene.rig.camera.height_px);
        let seen = (0..width * height).into_par_iter().filter_map(|pixel| {
            let (u, v) = ((pixel % width) as f64, (pixel / width) as f64);
            let at = |i: usize| (i as f64 + 0.5) / SIDE as f64;
            let points = (0..SIDE * SIDE).map(|i| (u + at(i % SIDE), v + at(i / SIDE)));
            let on_mirror = scene.camera.meets_paraboloid(u + 0.5, v + 0.5);
            let sources: Vec<Option<u32>> = points
                .map(|(u, v)| {
                    // Rays near the edge of the paraboloid belong to either side.
                    if scene.camera.meets_paraboloid(u, v) { scene.reflected(u, v) } else { scene.on_border(u, v) }
                })
                .collect();
            if sources.iter().all(Option::is_none) {
                return None;
            }
            let weight = if on_mirror { MIRROR } else { scene.border_radiance(u + 0.5, v + 0.5) };
            let sources = std::array::from_fn(|i| sources[i].unwrap_or(DARK));
            Some(Seen { pixel, sources, weight })
        });
        Self::Mirror(seen.collect())
    }

    /// The screen with its printed cross, with or without the wires above it.
    pub fn crosses(scene: &View<'_>, wires: bool) -> Self {
        let (width, height) = (scene.rig.camera.width_px, scene.rig.camera.height_px);
        let seen = (0..width * height).into_par_iter().filter_map(|pixel| {
            let (share, place) = scene.screen_seen(pixel % width, pixel / width, wires);
            (share > 0.0).then_some((pixel, share, place))
        });
        Self::Crosses { wires, seen: seen.collect() }
    }

    /// Radiance towards every pixel in units of white, of a pattern whose pixels shine by `light`: `add(pixel, radiance)`.
    pub fn image(&self, scene: &View<'_>, light: &[f64], mut add: impl FnMut(usize, f64)) {
        match self {
            Self::Mirror(seen) => {
                for s in seen {
                    let lit = s.sources.iter().filter(|&&p| p != DARK);
                    let sum: f64 = lit.map(|&p| light[p as usize]).sum();
                    add(s.pixel, s.weight * sum / (SIDE * SIDE) as f64);
                }
            }
            Self::Crosses { wires, seen } => {
                let screen = Screen::new(scene, light, *wires);
                for (pixel, share, place) in seen {
                    add(*pixel, share * screen.radiance(place));
                }
            }
        }
    }
}

impl View<'_> {
    /// The projector pixel that a camera ray meets by way of the mirrors and the mirror in the sample's place.
    fn reflected(&self, u: f64, v: f64) -> Option<u32> {
        let wi = self.camera.direction(u, v)?.mirrored();
        let (theta, phi) = (wi.theta(), wi.phi());
        let (p, q) = self.inverse.pixel((theta * phi.cos()) as f32, (theta * phi.sin()) as f32);
        let (p, q) = (f64::from(p), f64::from(q));
        self.projector.direction(p, q)?;
        self.panel_pixel(p, q)
    }

    /// The projector pixel that lights the point of the border that a camera ray meets.
    fn on_border(&self, u: f64, v: f64) -> Option<u32> {
        let a = &self.rig.alignment;
        let open = |device: &Misaligned, u: f64, v: f64| {
            let at = device.on_plane(u, v, a.wire_height_mm);
            at.x.hypot(at.y) < a.opening_radius_mm
        };
        let (p, q) = self.projector.image(&self.camera.on_plane(u, v, 0.0));
        let lit = open(self.camera, u, v) && open(self.projector, p, q) && !self.projector.meets_paraboloid(p, q);
        lit.then(|| self.panel_pixel(p, q))?
    }

    /// Radiance of a white diffuser in the sample's plane, lit by the projector's pupil directly.
    fn border_radiance(&self, u: f64, v: f64) -> f64 {
        let ray = self.projector.centre() - self.camera.on_plane(u, v, 0.0);
        let cos = ray.z / ray.norm();
        WHITE * (self.rig.projector.pupil_mm() / ray.z).powi(2) * cos.powi(4)
    }

    fn panel_pixel(&self, p: f64, q: f64) -> Option<u32> {
        let (w, h) = (self.rig.projector.width_px, self.rig.projector.height_px);
        let inside = p >= 0.0 && q >= 0.0 && p < w as f64 && q < h as f64;
        inside.then(|| (q as usize * w + p as usize) as u32)
    }

    /// Share of a pixel's light that comes from white screen, and the mean place of that: over the pixel and the pupil.
    fn screen_seen(&self, column: usize, row: usize, wires: bool) -> (f64, [f64; 2]) {
        let a = &self.rig.alignment;
        let focus = self.rig.centre_height_mm - self.rig.camera.focus_mm;
        let edge = edge_mm(self.rig.camera.pupil_mm(), CAMERA_POINTS, focus, self.rig.centre_height_mm);
        // Within a pixel the plane in focus is an affine image of it.
        let (u, v) = (column as f64, row as f64);
        let corner = self.camera.on_plane(u, v, focus);
        let (along, down) =
            (self.camera.on_plane(u + 1.0, v, focus) - corner, self.camera.on_plane(u, v + 1.0, focus) - corner);
        let (mut share, mut place) = (0.0, [0.0; 2]);
        for (i, q) in disc(CAMERA_POINTS).enumerate() {
            // Another point of the pixel for each point of the pupil, opposite for opposite ones.
            let jitter = |step: f64| {
                let x = ((i / 2) as f64 * step + 0.25).fract();
                if i % 2 == 0 { x } else { 1.0 - x }
            };
            let target = corner + along * jitter(0.754_877_666) + down * jitter(0.569_840_291);
            let pupil = self.camera.centre() + Vector3::new(q[0], q[1], 0.0) * self.rig.camera.pupil_mm();
            let at = |height: f64| pupil + (target - pupil) * ((height - pupil.z) / (target.z - pupil.z));
            let wire = at(a.wire_height_mm);
            if wire.x.hypot(wire.y) >= a.opening_radius_mm {
                continue;
            }
            let screen = at(a.screen_height_mm);
            let blocked = if wires { wire_cover(&wire, a.wire_width_mm, edge(a.wire_height_mm)) } else { 0.0 };
            let print = cover([screen.x, screen.y], a.line_width_mm, edge(a.screen_height_mm));
            let light = (1.0 - blocked) * (WHITE + (BLACK - WHITE) * print) / CAMERA_POINTS as f64;
            share += light;
            place = [place[0] + light * screen.x, place[1] + light * screen.y];
        }
        if share > 0.0 { (share, place.map(|x| x / share)) } else { (0.0, place) }
    }
}

/// Irradiance over the screen, as the radiance of an ideal diffuser.
struct Screen {
    side: usize,
    values: Vec<f64>,
}

impl Screen {
    fn new(scene: &View<'_>, light: &[f64], wires: bool) -> Self {
        let (rig, a) = (scene.rig, &scene.rig.alignment);
        // Light beyond the opening's shadow comes from nowhere.
        let reach = a.opening_radius_mm * 3.0;
        let side = 2 * (reach / SCREEN_STEP_MM).ceil() as usize + 1;
        let focus = rig.centre_height_mm - rig.projector.focus_mm;
        let edge = edge_mm(rig.projector.pupil_mm(), PROJECTOR_POINTS, a.screen_height_mm, rig.centre_height_mm);
        let pupil: Vec<Point3<f64>> = disc(PROJECTOR_POINTS)
            .map(|q| scene.projector.centre() + Vector3::new(q[0], q[1], 0.0) * rig.projector.pupil_mm())
            .collect();
        let area = PI * rig.projector.pupil_mm().powi(2) / PROJECTOR_POINTS as f64;
        let values = (0..side * side).into_par_iter().map(|i| {
            let at = |j: usize| (j as f64 - (side / 2) as f64) * SCREEN_STEP_MM;
            let x = Point3::new(at(i % side), at(i / side), a.screen_height_mm);
            let mut sum = 0.0;
            for q in &pupil {
                let up = q - x;
                let along = |height: f64| x + up * ((height - x.z) / up.z);
                let wire = along(a.wire_height_mm);
                if wire.x.hypot(wire.y) >= a.opening_radius_mm {
                    continue;
                }
                let blocked = if wires { wire_cover(&wire, a.wire_width_mm, edge(a.wire_height_mm)) } else { 0.0 };
                // The panel pixel whose chief ray goes through the same point of the plane in focus.
                let (u, v) = scene.projector.image(&along(focus));
                if let Some(p) = scene.panel_pixel(u, v) {
                    sum += (1.0 - blocked) * light[p as usize] * area * (up.z / up.norm()).powi(2) / up.norm_squared();
                }
            }
            sum / PI
        });
        Self { side, values: values.collect() }
    }

    fn radiance(&self, place: &[f64; 2]) -> f64 {
        let at = |x: f64| {
            let x = (x / SCREEN_STEP_MM + (self.side / 2) as f64).clamp(0.0, self.side as f64 - 1.001);
            (x as usize, x.fract())
        };
        let ((i, fx), (j, fy)) = (at(place[0]), at(place[1]));
        let row = |j: usize| self.values[j * self.side + i] * (1.0 - fx) + self.values[j * self.side + i + 1] * fx;
        row(j) * (1.0 - fy) + row(j + 1) * fy
    }
}

/// Points of the unit disc, all of one area: a sunflower and its mirror image, so that their mean is the centre.
fn disc(n: usize) -> impl Iterator<Item = [f64; 2]> {
    (0..n).map(move |i| {
        let (pair, sign) = ((i / 2) as f64, if i % 2 == 0 { 1.0 } else { -1.0 });
        let (r, phi) = (((pair + 0.5) / (n / 2) as f64).sqrt(), pair * 2.399_963_229_728_653);
        [sign * r * phi.cos(), sign * r * phi.sin()]
    })
}

/// Spacing, at some height, of the rays between `n` points of a pupil and one point at the height `focus`, mm.
fn edge_mm(pupil_mm: f64, n: usize, focus: f64, centre: f64) -> impl Fn(f64) -> f64 {
    move |height| pupil_mm * (PI / n as f64).sqrt() * ((height - focus) / (centre - focus)).abs()
}

/// Share of a spot of the size `spot` that a cross of lines along x and y covers.
fn cover(at: [f64; 2], width: f64, spot: f64) -> f64 {
    let [x, y] = at.map(|d| ((0.5 * width - d.abs()) / spot.max(1e-9) + 0.5).clamp(0.0, 1.0));
    1.0 - (1.0 - x) * (1.0 - y)
}

/// The same for wires at 45 deg.
fn wire_cover(at: &Point3<f64>, width: f64, spot: f64) -> f64 {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    cover([(at.x + at.y) * half, (at.y - at.x) * half], width, spot)
}
