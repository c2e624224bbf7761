//! The sensor's figures from its noise: photon transfer after EMVA Standard 1288.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Why frames do not give a sensor's figures.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum TransferError {
    /// A pair's frames differ in size or hold too little.
    #[error("frames of {first} and {second} pixels are no pair: take both with the same region, 2 pixels or more")]
    Pair {
        /// Pixels of the first frame.
        first: usize,
        /// Pixels of the second frame.
        second: usize,
    },
    /// Too few levels below saturation.
    #[error(
        "{usable} levels of light lie below saturation (5% to 95% for linearity, up to 70% for the gain), 3 are needed: take more"
    )]
    Levels {
        /// Usable levels.
        usable: usize,
    },
    /// Noise does not grow with the signal.
    #[error(
        "noise does not grow with the signal (gain {gain_dn_per_e} DN/e-): is the light steady and the gain fixed?"
    )]
    Gain {
        /// Fitted gain, DN/e-.
        gain_dn_per_e: f64,
    },
    /// Too few frames for maps.
    #[error("{frames} frames of darkness are too few for a map, take {} or more of the same size", MIN_STACK)]
    Stack {
        /// Frames given, of the size of the first.
        frames: usize,
    },
}

/// Frames a stack needs, so that its noise does not pass for differences between pixels.
pub const MIN_STACK: usize = 16;
/// Part of the saturation level over which gain and responsivity are fitted (EMVA 1288, release 3.1, section 6).
const FIT_UPTO: f64 = 0.7;
/// Parts of the saturation level between which linearity is judged (the same, section 6.7).
const LINEAR: [f64; 2] = [0.05, 0.95];
/// Variance in darkness below which quantisation hides the dark noise, DN^2 (the same, section 6.6).
const HIDDEN_DN2: f64 = 0.24;
/// Variance of rounding, DN^2.
const QUANTISATION_DN2: f64 = 1.0 / 12.0;

/// Mean and temporal variance of two frames taken alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairMoments {
    /// Mean over pixels and frames, DN.
    pub mean_dn: f64,
    /// Temporal variance of one frame, from the difference of both, so that the pixels' own differences cancel, DN^2.
    pub variance_dn2: f64,
}

impl PairMoments {
    /// Moments of a pair.
    ///
    /// # Errors
    /// [`TransferError::Pair`].
    pub fn of(first: &[u16], second: &[u16]) -> Result<Self, TransferError> {
        if first.len() != second.len() || first.len() < 2 {
            return Err(TransferError::Pair { first: first.len(), second: second.len() });
        }
        let n = first.len() as f64;
        let (mut sum, mut difference, mut square) = (0u64, 0i64, 0u64);
        for (&a, &b) in first.iter().zip(second) {
            let d = i64::from(a) - i64::from(b);
            sum += u64::from(a) + u64::from(b);
            difference += d;
            square += (d * d) as u64;
        }
        let drift = difference as f64 / n;
        Ok(Self { mean_dn: 0.5 * sum as f64 / n, variance_dn2: 0.5 * (square as f64 / n - drift * drift) })
    }
}

/// A pair under light and one in darkness with the same exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// Light of one pixel in one exposure, in any linear unit: photons, or seconds under steady light.
    pub light: f64,
    /// Under light.
    pub bright: PairMoments,
    /// In darkness.
    pub dark: PairMoments,
}

/// The figures of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhotonTransfer {
    /// Conversion gain K.
    pub gain_dn_per_e: f64,
    /// Signal for one unit of light; over the gain it is the quantum efficiency if light is counted in photons.
    pub responsivity_dn: f64,
    /// Mean value in darkness at the shortest exposure.
    pub dark_signal_dn: f64,
    /// Temporal dark noise at the shortest exposure, quantisation taken out.
    pub dark_noise_e: f64,
    /// Quantisation hides the dark noise (variance below 0.24 DN^2): the figure is then no more than a bound, 0.4 DN.
    pub dark_noise_hidden: bool,
    /// Mean value of the level with the most noise, from where on wells are full.
    pub saturation_dn: f64,
    /// Electrons at that level by its light, as the fitted responsivity counts them.
    pub saturation_e: f64,
    /// LE: mean deviation from a straight line between 5% and 95% of saturation, relative.
    pub linearity_error_rel: f64,
}

