//! The simulated devices behind the traits of real ones.

use std::sync::Arc;

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;

use super::TwinConfig;
use super::forward::{Accuracy, PatternLight, ResponseField};
use super::geometry::InverseMap;
use super::targets::{Scene, Target};
use crate::calibrate::GRAY_CARD_ALBEDO;
use crate::capture::{Bench, Camera, CaptureError, Frame, Placement, Projector};
use crate::geometry::{Direction, Sample, Zone};
use crate::optics::{Device, Misaligned, Rig};
use crate::patterns::Pattern;
use crate::reflectance::{Brdf, Lambert};

/// Pixels are integrated over this many samples along each side.
const PIXEL_SAMPLES: usize = 2;

/// A simulated rig with a sample in it.
pub struct TwinBench {
    rig: Rig,
    config: TwinConfig,
    accuracy: Accuracy,
    sample: Arc<dyn Brdf>,
    placement: Placement,
    camera: Misaligned,
    projector: Misaligned,
    inverse: InverseMap,
    /// Directions of the samples of each pixel that sees the dome: (sensor index, directions).
    pixels: Vec<(usize, Vec<Direction<Sample>>)>,
    dome: Zone,
    /// What is in place instead of a sample, once it has been looked at.
    target: Option<Target>,
    sequence: Vec<Pattern>,
    /// Electrons per second from the sample, of each pixel in `pixels` for each pattern: `[pixel][pattern]`.
    reflected: Option<Vec<f32>>,
    shown: usize,
    exposure_s: f64,
    /// Electrons per second of each sensor pixel for what is shown.
    rates: Option<Vec<f32>>,
    frames_taken: u64,
    clock_s: f64,
}

impl TwinBench {
    /// A simulated rig that holds `sample`.
    pub fn new(rig: &Rig, config: TwinConfig, sample: Arc<dyn Brdf>) -> Self {
        Self::with_accuracy(rig, config, sample, Accuracy::default())
    }

    /// The same with another quadrature.
    pub fn with_accuracy(rig: &Rig, config: TwinConfig, sample: Arc<dyn Brdf>, accuracy: Accuracy) -> Self {
        let camera = Misaligned::new(rig, &config.perturbation, Device::Camera);
        let projector = Misaligned::new(rig, &config.perturbation, Device::Projector);
        let theta_max = rig.dome.theta_max_deg.to_radians();
        let shadow = rig.mirrors().shadow(rig.paraboloid_radius_mm());
        let dome = Zone::new(shadow, theta_max).expect("a checked rig reaches beyond its shadow");
        let inverse = InverseMap::new(&projector, theta_max);
        let width = rig.camera.width_px;
        let (centre_u, centre_v) = camera.image_centre();
        let edge_px = rig.camera_map().radius_px(theta_max).unwrap_or(f64::INFINITY) + 3.0;
        let pixels = (0..width * rig.camera.height_px)
            .into_par_iter()
            .filter_map(|i| {
                let (u, v) = ((i % width) as f64, (i / width) as f64);
                if (u - centre_u).hypot(v - centre_v) > edge_px {
                    return None;
                }
                let at = |j: usize| (j as f64 + 0.5) / PIXEL_SAMPLES as f64;
                let directions: Vec<_> = (0..PIXEL_SAMPLES * PIXEL_SAMPLES)
                    .filter_map(|j| camera.direction(u + at(j % PIXEL_SAMPLES), v + at(j / PIXEL_SAMPLES)))
                    .filter(|d| d.theta() >= shadow && d.cos_theta() > 0.0)
                    .collect();
                (!directions.is_empty()).then_some((i, directions))
            })
            .collect();
        Self {
            rig: rig.clone(),
            config,
            accuracy,
            sample,
            placement: Placement::Sample,
            camera,
            projector,
            inverse,
            pixels,
            dome,
            target: None,
            sequence: Vec::new(),
            reflected: None,
            shown: 0,
            exposure_s: 1.0 / rig.projector.refresh_hz,
            rates: None,
            frames_taken: 0,
            clock_s: 0.0,
        }
    }

