//! Structured light: sinusoidal fringes of several periods, from which a camera pixel learns which projector pixel it sees.

use std::f64::consts::TAU;

use super::{Pattern, Primary};
use crate::radiometry::Response;

/// Period of the finest fringes, projector pixels: wide enough to survive the blur of a lens, narrow enough for 0.01 px.
const FINEST_PX: f64 = 16.0;
/// Ratio of neighbouring periods: a phase good to a twentieth of its period tells which fringe of the next it is.
const RATIO: f64 = 8.0;
/// Phase steps of the finest fringes, whose phase is what counts.
const FINEST_STEPS: usize = 8;
/// Phase steps of the others, which only number fringes.
const STEPS: usize = 4;
/// A phase is unreliable if its amplitude is below this many standard errors: wrong fringe numbers become rarer than 1e-6.
const LEAST_SNR: f64 = 8.0;
/// Neighbouring periods that disagree by more than this share of the finer one do not show the same point.
const WORST_DISAGREEMENT: f64 = 0.25;
/// Fringes of all periods have one amplitude where a pixel sees one point; mixed pixels lose the finer ones.
const LEAST_CONTRAST: f64 = 0.5;

/// Phase-shifted fringes along columns, then along rows, each from the coarsest period (longer than the panel, so that it
/// needs no fringe number) to the finest.
#[derive(Debug, Clone, PartialEq)]
pub struct Fringes {
    width: usize,
    height: usize,
    levels: Vec<Level>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Level {
    period_px: f64,
    steps: usize,
}

/// A coordinate on the panel as the fringes tell it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coordinate {
    /// Continuous pixel coordinate; the centre of pixel i is i + 1/2.
    pub px: f64,
    /// Its standard error from the camera's noise.
    pub sigma_px: f64,
    /// Half of the light of white above black, in the unit of the rates.
    pub amplitude: f64,
}

impl Fringes {
    /// The fringes for a panel.
    pub fn new(width: usize, height: usize) -> Self {
        let mut levels = vec![Level { period_px: FINEST_PX, steps: FINEST_STEPS }];
        while levels[0].period_px < width.max(height) as f64 {
            levels.insert(0, Level { period_px: levels[0].period_px * RATIO, steps: STEPS });
        }
        Self { width, height, levels }
    }

    /// Number of periods.
    pub fn levels(&self) -> usize {
        self.levels.len()
    }

    /// All frames: per axis, per period, per step. `response` makes them sinusoidal in light.
    pub fn patterns(&self, response: &Response) -> Vec<Pattern> {
        let frame = |axis: usize, level: &Level, step: usize| {
            let code = |x: usize| {
                let phase = TAU * ((x as f64 + 0.5) / level.period_px - step as f64 / level.steps as f64);
                response.code(0.5 + 0.5 * phase.cos())
            };
            let line: Vec<u8> = (0..[self.width, self.height][axis]).map(code).collect();
            let codes = (0..self.width * self.height).map(|p| line[[p % self.width, p / self.width][axis]]).collect();
            Pattern { width: self.width, height: self.height, light: Primary::White, codes }
        };
        let steps = |axis: usize| {
            self.levels.iter().flat_map(move |level| (0..level.steps).map(move |step| frame(axis, level, step)))
        };
        steps(0).chain(steps(1)).collect()
    }

    /// The column and row that a pixel sees, from its rates in the order of [`Fringes::patterns`] and their variances,
    /// with the first `levels` periods. `None` where they are not to be trusted: saturated (NaN), too dark, mixed light.
    pub fn decode(&self, rates: &[f64], variances: &[f64], levels: usize) -> Option<[Coordinate; 2]> {
        let per_axis: usize = self.levels.iter().map(|l| l.steps).sum();
        debug_assert_eq!(rates.len(), 2 * per_axis);
        let axis = |a: usize| {
            let range = a * per_axis..(a + 1) * per_axis;
            self.coordinate(&rates[range.clone()], &variances[range], levels, [self.width, self.height][a] as f64)
        };
        Some([axis(0)?, axis(1)?])
    }

