//! Zonal functions and their mixtures as light, integrated over the projector's pixels.

use std::path::Path;
use std::sync::Arc;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Step;
use crate::basis::{Harmonics, OrderError, lm};
use crate::geometry::Zone;
use crate::optics::OpticalMap;
use crate::radiometry::{FlatField, Response};
use crate::store::{self, Layers, Plane, StoreError};

/// Which frame of a step is shown; light cannot be negative.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sign {
    /// max(Z, 0), or the first of two lights.
    Positive,
    /// max(-Z, 0), or the second of two lights.
    Negative,
}

/// One frame of a plan: a lobe of the zonal function k = l(l+1) + m, or of a mixture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lobe {
    /// Number of the step: where functions are shown by themselves, the index of the function.
    pub k: usize,
    /// Which part of it.
    pub sign: Sign,
    /// Whether steps are numbers and no functions: in every scheme but `pairs`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub mixed: bool,
}

impl Lobe {
    /// Both frames of a step.
    pub fn both(k: usize, mixed: bool) -> [Self; 2] {
        [Sign::Positive, Sign::Negative].map(|sign| Self { k, sign, mixed })
    }

    /// A file name stem that sorts in the order of showing: `004_l2_m-2_a_positive`, or `004_a` where functions are mixed.
    pub fn stem(&self) -> String {
        if self.mixed {
            return format!("{:03}_{}", self.k, if self.sign == Sign::Positive { 'a' } else { 'b' });
        }
        let (l, m) = lm(self.k);
        let part = match self.sign {
            Sign::Positive => "a_positive",
            Sign::Negative => "b_negative",
        };
        format!("{:03}_l{l}_m{m:+}_{part}", self.k)
    }
}

/// The light of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Primary {
    /// All primaries, as in every measurement.
    #[default]
    White,
    /// Red alone.
    Red,
    /// Green alone.
    Green,
    /// Blue alone.
    Blue,
}

impl Primary {
    /// The three primaries.
    pub const ALL: [Self; 3] = [Self::Red, Self::Green, Self::Blue];

    /// Whether primary `p` (0 red, 1 green, 2 blue) follows the codes; one that does not shows code 0.
    pub fn lights(self, p: usize) -> bool {
        self == Self::White || self == Self::ALL[p]
    }
}

/// A frame for the projector: one 8-bit code for each pixel, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Pattern {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Codes, row by row.
    pub codes: Arc<[u8]>,
    /// In which light. The coded patch is shown in white whatever this says.
    pub light: Primary,
}

impl Pattern {
    /// A frame of one code.
    pub fn full(width: usize, height: usize, code: u8) -> Self {
        Self { width, height, codes: vec![code; width * height].into(), light: Primary::White }
    }

    /// The same frame in another light.
    pub fn in_light(self, light: Primary) -> Self {
        Self { light, ..self }
    }

    /// Writes an 8-bit grey PNG, whole or not at all.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write_png(&self, path: &Path) -> Result<(), StoreError> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let image = image::GrayImage::from_raw(self.width as u32, self.height as u32, self.codes.to_vec())
            .expect("one code for each pixel");
        image
            .write_to(&mut bytes, image::ImageFormat::Png)
            .map_err(|e| StoreError::invalid(path, format!("cannot encode PNG: {e}")))?;
        store::write(path, &bytes.into_inner())
    }
}

/// The two frames of one step, with the one scale they share.
#[derive(Debug, Clone, PartialEq)]
pub struct LobePair {
    /// Number of the step.
    pub k: usize,
    /// Its two frames.
    pub patterns: [Pattern; 2],
    /// Light, in units of full white, that stands for a function value of 1: the same for both frames, so that black level
    /// and ambient light cancel in their difference.
    pub scale: f64,
    /// `scale` times what 8-bit codes leave of it: the share of the mixture in the light that is really shown. Rates of each
    /// frame are divided by this; the same for both where their difference is what counts.
    pub gains: [f64; 2],
}

/// The frames of a scheme on one projector, before encoding.
///
/// Each pixel stands for the mean of a step's light over its area; the zone's edge is antialiased by the same integral, and all
/// is black outside. What is shown is that, sharpened for the pixels' own width.
#[derive(Debug, Clone)]
pub struct Lobes {
    steps: Vec<Step>,
    width: usize,
    height: usize,
    /// (u0, v0, u1, v1): nothing is lit outside.
    bounds: [usize; 4],
    /// Solid angle of each pixel in `bounds`, sr; 0 beyond the zone.
    solid_angle: Vec<f32>,
    /// Per step, per pixel in `bounds`: its two lights.
    parts: Vec<[Vec<f32>; 2]>,
}