    /// What the simulated rig is made of.
    pub fn config(&self) -> &TwinConfig {
        &self.config
    }

    /// Electrons per second in a green pixel for a unit of reflected radiance under white light.
    fn lamp_e_s(&self) -> f64 {
        let half_well = 0.5 * self.rig.camera.full_well_e / self.config.half_well_exposure_s;
        half_well / self.gray_card_radiance()
    }

    /// Radiance of the gray card when the whole zone is white, in units of white.
    fn gray_card_radiance(&self) -> f64 {
        GRAY_CARD_ALBEDO / std::f64::consts::PI * self.rig.zone().projected_solid_angle()
    }

    /// Light of a code above what leaks: black and response, for all codes, in units of white.
    fn code_lights(&self) -> [f64; 256] {
        let black = 1.0 / self.config.contrast;
        std::array::from_fn(|code| black + (1.0 - black) * self.config.response(code as u8))
    }

    /// Relative light of every panel pixel.
    fn vignetting(&self) -> Vec<f64> {
        let (w, h) = (self.rig.projector.width_px, self.rig.projector.height_px);
        (0..w * h).map(|p| self.config.vignetting(p % w, p / w, w, h)).collect()
    }

    fn mean_light(&self, pattern: &Pattern) -> f64 {
        let mut counts = [0usize; 256];
        pattern.codes.iter().for_each(|&c| counts[usize::from(c)] += 1);
        let sum: f64 = (0..=255u8).map(|c| counts[usize::from(c)] as f64 * self.config.response(c)).sum();
        sum / pattern.codes.len() as f64
    }

    fn pattern_light(&self) -> PatternLight {
        let p = &self.rig.projector;
        let edge = self.rig.projector_map().radius_px(self.dome.theta_max()).unwrap_or(f64::INFINITY) + 4.0;
        let (centre_u, centre_v) = self.projector.image_centre();
        let lo = |c: f64| (c - edge).floor().max(0.0) as usize;
        let hi = |c: f64, n: usize| ((c + edge).ceil() as usize).min(n);
        let (u0, v0) = (lo(centre_u), lo(centre_v));
        let (width, height) = (hi(centre_u, p.width_px) - u0, hi(centre_v, p.height_px) - v0);
        let means: Vec<f64> = self.sequence.iter().map(|s| self.mean_light(s)).collect();
        let (lights, vignetting) = (self.code_lights(), self.vignetting());
        PatternLight::new([u0, v0], [width, height], self.sequence.len(), |pattern, column, row| {
            let pixel = row * p.width_px + column;
            let code = self.sequence[pattern].codes[pixel];
            (lights[usize::from(code)] * vignetting[pixel] + self.config.leakage * means[pattern]) as f32
        })
    }

    /// Electrons per second of every sensor pixel for the pattern shown, without dark signal.
    fn compute_rates(&mut self) -> Vec<f32> {
        let (width, height) = (self.rig.camera.width_px, self.rig.camera.height_px);
        let mut rates = vec![self.config.ambient_e_s as f32; width * height];
        match self.placement {
            Placement::Screen => {
                self.add_screen(&mut rates);
                return rates;
            }
            Placement::PrintedCross | Placement::Crosses | Placement::Mirror => {
                self.add_target(&mut rates);
                return rates;
            }
            Placement::Sample | Placement::GrayCard => {}
        }
        if self.reflected.is_none() {
            self.reflected = Some(self.reflect());
        }
        let reflected = self.reflected.as_ref().expect("made above");
        for ((i, _), row) in self.pixels.iter().zip(reflected.chunks_exact(self.sequence.len())) {
            rates[*i] += row[self.shown];
        }
        rates
    }

