//! Exposures chosen for each pair of lobes while it is measured.

use rayon::prelude::*;

use crate::capture::{Exposer, ResponseImage};
use crate::geometry::Zone;
use crate::patterns::{AutomaticBracket, LobePair, Step, Timing};
use crate::radiometry::Sensor;
use crate::reduce::{CellMap, ChannelScale};

/// A pixel whose exposure is predicted to end this many standard errors below the limit is expected not to saturate.
const MARGIN_SIGMAS: f64 = 3.0;
/// Ratio of neighbouring exposures among which is chosen.
const LADDER: f64 = std::f64::consts::SQRT_2;
/// Pixels the noise is predicted from; more would say the same.
const SAMPLED_PIXELS: usize = 20_000;
/// Share of the target that is aimed at: predictions come from the noisy frames of the shortest exposure. That of black velvet
/// on a coarse camera was 4% too low.
const AIM: f64 = 0.95;
/// The same where steps begin with the exposures that the one before needed, and frames are less noisy.
const AIM_CARRYING: f64 = 0.97;
/// Most exposures beyond the first.
const MAX_FURTHER: usize = 3;

/// As few exposures as a noise target needs: one of the shortest kind for both lobes, and what their rates then ask for.
pub struct AutomaticExposer {
    sensor: Sensor,
    cells: CellMap,
    scale: ChannelScale,
    /// By step: the divisor of what it shows.
    gains: Vec<f64>,
    /// By step: what the mean rate of its two frames is to be multiplied by to be about z_00.
    brightness: Vec<f64>,
    noise_rel: f64,
    shortest_s: f64,
    /// Exposures to choose from, ascending, in whole refresh periods.
    ladder: Vec<f64>,
    /// What a pixel's variance counts for in the mean square standard error over cells.
    weights: Vec<f64>,
    /// Exposures to begin the next step with.
    start: Vec<f64>,
    /// Whether a step begins with what the one before it needed.
    carries: bool,
    /// RMS z_00, once a pair has been seen.
    constant: Option<f64>,
    /// Whether the first step is the constant function and black.
    is_constant: bool,
}

impl AutomaticExposer {
    /// Exposures for the frames of `steps`.
    pub fn new(
        target: &AutomaticBracket,
        timing: &Timing,
        sensor: Sensor,
        cells: CellMap,
        scale: ChannelScale,
        pairs: &[LobePair],
        steps: &[Step],
    ) -> Self {
        // Of a mixture, what counts is the noise of the coefficients in it.
        let gain = |pair: &LobePair, step: &Step| {
            let mixtures = step.mixtures().iter();
            let power = mixtures.map(|m| m.0.iter().map(|&(_, f)| f * f).sum::<f64>() / m.0.len() as f64);
            pair.gains[0] * (power.sum::<f64>() / step.mixtures().len() as f64).sqrt()
        };
        let gains = pairs.iter().zip(steps).map(|(pair, step)| gain(pair, step)).collect();
        let brightness =
            pairs.iter().zip(steps).map(|(pair, step)| brightness(cells.grid().zone(), step) / pair.gains[0]).collect();
        let mut refreshes: Vec<u32> =
            std::iter::successors(Some(f64::from(target.longest_refreshes)), |n| Some(n / LADDER))
                .map(|n| n.round() as u32)
                .take_while(|&n| n >= target.shortest_refreshes.max(1))
                .collect();
        refreshes.dedup();
        refreshes.reverse();
        let weights = cells.noise_weights(&scale);
        Self {
            sensor,
            cells,
            scale,
            gains,
            brightness,
            noise_rel: target.noise_rel,
            shortest_s: f64::from(target.shortest_refreshes) * timing.refresh_s,
            ladder: refreshes.into_iter().map(|n| f64::from(n) * timing.refresh_s).collect(),
            weights,
            start: vec![f64::from(target.shortest_refreshes) * timing.refresh_s],
            carries: false,
            constant: None,
            is_constant: steps.first() == Some(&Step::function(0)),
        }
    }

    /// Begins each step with the exposures that the one before it needed: for steps that are about equally bright, as mixtures
    /// are. A pixel that then saturates is taken again with the shortest exposure.
    pub fn carrying(self) -> Self {
        Self { carries: true, ..self }
    }

    /// RMS over cells of the standard error that the coefficients of a pair will have, from expected rates of (weight,
    /// rate) pixels of both lobes and all exposures.
    fn predicted_sigma(&self, pixels: &[(f64, f64)], exposures_s: &[f64], gain: f64) -> f64 {
        let floor = self.sensor.dark_noise_e.powi(2) + 1.0 / (12.0 * self.sensor.gain_dn_per_e.powi(2));
        let range = (self.sensor.limit_dn - self.sensor.black_level_dn) / self.sensor.gain_dn_per_e;
        let power: f64 = pixels
            .par_iter()
            .with_min_len(2048)
            .map(|&(weight, rate)| {
                let information: f64 = exposures_s
                    .iter()
                    .map(|&t| {
                        let electrons = rate * t;
                        let noise = electrons + floor;
                        let fits = electrons + MARGIN_SIGMAS * noise.sqrt() < range;
                        if fits { t * t / noise } else { 0.0 }
                    })
                    .sum();
                weight / information
            })
            // In order: a sum that does not depend on the number of threads.
            .collect::<Vec<_>>()
            .iter()
            .sum();
        power.sqrt() / gain
    }

