//! The response of a camera that is not linear: what exposure each 8-bit code stands for.

use std::ops::RangeInclusive;

use thiserror::Error;

use super::bounded::bounded_minimum;

/// Codes of a sample.
pub const CODES: usize = 256;
/// The code whose exposure is 1: the gauge, since a stack tells exposures only up to a factor.
pub const UNIT_CODE: usize = 128;

/// Why a stack shows no response.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum StackError {
    /// Images and exposures do not fit.
    #[error(
        "{images} images with {exposures} exposures are no stack: give at least two images of the same pixels, each with \
         its exposure in seconds above zero"
    )]
    Shape {
        /// Images given.
        images: usize,
        /// Exposures given.
        exposures: usize,
    },
    /// Hardly any pixel changes its code between exposures.
    #[error(
        "only {codes} codes between the ends of the usable range are seen, {MIN_CODES} are needed: take a scene with \
         shades, some of them between black and white in two images or more"
    )]
    Shades {
        /// Codes seen that are neither black nor white.
        codes: usize,
    },
    /// The equations have no single solution.
    #[error("the response is not determined: take exposures that differ, of a scene with more shades")]
    Undetermined,
}

/// Codes that must be seen.
const MIN_CODES: usize = 16;
/// Least step of ln(exposure) from one code to the next: what monotone means.
const MIN_STEP: f64 = 1e-4;
/// Pixels to which Debevec and Malik's smoothness refers; other numbers are scaled to it.
const USUAL_PIXELS: f64 = 70.0;
/// Passes of Robertson's estimate at most, and the relative change that ends them.
const PASSES: usize = 1000;
const SETTLED: f64 = 1e-6;
/// Part of their pixels that two images must share to tell their exposures' ratio.
const MIN_SHARED: f64 = 0.005;

/// Images of the same pixels with known exposures, one colour channel.
#[derive(Debug, Clone, Copy)]
pub struct Stack<'a> {
    images: &'a [&'a [u8]],
    exposures_s: &'a [f64],
    /// Codes that follow the light.
    usable: [usize; 2],
}

impl<'a> Stack<'a> {
    /// A stack of images, in any order. Codes outside of `usable` say nothing but that they are darker or brighter: film and
    /// scanners are black well above code 0. Give 0..=255 if nothing of the kind is known; the ends have next to no weight.
    ///
    /// # Errors
    /// [`StackError::Shape`], [`StackError::Shades`].
    pub fn new(images: &'a [&'a [u8]], exposures_s: &'a [f64], usable: RangeInclusive<u8>) -> Result<Self, StackError> {
        let usable = [usable.start(), usable.end()].map(|z| usize::from(*z));
        let alike = images.windows(2).all(|i| i[0].len() == i[1].len());
        let positive = exposures_s.iter().all(|t| t.is_finite() && *t > 0.0);
        if images.len() < 2 || images.len() != exposures_s.len() || !alike || !positive {
            return Err(StackError::Shape { images: images.len(), exposures: exposures_s.len() });
        }
        let mut seen = [false; CODES];
        images.iter().flat_map(|i| i.iter()).for_each(|&code| seen[usize::from(code)] = true);
        let codes = (usable[0] + 1..usable[1]).filter(|&z| seen[z]).count();
        if codes < MIN_CODES {
            return Err(StackError::Shades { codes });
        }
        Ok(Self { images, exposures_s, usable })
    }

    fn pixels(&self) -> usize {
        self.images[0].len()
    }

    /// Code and exposure of one pixel in every image.
    fn samples(&self, pixel: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.images.iter().zip(self.exposures_s).map(move |(image, t)| (usize::from(image[pixel]), *t))
    }
}

/// Exposure of every code, rising, relative to that of code 128.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraResponse {
    exposures: Vec<f64>,
}