    /// What every pixel gets from the sample for every pattern of the sequence.
    fn reflect(&self) -> Vec<f32> {
        let brdf: Arc<dyn Brdf> = match self.placement {
            Placement::GrayCard => Arc::new(Lambert { albedo: [GRAY_CARD_ALBEDO; 3] }),
            _ => self.sample.clone(),
        };
        let light = self.pattern_light();
        let field = ResponseField::new(brdf.as_ref(), &light, &self.inverse, self.dome, &self.accuracy);
        let lamp = self.lamp_e_s() / (PIXEL_SAMPLES * PIXEL_SAMPLES) as f64;
        let width = self.rig.camera.width_px;
        let patterns = self.sequence.len();
        let mut reflected = vec![0.0; self.pixels.len() * patterns];
        reflected.par_chunks_mut(patterns).zip(&self.pixels).for_each(|(row, (i, directions))| {
            let (column, line) = (i % width, i / width);
            let channels = self.rig.camera.mosaic.channels(column, line);
            let falloff = self.natural_falloff(self.camera.lens(), column, line);
            for wo in directions {
                for &c in channels {
                    let gain = self.config.channel_gains[c] / channels.len() as f64;
                    field.add_radiance(wo, c, lamp * falloff * gain, row);
                }
            }
        });
        reflected
    }

    /// What replaces the sample for `calibrate align` and `calibrate map`.
    fn add_target(&mut self, rates: &mut [f32]) {
        let target = self.target.take();
        let scene = Scene { rig: &self.rig, camera: &self.camera, projector: &self.projector, inverse: &self.inverse };
        let target = target.unwrap_or_else(|| match self.placement {
            Placement::Mirror => Target::mirror(&scene),
            placement => Target::crosses(&scene, placement == Placement::Crosses),
        });
        let pattern = &self.sequence[self.shown];
        let mean = self.mean_light(pattern);
        let (lights, vignetting, lamp) = (self.code_lights(), self.vignetting(), self.lamp_e_s());
        let shines = |(&code, v): (&u8, &f64)| lights[usize::from(code)] * v + self.config.leakage * mean;
        let light: Vec<f64> = pattern.codes.iter().zip(&vignetting).map(shines).collect();
        let width = self.rig.camera.width_px;
        target.image(&scene, &light, |pixel, radiance| {
            let (column, row) = (pixel % width, pixel / width);
            let falloff = self.natural_falloff(self.camera.lens(), column, row);
            rates[pixel] += (lamp * radiance * falloff * self.channel_gain(column, row)) as f32;
        });
        self.target = Some(target);
    }

    /// Sensitivity of a pixel.
    fn channel_gain(&self, column: usize, row: usize) -> f64 {
        let channels = self.rig.camera.mosaic.channels(column, row);
        channels.iter().map(|&c| self.config.channel_gains[c]).sum::<f64>() / channels.len() as f64
    }

    /// The white screen: a pixel sees one point of it, and that one direction of the projector.
    fn add_screen(&self, rates: &mut [f32]) {
        let (width, p) = (self.rig.camera.width_px, &self.rig.projector);
        let pattern = &self.sequence[self.shown];
        let mean = self.mean_light(pattern);
        let white = self.lamp_e_s() * self.gray_card_radiance();
        let (lights, vignetting) = (self.code_lights(), self.vignetting());
        let height = self.rig.centre_height_mm - p.focus_mm;
        for (i, rate) in rates.iter_mut().enumerate() {
            let (column, row) = (i % width, i / width);
            let point = self.camera.on_plane(column as f64 + 0.5, row as f64 + 0.5, height);
            let (u, v) = self.projector.image(&point);
            if u < 0.0 || v < 0.0 || u >= p.width_px as f64 || v >= p.height_px as f64 {
                continue;
            }
            let pixel = v as usize * p.width_px + u as usize;
            let code = pattern.codes[pixel];
            let light = lights[usize::from(code)] * vignetting[pixel] + self.config.leakage * mean;
            let falloff =
                self.projector.lens().ray(u, v).z.powi(4) * self.natural_falloff(self.camera.lens(), column, row);
            let gain = self.channel_gain(column, row);
            *rate += (white * gain * light * falloff) as f32;
        }
    }

    /// cos^4 of the angle to the optical axis.
    fn natural_falloff(&self, lens: &crate::optics::Lens, column: usize, row: usize) -> f64 {
        lens.ray(column as f64 + 0.5, row as f64 + 0.5).z.powi(4)
    }