    /// The fewest exposures beyond `taken`, and of those the shortest, that reach `limit`; the best there are if none does.
    fn fewest(&self, taken: &[f64], pixels: &[(f64, f64)], gain: f64, limit: f64) -> Vec<f64> {
        let sigma = |further: &[f64]| {
            let mut all = taken.to_vec();
            all.extend(further);
            self.predicted_sigma(pixels, &all, gain)
        };
        if sigma(&[]) <= limit {
            return Vec::new();
        }
        let mut chosen: Vec<f64> = Vec::new();
        for _ in 0..MAX_FURTHER {
            let with = |t: f64| {
                let mut set = chosen.clone();
                set.push(t);
                sigma(&set)
            };
            let tried: Vec<(f64, f64)> = self.ladder.iter().map(|&t| (t, with(t))).collect();
            if let Some((t, _)) = tried.iter().find(|(_, sigma)| *sigma <= limit) {
                chosen.push(*t);
                break;
            }
            let best = tried.iter().min_by(|a, b| a.1.total_cmp(&b.1)).expect("a ladder has steps");
            // Nothing at all tells nothing: then the best will do.
            if best.1 >= sigma(&chosen) && !(chosen.is_empty() && taken.is_empty()) {
                break;
            }
            chosen.push(best.0);
        }
        // Longest first, as in a fixed bracket.
        chosen.sort_by(|a, b| b.total_cmp(a));
        chosen
    }

    /// RMS of z_00 over cells and channels, from the light of both frames of a step; of a step that is not the constant
    /// function about as large.
    fn constant_of(&self, k: usize, pair: [&ResponseImage; 2]) -> f64 {
        let sign = if k == 0 && self.is_constant { -1.0 } else { 1.0 };
        let [positive, negative] = pair.map(|image| self.cells.apply(image));
        let grid = self.cells.grid();
        let (mut sum, mut n) = (0.0, 0.0);
        for i in 0..positive.rate.len() {
            let theta_o = grid.theta(i % grid.len() / grid.sectors());
            let factor = self.scale.at(&grid.zone(), theta_o, i / grid.len()) * self.brightness[k];
            // The noise of the shortest exposure must not be taken for light.
            let noise = positive.variance[i] + negative.variance[i];
            let power = factor * factor * ((positive.rate[i] + sign * negative.rate[i]).powi(2) - noise);
            if power.is_finite() {
                sum += power;
                n += 1.0;
            }
        }
        f64::sqrt(f64::max(sum, 0.0) / f64::max(n, 1.0))
    }
}

impl Exposer for AutomaticExposer {
    fn first(&self) -> Vec<f64> {
        self.start.clone()
    }

    fn further(&mut self, k: usize, pair: [&ResponseImage; 2]) -> Vec<f64> {
        if k == 0 || self.constant.is_none() {
            self.constant = Some(self.constant_of(k, pair));
        }
        let aim = if self.carries { AIM_CARRYING } else { AIM };
        let limit = aim * self.noise_rel * self.constant.expect("set above");
        let counted: Vec<usize> = (0..self.weights.len()).filter(|&p| self.weights[p] > 0.0).collect();
        let saturated = counted.iter().any(|&p| pair.iter().any(|image| image.rate[p].is_nan()));
        let step = counted.len().div_ceil(SAMPLED_PIXELS).max(1);
        let pixels: Vec<(f64, f64)> = counted
            .iter()
            .step_by(step)
            .flat_map(|&p| pair.map(|image| (self.weights[p] * step as f64, expected_rate(image, p))))
            .filter(|(_, rate)| rate.is_finite())
            .collect();
        if limit <= 0.0 || pixels.is_empty() {
            return Vec::new();
        }
        let mut taken = self.start.clone();
        let mut further = Vec::new();
        if saturated && !taken.contains(&self.shortest_s) {
            taken.push(self.shortest_s);
            further.push(self.shortest_s);
        }
        further.extend(self.fewest(&taken, &pixels, self.gains[k], limit));
        if self.carries {
            self.start =
                if saturated { vec![self.shortest_s] } else { self.fewest(&[], &pixels, self.gains[k], limit) };
        }
        further
    }

    fn is_adaptive(&self) -> bool {
        true
    }

    fn expected_frames(&self) -> usize {
        4
    }
}

/// z_00 of an even sample over the light that both frames of a step send together, before its gain.
fn brightness(zone: Zone, step: &Step) -> f64 {
    let (peak, means) = step.brightness(zone);
    1.0 / (peak * (means[0] + means[1]) * zone.solid_angle().sqrt())
}

/// The rate a pixel is expected to have: its own where that is clear of noise, else the mean of its neighbourhood of the same
/// colour. The noise of dark pixels must not be taken for light.
fn expected_rate(image: &ResponseImage, p: usize) -> f64 {
    const CLEAR_SIGMAS: f32 = 5.0;
    const REACH: isize = 3;
    if image.rate[p] > CLEAR_SIGMAS * image.variance[p].sqrt() {
        return image.rate[p].into();
    }
    let (width, height) = (image.crop.width as isize, image.crop.height as isize);
    let (u, v) = (p as isize % width, p as isize / width);
    let (mut sum, mut n) = (0.0, 0.0);
    // Colours repeat in every second column and row.
    for (du, dv) in (-REACH..=REACH).flat_map(|dv| (-REACH..=REACH).map(move |du| (2 * du, 2 * dv))) {
        if (0..width).contains(&(u + du)) && (0..height).contains(&(v + dv)) {
            let rate = image.rate[((v + dv) * width + u + du) as usize];
            if rate.is_finite() {
                sum += f64::from(rate);
                n += 1.0;
            }
        }
    }
    f64::max(sum / n, 0.0)
}