impl CameraResponse {
    /// The curve of Debevec and Malik (1997): least squares of g(z) = ln E + ln t over pixels and images, with weights that
    /// fall to the ends of the range, and curvature held down by `smoothness` (lambda for 70 pixels, 10 is usual; more pixels
    /// do not change how smooth the curve is). Gauge g(128) = 0.
    ///
    /// Among all curves that rise by 1e-4 of ln(exposure) a code at least, this is the one that fits best; where noise or
    /// lack of data would make it fall it is that steep and no more.
    ///
    /// # Errors
    /// [`StackError::Undetermined`].
    pub fn debevec(stack: &Stack<'_>, smoothness: f64) -> Result<Self, StackError> {
        let [black, white] = stack.usable;
        let rise = |z: usize| (z + 1).saturating_sub(black).min((white + 1).saturating_sub(z)) as f64;
        let weight = |z: usize| (2.0 * rise(z) / (white - black + 1) as f64).powi(2);
        let mut hessian = nalgebra::DMatrix::<f64>::zeros(CODES, CODES);
        let mut target = nalgebra::DVector::<f64>::zeros(CODES);
        for pixel in 0..stack.pixels() {
            // The pixel's own ln E is the weighted mean of what its samples say: it is eliminated here.
            let sum = |f: &dyn Fn(f64) -> f64| stack.samples(pixel).map(|(z, t)| weight(z) * f(t)).sum::<f64>();
            let total = sum(&|_| 1.0);
            if total == 0.0 {
                continue;
            }
            let mean = sum(&f64::ln) / total;
            for (z, t) in stack.samples(pixel) {
                hessian[(z, z)] += weight(z);
                target[z] += weight(z) * (t.ln() - mean);
                for (other, _) in stack.samples(pixel) {
                    hessian[(z, other)] -= weight(z) * weight(other) / total;
                }
            }
        }
        let curvature = smoothness * smoothness * stack.pixels() as f64 / USUAL_PIXELS;
        for z in 1..CODES - 1 {
            // Codes that no sample weighs go on straight.
            let weight = weight(z).max(weight(black));
            let taps = [(z - 1, 1.0), (z, -2.0), (z + 1, 1.0)];
            for (i, a) in taps {
                for (j, b) in taps {
                    hessian[(i, j)] += curvature * weight * a * b;
                }
            }
        }
        // In steps from code to code, outwards from the gauge, rising is a bound for each unknown.
        let steps = nalgebra::DMatrix::from_fn(CODES, CODES - 1, |z, step| match step < UNIT_CODE {
            true => -f64::from(u8::from(z <= step)),
            false => f64::from(u8::from(z > step)),
        });
        let hessian = steps.transpose() * hessian * &steps;
        let target = steps.transpose() * target;
        let rise = bounded_minimum(&hessian, &target, MIN_STEP).ok_or(StackError::Undetermined)?;
        Ok(Self { exposures: (steps * rise).iter().map(|g| g.exp()).collect() })
    }

    /// The curve of Robertson, Borman and Stevenson (2003): in turn the pixels' light, weighed towards the middle of the range
    /// and by exposure, and each code's exposure as the mean over its samples, until nothing moves. Gauge 1 at code 128.
    ///
    /// Each mean curve is replaced by the nearest rising one (isotonic regression, weighed by samples), so that the result is
    /// the best rising curve. Codes that no sample has lie on the line between their neighbours; the ends of the usable codes
    /// stand for all that is darker and brighter, and from there on the curve goes on straight.
    ///
    /// # Errors
    /// [`StackError::Undetermined`].
    pub fn robertson(stack: &Stack<'_>) -> Result<Self, StackError> {
        let [black, white] = stack.usable;
        let edge = (-4.0f64).exp();
        let weight: Vec<f64> = (0..CODES)
            .map(|z| 2.0 * (z as f64 - black as f64) / (white - black) as f64 - 1.0)
            .map(|x| (((-4.0 * x * x).exp() - edge) / (1.0 - edge)).max(0.0))
            .collect();
        let mut exposures: Vec<f64> = (0..CODES).map(|z| z as f64 / UNIT_CODE as f64).collect();
        for _ in 0..PASSES {
            let (mut sums, mut counts) = ([0.0; CODES], [0.0; CODES]);
            for pixel in 0..stack.pixels() {
                let (mut light, mut total) = (0.0, 0.0);
                for (z, t) in stack.samples(pixel) {
                    light += weight[z] * t * exposures[z];
                    total += weight[z] * t * t;
                }
                // Black or white in all images: nothing is known of it.
                if total > 0.0 {
                    for (z, t) in stack.samples(pixel) {
                        sums[z] += t * light / total;
                        counts[z] += 1.0;
                    }
                }
            }
            let seen: Vec<usize> = (black + 1..white).filter(|&z| counts[z] > 0.0).collect();
            let rising = rising(&seen.iter().map(|&z| (sums[z] / counts[z], counts[z])).collect::<Vec<_>>());
            let next = filled(&seen, &rising).ok_or(StackError::Undetermined)?;
            let moved = next.iter().zip(&exposures).map(|(a, b)| (a - b).abs() / a.max(SETTLED)).fold(0.0, f64::max);
            exposures = next;
            if moved < SETTLED {
                break;
            }
        }
        Ok(Self { exposures })
    }

    /// A response from the exposures of all 256 codes; `None` if they do not rise or the first is below 0.
    pub fn from_exposures(exposures: Vec<f64>) -> Option<Self> {
        let rising = exposures.windows(2).all(|e| e[0] <= e[1]) && exposures.iter().all(|e| e.is_finite() && *e >= 0.0);
        (rising && exposures.len() == CODES && exposures[0] < exposures[CODES - 1]).then_some(Self { exposures })
    }

