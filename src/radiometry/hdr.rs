//! The HDR estimate: several exposures of a pixel become one signed rate with its variance.

use rayon::prelude::*;

use super::censored::Cut;

/// What the estimate must know of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensor {
    /// Conversion gain, DN per electron.
    pub gain_dn_per_e: f64,
    /// Temporal dark noise, electrons.
    pub dark_noise_e: f64,
    /// Mean value in darkness, DN.
    pub black_level_dn: f64,
    /// Samples at or above this value are saturated, DN.
    pub limit_dn: f64,
}

/// A merged pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Signed rate, electrons per second.
    pub rate: f64,
    /// Variance of the rate, (electrons per second)^2.
    pub variance: f64,
}

/// Rows of a larger image: row `v` of a crop begins at `values[v * stride]`.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a, T> {
    /// From the crop's first pixel on.
    pub values: &'a [T],
    /// From the beginning of one row to that of the next.
    pub stride: usize,
}

impl<'a, T> Rows<'a, T> {
    fn part(&self, row: usize, from: usize, len: usize) -> &'a [T] {
        &self.values[row * self.stride + from..][..len]
    }
}

/// One frame of a bracket.
#[derive(Debug, Clone, Copy)]
pub struct ExposedRows<'a> {
    /// Samples, DN.
    pub samples: Rows<'a, u16>,
    /// Exposure, s.
    pub exposure_s: f64,
    /// Light relative to that of the rate sought: 1 unless the lamp drifts. It scales the signal, not what the sensor gives
    /// in darkness.
    pub light: f64,
}

/// What is known of single pixels, if anything. Maps cover the same pixels as the frames.
#[derive(Debug, Clone, Copy, Default)]
pub struct PixelMaps<'a> {
    /// Mean value in darkness, DN, instead of [`Sensor::black_level_dn`].
    pub black_level_dn: Option<Rows<'a, f32>>,
    /// Pixels that are not to be used: they come out as NaN.
    pub bad: Option<Rows<'a, bool>>,
}

/// Pixels done at once: their columns stay in the first cache.
const BLOCK: usize = 256;
/// Passes of reweighting. The second changes weights by less than noise does, the third nothing that counts.
const PASSES: usize = 3;
/// An exposure whose predicted sample is nearer to the limit, in standard errors, is treated as censored.
const NEAR: f64 = 5.0;
/// Newton steps at most towards the censored estimate; they approach it from below and double their digits.
const STEPS: usize = 6;
/// Steps shorter than this, in standard errors, are the last.
const CLOSE: f64 = 1e-3;
/// Share of the first-order bias that is taken out. With all of it exposures a factor 4 apart would end 0.14 standard
/// errors of the longer one too low above the limit; with this, errors on both sides of the limit are the same.
const SHARE_OF_BIAS: f64 = 0.85;

impl Sensor {
    /// Merges samples `(DN, exposure in s)` of one pixel, as [`Sensor::merge_into`] does. `None` if all are saturated.
    pub fn merge(&self, samples: impl Iterator<Item = (u16, f64)>) -> Option<Estimate> {
        let samples: Vec<([u16; 1], f64)> = samples.map(|(dn, t)| ([dn], t)).collect();
        let frames: Vec<_> = samples.iter().map(|(dn, t)| ExposedRows::steady(dn, 1, *t)).collect();
        let (mut rate, mut variance) = ([0.0], [0.0]);
        self.merge_into(1, &frames, &PixelMaps::default(), &mut rate, &mut variance);
        rate[0].is_finite().then(|| Estimate { rate: rate[0].into(), variance: variance[0].into() })
    }