/// Points along each side of a pixel at the zone's edge: antialiased to 1/64.
const SUBSAMPLES: usize = 8;
/// Pixels from the zone's edge where functions of odd m, which end there as square roots do, are smooth enough for [`GAUSS`].
const EDGE_PX: f64 = 3.0;
/// Points along each side of a pixel farther inside, by Gauss and Legendre. Where a function changes its sign both lights may be
/// off by the same, which their difference does not see.
const GAUSS: [f64; 2] = [0.211_324_865_405_187_1, 0.788_675_134_594_812_9];

impl Lobes {
    /// Integrates the lights of `steps` in functions of `zone` over the pixels of a panel.
    ///
    /// # Errors
    /// [`OrderError`].
    ///
    /// # Panics
    /// If the zone lies beyond the map's dome; a checked rig's does not.
    pub fn new(
        map: &OpticalMap,
        zone: Zone,
        steps: Vec<Step>,
        width: usize,
        height: usize,
    ) -> Result<Self, OrderError> {
        let order = steps.iter().map(Step::order).max().unwrap_or(0);
        let basis = Harmonics::zonal(zone, order)?;
        let bounds = map.bounding_box(&zone, width, height).expect("a checked rig shows its zone");
        let [u0, v0, u1, v1] = bounds;
        let pixels: Vec<([f32; 2], Vec<[f32; 2]>)> = (0..(u1 - u0) * (v1 - v0))
            .into_par_iter()
            .map_init(
                || (vec![0.0; basis.len()], vec![[0.0f64; 2]; steps.len()]),
                |(values, means), p| {
                    let (u, v) = ((u0 + p % (u1 - u0)) as f64, (v0 + p / (u1 - u0)) as f64);
                    let lit = integrate_pixel(map, &basis, &steps, u, v, values, means);
                    if lit == 0.0 {
                        return ([0.0; 2], Vec::new());
                    }
                    let means = means.iter().map(|s| s.map(|x| x as f32)).collect();
                    ([solid_angle(map, u, v) as f32, lit as f32], means)
                },
            )
            .collect();
        let part = |k: usize, s: usize| pixels.iter().map(|p| p.1.get(k).map_or(0.0, |m| m[s])).collect();
        let whole: Vec<bool> = pixels.iter().map(|p| p.0[1] == 1.0).collect();
        let shown = |k: usize| {
            let means = [part(k, 0), part(k, 1)];
            sharpened(&means, &whole, u1 - u0, matches!(steps[k], Step::Lights(_)))
        };
        let parts = (0..steps.len()).into_par_iter().map(shown).collect();
        let solid_angle = pixels.iter().map(|p| p.0[0]).collect();
        Ok(Self { steps, width, height, bounds, solid_angle, parts })
    }

    /// Number of steps.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether nothing is shown.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// The frames of all steps.
    pub fn encode_all(&self, response: &Response, flat: &FlatField) -> Vec<LobePair> {
        (0..self.len()).into_par_iter().map(|k| self.encode(k, response, flat)).collect()
    }

    /// The frames of step `k`: scaled, divided by the flat field, sent through the inverse response, quantised.
    pub fn encode(&self, k: usize, response: &Response, flat: &FlatField) -> LobePair {
        let [u0, v0, u1, _] = self.bounds;
        let flat_at = |p: usize| f64::from(flat.values[(v0 + p / (u1 - u0)) * self.width + u0 + p % (u1 - u0)]);
        let pixels = self.solid_angle.len();
        let peak = self.parts[k]
            .iter()
            .flat_map(|part| part.iter().enumerate().map(|(p, &value)| f64::from(value) / flat_at(p)))
            .fold(0.0, f64::max);
        let scale = 1.0 / peak;
        let apart = matches!(self.steps[k], Step::Lights(_));
        // Power shown and wanted, by frame.
        let mut powers = [[0.0; 2]; 2];
        let patterns = [0, 1].map(|s| {
            let mut codes = vec![0u8; self.width * self.height];
            for p in 0..pixels {
                let value = f64::from(self.parts[k][s][p]);
                if value == 0.0 {
                    continue;
                }
                let code = response.code(value * scale / flat_at(p));
                codes[(v0 + p / (u1 - u0)) * self.width + u0 + p % (u1 - u0)] = code;
                let shown = response.level(code) * flat_at(p);
                // Where the difference counts, light of the other part in the same pixel works against this one's.
                let other = if apart { 0.0 } else { f64::from(self.parts[k][1 - s][p]) };
                let weight = (value - other) * f64::from(self.solid_angle[p]);
                powers[s][0] += shown * weight;
                powers[s][1] += value * scale * weight;
            }
            Pattern { width: self.width, height: self.height, codes: codes.into(), light: Primary::White }
        });
        let both = [powers[0][0] + powers[1][0], powers[0][1] + powers[1][1]];
        let gains = powers.map(|own| if apart { own } else { both }).map(|[shown, wanted]| scale * shown / wanted);
        LobePair { k, patterns, scale, gains }
    }

