//! The simulated devices behind the traits of real ones.

use std::sync::{Arc, Mutex, PoisonError};

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;

use super::clock::{RealClock, VirtualClock};
use super::devices::{Devices, Truth, TwinCameraFactory, TwinProjectorFactory, World};
use super::forward::{Accuracy, PatternLight, ResponseField};
use super::geometry::InverseMap;
use super::{Faults, PerturbedDevice, TwinConfig};
use crate::calibrate::GRAY_CARD_ALBEDO;
use crate::capture::{Bench, CameraFactory, CaptureError, Clock, Placement, ProjectorFactory, Triggering};
use crate::geometry::{Direction, Sample, Zone};
use crate::optics::{Lens, Rig};
use crate::patterns::{Pattern, Rect, TagLayout};
use crate::reflectance::{Brdf, Lambert};

/// Pixels are integrated over this many samples along each side.
const PIXEL_SAMPLES: usize = 2;

/// The simulated rig's mirrors, devices and sample: what a pixel gets from each pattern.
pub(super) struct Scene {
    rig: Rig,
    config: TwinConfig,
    accuracy: Accuracy,
    sample: Arc<dyn Brdf>,
    placement: Placement,
    projector: PerturbedDevice,
    inverse: InverseMap,
    /// Directions of the samples of each pixel that sees the dome: (sensor index, directions).
    pixels: Vec<(usize, Vec<Direction<Sample>>)>,
    camera_lens: crate::optics::Lens,
    dome: Zone,
    sequence: Vec<Pattern>,
    /// Electrons per second from the sample, of each pixel in `pixels` for each pattern: `[pixel][pattern]`.
    reflected: Option<Vec<f32>>,
    /// Sensor pixels that look past the mirrors at the coded patch: the panel's pixel they see, and what of it reaches them.
    border: Vec<(u32, u32, f32)>,
    /// Electrons per second of each sensor pixel for one pattern.
    rates: Option<(usize, Vec<f32>)>,
}