    /// Merges a bracket into `rate` (signed, e-/s) and `variance` ((e-/s)^2), row by row, `width` pixels in each.
    ///
    /// Each linear, black-subtracted, *signed* sample weighs with the inverse of its variance (shot, dark and quantisation
    /// noise) at the merged estimate, found by iteration: weights from each sample's own value would favour samples that
    /// happen to be low (-2.9% at 100 e-/s). Samples at or above the limit say that they are, and no more. Where that
    /// matters, within 5 standard errors of an exposure's limit, the rate is the maximum of the likelihood of normal noise
    /// with censoring, less most of its bias (Cox and Snell 1968), and the variance the inverse of the expected information.
    /// Nothing can be known beyond the limit of the shortest exposure; samples below it are taken as they are.
    ///
    /// NaN where all samples are saturated and where a map says `bad`. Results do not depend on the number of threads.
    ///
    /// # Panics
    /// If `rate` and `variance` differ in length or are no whole rows, or if an image is too small.
    pub fn merge_into(
        &self,
        width: usize,
        frames: &[ExposedRows<'_>],
        maps: &PixelMaps<'_>,
        rate: &mut [f32],
        variance: &mut [f32],
    ) {
        assert!(rate.len() == variance.len(), "{} rates, {} variances", rate.len(), variance.len());
        if rate.is_empty() {
            return;
        }
        assert!(width > 0 && rate.len().is_multiple_of(width), "{} pixels are no rows of {width}", rate.len());
        let bracket = Bracket::new(self, frames, maps);
        rate.par_chunks_mut(width).zip(variance.par_chunks_mut(width)).enumerate().for_each_init(
            || Columns::new(frames.len()),
            |columns, (row, (rate, variance))| {
                let blocks = rate.chunks_mut(BLOCK).zip(variance.chunks_mut(BLOCK)).enumerate();
                for (block, (rate, variance)) in blocks {
                    bracket.merge_block(columns, row, block * BLOCK, rate, variance);
                }
            },
        );
    }
}

impl<'a> ExposedRows<'a> {
    /// A frame under steady light.
    pub fn steady(samples: &'a [u16], stride: usize, exposure_s: f64) -> Self {
        Self { samples: Rows { values: samples, stride }, exposure_s, light: 1.0 }
    }
}

/// A bracket with the sensor's figures in electrons.
struct Bracket<'a> {
    frames: &'a [ExposedRows<'a>],
    maps: &'a PixelMaps<'a>,
    /// Electrons of each frame for a rate of one.
    seconds: Vec<f32>,
    shortest: f32,
    e_per_dn: f32,
    black_dn: f32,
    limit_dn: f32,
    /// Where rounding begins to give the limit.
    threshold_dn: f32,
    /// Variance in darkness: dark noise and quantisation, e-^2.
    floor: f32,
}

/// A block of pixels, all that its passes need: one column for each frame, or one alone.
struct Columns {
    electrons: Vec<[f32; BLOCK]>,
    /// Electrons for a rate of one; 0 if the sample is censored.
    seconds: Vec<[f32; BLOCK]>,
    black_dn: [f32; BLOCK],
    near: [bool; BLOCK],
}

impl Columns {
    fn new(frames: usize) -> Self {
        let column = vec![[0.0; BLOCK]; frames];
        Self { electrons: column.clone(), seconds: column, black_dn: [0.0; BLOCK], near: [false; BLOCK] }
    }
}

