//! The camera's figures from its own frames of the gray card and of the black trap.

use serde::{Deserialize, Serialize};

use super::CalibrateError;
use crate::capture::{Bench, Crop, Placement, SensorMaps, capture_frames, capture_sequence};
use crate::optics::Rig;
use crate::patterns::{Pattern, Plan, Timing};
use crate::radiometry::{
    CameraResponse, DarkMaps, Level, LinearRange, MIN_STACK, PairMoments, PhotonTransfer, TransferError,
};

/// Codes tried, brightest first, until saturation takes long enough for fine steps.
const CODES: [u8; 6] = [255, 180, 128, 90, 64, 45];
/// Refresh periods to saturation that are enough: steps of one are then 1.3% of it.
const FINE_ENOUGH: f64 = 80.0;
/// Longest exposure over the one expected to saturate.
const BEYOND: f64 = 1.15;
/// Longer series tried where a sensor holds more than its file says.
const ATTEMPTS: usize = 3;
/// Pixels of most equal light that a series is made of: the variance of a level is then known to 1.1%.
const PIXELS: usize = 16384;
/// The most equal of those, from which the linear range is found: they saturate together.
const EQUAL: usize = 2048;
/// Deviation from a line at which the linear range ends...
const DEVIATION: f64 = 0.005;
/// ... of codes made linear, which are coarse and known to a percent or two.
const DEVIATION_OF_CODES: f64 = 0.03;
/// Share of the linear range that is used: single samples scatter about the mean that was judged.
const USED: f64 = 0.995;
/// Standard deviations of all pixels beyond which one is hot.
const HOT_SIGMAS: f64 = 8.0;
/// Exposure in which hot pixels are looked for, refresh periods.
const HOT_REFRESHES: f64 = 16.0;

/// Measured figures of a camera. What is `None` was not measured: the rig file's figure stays.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraFigures {
    /// From photon transfer.
    pub noise: Option<NoiseFigures>,
    /// Where the response leaves its line, over exposure times.
    pub linear_range: Option<LinearRange>,
    /// Exposures of the codes of a camera that is not linear, 256, relative to that of code 128. The other figures are then
    /// those of samples made linear.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub codes: Option<Vec<f64>>,
}

/// Figures after EMVA 1288.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseFigures {
    /// Gain, dark noise, saturation, linearity error; light is counted in seconds of exposure or, from files, in photons.
    pub transfer: PhotonTransfer,
    /// Mean value in darkness, ambient light of the shortest exposure included.
    pub black_level_dn: f64,
    /// Greatest mean of any level: with full wells, or where the converter ends. The noisiest level, which EMVA 1288 takes
    /// for saturation, lies some noise below.
    pub saturation_dn: f64,
}

impl NoiseFigures {
    /// Figures from levels of light, with the black level if it is known better than from them.
    ///
    /// # Errors
    /// [`TransferError`].
    pub fn of(levels: &[Level], black_level_dn: Option<f64>) -> Result<Self, TransferError> {
        let transfer = PhotonTransfer::of(levels)?;
        let black_level_dn = black_level_dn.unwrap_or(transfer.dark_signal_dn);
        let saturation_dn = levels.iter().map(|l| l.bright.mean_dn).fold(0.0, f64::max);
        Ok(Self { transfer, black_level_dn, saturation_dn })
    }
}

impl CameraFigures {
    /// A rig with these figures instead of its file's.
    pub fn of_rig(&self, rig: &Rig) -> Rig {
        let mut rig = rig.clone();
        let camera = &mut rig.camera;
        if let Some(response) = self.codes.clone().and_then(CameraResponse::from_exposures) {
            let white_dn = f64::from(camera.white_dn());
            camera.codes_dn = Some(response.levels_dn(camera.black_level_dn, white_dn).into());
            // Nothing is known beyond the last code.
            camera.linear_limit_dn = camera.linear_limit_dn.min(white_dn);
        }
        if let Some(noise) = &self.noise {
            let PhotonTransfer { gain_dn_per_e, dark_noise_e, .. } = noise.transfer;
            (camera.gain_dn_per_e, camera.dark_noise_e) = (gain_dn_per_e, dark_noise_e);
            camera.black_level_dn = noise.black_level_dn;
            camera.full_well_e = (noise.saturation_dn - noise.black_level_dn) / gain_dn_per_e;
            camera.linear_limit_dn = camera.linear_limit_dn.min(noise.transfer.saturation_dn);
        }
        if let Some(range) = &self.linear_range {
            camera.linear_limit_dn = range.black_level_dn + USED * (range.end_dn - range.black_level_dn);
        }
        rig
    }

    /// Whether a file's figures are those of a camera.
    ///
    /// # Errors
    /// What is wrong and what to do.
    pub(super) fn check(&self) -> Result<(), &'static str> {
        let noise = self.noise.as_ref().is_none_or(|n| {
            let t = &n.transfer;
            [t.gain_dn_per_e, t.dark_noise_e, n.saturation_dn - n.black_level_dn].iter().all(|x| *x > 0.0)
        });
        let range = self.linear_range.as_ref().is_none_or(|r| r.end_dn > r.black_level_dn && r.slope_dn_per_s > 0.0);
        let codes = self.codes.clone().is_none_or(|codes| CameraResponse::from_exposures(codes).is_some());
        if !codes {
            return Err("`codes` are not 256 rising exposures: calibrate again");
        }
        if noise && range { Ok(()) } else { Err("gain, dark noise or range is not positive: calibrate again") }
    }
}