    fn coordinate(&self, rates: &[f64], variances: &[f64], levels: usize, size: f64) -> Option<Coordinate> {
        let mut found: Option<Coordinate> = None;
        let mut first = 0;
        for level in &self.levels[..levels] {
            let n = level.steps as f64;
            let (mut sin, mut cos, mut variance) = (0.0, 0.0, 0.0);
            for step in 0..level.steps {
                let (s, c) = (TAU * step as f64 / n).sin_cos();
                sin += rates[first + step] * s;
                cos += rates[first + step] * c;
                variance += variances[first + step] / n;
            }
            first += level.steps;
            let amplitude = 2.0 / n * sin.hypot(cos);
            let sigma = (2.0 * variance / n).sqrt();
            if amplitude.is_nan() || amplitude < LEAST_SNR * sigma {
                return None;
            }
            let within = sin.atan2(cos) / TAU * level.period_px;
            let near = found.map_or(0.5 * level.period_px, |coarser| coarser.px);
            let px = within + ((near - within) / level.period_px).round() * level.period_px;
            if let Some(coarser) = found
                && ((px - coarser.px).abs() > WORST_DISAGREEMENT * level.period_px
                    || amplitude < LEAST_CONTRAST * coarser.amplitude)
            {
                return None;
            }
            found = Some(Coordinate { px, sigma_px: sigma / amplitude * level.period_px / TAU, amplitude });
        }
        found.filter(|c| c.px > 0.0 && c.px < size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// What a pixel that sees the point (u, v) records of every frame, by the frames' own codes.
    fn seen(fringes: &Fringes, response: &Response, u: f64, v: f64) -> Vec<f64> {
        let at = |p: &Pattern, x: usize, y: usize| 1000.0 * response.level(p.codes[y * p.width + x]) + 40.0;
        let mix = |p: &Pattern| {
            let (x, y) = (u - 0.5, v - 0.5);
            let (i, j, fx, fy) = (x as usize, y as usize, x.fract(), y.fract());
            (1.0 - fx) * (1.0 - fy) * at(p, i, j)
                + fx * (1.0 - fy) * at(p, i + 1, j)
                + (1.0 - fx) * fy * at(p, i, j + 1)
                + fx * fy * at(p, i + 1, j + 1)
        };
        fringes.patterns(response).iter().map(mix).collect()
    }

    fn gamma() -> Response {
        let points: Vec<_> = (0..=51).map(|i| (5 * i as u8, (5.0 * f64::from(i) / 255.0).powf(1.83))).collect();
        Response::from_points(&points).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn every_point_of_the_panel_is_told(u in 2.0..798.0f64, v in 2.0..598.0f64) {
            let fringes = Fringes::new(800, 600);
            let rates = seen(&fringes, &gamma(), u, v);
            let variances = vec![1.0; rates.len()];
            let [x, y] = fringes.decode(&rates, &variances, fringes.levels()).unwrap();
            // 8-bit codes and linear interpolation between pixels.
            prop_assert!((x.px - u).abs() < 0.02 && (y.px - v).abs() < 0.02, "{x:?} {y:?} at {u} {v}");
            let [coarse, _] = fringes.decode(&rates, &variances, fringes.levels() - 1).unwrap();
            prop_assert!((coarse.px - u).abs() < 0.2);
        }
    }

    #[test]
    fn what_cannot_be_trusted_is_refused() {
        let fringes = Fringes::new(800, 600);
        let good = seen(&fringes, &gamma(), 300.0, 200.0);
        let all = fringes.levels();
        let quiet = vec![1.0; good.len()];
        assert!(fringes.decode(&good, &quiet, all).is_some());
        let mut saturated = good.clone();
        saturated[3] = f64::NAN;
        assert!(fringes.decode(&saturated, &quiet, all).is_none());
        assert!(fringes.decode(&good, &vec![1e5; good.len()], all).is_none(), "buried in noise");
        let other = seen(&fringes, &gamma(), 308.0, 208.0);
        let mixed: Vec<f64> = good.iter().zip(&other).map(|(a, b)| 0.5 * (a + b)).collect();
        assert!(fringes.decode(&mixed, &quiet, all).is_none(), "two points in one pixel");
    }
}