    /// Samples of a linear camera that mean the same: code 255 is `white_dn`, no light `black_dn`.
    pub fn levels_dn(&self, black_dn: f64, white_dn: f64) -> Vec<u16> {
        let white = self.exposures[CODES - 1];
        self.exposures.iter().map(|e| (black_dn + e / white * (white_dn - black_dn)).round() as u16).collect()
    }

    /// Exposure of a code, 1 for code 128.
    pub fn exposure(&self, code: u8) -> f64 {
        self.exposures[usize::from(code)]
    }

    /// Exposures of all 256 codes, none below the one before.
    pub fn exposures(&self) -> &[f64] {
        &self.exposures
    }

    /// The inverse: the code of an exposure, between codes as between their exposures; clamped to 0..=255.
    pub fn code(&self, exposure: f64) -> f64 {
        let above = self.exposures.partition_point(|&e| e < exposure);
        if above == 0 || above == CODES {
            return if above == 0 { 0.0 } else { (CODES - 1) as f64 };
        }
        let (low, high) = (self.exposures[above - 1], self.exposures[above]);
        (above - 1) as f64 + (exposure - low) / (high - low)
    }

    /// How many times more light `longer` received than `shorter`: the median over pixels whose codes lie in `usable` in both.
    /// `None` if fewer than 1 in 200 do, as with nearly black or white images: what little they share is glare and grain.
    pub fn exposure_ratio(&self, shorter: &[u8], longer: &[u8], usable: RangeInclusive<u8>) -> Option<f64> {
        let shared = shorter.iter().zip(longer).filter(|(a, b)| usable.contains(a) && usable.contains(b));
        let mut ratios: Vec<f64> = shared.map(|(a, b)| self.exposure(*b) / self.exposure(*a)).collect();
        ratios.sort_by(f64::total_cmp);
        (ratios.len() as f64 > MIN_SHARED * shorter.len() as f64).then(|| ratios[ratios.len() / 2])
    }
}

/// The rising sequence nearest to `(value, weight)`: neighbours that fall are pooled.
fn rising(points: &[(f64, f64)]) -> Vec<f64> {
    let mut pools: Vec<(f64, f64, usize)> = Vec::new();
    for &(value, weight) in points {
        pools.push((value, weight, 1));
        while let [.., a, b] = pools[..] {
            if a.0 <= b.0 {
                break;
            }
            pools.truncate(pools.len() - 2);
            pools.push(((a.0 * a.1 + b.0 * b.1) / (a.1 + b.1), a.1 + b.1, a.2 + b.2));
        }
    }
    pools.into_iter().flat_map(|(value, _, count)| std::iter::repeat_n(value, count)).collect()
}