impl<'a> Bracket<'a> {
    fn new(sensor: &Sensor, frames: &'a [ExposedRows<'a>], maps: &'a PixelMaps<'a>) -> Self {
        let e_per_dn = 1.0 / sensor.gain_dn_per_e;
        let seconds: Vec<f32> = frames.iter().map(|f| (f.exposure_s * f.light) as f32).collect();
        Self {
            frames,
            maps,
            shortest: seconds.iter().copied().fold(f32::INFINITY, f32::min),
            seconds,
            e_per_dn: e_per_dn as f32,
            black_dn: sensor.black_level_dn as f32,
            limit_dn: sensor.limit_dn as f32,
            threshold_dn: (sensor.limit_dn.ceil() - 0.5) as f32,
            floor: (sensor.dark_noise_e * sensor.dark_noise_e + e_per_dn * e_per_dn / 12.0) as f32,
        }
    }

    /// Pixels `from..` of a row, as many as `rate` holds.
    fn merge_block(&self, columns: &mut Columns, row: usize, from: usize, rate: &mut [f32], variance: &mut [f32]) {
        let n = rate.len();
        match self.maps.black_level_dn {
            Some(map) => columns.black_dn[..n].copy_from_slice(map.part(row, from, n)),
            None => columns.black_dn[..n].fill(self.black_dn),
        }
        for (i, frame) in self.frames.iter().enumerate() {
            let samples = frame.samples.part(row, from, n).iter().zip(&columns.black_dn);
            let column = columns.electrons[i].iter_mut().zip(&mut columns.seconds[i]);
            for ((&dn, black), (electrons, seconds)) in samples.zip(column) {
                let dn = f32::from(dn);
                *electrons = (dn - black) * self.e_per_dn;
                *seconds = if dn < self.limit_dn { self.seconds[i] } else { 0.0 };
            }
        }
        self.merge_columns(columns, rate, variance);
        if columns.near[..n].contains(&true) {
            for p in (0..n).filter(|&p| columns.near[p]) {
                let merged = self.censored(columns, p, rate[p].into());
                (rate[p], variance[p]) = (merged.rate as f32, merged.variance as f32);
            }
        }
        if let Some(bad) = self.maps.bad {
            for (p, _) in bad.part(row, from, n).iter().enumerate().filter(|(_, bad)| **bad) {
                (rate[p], variance[p]) = (f32::NAN, f32::NAN);
            }
        }
    }

    /// Iterated weights over the samples that are seen, and which pixels have an exposure near its limit.
    fn merge_columns(&self, columns: &mut Columns, rate: &mut [f32], variance: &mut [f32]) {
        let n = rate.len();
        let (mut sum, mut information) = ([0.0f32; BLOCK], [0.0f32; BLOCK]);
        for pass in 0..=PASSES {
            sum.fill(0.0);
            information.fill(0.0);
            for (electrons, seconds) in columns.electrons.iter().zip(&columns.seconds) {
                for p in 0..n {
                    let (e, s) = (electrons[p], seconds[p]);
                    // Electrons over seconds is the Poisson estimate: a good start, and unbiased.
                    let weight =
                        if pass == 0 { (s > 0.0) as u8 as f32 } else { s / (rate[p].max(0.0) * s + self.floor) };
                    sum[p] += weight * e;
                    information[p] += weight * s;
                }
            }
            for ((rate, sum), information) in rate.iter_mut().zip(&sum).zip(&information) {
                *rate = sum / information;
            }
        }
        columns.near.fill(false);
        let near_squared = (NEAR * NEAR) as f32;
        for &s in self.seconds.iter().filter(|&&s| s > self.shortest) {
            for ((near, rate), black_dn) in columns.near.iter_mut().zip(rate.iter()).zip(&columns.black_dn) {
                let above = rate * s - (self.threshold_dn - black_dn) * self.e_per_dn;
                *near |= above * above < near_squared * (rate.max(0.0) * s + self.floor);
            }
        }
        for (variance, information) in variance.iter_mut().zip(&information) {
            *variance = if *information > 0.0 { 1.0 / information } else { f32::NAN };
        }
    }

    /// Maximum likelihood with censoring from the estimate of the samples that are seen, less most of its bias.
    fn censored(&self, columns: &Columns, p: usize, seen: f64) -> Estimate {
        let threshold = f64::from((self.threshold_dn - columns.black_dn[p]) * self.e_per_dn);
        // Per sample: electrons for a rate of one, electrons, whether they are seen, whether censoring counts at all.
        let samples = || {
            let columns = columns.electrons.iter().zip(&columns.seconds);
            self.seconds
                .iter()
                .zip(columns)
                .map(move |(&s, (e, seen))| (f64::from(s), f64::from(e[p]), seen[p] > 0.0, s > self.shortest))
        };
        let sigma = |rate: f64, s: f64| (rate.max(0.0) * s + f64::from(self.floor)).sqrt();
        let mut rate = seen;
        for _ in 0..STEPS {
            let (mut score, mut slope) = (0.0, 0.0);
            for (s, e, seen, _) in samples() {
                let sigma = sigma(rate, s);
                if seen {
                    score += s * (e - rate * s) / (sigma * sigma);
                    slope += s * s / (sigma * sigma);
                } else {
                    let cut = Cut::at((rate * s - threshold) / sigma);
                    score += s / sigma * cut.hazard;
                    slope += s * s / (sigma * sigma) * cut.curvature;
                }
            }
            rate += score / slope;
            if score * score < CLOSE * CLOSE * slope {
                break;
            }
        }
        let (mut information, mut skew) = (0.0, 0.0);
        for (s, _, seen, cuts) in samples() {
            let unit = s / sigma(rate, s);
            if cuts {
                let cut = Cut::at((rate * s - threshold) * unit / s);
                information += unit * unit * cut.information;
                skew += unit * unit * unit * cut.skew;
            } else if seen {
                information += unit * unit;
            }
        }
        Estimate { rate: rate - SHARE_OF_BIAS * skew / (information * information), variance: 1.0 / information }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CCD: Sensor = Sensor { gain_dn_per_e: 0.28, dark_noise_e: 10.9, black_level_dn: 14.7, limit_dn: 3850.0 };
    /// Of f32 sums over a few samples.
    const ROUNDING: f64 = 1e-6;

    #[test]
    fn exact_samples_give_the_exact_rate_and_saturated_ones_alone_none() {
        let dn = |rate: f64, t: f64| (14.7 + 0.28 * rate * t).min(4095.0).round() as u16;
        for rate in [-200.0, 0.0, 1e3, 2.5e4, 4e5] {
            let stack = [1.0 / 60.0, 4.0 / 60.0, 16.0 / 60.0].map(|t| (dn(rate, t), t));
            let got = CCD.merge(stack.iter().copied()).unwrap();
            let step = 0.5 / 0.28 * 60.0; // half a quantisation step of the shortest exposure
            assert!((got.rate - rate).abs() < step, "{rate}: {got:?}");
            assert!((got.rate - rate).abs() < 4.0 * got.variance.sqrt());
        }
        assert_eq!(CCD.merge([(4095, 0.1), (3900, 0.02)].into_iter()), None);
        assert_eq!(CCD.merge(std::iter::empty()), None);
    }

    /// Variance is the inverse of the Fisher information of the unsaturated samples: by hand for one exposure.
    #[test]
    fn variance_of_one_exposure_is_shot_plus_dark_plus_quantisation() {
        let got = CCD.merge([(294u16, 0.1)].into_iter()).unwrap();
        let electrons = (294.0 - 14.7) / 0.28;
        let want = (electrons + 10.9 * 10.9 + 1.0 / (12.0 * 0.28 * 0.28)) / 0.01;
        assert!((got.variance / want - 1.0).abs() < ROUNDING);
    }

    /// A saturated sample lifts an estimate that would leave it dark, and says nothing to one that is brighter anyway.
    #[test]
    fn a_censored_sample_counts_where_it_says_something() {
        let with = |short: u16| CCD.merge([(short, 0.01), (4095, 0.04)].into_iter()).unwrap();
        let alone = |short: u16| CCD.merge([(short, 0.01)].into_iter()).unwrap();
        assert!(with(950).rate > alone(950).rate + 0.5 * alone(950).variance.sqrt());
        assert!(with(950).variance < 0.5 * alone(950).variance);
        assert_eq!(with(1600), alone(1600));
    }

    #[test]
    fn light_scales_the_signal_and_not_the_darkness() {
        let samples = [394u16];
        let frame = ExposedRows { light: 1.01, ..ExposedRows::steady(&samples, 1, 0.1) };
        let (mut rate, mut variance) = ([0.0], [0.0]);
        CCD.merge_into(1, &[frame], &PixelMaps::default(), &mut rate, &mut variance);
        let steady = CCD.merge([(394u16, 0.1)].into_iter()).unwrap();
        assert!((f64::from(rate[0]) * 1.01 / steady.rate - 1.0).abs() < ROUNDING);
        assert!((f64::from(variance[0]) * 1.01 * 1.01 / steady.variance - 1.0).abs() < ROUNDING);
    }

    /// A crop of a larger image with maps: each pixel as if it were merged alone with its own black level.
    #[test]
    fn crops_and_maps_are_merged_pixel_by_pixel() {
        let (stride, width, height, first) = (700, 600, 5, 60);
        let image = |k: usize| -> Vec<u16> {
            (0..stride * 8).map(|p| ((p * 7919 + k * 104_729) % 4096 * [1, 4, 16][k] / 16).min(4095) as u16).collect()
        };
        let images = [image(0), image(1), image(2)];
        let times = [1.0 / 60.0, 4.0 / 60.0, 16.0 / 60.0];
        let black: Vec<f32> = (0..stride * 8).map(|p| 10.0 + (p % 13) as f32).collect();
        let bad: Vec<bool> = (0..stride * 8).map(|p| p % 101 == 0).collect();
        let frames: Vec<_> =
            images.iter().zip(times).map(|(i, t)| ExposedRows::steady(&i[first..], stride, t)).collect();
        let maps = PixelMaps {
            black_level_dn: Some(Rows { values: &black[first..], stride }),
            bad: Some(Rows { values: &bad[first..], stride }),
        };
        let (mut rate, mut variance) = (vec![0.0; width * height], vec![0.0; width * height]);
        CCD.merge_into(width, &frames, &maps, &mut rate, &mut variance);
        for p in 0..width * height {
            let at = first + p / width * stride + p % width;
            if bad[at] {
                assert!(rate[p].is_nan() && variance[p].is_nan());
                continue;
            }
            let own = Sensor { black_level_dn: black[at].into(), ..CCD };
            let want = own.merge(images.iter().zip(times).map(|(i, t)| (i[at], t)));
            match want {
                Some(want) => assert_eq!((f64::from(rate[p]), f64::from(variance[p])), (want.rate, want.variance)),
                None => assert!(rate[p].is_nan() && variance[p].is_nan()),
            }
        }
    }
}
