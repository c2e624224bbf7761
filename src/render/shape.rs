//! Orthographic unit shapes of one material.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::lights::ProbeLight;
use super::{Image, Probe, View};
use crate::geometry::{Direction, Sample};
use crate::reflectance::Brdf;

/// Directional lights that stand for a probe in [`Shape::in_probe`].
const PROBE_LIGHTS: usize = 512;
/// Subsamples along each side of a pixel on the sphere's edge.
const EDGE_SUBSAMPLES: usize = 2;

/// What a picture shows. It fills the square picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// A sphere, black around it: the grain runs along its circles of latitude, eastwards, with the poles at +-y.
    Sphere,
    /// An upright cylinder, whose angles run along one axis of the picture: the grain runs round it, eastwards.
    Cylinder,
}

/// Towards the light of [`Shape::in_key_light`], in the frame of the picture; any length.
const KEY_LIGHT: [f64; 3] = [0.45, 0.55, 0.7];

impl Shape {
    /// The shape under one directional light: each pixel is f_cos times `irradiance`.
    ///
    /// `light` points from the shape to the light; `irradiance` is what a surface facing the light receives, linear RGB in
    /// any unit; `size` is the picture's side in pixels. Nothing casts a shadow on another part.
    pub fn directional(self, brdf: &dyn Brdf, light: Direction<View>, irradiance: [f64; 3], size: usize) -> Image {
        self.lit(brdf, &[ProbeLight { direction: light, irradiance }], size)
    }

    /// The shape under the light of preview pictures: from above, to the right, towards the viewer, of irradiance pi, so
    /// that a diffuser facing it shows its albedo.
    pub fn in_key_light(self, brdf: &dyn Brdf, size: usize) -> Image {
        self.directional(brdf, Direction::new(Vector3::from(KEY_LIGHT)), [std::f64::consts::PI; 3], size)
    }

    /// The shape in a light probe: each pixel is the integral of f_cos times the probe's radiance.
    ///
    /// The integral is a sum over 512 directional lights ([`Probe::lights`]).
    pub fn in_probe(self, brdf: &dyn Brdf, probe: &Probe, size: usize) -> Image {
        self.lit(brdf, &probe.lights(PROBE_LIGHTS), size)
    }

    fn lit(self, brdf: &dyn Brdf, lights: &[ProbeLight], size: usize) -> Image {
        let row = |y: usize| (0..size).map(move |x| self.pixel(brdf, lights, size, x, y));
        let pixels = match self {
            Self::Sphere => (0..size).into_par_iter().flat_map_iter(row).collect(),
            // All rows are alike.
            Self::Cylinder => {
                let row: Vec<[f32; 3]> =
                    (0..size).into_par_iter().map(|x| self.pixel(brdf, lights, size, x, 0)).collect();
                row.repeat(size)
            }
        };
        Image { width: size, height: size, pixels }
    }

    /// One sample in the middle; on the sphere's edge a grid of subsamples, those beside it black.
    fn pixel(self, brdf: &dyn Brdf, lights: &[ProbeLight], size: usize, x: usize, y: usize) -> [f32; 3] {
        let at = |x: f64, y: f64| (2.0 * x / size as f64 - 1.0, 1.0 - 2.0 * y / size as f64);
        let (u, v) = at(x as f64 + 0.5, y as f64 + 0.5);
        let half_diagonal = std::f64::consts::SQRT_2 / size as f64;
        let radius = u.hypot(v);
        let n = match self {
            Self::Sphere if radius >= 1.0 + half_diagonal => return [0.0; 3],
            Self::Sphere if radius >= 1.0 - half_diagonal => EDGE_SUBSAMPLES,
            _ => 1,
        };
        let mut sum = [0.0; 3];
        for s in 0..n * n {
            let inside = |i: usize| (i as f64 + 0.5) / n as f64;
            let (u, v) = at(x as f64 + inside(s % n), y as f64 + inside(s / n));
            if let Some(normal) = self.normal(u, v) {
                sum = add(sum, Frame::of(normal).reflected(brdf, lights));
            }
        }
        sum.map(|s| (s / (n * n) as f64) as f32)
    }

    /// The normal at the point seen at (u, v), or `None` beside the shape.
    fn normal(self, u: f64, v: f64) -> Option<Vector3<f64>> {
        let v = if self == Self::Sphere { v } else { 0.0 };
        let z2 = 1.0 - u * u - v * v;
        (z2 > 0.0).then(|| Vector3::new(u, v, z2.sqrt()))
    }
}

fn add(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|c| a[c] + b[c])
}

/// Grain, its perpendicular and the shading normal at a point.
struct Frame {
    grain: Vector3<f64>,
    across: Vector3<f64>,
    normal: Vector3<f64>,
}

impl Frame {
    /// The frame at the point with a normal that is not upright.
    fn of(normal: Vector3<f64>) -> Self {
        let grain = Vector3::new(normal.z, 0.0, -normal.x).normalize();
        Self { grain, across: normal.cross(&grain), normal }
    }