    /// Writes the linear, signed mixture, or the difference of two lights, as shown by ideal pixels (1/sqrt(sr)) to an OpenEXR file.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write_exr(&self, k: usize, path: &Path) -> Result<(), StoreError> {
        let [u0, v0, u1, _] = self.bounds;
        let mut values = vec![0.0; self.width * self.height];
        for p in 0..self.solid_angle.len() {
            values[(v0 + p / (u1 - u0)) * self.width + u0 + p % (u1 - u0)] = self.parts[k][0][p] - self.parts[k][1][p];
        }
        let mut image = Layers::new(self.width, self.height);
        image.plane("Y", Plane::Float(values));
        image.attribute("zonal_content", "zonal basis function or mixture, mean over each projector pixel");
        image.attribute("zonal_units", "1/sqrt(sr)");
        image.attribute("zonal_k", k as f64);
        image.write(path)
    }
}

/// Means of both lights of all steps over the pixel with the corner (u, v); the share of the pixel that lies in the zone.
fn integrate_pixel(
    map: &OpticalMap,
    basis: &Harmonics,
    steps: &[Step],
    u: f64,
    v: f64,
    values: &mut [f64],
    means: &mut [[f64; 2]],
) -> f64 {
    means.fill([0.0; 2]);
    let zone = basis.zone();
    let inside = |x: f64, y: f64| {
        let d = map.direction(u + x, v + y)?;
        (zone.cos_max()..=zone.cos_min()).contains(&d.cos_theta()).then_some(d)
    };
    let reach = [-EDGE_PX, 1.0 + EDGE_PX];
    let within = reach.into_iter().all(|y| reach.into_iter().all(|x| inside(x, y).is_some()));
    let edge: [f64; SUBSAMPLES] = std::array::from_fn(|i| (i as f64 + 0.5) / SUBSAMPLES as f64);
    let along: &[f64] = if within { &GAUSS } else { &edge };
    let weight = 1.0 / (along.len() * along.len()) as f64;
    let mut lit = 0.0;
    for &y in along {
        for &x in along {
            let Some(d) = inside(x, y) else { continue };
            lit += weight;
            basis.eval_direction_into(&d, values);
            for (mean, step) in means.iter_mut().zip(steps) {
                mean.iter_mut().zip(step.lights(values)).for_each(|(mean, light)| *mean += weight * light);
            }
        }
    }
    lit
}

/// Lights that act through pixels of a width of 1 as `means` would through points: a mean over a pixel, shown evenly over it, is the
/// light twice smeared over the pixel's width, which adds a twelfth of its Laplacian. Sharp lobes would be found weaker and wider:
/// functions of order 6 lose 0.03 to 0.3% in pixels of 0.35 deg.
///
/// The Laplacian counts neighbours that lie in the zone as a whole; what one pixel gives the other gets, so that the sum stays. Of a
/// mixture it is the difference of both lights that counts; lights `apart` are each one for itself.
fn sharpened(means: &[Vec<f32>; 2], whole: &[bool], width: usize, apart: bool) -> [Vec<f32>; 2] {
    let laplacian = |of: &dyn Fn(usize) -> f32, p: usize| -> f32 {
        let neighbours = [p.wrapping_sub(1), p + 1, p.wrapping_sub(width), p + width];
        neighbours.into_iter().filter(|&n| whole.get(n) == Some(&true)).map(|n| of(n) - of(p)).sum()
    };
    let shown = |p: usize| -> [f32; 2] {
        let own = [means[0][p], means[1][p]];
        if !whole[p] {
            return own;
        }
        if apart {
            return [0, 1].map(|s| (own[s] - laplacian(&|n| means[s][n], p) / 12.0).max(0.0));
        }
        // Less of the other light comes before more of this one: common light is but noise.
        let more = -laplacian(&|n| means[0][n] - means[1][n], p) / 12.0;
        let less = more.abs().min(own[usize::from(more > 0.0)]);
        if more > 0.0 { [own[0] + more - less, own[1] - less] } else { [own[0] - less, own[1] - more - less] }
    };
    let both: Vec<[f32; 2]> = (0..whole.len()).map(shown).collect();
    [0, 1].map(|s| both.iter().map(|b| b[s]).collect())
}