impl Scene {
    fn new(rig: &Rig, config: TwinConfig, sample: Arc<dyn Brdf>, accuracy: Accuracy) -> Self {
        let camera = PerturbedDevice::camera(rig, &config.perturbation);
        let projector = PerturbedDevice::projector(rig, &config.perturbation);
        let theta_max = rig.dome.theta_max_deg.to_radians();
        let shadow = rig.mirrors().shadow(rig.paraboloid_radius_mm());
        let dome = Zone::new(shadow, theta_max).expect("a checked rig reaches beyond its shadow");
        let inverse = InverseMap::new(&projector, theta_max);
        let width = rig.camera.width_px;
        let lens = *camera.lens();
        let edge_px = rig.camera_map().radius_px(theta_max).unwrap_or(f64::INFINITY) + 3.0;
        let pixels = (0..width * rig.camera.height_px)
            .into_par_iter()
            .filter_map(|i| {
                let (u, v) = ((i % width) as f64, (i / width) as f64);
                if (u - lens.centre_u).hypot(v - lens.centre_v) > edge_px {
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
        let border = border(rig, projector.lens(), &lens);
        Self {
            rig: rig.clone(),
            config,
            accuracy,
            sample,
            placement: Placement::Sample,
            projector,
            inverse,
            pixels,
            camera_lens: lens,
            dome,
            sequence: Vec::new(),
            reflected: None,
            border,
            rates: None,
        }
    }

    pub fn sensor_size(&self) -> (usize, usize) {
        (self.rig.camera.width_px, self.rig.camera.height_px)
    }

    pub fn panel_size(&self) -> (usize, usize) {
        (self.rig.projector.width_px, self.rig.projector.height_px)
    }

    pub fn frame_s(&self) -> f64 {
        1.0 / self.rig.camera.max_frame_rate_hz
    }

    pub fn readout_s(&self) -> f64 {
        self.rig.camera.readout_s
    }

    pub fn refresh_hz(&self) -> f64 {
        self.rig.projector.refresh_hz
    }

    pub fn latency_s(&self) -> f64 {
        self.config.latency_refreshes / self.refresh_hz()
    }

    /// Number of frames loaded.
    pub fn frames(&self) -> usize {
        self.sequence.len()
    }

    /// Takes another sequence of frames.
    pub fn load(&mut self, sequence: &[Pattern]) {
        self.sequence = sequence.to_vec();
        (self.reflected, self.rates) = (None, None);
    }

    /// Puts something else in place.
    fn place(&mut self, what: Placement) {
        self.placement = what;
        (self.reflected, self.rates) = (None, None);
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
        let lens = self.projector.lens();
        let lo = |c: f64| (c - edge).floor().max(0.0) as usize;
        let hi = |c: f64, n: usize| ((c + edge).ceil() as usize).min(n);
        let (u0, v0) = (lo(lens.centre_u), lo(lens.centre_v));
        let (width, height) = (hi(lens.centre_u, p.width_px) - u0, hi(lens.centre_v, p.height_px) - v0);
        let means: Vec<f64> = self.sequence.iter().map(|s| self.mean_light(s)).collect();
        let (lights, vignetting) = (self.code_lights(), self.vignetting());
        PatternLight::new([u0, v0], [width, height], self.sequence.len(), |pattern, column, row| {
            let pixel = row * p.width_px + column;
            let code = self.sequence[pattern].codes[pixel];
            (lights[usize::from(code)] * vignetting[pixel] + self.config.leakage * means[pattern]) as f32
        })
    }

    /// Electrons per second of every sensor pixel for a pattern, without dark signal; for no pattern, darkness.
    fn rates(&mut self, shown: Option<usize>) -> Vec<f32> {
        let (width, height) = self.sensor_size();
        let mut rates = vec![self.config.ambient_e_s as f32; width * height];
        let Some(shown) = shown else { return rates };
        if self.placement == Placement::Screen {
            self.add_screen(shown, &mut rates);
            return rates;
        }
        self.add_border(shown, &mut rates);
        if self.reflected.is_none() {
            self.reflected = Some(self.reflect());
        }
        let reflected = self.reflected.as_ref().expect("made above");
        for ((i, _), row) in self.pixels.iter().zip(reflected.chunks_exact(self.sequence.len())) {
            rates[*i] += row[shown];
        }
        rates
    }

    /// The coded patch on the border around the sample.
    fn add_border(&self, shown: usize, rates: &mut [f32]) {
        let pattern = &self.sequence[shown];
        let white = (self.lamp_e_s() * self.config.border_radiance) as f32;
        let (lights, vignetting) = (self.code_lights().map(|l| l as f32), self.vignetting());
        let width = self.rig.camera.width_px;
        let gains = self.config.channel_gains.map(|g| g as f32);
        for &(i, pixel, reach) in &self.border {
            let (column, row) = (i as usize % width, i as usize / width);
            let channels = self.rig.camera.mosaic.channels(column, row);
            let gain = channels.iter().map(|&c| gains[c]).sum::<f32>() / channels.len() as f32;
            let light = lights[usize::from(pattern.codes[pixel as usize])] * vignetting[pixel as usize] as f32;
            rates[i as usize] += white * gain * light * reach;
        }
    }

    /// What every pixel gets from the sample for every pattern of the sequence.
    fn reflect(&self) -> Vec<f32> {
        let brdf: Arc<dyn Brdf> = match self.placement {
            Placement::GrayCard => {
                let albedo = GRAY_CARD_ALBEDO * (1.0 + self.config.card_albedo_error_rel);
                Arc::new(Lambert { albedo: [albedo; 3] })
            }
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
            let falloff = self.natural_falloff(&self.camera_lens, column, line);
            for wo in directions {
                for &c in channels {
                    let gain = self.config.channel_gains[c] / channels.len() as f64;
                    field.add_radiance(wo, c, lamp * falloff * gain, row);
                }
            }
        });
        reflected
    }

    /// The white screen: both devices share one centre of projection, so a pixel sees one direction of the projector.
    fn add_screen(&self, shown: usize, rates: &mut [f32]) {
        let (width, p) = (self.rig.camera.width_px, &self.rig.projector);
        let pattern = &self.sequence[shown];
        let mean = self.mean_light(pattern);
        let white = self.lamp_e_s() * self.gray_card_radiance();
        let (lights, vignetting) = (self.code_lights(), self.vignetting());
        for (i, rate) in rates.iter_mut().enumerate() {
            let (column, row) = (i % width, i / width);
            let ray = self.camera_lens.ray(column as f64 + 0.5, row as f64 + 0.5);
            let (u, v) = self.projector.lens().pixel(&ray);
            if u < 0.0 || v < 0.0 || u >= p.width_px as f64 || v >= p.height_px as f64 {
                continue;
            }
            let pixel = v as usize * p.width_px + u as usize;
            let code = pattern.codes[pixel];
            let light = lights[usize::from(code)] * vignetting[pixel] + self.config.leakage * mean;
            let falloff = ray.z.powi(4) * self.natural_falloff(&self.camera_lens, column, row);
            let gain: f64 = {
                let channels = self.rig.camera.mosaic.channels(column, row);
                channels.iter().map(|&c| self.config.channel_gains[c]).sum::<f64>() / channels.len() as f64
            };
            *rate += (white * gain * light * falloff) as f32;
        }
    }

    /// cos^4 of the angle to the optical axis.
    fn natural_falloff(&self, lens: &crate::optics::Lens, column: usize, row: usize) -> f64 {
        lens.ray(column as f64 + 0.5, row as f64 + 0.5).z.powi(4)
    }

    /// Samples of an exposure during which `parts` were lit, each for its share of the time. `number` seeds the noise;
    /// `time_s` tells how far the lamp has drifted.
    pub fn expose(&mut self, parts: &[(Option<usize>, f64)], exposure_s: f64, number: u64, time_s: f64) -> Vec<u16> {
        let rates = match parts {
            [(Some(shown), _)] => {
                let kept = self.rates.take().filter(|(index, _)| index == shown);
                kept.map_or_else(|| self.rates(Some(*shown)), |(_, rates)| rates)
            }
            _ => {
                let (width, height) = self.sensor_size();
                let mut sum = vec![0.0; width * height];
                for &(shown, share) in parts {
                    let rates = self.rates(shown);
                    sum.iter_mut().zip(&rates).for_each(|(s, r)| *s += share as f32 * r);
                }
                sum
            }
        };
        let c = &self.rig.camera;
        let lamp = 1.0 + self.config.lamp_drift_per_min * time_s / 60.0;
        let (t, white) = (exposure_s as f32, f32::from(c.white_dn()));
        let (ambient, lamp) = (self.config.ambient_e_s as f32, lamp as f32);
        let (gain, black, well) = (c.gain_dn_per_e as f32, c.black_level_dn as f32, c.full_well_e as f32);
        let dark_variance = (c.dark_noise_e * c.dark_noise_e) as f32;
        let (seed, noise) = (self.config.seed, self.config.noise);
        let mut samples = vec![0u16; rates.len()];
        samples.par_chunks_mut(c.width_px).zip(rates.par_chunks(c.width_px)).enumerate().for_each(
            |(row, (samples, rates))| {
                let mut rng = row_generator(seed, number, row as u64);
                for (sample, &rate) in samples.iter_mut().zip(rates) {
                    let mean = (ambient + (rate - ambient) * lamp) * t;
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
        if let [(Some(shown), _)] = parts {
            self.rates = Some((*shown, rates));
        }
        samples
    }
}

/// Sensor pixels that look past the mirrors at the coded patch, the panel's pixel each sees, and the share of its light that
/// both lenses leave.
fn border(rig: &Rig, projector: &Lens, camera: &Lens) -> Vec<(u32, u32, f32)> {
    let Some(layout) = TagLayout::of(rig) else { return Vec::new() };
    let (width, panel_width) = (rig.camera.width_px, rig.projector.width_px);
    let mut seen = Vec::new();
    for i in 0..width * rig.camera.height_px {
        let ray = camera.ray((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let (u, v) = projector.pixel(&ray);
        let in_cell = |cell: &Rect| {
            let (du, dv) = (u - cell.u0 as f64, v - cell.v0 as f64);
            du >= 0.0 && dv >= 0.0 && du < cell.width as f64 && dv < cell.height as f64
        };
        if layout.bits().iter().flat_map(|bit| &bit.panel).any(in_cell) {
            let pixel = v as usize * panel_width + u as usize;
            seen.push((i as u32, pixel as u32, ray.z.powi(8) as f32));
        }
    }
    seen
}

/// One generator for each row of each frame: the noise does not depend on the number of threads.
fn row_generator(seed: u64, frame: u64, row: u64) -> Xoshiro256PlusPlus {
    let mixed = seed ^ (frame + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (row + 1).wrapping_mul(0xD1B5_4A32_D192_ED03);
    Xoshiro256PlusPlus::seed_from_u64(mixed)
}

/// A simulated rig with a sample in it.
pub struct TwinBench {
    world: Arc<World>,
    camera: TwinCameraFactory,
    projector: TwinProjectorFactory,
}

impl TwinBench {
    /// A simulated rig that holds `sample`, with a triggered camera and time as fast as it can be computed.
    pub fn new(rig: &Rig, config: TwinConfig, sample: Arc<dyn Brdf>) -> Self {
        Self::with_accuracy(rig, config, sample, Accuracy::default())
    }

    /// The same with another quadrature.
    pub fn with_accuracy(rig: &Rig, config: TwinConfig, sample: Arc<dyn Brdf>, accuracy: Accuracy) -> Self {
        let scene = Scene::new(rig, config, sample, accuracy);
        Self::in_world(World {
            state: Mutex::new(Devices::new(1.0 / rig.projector.refresh_hz)),
            scene: Mutex::new(scene),
            clock: Arc::new(VirtualClock::default()),
            faults: Faults::default(),
            triggering: Triggering::Triggered,
        })
    }

    fn in_world(world: World) -> Self {
        let world = Arc::new(world);
        Self { camera: TwinCameraFactory(world.clone()), projector: TwinProjectorFactory(world.clone()), world }
    }

    /// Changes what the devices share, before they are opened.
    fn changed(self, change: impl FnOnce(&mut World)) -> Self {
        let Self { world, camera, projector } = self;
        drop((camera, projector));
        let mut world = Arc::into_inner(world).expect("no device is open yet");
        change(&mut world);
        Self::in_world(world)
    }

    /// The same rig in real time.
    pub fn paced(self) -> Self {
        self.changed(|world| world.clock = Arc::new(RealClock::start()))
    }

    /// The same rig with a camera that runs freely.
    pub fn free_running(self) -> Self {
        self.changed(|world| world.triggering = Triggering::FreeRunning)
    }

    /// The same rig with devices that fail.
    pub fn failing(self, faults: Faults) -> Self {
        self.changed(|world| world.faults = faults)
    }

    /// What every frame delivered so far really was: for tests.
    pub fn truth(&self) -> Vec<Truth> {
        self.world.state.lock().unwrap_or_else(PoisonError::into_inner).truth.clone()
    }
}

impl Bench for TwinBench {
    fn camera(&self) -> &dyn CameraFactory {
        &self.camera
    }

    fn projector(&self) -> &dyn ProjectorFactory {
        &self.projector
    }

    fn clock(&self) -> Arc<dyn Clock> {
        self.world.clock.clone()
    }

    fn place(&mut self, what: Placement) -> Result<(), CaptureError> {
        self.world.scene.lock().unwrap_or_else(PoisonError::into_inner).place(what);
        Ok(())
    }
}