impl PhotonTransfer {
    /// Figures from levels in any order: EMVA Standard 1288, release 3.1, sections 6.6 and 6.7.
    ///
    /// Gain: slope of the variance over the mean; responsivity: slope of the mean over the light; both above darkness,
    /// through the origin, up to 70% of saturation.
    ///
    /// # Errors
    /// [`TransferError::Levels`], [`TransferError::Gain`].
    pub fn of(levels: &[Level]) -> Result<Self, TransferError> {
        let signal = |l: &Level| l.bright.mean_dn - l.dark.mean_dn;
        let noisiest = levels.iter().max_by(|a, b| a.bright.variance_dn2.total_cmp(&b.bright.variance_dn2));
        let darkest = levels.iter().min_by(|a, b| a.light.total_cmp(&b.light));
        let (Some(full), Some(shortest)) = (noisiest, darkest) else { return Err(TransferError::Levels { usable: 0 }) };
        let upto = |share: f64| move |l: &&Level| signal(l) > 0.0 && l.light > 0.0 && signal(l) <= share * signal(full);
        let fitted: Vec<&Level> = levels.iter().filter(upto(FIT_UPTO)).collect();
        if fitted.len() < 3 {
            return Err(TransferError::Levels { usable: fitted.len() });
        }
        let slope = |x: &dyn Fn(&Level) -> f64, y: &dyn Fn(&Level) -> f64| {
            fitted.iter().map(|l| x(l) * y(l)).sum::<f64>() / fitted.iter().map(|l| x(l) * x(l)).sum::<f64>()
        };
        let gain = slope(&signal, &|l| l.bright.variance_dn2 - l.dark.variance_dn2);
        let responsivity = slope(&|l| l.light, &signal);
        // Written so that NaN fails.
        if !(gain > 0.0 && gain.is_finite()) {
            return Err(TransferError::Gain { gain_dn_per_e: gain });
        }
        let hidden = shortest.dark.variance_dn2 < HIDDEN_DN2;
        let dark_dn2 = shortest.dark.variance_dn2.max(HIDDEN_DN2) - QUANTISATION_DN2;
        let judged: Vec<(f64, f64)> = levels
            .iter()
            .filter(upto(LINEAR[1]))
            .filter(|l| signal(l) >= LINEAR[0] * signal(full))
            .map(|l| (l.light, signal(l)))
            .collect();
        if judged.len() < 3 {
            return Err(TransferError::Levels { usable: judged.len() });
        }
        let [offset, slope] = relative_line(&judged);
        let deviation = |(light, y): &(f64, f64)| (y / (offset + slope * light) - 1.0).abs();
        Ok(Self {
            gain_dn_per_e: gain,
            responsivity_dn: responsivity,
            dark_signal_dn: shortest.dark.mean_dn,
            dark_noise_e: dark_dn2.sqrt() / gain,
            dark_noise_hidden: hidden,
            saturation_dn: full.bright.mean_dn,
            saturation_e: responsivity * full.light / gain,
            linearity_error_rel: judged.iter().map(deviation).sum::<f64>() / judged.len() as f64,
        })
    }
}

/// Offset and slope of the line through (x, y > 0) with the least sum of squared *relative* deviations.
pub(super) fn relative_line(points: &[(f64, f64)]) -> [f64; 2] {
    let weight = |y: f64| 1.0 / (y * y);
    let total: f64 = points.iter().map(|p| weight(p.1)).sum();
    let mean = |f: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(|p| weight(p.1) * f(p)).sum::<f64>() / total;
    let (x, y) = (mean(&|p| p.0), mean(&|p| p.1));
    let slope = mean(&|p| (p.0 - x) * (p.1 - y)) / mean(&|p| (p.0 - x).powi(2));
    [y - slope * x, slope]
}

