//! Control charts of gray-card runs: individuals charts after Shewhart, with limits from the moving range.

use serde::Serialize;

use crate::calibrate::{GRAY_CARD_ALBEDO, gray_card_coefficients};
use crate::reduce::Coefficients;

/// Mean moving range of two over the standard deviation of a normal distribution: d2 of ISO 7870-2 for two.
const MOVING_RANGE: f64 = 1.128;
/// Points in a row on one side of the mean that are no chance.
const RUN: usize = 8;

/// What a control chart knows of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ControlRun {
    /// Its folder.
    pub run: String,
    /// When it began, UTC, ISO 8601.
    pub started: Option<String>,
    /// Errors of z_00, z_10 and z_20 over the analytic z_00, `[coefficient][channel]`; NaN above the run's order.
    pub errors: [[f64; 3]; 3],
}

impl ControlRun {
    /// A gray-card run: means over directions against the analytic coefficients.
    pub fn new(run: String, started: Option<String>, measured: &Coefficients) -> Self {
        let want = gray_card_coefficients(measured.grid.zone(), measured.order.max(2), GRAY_CARD_ALBEDO);
        let mean = |k: usize, c: usize| {
            let values = measured.plane(k, c).iter().filter(|z| z.is_finite());
            let (sum, n) = values.fold((0.0, 0.0), |(s, n), &z| (s + f64::from(z), n + 1.0));
            sum / n
        };
        let known = |k: usize| k < (measured.order + 1).pow(2);
        let error = |k: usize, c: usize| if known(k) { (mean(k, c) - want[k]) / want[0] } else { f64::NAN };
        Self { run, started, errors: [0, 2, 6].map(|k| [0, 1, 2].map(|c| error(k, c))) }
    }
}

/// Why a point is out of control (Western Electric's first, second and fourth rule).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Signal {
    /// It lies beyond 3 sigma.
    BeyondThree,
    /// It is the second of three in a row beyond 2 sigma on the same side.
    TwoOfThree,
    /// It is the eighth or a later one in a row on the same side of the mean.
    EightOnOneSide,
}

/// One quantity over the runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ControlSeries {
    /// 0, 1, 2 for z_00, z_10, z_20.
    pub coefficient: usize,
    /// Red, green, blue.
    pub channel: usize,
    /// Errors, run by run.
    pub values: Vec<f64>,
    /// Mean of the first runs.
    pub mean: f64,
    /// Standard deviation by the moving range of the first runs.
    pub sigma: f64,
    /// What is wrong with each point.
    pub signals: Vec<Vec<Signal>>,
}

impl ControlSeries {
    /// The chart of `values`, with mean and limits from the first `baseline` of them (at least 2).
    pub fn new(coefficient: usize, channel: usize, values: Vec<f64>, baseline: usize) -> Self {
        let first = &values[..baseline.clamp(2, values.len().max(2)).min(values.len())];
        let mean = first.iter().sum::<f64>() / first.len() as f64;
        let ranges = first.windows(2).map(|w| (w[1] - w[0]).abs()).sum::<f64>();
        let sigma = ranges / (first.len().max(2) - 1) as f64 / MOVING_RANGE;
        let signals = (0..values.len()).map(|i| signals(&values[..=i], mean, sigma)).collect();
        Self { coefficient, channel, values, mean, sigma, signals }
    }
}

/// What is wrong with the last of `values`.
fn signals(values: &[f64], mean: f64, sigma: f64) -> Vec<Signal> {
    let offs: Vec<f64> = values.iter().map(|v| v - mean).collect();
    let last = offs[offs.len() - 1];
    let side = |off: &f64| off * last.signum();
    let mut found = Vec::new();
    if last.abs() > 3.0 * sigma {
        found.push(Signal::BeyondThree);
    }
    let recent = &offs[offs.len().saturating_sub(3)..];
    if side(&last) > 2.0 * sigma && recent.iter().filter(|off| side(off) > 2.0 * sigma).count() >= 2 {
        found.push(Signal::TwoOfThree);
    }
    if offs.len() >= RUN && last != 0.0 && offs[offs.len() - RUN..].iter().all(|off| side(off) > 0.0) {
        found.push(Signal::EightOnOneSide);
    }
    found
}

/// All nine charts of gray-card runs, in order of time: z_00, z_10, z_20, each red, green, blue; those no run reached left out.
pub fn control_series(runs: &[ControlRun], baseline: usize) -> Vec<ControlSeries> {
    let of = |i: usize| {
        let values: Vec<f64> = runs.iter().map(|r| r.errors[i / 3][i % 3]).collect();
        ControlSeries::new(i / 3, i % 3, values, baseline)
    };
    (0..9).map(of).filter(|s| s.values.iter().all(|v| v.is_finite())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const BASELINE: [f64; 6] = [1.0, -1.0, 1.0, -1.0, 1.0, -1.0];

    fn last(more: &[f64]) -> Vec<Signal> {
        let values = [&BASELINE[..], more].concat();
        ControlSeries::new(0, 0, values, BASELINE.len()).signals.pop().unwrap()
    }

    #[test]
    fn limits_come_from_the_moving_range_of_the_first_runs() {
        let series = ControlSeries::new(0, 0, [&BASELINE[..], &[50.0]].concat(), 6);
        assert_eq!(series.mean, 0.0);
        assert!((series.sigma - 2.0 / 1.128).abs() < 1e-12);
        assert!(series.signals[..6].iter().all(Vec::is_empty));
    }

    #[test]
    fn each_rule_finds_its_pattern() {
        // Sigma is 1.77: limits at 3.55 and 5.32.
        assert_eq!(last(&[5.4]), [Signal::BeyondThree]);
        assert_eq!(last(&[5.2]), []);
        assert_eq!(last(&[3.7, 0.0, 3.7]), [Signal::TwoOfThree]);
        assert_eq!(last(&[3.7, -3.7]), []);
        assert_eq!(last(&[3.7, 0.0, 0.0, 3.7]), []);
        assert_eq!(last(&[0.5; 8]), [Signal::EightOnOneSide]);
        assert_eq!(last(&[0.5; 7]), []);
        assert_eq!(last(&[-6.0, -6.0]), [Signal::BeyondThree, Signal::TwoOfThree]);
    }
}