/// Gain, dark noise, black level, saturation, linear range and single pixels of the camera: pairs of frames of the evenly lit
/// gray card from darkness to saturation, and stacks of frames of the black trap.
///
/// # Errors
/// [`CalibrateError`].
pub fn noise(rig: &Rig, bench: &mut dyn Bench) -> Result<(CameraFigures, SensorMaps), CalibrateError> {
    let maps = dark_maps(rig, bench)?;
    let zone = Crop::of_zone(rig);
    let mut black: Vec<f32> = (0..zone.len()).map(|p| maps.black_dn[index(&maps, zone, p)]).collect();
    black.sort_by(f32::total_cmp);
    let (levels, range) = series(rig, bench)?;
    let noise = NoiseFigures::of(&levels, Some(f64::from(black[black.len() / 2])))?;
    Ok((CameraFigures { noise: Some(noise), linear_range: Some(range), codes: None }, maps))
}

/// The linear range alone.
///
/// # Errors
/// [`CalibrateError`].
pub fn linearity(rig: &Rig, bench: &mut dyn Bench) -> Result<LinearRange, CalibrateError> {
    Ok(series(rig, bench)?.1)
}

fn index(maps: &SensorMaps, crop: Crop, p: usize) -> usize {
    let (column, row) = crop.sensor_pixel(p);
    row * maps.width + column
}

/// Black levels from the shortest exposure, hot pixels from a longer one too, over the zone; elsewhere the median.
fn dark_maps(rig: &Rig, bench: &mut dyn Bench) -> Result<SensorMaps, CalibrateError> {
    bench.place(Placement::BlackTrap)?;
    let (p, c) = (&rig.projector, &rig.camera);
    let black = Pattern::full(p.width_px, p.height_px, 0);
    let crop = Crop::of_zone(rig);
    let mut stack = |refreshes: f64| {
        let exposures_s = vec![refreshes / p.refresh_hz; MIN_STACK];
        let mut frames = Vec::with_capacity(MIN_STACK);
        let keep = &mut |_: usize, _: usize, taken: crate::capture::Taken| frames.push(taken.samples);
        capture_frames(rig, bench, std::slice::from_ref(&black), &exposures_s, crop, keep)?;
        let frames: Vec<&[u16]> = frames.iter().map(Vec::as_slice).collect();
        Ok::<_, CalibrateError>(DarkMaps::of(&frames, HOT_SIGMAS)?)
    };
    let (dark, longer) = (stack(1.0)?, stack(HOT_REFRESHES)?);
    let mut sorted = dark.black_level_dn.clone();
    sorted.sort_by(f32::total_cmp);
    let pixels = c.width_px * c.height_px;
    let mut maps =
        SensorMaps { width: c.width_px, black_dn: vec![sorted[sorted.len() / 2]; pixels], bad: vec![false; pixels] };
    for i in 0..crop.len() {
        let at = index(&maps, crop, i);
        maps.black_dn[at] = dark.black_level_dn[i];
        maps.bad[at] = dark.hot[i] || longer.hot[i];
    }
    Ok(maps)
}

/// Levels of light on the same pixels, ascending, and the linear range they show.
fn series(rig: &Rig, bench: &mut dyn Bench) -> Result<(Vec<Level>, LinearRange), CalibrateError> {
    bench.place(Placement::GrayCard)?;
    let (code, mut refreshes, pixels) = even_light(rig, bench)?;
    let mut attempt = 1;
    loop {
        let (levels, points) = levels(rig, bench, code, &steps(refreshes), &pixels)?;
        let deviation = if rig.camera.codes_dn.is_some() { DEVIATION_OF_CODES } else { DEVIATION };
        let range = LinearRange::of(&points, deviation)?;
        if range.ends || attempt == ATTEMPTS {
            return Ok((levels, range));
        }
        attempt += 1;
        refreshes *= 1.5;
    }
}