/// All 256 values from those at some codes, 1 at the gauge. `None` unless at least two are known and the gauge is positive.
fn filled(codes: &[usize], values: &[f64]) -> Option<Vec<f64>> {
    if codes.len() < 2 {
        return None;
    }
    let at = |z: usize| {
        let right = codes.partition_point(|&c| c < z).clamp(1, codes.len() - 1);
        let (a, b) = (right - 1, right);
        let slope = (values[b] - values[a]) / (codes[b] - codes[a]) as f64;
        (values[a] + slope * (z as f64 - codes[a] as f64)).max(0.0)
    };
    let unit = at(UNIT_CODE);
    (unit > 0.0).then(|| (0..CODES).map(|z| at(z) / unit).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;

    type Curve = fn(f64) -> f64;

    /// Code of an exposure, before it is clipped at 255.
    fn power_law(x: f64) -> f64 {
        255.0 * x.powf(1.0 / 2.2)
    }

    fn power_law_inverse(code: f64) -> f64 {
        (code / 255.0).powf(2.2)
    }

    /// Where the shoulder of the film levels off. At 255 itself noise would be worth any exposure, which Robertson's weights
    /// do not know: errors of 17%.
    const FILM_WHITE: f64 = 300.0;

    /// As film: a toe and a shoulder, straight between them over the logarithm.
    fn s_curve(x: f64) -> f64 {
        FILM_WHITE / (1.0 + (0.15 / x).powf(1.3))
    }

    fn s_curve_inverse(code: f64) -> f64 {
        0.15 / (FILM_WHITE / code - 1.0).powf(1.0 / 1.3)
    }

    fn images(response: Curve, exposures: &[f64], pixels: usize) -> Vec<Vec<u8>> {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(1997);
        let light: Vec<f64> = (0..pixels).map(|_| (9.0 * (rng.random::<f64>() - 0.7)).exp()).collect();
        let mut code = |x: f64| {
            let noise: f64 = StandardNormal.sample(&mut rng);
            (response(x) + 0.5 * noise).round().clamp(0.0, 255.0) as u8
        };
        exposures.iter().map(|t| light.iter().map(|l| code(l * t)).collect()).collect()
    }

    /// Codes that are compared: beyond them few samples have weight.
    const JUDGED: RangeInclusive<u8> = 15..=240;

    /// Greatest relative error of exposures over [`JUDGED`] against a known inverse.
    fn worst(got: &CameraResponse, inverse: Curve) -> f64 {
        let want = |z: u8| inverse(f64::from(z)) / inverse(128.0);
        JUDGED.map(|z| (got.exposure(z) / want(z) - 1.0).abs()).fold(0.0, f64::max)
    }

    const EXPOSURES_S: [f64; 7] = [0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
    /// Noise of half a code and rounding; the smoothness of Debevec's curve rounds its ends.
    const DEBEVEC: f64 = 0.04;
    const ROBERTSON: f64 = 0.04;

    #[test]
    fn known_responses_are_recovered() {
        let cases: [[Curve; 2]; 2] = [[power_law, power_law_inverse], [s_curve, s_curve_inverse]];
        for [response, inverse] in cases {
            let images = images(response, &EXPOSURES_S, 3000);
            let images: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
            let stack = Stack::new(&images, &EXPOSURES_S, 0..=255).unwrap();
            let debevec = CameraResponse::debevec(&stack, 3.0).unwrap();
            let robertson = CameraResponse::robertson(&stack).unwrap();
            let errors = [worst(&debevec, inverse), worst(&robertson, inverse)];
            assert!(errors[0] < DEBEVEC && errors[1] < ROBERTSON, "{errors:?}");
            for got in [debevec, robertson] {
                assert_eq!(got.exposure(128), 1.0);
                assert!(got.exposures().windows(2).all(|e| e[0] <= e[1]));
                for code in JUDGED {
                    assert!((got.code(got.exposure(code)) - f64::from(code)).abs() < 1e-9);
                }
                let ratio = got.exposure_ratio(images[2], images[3], 20..=235).unwrap();
                assert!((ratio / 2.0 - 1.0).abs() < 0.01, "{ratio}");
            }
        }
    }

    /// With few pixels, much noise and hardly any smoothness the best curve would fall somewhere; the best rising one does not.
    #[test]
    fn noise_does_not_make_curves_fall() {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(3);
        let noisy: Vec<Vec<u8>> = images(power_law, &EXPOSURES_S, 60)
            .into_iter()
            .map(|i| i.into_iter().map(|z| z.saturating_add(rng.random_range(0..30))).collect())
            .collect();
        let noisy: Vec<&[u8]> = noisy.iter().map(Vec::as_slice).collect();
        let stack = Stack::new(&noisy, &EXPOSURES_S, 0..=255).unwrap();
        for got in [CameraResponse::debevec(&stack, 0.01).unwrap(), CameraResponse::robertson(&stack).unwrap()] {
            assert!(got.exposures().windows(2).all(|e| e[0] <= e[1]));
            assert!(got.exposures().windows(2).any(|e| e[1] < e[0] * (1.0 + 2.0 * MIN_STEP)), "nothing was held");
        }
    }

    #[test]
    fn what_is_no_stack_is_refused() {
        let (a, b) = ([10u8, 20, 30], [20u8, 40]);
        let shape = |images: &[&[u8]], exposures: &[f64]| Stack::new(images, exposures, 0..=255).unwrap_err();
        assert_eq!(shape(&[&a], &[1.0]), StackError::Shape { images: 1, exposures: 1 });
        assert_eq!(shape(&[&a, &b], &[1.0, 2.0]), StackError::Shape { images: 2, exposures: 2 });
        assert_eq!(shape(&[&a, &a], &[1.0, 0.0]), StackError::Shape { images: 2, exposures: 2 });
        assert_eq!(shape(&[&a, &a], &[1.0, 2.0]), StackError::Shades { codes: 3 });
        let dark = [0u8; 500];
        let response = CameraResponse { exposures: (0..CODES).map(|z| z as f64).collect() };
        assert_eq!(response.exposure_ratio(&dark, &dark, 20..=235), None);
    }

    proptest! {
        #[test]
        fn pooled_values_rise_and_keep_their_mean(values in proptest::collection::vec((-5.0..5.0f64, 0.1..9.0f64), 1..40)) {
            let got = rising(&values);
            prop_assert!(got.windows(2).all(|v| v[0] <= v[1] + 1e-12));
            let mean = |f: &dyn Fn(usize) -> f64| (0..values.len()).map(|i| values[i].1 * f(i)).sum::<f64>();
            prop_assert!((mean(&|i| got[i]) - mean(&|i| values[i].0)).abs() < 1e-9);
        }
    }
}