/// Mean and temporal variance of every pixel of a stack, and what the spread of the means holds beyond noise.
struct Stack {
    means: Vec<f64>,
    mean: f64,
    /// Mean temporal variance of one frame.
    temporal: f64,
    /// Variance between pixels, temporal noise taken out: may come out below zero.
    spatial: f64,
}

impl Stack {
    fn of(frames: &[&[u16]]) -> Result<Self, TransferError> {
        let pixels = frames.first().map_or(0, |f| f.len());
        let alike = frames.iter().filter(|f| f.len() == pixels && pixels > 1).count();
        if alike < MIN_STACK || alike < frames.len() {
            return Err(TransferError::Stack { frames: alike });
        }
        let (l, n) = (frames.len() as f64, pixels as f64);
        let (mut sums, mut squares) = (vec![0u64; pixels], vec![0u64; pixels]);
        for frame in frames {
            for ((sum, square), &dn) in sums.iter_mut().zip(&mut squares).zip(*frame) {
                *sum += u64::from(dn);
                *square += u64::from(dn) * u64::from(dn);
            }
        }
        let means: Vec<f64> = sums.iter().map(|s| *s as f64 / l).collect();
        let within = |(m, s): (&f64, &u64)| (*s as f64 - l * m * m) / (l - 1.0);
        let temporal = means.iter().zip(&squares).map(within).sum::<f64>() / n;
        let mean = means.iter().sum::<f64>() / n;
        let spread = means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n - 1.0);
        Ok(Self { means, mean, temporal, spatial: spread - temporal / l })
    }
}

/// Differences between pixels that stay.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NonUniformity {
    /// DSNU: standard deviation of the dark signal between pixels.
    pub dsnu_e: f64,
    /// PRNU: relative standard deviation of the response between pixels. Uneven light counts as theirs.
    pub prnu_rel: f64,
}

impl NonUniformity {
    /// From stacks of [`MIN_STACK`] frames and more in darkness and near half of saturation, both with the same exposure
    /// (EMVA 1288, section 8.2; without its high-pass filter).
    ///
    /// # Errors
    /// [`TransferError::Stack`].
    pub fn of(dark: &[&[u16]], bright: &[&[u16]], gain_dn_per_e: f64) -> Result<Self, TransferError> {
        let (dark, bright) = (Stack::of(dark)?, Stack::of(bright)?);
        Ok(Self {
            dsnu_e: dark.spatial.max(0.0).sqrt() / gain_dn_per_e,
            prnu_rel: (bright.spatial - dark.spatial).max(0.0).sqrt() / (bright.mean - dark.mean),
        })
    }
}

/// Every pixel in darkness.
#[derive(Debug, Clone, PartialEq)]
pub struct DarkMaps {
    /// Mean value in darkness, DN.
    pub black_level_dn: Vec<f32>,
    /// Pixels far from the others.
    pub hot: Vec<bool>,
}