    fn local(&self, d: &Vector3<f64>) -> Direction<Sample> {
        Direction::new_unchecked(Vector3::new(self.grain.dot(d), self.across.dot(d), self.normal.dot(d)))
    }

    fn reflected(&self, brdf: &dyn Brdf, lights: &[ProbeLight]) -> [f64; 3] {
        let f_cos_of = brdf.towards(&self.local(&Vector3::z()));
        lights.iter().fold([0.0; 3], |sum, light| {
            let wi = self.local(&light.direction.vector());
            if wi.cos_theta() <= 0.0 {
                return sum;
            }
            let f_cos = f_cos_of(&wi);
            add(sum, [0, 1, 2].map(|c| f_cos[c] * light.irradiance[c]))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::{Ggx, Lambert};
    use std::f64::consts::FRAC_1_PI;

    #[test]
    fn lambert_under_one_light_is_albedo_over_pi_times_e_cos() {
        let (albedo, e, size) = ([0.2, 0.5, 0.8], [3.0, 2.0, 1.0], 64);
        let light = Direction::new(Vector3::new(0.5, 0.7, 0.6));
        let image = Shape::Sphere.directional(&Lambert { albedo }, light, e, size);
        let mut lit = 0;
        for (i, pixel) in image.pixels.iter().enumerate() {
            let (u, v) = ((2 * (i % size) + 1) as f64 / 64.0 - 1.0, 1.0 - (2 * (i / size) + 1) as f64 / 64.0);
            if u.hypot(v) < 0.95 {
                let normal = Vector3::new(u, v, (1.0 - u * u - v * v).sqrt());
                let cos = normal.dot(&light.vector()).max(0.0);
                for c in 0..3 {
                    let want = albedo[c] * FRAC_1_PI * e[c] * cos;
                    assert!((f64::from(pixel[c]) - want).abs() < 1e-6, "{pixel:?} at ({u}, {v})");
                }
                lit += usize::from(cos > 0.0);
            }
        }
        assert!(lit > 1000);
        assert_eq!(image.pixels[0], [0.0; 3]);
    }

    #[test]
    fn lambert_in_a_furnace_is_its_albedo() {
        const RULE: f64 = 0.01;
        let size = 48;
        let image = Shape::Sphere.in_probe(&Lambert::gray(0.6), &Probe::constant([1.0, 2.0, 0.5]), size);
        for (i, pixel) in image.pixels.iter().enumerate() {
            let (u, v) = ((2 * (i % size) + 1) as f64 / 48.0 - 1.0, 1.0 - (2 * (i / size) + 1) as f64 / 48.0);
            if u.hypot(v) < 0.97 {
                for (value, light) in pixel.iter().zip([1.0, 2.0, 0.5]) {
                    let error = f64::from(*value) / (0.6 * light) - 1.0;
                    assert!(error.abs() < RULE, "{error} at ({u}, {v})");
                }
            }
        }
    }

    #[test]
    fn grain_follows_the_latitude() {
        // Along the grain the surface is smooth: a light above the camera sees the rough side in the middle.
        let across = Shape::Sphere.directional(
            &Ggx::anisotropic(0.05, 0.5, [1.0; 3]),
            Direction::new(Vector3::new(0.0, 0.9, 1.0)),
            [1.0; 3],
            33,
        );
        let along = Shape::Sphere.directional(
            &Ggx::anisotropic(0.05, 0.5, [1.0; 3]),
            Direction::new(Vector3::new(0.9, 0.0, 1.0)),
            [1.0; 3],
            33,
        );
        let middle = 16 * 33 + 16;
        assert!(across.pixels[middle][0] > 10.0 * along.pixels[middle][0]);
    }

    #[test]
    fn a_cylinder_shows_the_equator_of_the_sphere_in_every_row() {
        let brdf = Ggx::anisotropic(0.1, 0.4, [0.5; 3]).on_lambert(1.0, [0.2; 3]);
        let light = Direction::new(Vector3::new(0.5, 0.0, 0.6));
        let [sphere, cylinder] = [Shape::Sphere, Shape::Cylinder].map(|s| s.directional(&brdf, light, [1.0; 3], 65));
        // The sphere's edge is antialiased.
        for x in 2..63 {
            for c in 0..3 {
                let (a, b) = (sphere.pixels[32 * 65 + x][c], cylinder.pixels[32 * 65 + x][c]);
                assert!((a - b).abs() <= 1e-5 * a.max(1e-3), "{a} and {b} in column {x}");
            }
            assert_eq!(cylinder.pixels[x], cylinder.pixels[64 * 65 + x]);
        }
    }

    #[test]
    fn no_picture_is_no_panic() {
        assert_eq!(Shape::Sphere.in_probe(&Lambert::gray(0.5), &Probe::studio(), 0), Image::new(0, 0));
        assert_eq!(Shape::Sphere.in_probe(&Lambert::gray(0.5), &Probe::studio(), 1).pixels.len(), 1);
    }
}
