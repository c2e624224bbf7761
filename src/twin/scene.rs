//! What the simulated rig does to light: what every sensor pixel gets of every pattern.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use rayon::prelude::*;

use super::forward::{Accuracy, ResponseField};
use super::geometry::InverseMap;
use super::light::PatternLight;
use super::panel::{border, lit_zone};
use super::sensor::Sensor;
use super::targets::{Target, View};
use super::{Pupils, TwinConfig};
use crate::calibrate::GRAY_CARD_ALBEDO;
use crate::capture::Placement;
use crate::geometry::{Direction, Sample, Zone};
use crate::optics::{Device, Misaligned, Rig};
use crate::patterns::{Pattern, Primary};
use crate::reflectance::{Brdf, Lambert};

/// Pixels are integrated over this many samples along each side.
const PIXEL_SAMPLES: usize = 2;

/// An exitant direction, and the share of the camera's pencil for it that is not cut.
type Seen = (Direction<Sample>, f64);

/// Hash of the codes that reach the dome, and of their colour.
type Content = u64;

/// Patterns whose reflection is kept.
const MAX_REFLECTED: usize = 1000;

/// The simulated rig's mirrors, devices and sample: what a pixel gets from each pattern.
pub(super) struct Scene {
    rig: Rig,
    config: TwinConfig,
    accuracy: Accuracy,
    sample: Arc<dyn Brdf>,
    /// What [`Placement::GrayCard`] puts in place.
    pub card: Arc<dyn Brdf>,
    pub sensor: Sensor,
    /// Relative light of every panel pixel.
    vignetting: Vec<f64>,
    /// Panel pixels whose light goes into the zone; known only where there is stray light.
    lit_zone: Vec<usize>,
    placement: Placement,
    camera: Misaligned,
    projector: Misaligned,
    inverse: InverseMap,
    /// Where rays are not chief rays alone.
    pupils: Option<Pupils>,
    /// What each pixel that sees the dome sees of it: (sensor index, samples).
    pixels: Vec<(usize, Vec<Seen>)>,
    dome: Zone,
    /// What is in place instead of a sample, once it has been looked at.
    target: Option<Target>,
    sequence: Vec<Pattern>,
    /// Electrons per second from the sample, of each pixel in `pixels`, for what has been shown of the dome since something
    /// was put in place.
    reflected: HashMap<Content, Vec<f32>>,
    /// The same for each primary that shines evenly over the whole panel, as what leaks does: pixel * 3 + primary.
    even: Option<Vec<f32>>,
    /// Sensor pixels that look past the mirrors at the coded patch: the panel's pixel they see, and what of it reaches them.
    border: Vec<(u32, u32, f32)>,
    /// Electrons per second of each sensor pixel for one pattern.
    rates: Option<(usize, Vec<f32>)>,
}