fn solid_angle(map: &OpticalMap, u: f64, v: f64) -> f64 {
    map.pixel_solid_angle(u + 0.5, v + 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::basis::size;
    use crate::optics::Rig;
    use crate::patterns::Scheme;

    fn lobes(order: usize) -> (Rig, Lobes) {
        shown(Scheme::Pairs, order)
    }

    fn shown(scheme: Scheme, order: usize) -> (Rig, Lobes) {
        let rig = Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap();
        let p = &rig.projector;
        let steps = scheme.steps(rig.zone(), order).unwrap();
        let lobes = Lobes::new(&rig.projector_map(), rig.zone(), steps, p.width_px, p.height_px).unwrap();
        (rig, lobes)
    }

    /// What is left is of fourth order in the width of a pixel.
    const SMEARED: f64 = 5e-5;
    /// Of z_00. Pixels are 0.35 deg wide; a centre stands for its pixel to second order.
    const PIXELATION: f64 = 2e-4;

    #[test]
    fn a_diffuse_sample_answers_the_pixels_with_its_analytic_coefficients() {
        let (rig, lobes) = lobes(4);
        let p = &rig.projector;
        let map = rig.projector_map();
        let [u0, v0, u1, _] = lobes.bounds;
        let cosines: Vec<f64> = (0..lobes.solid_angle.len())
            .map(|i| map.direction((u0 + i % (u1 - u0)) as f64 + 0.5, (v0 + i / (u1 - u0)) as f64 + 0.5))
            .map(|d| d.map_or(0.0, |d| d.cos_theta()))
            .collect();
        let (a, b) = (rig.zone().cos_min(), rig.zone().cos_max());
        let z_00 = std::f64::consts::PI * (a + b) * ((a - b) / std::f64::consts::TAU).sqrt();
        let z_10 = std::f64::consts::PI * (a - b).powf(1.5) / (6.0 * std::f64::consts::PI).sqrt();
        for k in 0..size(4) {
            let z = |i: usize| f64::from(lobes.parts[k][0][i]) - f64::from(lobes.parts[k][1][i]);
            let sum: f64 = (0..cosines.len()).map(|i| z(i) * cosines[i] * f64::from(lobes.solid_angle[i])).sum();
            let want = match k {
                0 => z_00,
                2 => z_10,
                _ => 0.0,
            };
            assert!((sum - want).abs() < PIXELATION * z_00, "{k}: {sum} {want} on {} px", p.width_px);
        }
    }

    /// A hundredth of a projector's code. Near the edge functions of order 10 turn by half a radian in a pixel.
    const UNSEEN: f64 = 0.01 / 255.0;

    #[test]
    fn four_points_of_a_pixel_say_what_many_do() {
        let (rig, lobes) = lobes(10);
        let map = rig.projector_map();
        let [u0, v0, u1, _] = lobes.bounds;
        let basis = Harmonics::zonal(rig.zone(), 10).unwrap();
        let (mut values, mut means) = (vec![0.0; basis.len()], vec![[0.0; 2]; lobes.len()]);
        let mut compared = 0;
        for p in (0..lobes.solid_angle.len()).step_by(97) {
            let (u, v) = ((u0 + p % (u1 - u0)) as f64, (v0 + p / (u1 - u0)) as f64);
            let far = |x: f64, y: f64| map.direction(u + x, v + y).is_some_and(|d| rig.zone().contains(d.theta()));
            if ![far(-3.0, -3.0), far(4.0, -3.0), far(-3.0, 4.0), far(4.0, 4.0)].into_iter().all(|far| far) {
                continue;
            }
            assert_eq!(integrate_pixel(&map, &basis, &lobes.steps, u, v, &mut values, &mut means), 1.0);
            let mut want = vec![0.0; basis.len()];
            for i in 0..64 {
                // The same rule in quarters of the pixel's sides.
                let at = |i: usize| ((i / 2) as f64 + GAUSS[i % 2]) / 4.0;
                let d = map.direction(u + at(i % 8), v + at(i / 8)).unwrap();
                basis.eval(&d).iter().zip(&mut want).for_each(|(z, sum)| *sum += z / 64.0);
            }
            for (k, (mean, want)) in means.iter().zip(&want).enumerate() {
                assert!((mean[0] - mean[1] - want).abs() < UNSEEN, "{k} at ({u}, {v}): {mean:?} {want}");
            }
            compared += 1;
        }
        assert!(compared > 500, "{compared}");
    }

    /// A sample that reflects as a function does is found as that function, through pixels that smear it: unsharpened they lose
    /// 0.03 to 0.1% of these.
    #[test]
    fn pixels_lose_nothing_of_functions_that_turn_quickly() {
        let (rig, lobes) = lobes(6);
        let map = rig.projector_map();
        let [u0, v0, u1, _] = lobes.bounds;
        let basis = Harmonics::zonal(rig.zone(), 6).unwrap();
        let steps = Scheme::Pairs.steps(rig.zone(), 6).unwrap();
        let (mut values, mut means) = (vec![0.0; basis.len()], vec![[0.0; 2]; steps.len()]);
        let mut found = vec![0.0; steps.len()];
        for p in 0..lobes.solid_angle.len() {
            let (u, v) = ((u0 + p % (u1 - u0)) as f64, (v0 + p / (u1 - u0)) as f64);
            if integrate_pixel(&map, &basis, &steps, u, v, &mut values, &mut means) > 0.0 {
                let area = f64::from(lobes.solid_angle[p]);
                for (k, (found, mean)) in found.iter_mut().zip(&means).enumerate() {
                    *found += f64::from(lobes.parts[k][0][p] - lobes.parts[k][1][p]) * (mean[0] - mean[1]) * area;
                }
            }
        }
        // Those with a smaller m do not vanish at the zone's edge, which cuts pixels.
        for (k, found) in found.iter().enumerate().skip(size(5)).filter(|(k, _)| lm(*k).1.abs() >= 3) {
            assert!((found - 1.0).abs() < SMEARED, "{k}: {found}");
        }
    }

    #[test]
    fn both_lobes_share_one_scale_and_use_the_whole_range() {
        let (rig, lobes) = lobes(2);
        let flat = FlatField::uniform(rig.projector.width_px, rig.projector.height_px);
        for k in 0..size(2) {
            let pair = lobes.encode(k, &Response::linear(), &flat);
            let brightest = pair.patterns.iter().flat_map(|p| p.codes.iter().copied()).max().unwrap();
            assert_eq!(brightest, 255, "{k}");
            // 8 bits over some 85,000 pixels: the mean quantisation error vanishes.
            assert!((pair.gains[0] / pair.scale - 1.0).abs() < 3e-3, "{k}: {:?} {}", pair.gains, pair.scale);
            assert_eq!(pair.gains[0], pair.gains[1]);
        }
        let dc = lobes.encode(0, &Response::linear(), &flat);
        assert!(dc.patterns[1].codes.iter().all(|&c| c == 0), "the partner of the constant is black");
    }

    #[test]
    fn a_flat_field_is_divided_out() {
        let (rig, lobes) = lobes(1);
        let (w, h) = (rig.projector.width_px, rig.projector.height_px);
        let light = (0..w * h).map(|p| 1.0 - 0.3 * (p % w) as f32 / w as f32).collect();
        let flat = FlatField::from_light(w, h, light).unwrap();
        let pair = lobes.encode(0, &Response::linear(), &flat);
        let shown = |u: usize| {
            let p = 150 * w + u;
            f64::from(pair.patterns[0].codes[p]) * f64::from(flat.values[p])
        };
        assert!((shown(330) / shown(470) - 1.0).abs() < 1e-2, "one code is 1/200 here");
    }

    #[test]
    fn stems_sort_in_the_order_of_showing() {
        let plan = super::super::Plan::of_order(3);
        let stems: Vec<_> = plan.lobes(0..size(3)).map(|l| l.stem()).collect();
        assert!(stems.is_sorted());
        assert_eq!(stems[8], "004_l2_m-2_a_positive");
        let mixed: Vec<_> = plan.by(Scheme::Isotropic).lobes(0..12).map(|l| l.stem()).collect();
        assert!(mixed.is_sorted() && mixed[9] == "004_b");
    }
}
