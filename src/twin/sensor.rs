//! The simulated sensor: from electrons per second to samples, with noise and differences between pixels.

use pulp::{Arch, Simd, WithSimd};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use rayon::prelude::*;

use super::{SensorTruth, TwinConfig};
use crate::optics::Rig;

/// The sensor as it is, which may not be what the rig file says.
pub(super) struct Sensor {
    width: usize,
    gain: f32,
    black: f32,
    well: f32,
    dark_variance: f32,
    white: f32,
    ambient: f32,
    seed: u64,
    noise: bool,
    gamma: f32,
    pixels: Option<Pixels>,
}

impl Sensor {
    /// The sensor of a rig.
    pub fn new(rig: &Rig, config: &TwinConfig) -> Self {
        let (c, truth) = (&rig.camera, &config.sensor);
        Self {
            width: c.width_px,
            gain: (c.gain_dn_per_e * truth.gain) as f32,
            black: (c.black_level_dn + truth.black_level_dn) as f32,
            well: (c.full_well_e * truth.full_well) as f32,
            dark_variance: (c.dark_noise_e * truth.dark_noise).powi(2) as f32,
            white: f32::from(c.white_dn()),
            ambient: config.ambient_e_s as f32,
            seed: config.seed,
            noise: config.noise,
            gamma: truth.gamma as f32,
            pixels: Pixels::new(truth, c.width_px * c.height_px),
        }
    }

    /// Whether each pixel is hot, row by row; empty where all are alike.
    pub fn hot_pixels(&self) -> Vec<bool> {
        self.pixels.as_ref().map_or_else(Vec::new, |p| p.dark_e_s.iter().map(|e| *e > 0.0).collect())
    }

    /// Samples of an exposure from the light in electrons per second, ambient included, that a lamp of relative light `lamp`
    /// sends. `number` tells one frame's noise from another's.
    pub fn samples(&self, rates: &[f32], exposure_s: f64, lamp: f64, number: u64) -> Vec<u16> {
        let light = Light { exposure_s: exposure_s as f32, lamp: lamp as f32 };
        let mut samples = vec![0u16; rates.len()];
        let rows = samples.par_chunks_mut(self.width).zip(rates.par_chunks(self.width));
        rows.enumerate().for_each_init(Vec::new, |units, (row, (samples, rates))| {
            // First all that is drawn, one after the other, then what is computed of it, in vectors.
            units.clear();
            if self.noise {
                let mut rng = row_generator(self.seed, number, row as u64);
                units.extend(rates.iter().map(|_| Distribution::<f32>::sample(&StandardNormal, &mut rng)));
            } else {
                units.resize(rates.len(), 0.0);
            }
            Arch::new().dispatch(Row { sensor: self, light, at: row * self.width, rates, units, samples });
        });
        samples
    }
}

/// How long, and how bright the lamp is.
#[derive(Clone, Copy)]
struct Light {
    exposure_s: f32,
    lamp: f32,
}

/// A row of pixels from `at` on, with a standard normal number for each.
struct Row<'a> {
    sensor: &'a Sensor,
    light: Light,
    at: usize,
    rates: &'a [f32],
    units: &'a [f32],
    samples: &'a mut [u16],
}

impl WithSimd for Row<'_> {
    type Output = ();

    /// The compiler finds the vectors; here is only said of which width they may be.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { sensor, light: Light { exposure_s, lamp }, at, rates, units, samples } = self;
        let mean = |rate: f32| (sensor.ambient + (rate - sensor.ambient) * lamp) * exposure_s;
        let code = |mean: f32, offset: f32, unit: f32| {
            // Beside 10 electrons of dark noise, Poisson and normal shot noise cannot be told apart.
            let noise = unit * (mean.max(0.0) + sensor.dark_variance).sqrt();
            let electrons = (mean + noise + offset).min(sensor.well);
            (sensor.black + sensor.gain * electrons).clamp(0.0, sensor.white)
        };
        let white = sensor.white;
        let rounded = |code: f32| (code + 0.5).min(white) as u16;
        let pixels = samples.iter_mut().zip(rates).zip(units);
        match &sensor.pixels {
            None if sensor.gamma == 1.0 => {
                pixels.for_each(|((sample, &rate), &unit)| *sample = rounded(code(mean(rate), 0.0, unit)));
            }
            own => pixels.enumerate().for_each(|(i, ((sample, &rate), &unit))| {
                let mut dn = match own {
                    None => code(mean(rate), 0.0, unit),
                    Some(own) => {
                        let mean = mean(rate) * own.response[at + i] + own.dark_e_s[at + i] * exposure_s;
                        code(mean, own.offset_e[at + i], unit)
                    }
                };
                if sensor.gamma != 1.0 {
                    dn = 255.0 * (dn / white).powf(sensor.gamma.recip());
                }
                *sample = rounded(dn);
            }),
        }
    }
}

/// One value for each pixel of the sensor.
struct Pixels {
    /// Signal without light, electrons.
    offset_e: Vec<f32>,
    /// Dark current, electrons/s.
    dark_e_s: Vec<f32>,
    /// Response over the mean pixel's.
    response: Vec<f32>,
}

impl Pixels {
    /// Pixels as their seed makes them; `None` where all are alike.
    fn new(truth: &SensorTruth, count: usize) -> Option<Self> {
        if truth.hot_share == 0.0 && truth.dsnu_e == 0.0 && truth.prnu_rel == 0.0 {
            return None;
        }
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(truth.seed);
        let mut normal = |sigma: f64| -> Vec<f32> {
            (0..count).map(|_| (sigma * Distribution::<f64>::sample(&StandardNormal, &mut rng)) as f32).collect()
        };
        let offset_e = normal(truth.dsnu_e);
        let response = normal(truth.prnu_rel).into_iter().map(|x| 1.0 + x).collect();
        let hot = |_| if rng.random::<f64>() < truth.hot_share { truth.hot_e_s as f32 } else { 0.0 };
        let dark_e_s = (0..count).map(hot).collect();
        Some(Self { offset_e, dark_e_s, response })
    }
}

/// One generator for each row of each frame: the noise does not depend on the number of threads.
fn row_generator(seed: u64, frame: u64, row: u64) -> Xoshiro256PlusPlus {
    let mixed = seed ^ (frame + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (row + 1).wrapping_mul(0xD1B5_4A32_D192_ED03);
    Xoshiro256PlusPlus::seed_from_u64(mixed)
}