/// A code and the refresh periods in which it should saturate, and the pixels that get most equal light from it, the most equal
/// first.
fn even_light(rig: &Rig, bench: &mut dyn Bench) -> Result<(u8, f64, Vec<usize>), CalibrateError> {
    let (p, c) = (&rig.projector, &rig.camera);
    let patterns: Vec<Pattern> = CODES.iter().map(|&code| Pattern::full(p.width_px, p.height_px, code)).collect();
    let exposures_s = Plan::of_order(0).exposures_s(&Timing::of(rig));
    let images = capture_sequence(rig, bench, &patterns, &exposures_s, Crop::of_zone(rig))?;
    let range_e = (c.linear_limit_dn - c.black_level_dn) / c.gain_dn_per_e;
    let median = |rate: &[f32]| {
        let mut rates: Vec<f32> = rate.iter().copied().filter(|r| r.is_finite()).collect();
        rates.sort_by(f32::total_cmp);
        rates.get(rates.len() / 2).copied().filter(|r| *r > 0.0).ok_or(CalibrateError::DarkGrayCard)
    };
    let saturating = |rate: f32| range_e / f64::from(rate) * p.refresh_hz;
    let mut chosen = (CODES[0], 0, saturating(median(&images[0].rate)?));
    for (i, image) in images.iter().enumerate() {
        let refreshes = saturating(median(&image.rate)?);
        chosen = (CODES[i], i, refreshes);
        if refreshes >= FINE_ENOUGH {
            break;
        }
    }
    let (code, i, refreshes) = chosen;
    let rate = &images[i].rate;
    let middle = median(rate)?;
    let mut order: Vec<usize> = (0..rate.len()).filter(|&p| rate[p].is_finite()).collect();
    order.sort_by(|&a, &b| (rate[a] - middle).abs().total_cmp(&(rate[b] - middle).abs()));
    order.truncate(PIXELS.min(order.len() / 4));
    Ok((code, refreshes, order))
}

/// Exposures in refresh periods: a few short ones, even steps to near saturation, every one around it.
fn steps(saturating: f64) -> Vec<u32> {
    let upto = |share: f64| (share * saturating).round().max(1.0) as u32;
    let coarse = (upto(0.85) / 16).max(1) as usize;
    let mut all: Vec<u32> = vec![1, 2, 3];
    all.extend((1..upto(0.85)).step_by(coarse));
    all.extend((upto(0.85)..=upto(BEYOND)).step_by((saturating / 100.0).ceil() as usize));
    all.sort_unstable();
    all.dedup();
    all
}

/// Light, and mean value under it, DN.
type LightAndMean = (f64, f64);

/// A pair of frames under light and one of black frames for each exposure; and light and mean of the most equal pixels.
fn levels(
    rig: &Rig,
    bench: &mut dyn Bench,
    code: u8,
    refreshes: &[u32],
    pixels: &[usize],
) -> Result<(Vec<Level>, Vec<LightAndMean>), CalibrateError> {
    let p = &rig.projector;
    let patterns = [code, 0].map(|code| Pattern::full(p.width_px, p.height_px, code));
    let pairs = refreshes.iter().flat_map(|&n| [f64::from(n) / p.refresh_hz; 2]);
    let exposures_s: Vec<f64> = pairs.collect();
    let mut frames = vec![Vec::new(); 2 * exposures_s.len()];
    let mut lamp = vec![1.0; exposures_s.len()];
    capture_frames(rig, bench, &patterns, &exposures_s, Crop::of_zone(rig), &mut |i, j, taken| {
        frames[i * exposures_s.len() + j] = pixels.iter().map(|&p| taken.samples[p]).collect::<Vec<u16>>();
        if i == 0 {
            lamp[j] = taken.light;
        }
    })?;
    let lamp = drift(&lamp);
    let pair = |at: usize| PairMoments::of(&frames[at], &frames[at + 1]);
    let equal = EQUAL.min(pixels.len() / 4).max(2);
    (0..refreshes.len())
        .map(|n| {
            let light = exposures_s[2 * n] * (lamp[2 * n] + lamp[2 * n + 1]) / 2.0;
            let point = PairMoments::of(&frames[2 * n][..equal], &frames[2 * n + 1][..equal])?.mean_dn;
            let level = Level { light, bright: pair(2 * n)?, dark: pair(exposures_s.len() + 2 * n)? };
            Ok((level, (light, point)))
        })
        .collect::<Result<Vec<_>, CalibrateError>>()
        .map(|all| all.into_iter().unzip())
}

/// The line through the lamp's light from frame to frame: what a single frame says of it would bend the response.
fn drift(light: &[f64]) -> Vec<f64> {
    let n = light.len() as f64;
    let middle = (n - 1.0) / 2.0;
    let mean = light.iter().sum::<f64>() / n;
    let (mut rise, mut run) = (0.0, 0.0);
    for (i, l) in light.iter().enumerate() {
        let x = i as f64 - middle;
        rise += x * (l - mean);
        run += x * x;
    }
    let slope = if run > 0.0 { rise / run } else { 0.0 };
    (0..light.len()).map(|i| mean + slope * (i as f64 - middle)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drift_is_kept_and_its_noise_is_not() {
        let line = [1.0, 1.01, 1.02, 1.03];
        drift(&line).iter().zip(line).for_each(|(got, want)| assert!((got - want).abs() < 1e-12));
        let noisy = drift(&[1.0, 1.02, 1.0, 1.02, 1.0]);
        assert!(noisy.iter().all(|l| (l - 1.008).abs() < 1e-12), "{noisy:?}");
    }

    #[test]
    fn steps_are_fine_about_saturation() {
        let all = steps(80.0);
        assert!(all.is_sorted() && all[0] == 1 && all.len() < 60, "{all:?}");
        assert!((68..=92).all(|n| all.contains(&n)), "{all:?}");
    }
}