impl DarkMaps {
    /// From [`MIN_STACK`] dark frames and more. A pixel is hot whose mean differs from the median pixel by more than `sigmas`
    /// standard deviations of all pixels, found from their quartiles, which hot pixels do not move; noise left in the means
    /// is the least that counts as one.
    ///
    /// # Errors
    /// [`TransferError::Stack`].
    pub fn of(frames: &[&[u16]], sigmas: f64) -> Result<Self, TransferError> {
        /// Quartiles of a normal law, apart, in standard deviations.
        const QUARTILES_APART: f64 = 1.349;
        let stack = Stack::of(frames)?;
        let mut sorted = stack.means.clone();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
        let noise = (stack.temporal / frames.len() as f64).sqrt();
        let sigma = ((at(0.75) - at(0.25)) / QUARTILES_APART).max(noise);
        let median = at(0.5);
        Ok(Self {
            hot: stack.means.iter().map(|m| (m - median).abs() > sigmas * sigma).collect(),
            black_level_dn: stack.means.iter().map(|m| *m as f32).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal, Poisson};
    use rand_xoshiro::Xoshiro256PlusPlus;

    const GAIN: f64 = 0.28;
    const DARK_NOISE_E: f64 = 10.9;
    const BLACK_DN: f64 = 14.7;
    const WELL_E: f64 = 14_000.0;
    const EFFICIENCY: f64 = 0.45;
    const DSNU_E: f64 = 6.0;
    const PRNU: f64 = 0.012;
    const PIXELS: usize = 40_000;

    /// A sensor whose pixels differ.
    struct Synthetic {
        rng: Xoshiro256PlusPlus,
        offset_e: Vec<f64>,
        response: Vec<f64>,
    }

    impl Synthetic {
        fn new() -> Self {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(1288);
            let mut spread = |mean: f64, sigma: f64| -> Vec<f64> {
                (0..PIXELS).map(|_| Normal::new(mean, sigma).unwrap().sample(&mut rng)).collect()
            };
            let (offset_e, response) = (spread(0.0, DSNU_E), spread(1.0, PRNU));
            Self { rng, offset_e, response }
        }

        fn frame(&mut self, photons: f64) -> Vec<u16> {
            let dark = Normal::new(0.0, DARK_NOISE_E).unwrap();
            let pixels = self.offset_e.iter().zip(&self.response);
            let sample = |(offset, response): (&f64, &f64)| {
                let mean = EFFICIENCY * photons * response;
                let shot = if mean > 0.0 { Poisson::new(mean).unwrap().sample(&mut self.rng) } else { 0.0 };
                let electrons = (shot + offset + dark.sample(&mut self.rng)).min(WELL_E);
                (BLACK_DN + GAIN * electrons).round().clamp(0.0, 4095.0) as u16
            };
            pixels.map(sample).collect()
        }

        fn pair(&mut self, photons: f64) -> PairMoments {
            PairMoments::of(&self.frame(photons), &self.frame(photons)).unwrap()
        }
    }

    #[test]
    fn a_synthetic_sensor_is_found_again() {
        let mut sensor = Synthetic::new();
        let levels: Vec<Level> = (1..=20)
            .map(|i| {
                let light = 1750.0 * f64::from(i);
                Level { light, bright: sensor.pair(light), dark: sensor.pair(0.0) }
            })
            .collect();
        let got = PhotonTransfer::of(&levels).unwrap();
        let near = |got: f64, want: f64, share: f64| assert!((got / want - 1.0).abs() < share, "{got} for {want}");
        // A variance of 40,000 differences is known to 0.7%; a dozen levels are fitted.
        near(got.gain_dn_per_e, GAIN, 0.005);
        near(got.responsivity_dn, GAIN * EFFICIENCY, 1e-3);
        near(got.dark_noise_e, DARK_NOISE_E, 0.01);
        assert!(!got.dark_noise_hidden);
        assert!((got.dark_signal_dn - BLACK_DN).abs() < 0.05);
        // To one step of light.
        near(got.saturation_e, WELL_E, 0.05);
        assert!(got.linearity_error_rel < 1e-3, "{got:?}");
        let text = serde_json::to_string(&got).unwrap();
        assert_eq!(serde_json::from_str::<PhotonTransfer>(&text).unwrap(), got);
    }

    #[test]
    fn a_bent_response_has_its_linearity_error() {
        let moments = |mean_dn: f64| PairMoments { mean_dn: 10.0 + mean_dn, variance_dn2: 1.0 + 0.3 * mean_dn };
        let dark = moments(0.0);
        let levels = |bend: f64| -> Vec<Level> {
            (1..=50)
                .map(|i| {
                    let light = 20.0 * f64::from(i);
                    Level { light, bright: moments(2.0 * light * (1.0 - bend * light / 1000.0)), dark }
                })
                .collect()
        };
        let error = |bend: f64| PhotonTransfer::of(&levels(bend)).unwrap().linearity_error_rel;
        assert!(error(0.0) < 1e-12);
        assert!((error(0.02) / error(0.01) - 2.0).abs() < 0.05);
        assert!((0.0005..0.002).contains(&error(0.01)), "{}", error(0.01));
    }

    #[test]
    fn quantisation_that_hides_the_dark_noise_is_told() {
        let moments = |mean_dn: f64| PairMoments { mean_dn, variance_dn2: 0.1 + 0.01 * mean_dn };
        let level = |i: u32| Level { light: f64::from(i), bright: moments(10.0 * f64::from(i)), dark: moments(0.0) };
        let got = PhotonTransfer::of(&(1..20).map(level).collect::<Vec<_>>()).unwrap();
        assert!(got.dark_noise_hidden);
        assert!((got.dark_noise_e * got.gain_dn_per_e - 0.4).abs() < 0.01);
    }

    #[test]
    fn stacks_show_what_differs_between_pixels_and_which_are_hot() {
        let mut sensor = Synthetic::new();
        for p in (0..PIXELS).step_by(1000) {
            sensor.offset_e[p] = 400.0;
        }
        let dark: Vec<_> = (0..MIN_STACK).map(|_| sensor.frame(0.0)).collect();
        let dark: Vec<&[u16]> = dark.iter().map(Vec::as_slice).collect();
        let maps = DarkMaps::of(&dark, 8.0).unwrap();
        let found: Vec<usize> = (0..PIXELS).filter(|&p| maps.hot[p]).collect();
        assert_eq!(found, (0..PIXELS).step_by(1000).collect::<Vec<_>>());
        assert!((f64::from(maps.black_level_dn[1000]) - (BLACK_DN + GAIN * 400.0)).abs() < 4.0);

        let mut sensor = Synthetic::new();
        let mut stack = |photons: f64| (0..MIN_STACK).map(|_| sensor.frame(photons)).collect::<Vec<_>>();
        let (dark, bright) = (stack(0.0), stack(0.5 * WELL_E / EFFICIENCY));
        let got = NonUniformity::of(
            &dark.iter().map(Vec::as_slice).collect::<Vec<_>>(),
            &bright.iter().map(Vec::as_slice).collect::<Vec<_>>(),
            GAIN,
        )
        .unwrap();
        assert!((got.dsnu_e / DSNU_E - 1.0).abs() < 0.03, "{got:?}");
        assert!((got.prnu_rel / PRNU - 1.0).abs() < 0.03, "{got:?}");
    }

    #[test]
    fn what_gives_no_figures_is_refused() {
        assert_eq!(PairMoments::of(&[1, 2, 3], &[1, 2]), Err(TransferError::Pair { first: 3, second: 2 }));
        assert_eq!(PhotonTransfer::of(&[]), Err(TransferError::Levels { usable: 0 }));
        let dark = PairMoments { mean_dn: 1.0, variance_dn2: 2.0 };
        let steady =
            |i: u32| Level { light: f64::from(i), bright: PairMoments { mean_dn: 9.0 * f64::from(i), ..dark }, dark };
        let mut levels: Vec<Level> = (1..9).map(steady).collect();
        levels[7].bright.variance_dn2 = 2.5;
        assert_eq!(PhotonTransfer::of(&levels), Err(TransferError::Gain { gain_dn_per_e: 0.0 }));
        assert_eq!(DarkMaps::of(&[&[1, 2], &[1, 2]], 5.0), Err(TransferError::Stack { frames: 2 }));
    }
}