impl Scene {
    pub fn new(rig: &Rig, config: TwinConfig, sample: Arc<dyn Brdf>, accuracy: Accuracy) -> Self {
        let perturbation = config.of_chief_rays();
        let camera = Misaligned::new(rig, &perturbation, Device::Camera);
        let projector = Misaligned::new(rig, &perturbation, Device::Projector);
        let theta_max = rig.dome.theta_max_deg.to_radians();
        let shadow = rig.mirrors().shadow(rig.paraboloid_radius_mm());
        let dome = Zone::new(shadow, theta_max).expect("a checked rig reaches beyond its shadow");
        let inverse = InverseMap::new(&projector, theta_max);
        let pupils = Pupils::new(rig, &config);
        let width = rig.camera.width_px;
        let (centre_u, centre_v) = camera.image_centre();
        let edge_px = rig.camera_map().radius_px(theta_max).unwrap_or(f64::INFINITY) + 3.0;
        let vignettes = pupils.as_ref().filter(|pupils| pupils.vignettes());
        let seen = |u: f64, v: f64| match vignettes {
            None => camera.direction(u, v).map(|d| (d, 1.0)),
            Some(pupils) => camera.direction_beyond(u, v).map(|d| (d, pupils.transmitted(&d))),
        };
        let pixels = (0..width * rig.camera.height_px)
            .into_par_iter()
            .filter_map(|i| {
                let (u, v) = ((i % width) as f64, (i / width) as f64);
                if (u - centre_u).hypot(v - centre_v) > edge_px {
                    return None;
                }
                let at = |j: usize| (j as f64 + 0.5) / PIXEL_SAMPLES as f64;
                let directions: Vec<_> = (0..PIXEL_SAMPLES * PIXEL_SAMPLES)
                    .filter_map(|j| seen(u + at(j % PIXEL_SAMPLES), v + at(j / PIXEL_SAMPLES)))
                    .filter(|(d, share)| d.theta() >= shadow && d.cos_theta() > 0.0 && *share > 0.0)
                    .collect();
                (!directions.is_empty()).then_some((i, directions))
            })
            .collect();
        let border = border(rig, &projector, &camera);
        let sensor = Sensor::new(rig, &config);
        let (w, h) = (rig.projector.width_px, rig.projector.height_px);
        let vignetting = (0..w * h).map(|p| config.vignetting(p % w, p / w, w, h)).collect();
        let lit_zone = if config.stray_share == 0.0 { Vec::new() } else { lit_zone(rig) };
        let card = Arc::new(Lambert::gray(GRAY_CARD_ALBEDO * (1.0 + config.card_albedo_error_rel)));
        Self {
            rig: rig.clone(),
            config,
            accuracy,
            sample,
            card,
            sensor,
            vignetting,
            lit_zone,
            placement: Placement::Sample,
            camera,
            projector,
            inverse,
            pupils,
            pixels,
            dome,
            target: None,
            sequence: Vec::new(),
            reflected: HashMap::new(),
            even: None,
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
        self.rates = None;
    }

    /// Learns what the thing in place reflects of these frames before they are shown: directions are gone through once for all.
    pub fn foresee(&mut self, frames: &[Pattern]) {
        let ([first, ..], Placement::Sample | Placement::GrayCard) = (frames, self.placement) else { return };
        // Devices are made ready with a dark dome.
        let dark = Pattern { codes: vec![0; first.codes.len()].into(), ..*first };
        let shown = std::mem::replace(&mut self.sequence, frames.iter().cloned().chain([dark]).collect());
        self.reflect();
        self.sequence = shown;
    }

    /// Puts something else in place.
    pub fn place(&mut self, what: Placement) {
        if what == self.placement {
            return;
        }
        self.placement = what;
        (self.target, self.rates) = (None, None);
        self.reflected.clear();
        self.even = None;
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

    fn mean_light(&self, pattern: &Pattern) -> f64 {
        let mut counts = [0usize; 256];
        pattern.codes.iter().for_each(|&c| counts[usize::from(c)] += 1);
        let sum: f64 = (0..=255u8).map(|c| counts[usize::from(c)] as f64 * self.config.response(c)).sum();
        sum / pattern.codes.len() as f64
    }

    /// The part of the panel whose light reaches the dome: first column and row, and size.
    fn dome_panel(&self) -> ([usize; 2], [usize; 2]) {
        let p = &self.rig.projector;
        let edge = self.rig.projector_map().radius_px(self.dome.theta_max()).unwrap_or(f64::INFINITY) + 4.0;
        let (centre_u, centre_v) = self.projector.image_centre();
        let lo = |c: f64| (c - edge).floor().max(0.0) as usize;
        let hi = |c: f64, n: usize| ((c + edge).ceil() as usize).min(n);
        let (u0, v0) = (lo(centre_u), lo(centre_v));
        ([u0, v0], [hi(centre_u, p.width_px) - u0, hi(centre_v, p.height_px) - v0])
    }

    /// What of a pattern reaches the dome: patterns alike in this reflect alike.
    fn content(&self, shown: usize) -> Content {
        let pattern = &self.sequence[shown];
        let ([u0, v0], [width, height]) = self.dome_panel();
        let mut hasher = DefaultHasher::new();
        pattern.light.hash(&mut hasher);
        for v in v0..v0 + height {
            pattern.codes[v * pattern.width + u0..][..width].hash(&mut hasher);
        }
        hasher.finish()
    }

    /// The light of some frames without what leaks, and of a panel that shines evenly.
    fn pattern_light(&self, frames: &[&Pattern]) -> PatternLight {
        let p = &self.rig.projector;
        let (origin, size) = self.dome_panel();
        let (lights, vignetting) = (self.code_lights(), &self.vignetting);
        PatternLight::new(origin, size, frames.len() + 1, |pattern, column, row| {
            let pixel = row * p.width_px + column;
            let lit = |frame: &&Pattern| (lights[usize::from(frame.codes[pixel])] * vignetting[pixel]) as f32;
            frames.get(pattern).map_or(1.0, lit)
        })
    }

    /// Electrons per second of every sensor pixel for a pattern, without dark signal; for no pattern, darkness.
    fn rates(&mut self, shown: Option<usize>) -> Vec<f32> {
        let (width, height) = self.sensor_size();
        let mut rates = vec![self.config.ambient_e_s as f32; width * height];
        let Some(shown) = shown else { return rates };
        match self.placement {
            Placement::Screen => {
                self.add_screen(shown, &mut rates);
                return rates;
            }
            Placement::PrintedCross | Placement::Crosses | Placement::Mirror => {
                self.add_target(shown, &mut rates);
                return rates;
            }
            Placement::Sample | Placement::GrayCard | Placement::BlackTrap => {}
        }
        self.add_border(shown, &mut rates);
        self.add_stray(shown, &mut rates);
        if self.placement == Placement::BlackTrap {
            return rates;
        }
        let content = self.content(shown);
        if !self.reflected.contains_key(&content) {
            self.reflect();
        }
        let pattern = &self.sequence[shown];
        let leaks = (self.config.leakage * self.mean_light(pattern)) as f32;
        let leaking = [0, 1, 2].map(|p| if pattern.light.lights(p) { leaks } else { 0.0 });
        let even = self.even.as_ref().expect("known with the first reflection").chunks_exact(3);
        for (((i, _), rate), even) in self.pixels.iter().zip(&self.reflected[&content]).zip(even) {
            rates[*i] += rate + even.iter().zip(leaking).map(|(e, l)| e * l).sum::<f32>();
        }
        rates
    }

    /// The coded patch on the border around the sample.
    fn add_border(&self, shown: usize, rates: &mut [f32]) {
        let pattern = &self.sequence[shown];
        let white = (self.lamp_e_s() * self.config.border_radiance) as f32;
        let (lights, vignetting) = (self.code_lights().map(|l| l as f32), &self.vignetting);
        let width = self.rig.camera.width_px;
        for &(i, pixel, reach) in &self.border {
            let (column, row) = (i as usize % width, i as usize / width);
            let gain = self.channel_gain(column, row) as f32;
            let light = lights[usize::from(pattern.codes[pixel as usize])] * vignetting[pixel as usize] as f32;
            rates[i as usize] += white * gain * light * reach;
        }
    }

    /// Sensitivity of red, green and blue pixels to white light.
    fn white_gains(&self) -> [f64; 3] {
        std::array::from_fn(|c| self.config.channel_gains[c] * self.config.crosstalk[c].iter().sum::<f64>())
    }

    /// Mean light of a pattern over the panel's lit zone, in units of white.
    fn zone_light(&self, pattern: &Pattern) -> f64 {
        let (lights, vignetting) = (self.code_lights(), &self.vignetting);
        let light = |&p: &usize| lights[usize::from(pattern.codes[p])] * vignetting[p];
        self.lit_zone.iter().map(light).sum::<f64>() / self.lit_zone.len().max(1) as f64
    }

    /// Stray light: smooth over the sensor, in proportion to the pattern's mean.
    fn add_stray(&self, shown: usize, rates: &mut [f32]) {
        if self.config.stray_share == 0.0 {
            return;
        }
        let pattern = &self.sequence[shown];
        let card = self.config.stray_share * self.lamp_e_s() * self.gray_card_radiance();
        let lit = card * self.zone_light(pattern);
        let unlit = card * self.code_lights()[0];
        let c = &self.rig.camera;
        for (i, rate) in rates.iter_mut().enumerate() {
            let (column, row) = (i % c.width_px, i / c.width_px);
            let x = 2.0 * (column as f64 + 0.5) / c.width_px as f64 - 1.0;
            let y = 2.0 * (row as f64 + 0.5) / c.height_px as f64 - 1.0;
            let profile = 1.0 + 0.3 * x + 0.2 * (1.0 - 3.0 * y * y);
            let channels = c.mosaic.channels(column, row);
            let light = |&channel: &usize| {
                let shares = self.config.crosstalk[channel].iter().enumerate();
                let seen = shares.map(|(p, share)| share * if pattern.light.lights(p) { lit } else { unlit });
                self.config.channel_gains[channel] * seen.sum::<f64>()
            };
            *rate += (profile * channels.iter().map(light).sum::<f64>() / channels.len() as f64) as f32;
        }
    }

    /// What every pixel gets from the sample for every pattern of the sequence.
    fn reflect(&mut self) {
        let mut contents: Vec<(Content, usize)> = (0..self.sequence.len()).map(|i| (self.content(i), i)).collect();
        contents.retain(|(content, _)| !self.reflected.contains_key(content));
        contents.sort_by_key(|&(content, i)| (content, i));
        contents.dedup_by_key(|&mut (content, _)| content);
        if contents.is_empty() {
            return;
        }
        contents.sort_by_key(|&(_, i)| i);
        let new: Vec<&Pattern> = contents.iter().map(|&(_, i)| &self.sequence[i]).collect();
        let p = &self.rig.projector;
        // Beside a coloured frame, what its dark primaries show.
        let coloured = new.iter().any(|pattern| pattern.light != Primary::White);
        let black = coloured.then(|| Pattern::full(p.width_px, p.height_px, 0));
        let frames: Vec<&Pattern> = new.iter().copied().chain(&black).collect();
        let brdf = if self.placement == Placement::GrayCard { &self.card } else { &self.sample };
        let light = self.pattern_light(&frames);
        let pupils = self.pupils.as_ref();
        let field = ResponseField::through(brdf.as_ref(), &light, &self.inverse, pupils, self.dome, &self.accuracy);
        let lamp = self.lamp_e_s() / (PIXEL_SAMPLES * PIXEL_SAMPLES) as f64;
        let width = self.rig.camera.width_px;
        let patterns = new.len();
        // For each pixel the patterns, then the three primaries of an even panel.
        let columns = patterns + 3;
        let mut reflected = vec![0.0; self.pixels.len() * columns];
        reflected.par_chunks_mut(columns).zip(&self.pixels).for_each(|(row, (i, directions))| {
            let mut lit = vec![0.0f32; frames.len() + 1];
            let (column, line) = (i % width, i / width);
            let channels = self.rig.camera.mosaic.channels(column, line);
            let falloff = self.natural_falloff(self.camera.lens(), column, line);
            for (wo, seen) in directions {
                for &c in channels {
                    let gain = self.config.channel_gains[c] / channels.len() as f64;
                    for (p, share) in self.config.crosstalk[c].iter().enumerate().filter(|(_, share)| **share != 0.0) {
                        let scale = lamp * falloff * gain * share * seen;
                        lit.fill(0.0);
                        field.add_radiance(wo, p, scale, &mut lit);
                        let lights = new.iter().map(|pattern| pattern.light.lights(p));
                        for ((sum, lights), j) in row.iter_mut().zip(lights).zip(0..) {
                            // The black frame comes after the new ones.
                            *sum += lit[if lights { j } else { patterns }];
                        }
                        row[patterns + p] += lit[frames.len()];
                    }
                }
            }
        });
        if self.reflected.len() + patterns > MAX_REFLECTED {
            self.reflected.clear();
        }
        for (j, (content, _)) in contents.into_iter().enumerate() {
            self.reflected.insert(content, reflected.iter().skip(j).step_by(columns).copied().collect());
        }
        self.even = Some(reflected.chunks_exact(columns).flat_map(|row| &row[patterns..]).copied().collect());
    }

    /// What replaces the sample for `calibrate align` and `calibrate map`.
    fn add_target(&mut self, shown: usize, rates: &mut [f32]) {
        let target = self.target.take();
        let scene = View { rig: &self.rig, camera: &self.camera, projector: &self.projector, inverse: &self.inverse };
        let target = target.unwrap_or_else(|| match self.placement {
            Placement::Mirror => Target::mirror(&scene),
            placement => Target::crosses(&scene, placement == Placement::Crosses),
        });
        let pattern = &self.sequence[shown];
        let mean = self.mean_light(pattern);
        let (lights, vignetting, lamp) = (self.code_lights(), &self.vignetting, self.lamp_e_s());
        let shines = |(&code, v): (&u8, &f64)| lights[usize::from(code)] * v + self.config.leakage * mean;
        let light: Vec<f64> = pattern.codes.iter().zip(vignetting).map(shines).collect();
        let width = self.rig.camera.width_px;
        target.image(&scene, &light, |pixel, radiance| {
            let (column, row) = (pixel % width, pixel / width);
            let falloff = self.natural_falloff(self.camera.lens(), column, row);
            rates[pixel] += (lamp * radiance * falloff * self.channel_gain(column, row)) as f32;
        });
        self.target = Some(target);
    }

    /// Sensitivity of a pixel to white light.
    fn channel_gain(&self, column: usize, row: usize) -> f64 {
        let channels = self.rig.camera.mosaic.channels(column, row);
        channels.iter().map(|&c| self.white_gains()[c]).sum::<f64>() / channels.len() as f64
    }

    /// The white screen: a pixel sees one point of it, and that one direction of the projector.
    fn add_screen(&self, shown: usize, rates: &mut [f32]) {
        let (width, p) = (self.rig.camera.width_px, &self.rig.projector);
        let pattern = &self.sequence[shown];
        let mean = self.mean_light(pattern);
        let white = self.lamp_e_s() * self.gray_card_radiance();
        let (lights, vignetting) = (self.code_lights(), &self.vignetting);
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
        let lamp = 1.0 + self.config.lamp_drift_per_min * time_s / 60.0;
        let samples = self.sensor.samples(&rates, exposure_s, lamp, number);
        if let [(Some(shown), _)] = parts {
            self.rates = Some((*shown, rates));
        }
        samples
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::open;

    const COARSE: Accuracy = Accuracy { dome_nodes: 377, lobe_nodes: 377, sectors: 32, rings_per_lobe: 1.0 };

    /// Frames come out the same whether they were foreseen or not; those that were, and the dark dome before them, cost nothing more.
    #[test]
    fn what_was_foreseen_is_what_is_shown() {
        let rig = Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap();
        let scene = || Scene::new(&rig, TwinConfig::pinhole(1), open("ggx-0.2").unwrap(), COARSE);
        let full = |code| Pattern::full(rig.projector.width_px, rig.projector.height_px, code);
        let (dark, frames) = ([full(0)], [full(255), full(100)]);
        let shown = |scene: &mut Scene| {
            let mut rates = Vec::new();
            for sequence in [&dark[..], &frames] {
                scene.load(sequence);
                rates.extend((0..sequence.len()).map(|i| scene.rates(Some(i))));
            }
            rates
        };
        let (mut surprised, mut told) = (scene(), scene());
        told.foresee(&frames);
        assert_eq!(told.reflected.len(), frames.len() + dark.len());
        let kept = told.reflected.clone();
        assert!(shown(&mut told) == shown(&mut surprised));
        assert!(told.reflected == kept && kept == surprised.reflected);
        // Nothing is learnt of a sample that is not in place.
        told.place(Placement::BlackTrap);
        told.foresee(&frames);
        assert!(told.reflected.is_empty());
    }
}
