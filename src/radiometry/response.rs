//! The projector's response: what a code adds to the light of a black frame.

use thiserror::Error;

/// Why measured levels are not a response curve.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum ResponseError {
    /// Too few points.
    #[error("a response needs codes from 0 to 255 in ascending order, at least 4 of them: measure it again")]
    Codes,
    /// The light does not grow with the code.
    #[error("white is not brighter than black ({black} to {white}): is the lamp on and the lens open?")]
    Flat {
        /// Level at code 0.
        black: f64,
        /// Level at code 255.
        white: f64,
    },
}

/// A monotone curve over 8-bit codes: light above black, 0 at code 0 and 1 at code 255.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    levels: Vec<f64>,
    contrast: f64,
}

impl Response {
    /// A curve through measured (code, light) points, codes ascending from 0 to 255, light in any linear unit.
    ///
    /// Between the points it is the monotone cubic of Fritsch and Carlson (1980); noise that makes points fall is
    /// flattened first.
    ///
    /// # Errors
    /// [`ResponseError`].
    pub fn from_points(points: &[(u8, f64)]) -> Result<Self, ResponseError> {
        let ascending = points.windows(2).all(|p| p[0].0 < p[1].0);
        let (Some(first), Some(last)) = (points.first(), points.last()) else { return Err(ResponseError::Codes) };
        if !ascending || points.len() < 4 || first.0 != 0 || last.0 != 255 {
            return Err(ResponseError::Codes);
        }
        let (black, white) = (first.1, last.1);
        // Written so that NaN fails.
        if !(white.is_finite() && white > black) {
            return Err(ResponseError::Flat { black, white });
        }
        let mut highest = 0.0f64;
        let y: Vec<f64> = points
            .iter()
            .map(|p| {
                highest = highest.max((p.1 - black) / (white - black)).min(1.0);
                highest
            })
            .collect();
        let x: Vec<f64> = points.iter().map(|p| f64::from(p.0)).collect();
        Ok(Self { levels: monotone_cubic(&x, &y), contrast: white / black })
    }

    /// A curve from its 256 levels, as a calibration file keeps them.
    ///
    /// # Errors
    /// [`ResponseError`] unless there are 256 levels that rise from 0 to 1.
    pub fn from_levels(levels: Vec<f64>, contrast: f64) -> Result<Self, ResponseError> {
        let rising = levels.windows(2).all(|l| l[0] <= l[1]);
        match (levels.len(), levels.first(), levels.last()) {
            (256, Some(&0.0), Some(&1.0)) if rising => Ok(Self { levels, contrast }),
            _ => Err(ResponseError::Codes),
        }
    }

    /// A response that is proportional to the code: an ideal projector without black light.
    pub fn linear() -> Self {
        Self { levels: (0..256).map(|c| f64::from(c) / 255.0).collect(), contrast: f64::INFINITY }
    }

    /// Light of a white frame over that of a black one.
    pub fn contrast(&self) -> f64 {
        self.contrast
    }

    /// Light above black of a code, 0..=1.
    pub fn level(&self, code: u8) -> f64 {
        self.levels[usize::from(code)]
    }

    /// The code whose light above black is nearest to `level`, which is clamped to 0..=1.
    pub fn code(&self, level: f64) -> u8 {
        let above = self.levels.partition_point(|&l| l < level).min(255);
        let below = above.saturating_sub(1);
        let nearest = if level - self.levels[below] < self.levels[above] - level { below } else { above };
        nearest as u8
    }
}

/// Values at 0..=255 of the monotone piecewise cubic through (x, y).
fn monotone_cubic(x: &[f64], y: &[f64]) -> Vec<f64> {
    let n = x.len();
    let secant: Vec<f64> = (0..n - 1).map(|i| (y[i + 1] - y[i]) / (x[i + 1] - x[i])).collect();
    let mut slope: Vec<f64> = (0..n)
        .map(|i| match i {
            0 => secant[0],
            i if i == n - 1 => secant[n - 2],
            i if secant[i - 1] * secant[i] <= 0.0 => 0.0,
            i => 2.0 / (1.0 / secant[i - 1] + 1.0 / secant[i]),
        })
        .collect();
    for i in 0..n - 1 {
        let limit = 3.0 * secant[i];
        slope[i] = slope[i].min(limit);
        slope[i + 1] = slope[i + 1].min(limit);
    }
    (0..256)
        .map(|code| {
            let c = f64::from(code);
            let i = x.partition_point(|&x| x <= c).clamp(1, n - 1) - 1;
            let h = x[i + 1] - x[i];
            let t = (c - x[i]) / h;
            let (a, b) = (1.0 - t, t);
            a * a * (1.0 + 2.0 * b) * y[i]
                + b * b * (1.0 + 2.0 * a) * y[i + 1]
                + a * b * h * (a * slope[i] - b * slope[i + 1])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn power(c: f64) -> f64 {
        3.0 + 500.0 * (c / 255.0).powf(1.83)
    }

    #[test]
    fn a_power_law_is_recovered_between_its_points() {
        let points: Vec<_> = (0..=51).map(|i| (5 * i as u8, power(5.0 * f64::from(i)))).collect();
        let r = Response::from_points(&points).unwrap();
        for code in 0..=255u8 {
            let want = (power(f64::from(code)) - 3.0) / 500.0;
            assert!((r.level(code) - want).abs() < 2e-4, "{code}");
            assert_eq!(r.code(r.level(code)), code);
        }
        assert!((r.contrast() - 503.0 / 3.0).abs() < 1e-9);
    }

    #[test]
    fn curves_that_are_none_are_refused() {
        assert_eq!(Response::from_points(&[]).unwrap_err(), ResponseError::Codes);
        let flat = [(0, 1.0), (100, 1.0), (200, 1.0), (255, 1.0)];
        assert!(matches!(Response::from_points(&flat), Err(ResponseError::Flat { .. })));
        let nan = [(0, 1.0), (100, 2.0), (200, 3.0), (255, f64::NAN)];
        assert!(matches!(Response::from_points(&nan), Err(ResponseError::Flat { .. })));
    }

    proptest! {
        #[test]
        fn codes_are_the_nearest_and_curves_monotone(ys in proptest::collection::vec(0.0..10.0f64, 20), level in -0.5..1.5f64) {
            let points: Vec<_> = (0..20).map(|i| {
                let code = (i * 255 / 19) as u8;
                (code, if i == 0 { 0.0 } else if i == 19 { 10.0 } else { ys[i] })
            }).collect();
            let r = Response::from_points(&points).unwrap();
            for c in 1..=255u8 {
                prop_assert!(r.level(c) >= r.level(c - 1) - 1e-12);
            }
            let got = (r.level(r.code(level)) - level).abs();
            prop_assert!((0..=255u8).all(|c| (r.level(c) - level).abs() >= got - 1e-12));
        }
    }
}