    fn expose(&mut self) -> Vec<u16> {
        if self.rates.is_none() {
            self.rates = Some(self.compute_rates());
        }
        let rates = self.rates.as_ref().expect("computed above");
        let c = &self.rig.camera;
        let (t, white) = (self.exposure_s as f32, f32::from(c.white_dn()));
        let (gain, black, well) = (c.gain_dn_per_e as f32, c.black_level_dn as f32, c.full_well_e as f32);
        let dark_variance = (c.dark_noise_e * c.dark_noise_e) as f32;
        let (seed, number, noise) = (self.config.seed, self.frames_taken, self.config.noise);
        let mut samples = vec![0u16; rates.len()];
        samples.par_chunks_mut(c.width_px).zip(rates.par_chunks(c.width_px)).enumerate().for_each(
            |(row, (samples, rates))| {
                let mut rng = row_generator(seed, number, row as u64);
                for (sample, &rate) in samples.iter_mut().zip(rates) {
                    let mean = rate * t;
                    // Beside 10 electrons of dark noise, Poisson and normal shot noise cannot be told apart.
                    let noise = if noise {
                        let unit: f32 = StandardNormal.sample(&mut rng);
                        unit * (mean.max(0.0) + dark_variance).sqrt()
                    } else {
                        0.0
                    };
                    *sample = (black + gain * (mean + noise).min(well) + 0.5).clamp(0.0, white) as u16;
                }
            },
        );
        samples
    }
}

/// One generator for each row of each frame: the noise does not depend on the number of threads.
fn row_generator(seed: u64, frame: u64, row: u64) -> Xoshiro256PlusPlus {
    let mixed = seed ^ (frame + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (row + 1).wrapping_mul(0xD1B5_4A32_D192_ED03);
    Xoshiro256PlusPlus::seed_from_u64(mixed)
}

impl Camera for TwinBench {
    fn set_exposure(&mut self, exposure_s: f64) -> Result<f64, CaptureError> {
        self.exposure_s = exposure_s;
        Ok(exposure_s)
    }

    fn grab(&mut self) -> Result<Frame, CaptureError> {
        if self.shown >= self.sequence.len() {
            return Err(CaptureError::Device {
                device: "camera",
                step: "grab".into(),
                reason: "no pattern is shown: load a sequence and show a frame of it first".into(),
            });
        }
        let samples = self.expose();
        let frame = Frame {
            width: self.rig.camera.width_px,
            height: self.rig.camera.height_px,
            samples,
            exposure_s: self.exposure_s,
            sequence: self.frames_taken,
            timestamp_s: self.clock_s,
        };
        self.frames_taken += 1;
        self.clock_s += self.exposure_s.max(1.0 / self.rig.camera.max_frame_rate_hz);
        Ok(frame)
    }
}

impl Projector for TwinBench {
    fn load(&mut self, sequence: &[Pattern]) -> Result<(), CaptureError> {
        let p = &self.rig.projector;
        if let Some(bad) = sequence.iter().find(|s| (s.width, s.height) != (p.width_px, p.height_px)) {
            return Err(CaptureError::Device {
                device: "projector",
                step: "load".into(),
                reason: format!("a {} x {} frame on a {} x {} panel", bad.width, bad.height, p.width_px, p.height_px),
            });
        }
        self.sequence = sequence.to_vec();
        (self.reflected, self.rates, self.shown) = (None, None, usize::MAX);
        Ok(())
    }

    fn show(&mut self, index: usize) -> Result<(), CaptureError> {
        if index >= self.sequence.len() {
            return Err(CaptureError::Device {
                device: "projector",
                step: format!("show frame {index}"),
                reason: format!("the sequence has {} frames", self.sequence.len()),
            });
        }
        self.shown = index;
        self.rates = None;
        Ok(())
    }
}

impl Bench for TwinBench {
    fn camera(&mut self) -> &mut dyn Camera {
        self
    }

    fn projector(&mut self) -> &mut dyn Projector {
        self
    }

    fn place(&mut self, what: Placement) -> Result<(), CaptureError> {
        self.placement = what;
        (self.target, self.reflected, self.rates) = (None, None, None);
        Ok(())
    }
}
