//! Axes: ranges that end at round numbers, and ticks.

use super::text::{number, power_of_ten};

/// How values map to lengths.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Proportionally.
    Linear,
    /// By their logarithm: values that are not positive are left out.
    Log,
}

/// An axis of a [`super::Chart`].
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// Quantity and unit.
    pub label: String,
    /// Linear or logarithmic.
    pub scale: Scale,
    /// Ticks to draw instead of round numbers: position and label.
    pub ticks: Option<Vec<(f64, String)>>,
    /// Range to show instead of that of the points.
    pub range: Option<[f64; 2]>,
}

/// Magnitudes a chart can show: quotients and products of two stay finite.
const LARGEST: f64 = 1e150;
/// Errors of positions in steps.
const ROUNDING: f64 = 1e-6;
/// Ticks aimed at.
const TICKS: f64 = 5.0;

impl Axis {
    /// A linear axis that fits its points.
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Linear, ticks: None, range: None }
    }

    /// A logarithmic axis that fits its points.
    pub fn log(label: impl Into<String>) -> Self {
        Self { scale: Scale::Log, ..Self::linear(label) }
    }

    /// Whether the axis can show a value.
    pub(super) fn shows(&self, x: f64) -> bool {
        match self.scale {
            Scale::Linear => x.abs() < LARGEST,
            Scale::Log => x > 1.0 / LARGEST && x < LARGEST,
        }
    }

    /// The range that holds all values the axis can show, widened to round numbers.
    pub(super) fn fit(&self, values: impl Iterator<Item = f64>) -> [f64; 2] {
        if let Some(range) = self.range {
            return range;
        }
        let limits = values
            .filter(|&v| self.shows(v))
            .fold(None, |limits: Option<[f64; 2]>, v| Some(limits.map_or([v, v], |[lo, hi]| [lo.min(v), hi.max(v)])));
        match (self.scale, limits) {
            (Scale::Linear, None) => [0.0, 1.0],
            (Scale::Log, None) => [0.1, 1.0],
            (Scale::Log, Some([lo, hi])) => [round_down(lo / MARGIN), round_up(hi * MARGIN)],
            (Scale::Linear, Some([lo, hi])) => {
                let slack = if hi - lo > 1e-9 * hi.abs().max(lo.abs()) { 0.0 } else { 0.5 * hi.abs().max(1.0) };
                let (lo, hi) = (lo - slack, hi + slack);
                let step = nice_step(hi - lo);
                [(lo / step).floor() * step, (hi / step).ceil() * step]
            }
        }
    }

    /// Ticks inside a range: position and label.
    pub(super) fn ticks_in(&self, [lo, hi]: [f64; 2]) -> Vec<(f64, String)> {
        if let Some(ticks) = &self.ticks {
            return ticks.iter().filter(|(x, _)| (lo..=hi).contains(x)).cloned().collect();
        }
        match self.scale {
            Scale::Linear => {
                let step = nice_step(hi - lo);
                let decimals = (-step.log10().floor()).clamp(0.0, 12.0) as usize;
                // The step of a widened range may not divide its ends; rounding must not lose those it does.
                let (first, last) = ((lo / step - ROUNDING).ceil() as i64, (hi / step + ROUNDING).floor() as i64);
                let label = |x: f64| if x.abs() < 1e5 { format!("{x:.decimals$}") } else { number(x, 3) };
                (first..=last).map(|i| (i as f64 * step, label(i as f64 * step))).collect()
            }
            Scale::Log => log_ticks(lo, hi),
        }
    }

    /// Where a value lies in a range: 0 at its start, 1 at its end, beyond them outside.
    pub(super) fn place(&self, x: f64, [lo, hi]: [f64; 2]) -> f64 {
        let t = match self.scale {
            Scale::Linear => (x - lo) / (hi - lo),
            Scale::Log => (x / lo).ln() / (hi / lo).ln(),
        };
        if t.is_nan() { 0.0 } else { t }
    }
}

/// Points of a logarithmic axis stay away from its ends by this factor.
const MARGIN: f64 = 1.08;

fn log_ticks(lo: f64, hi: f64) -> Vec<(f64, String)> {
    let (first, last) = (lo.log10().floor() as i32, hi.log10().ceil() as i32);
    let inside = |x: f64| x >= lo * (1.0 - 1e-9) && x <= hi * (1.0 + 1e-9);
    if hi / lo <= 1e2 {
        let mantissas = (first..=last).flat_map(|e| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(e)));
        return mantissas.filter(|&x| inside(x)).map(|x| (x, number(x, 1))).collect();
    }
    let stride = ((hi / lo).log10() / TICKS).ceil().max(1.0) as usize;
    let plain = first >= -3 && last <= 4;
    let label = |e: i32| if plain || e == 0 { number(10f64.powi(e), 1) } else { power_of_ten(e) };
    let decades = (first..=last).step_by(stride).map(|e| (10f64.powi(e), label(e)));
    decades.filter(|(x, _)| inside(*x)).collect()
}

/// A round step (1, 2 or 5 times a power of ten) that divides a span into about five.
fn nice_step(span: f64) -> f64 {
    round_up(span / TICKS * 0.999)
}

/// The next number 1, 2 or 5 times a power of ten, not below `x` > 0.
pub(super) fn round_up(x: f64) -> f64 {
    let decade = 10f64.powf(x.log10().floor());
    let nice = [1.0, 2.0, 5.0, 10.0].into_iter().find(|m| m * decade >= x * (1.0 - 1e-9));
    nice.unwrap_or(10.0) * decade
}

fn round_down(x: f64) -> f64 {
    let decade = 10f64.powf(x.log10().floor());
    let nice = [5.0, 2.0, 1.0].into_iter().find(|m| m * decade <= x * (1.0 + 1e-9));
    nice.unwrap_or(1.0) * decade
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn ticks_are_round() {
        let labels = |axis: &Axis, range| axis.ticks_in(range).into_iter().map(|t| t.1).collect::<Vec<_>>();
        assert_eq!(labels(&Axis::linear("x"), [0.0, 10.0]), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels(&Axis::linear("x"), Axis::linear("x").fit([1.5, 6.1].into_iter())), ["2", "4", "6"]);
        assert_eq!(labels(&Axis::log("x"), [5.0, 100.0]), ["5", "10", "20", "50", "100"]);
        assert_eq!(labels(&Axis::log("x"), [1e-4, 1.0]), ["10⁻⁴", "10⁻³", "10⁻²", "10⁻¹", "1"]);
        assert_eq!(Axis::linear("x").fit([0.3, 9.2].into_iter()), [0.0, 10.0]);
        assert_eq!(Axis::log("x").fit([7.0, 60.0].into_iter()), [5.0, 100.0]);
    }

    proptest! {
        #[test]
        fn a_fitted_axis_holds_its_points_and_two_ticks(
            a in prop::num::f64::NORMAL, b in prop::num::f64::NORMAL, log in any::<bool>()
        ) {
            let axis = if log { Axis::log("x") } else { Axis::linear("x") };
            let [lo, hi] = axis.fit([a, b].into_iter());
            prop_assert!(lo < hi && lo.is_finite() && hi.is_finite());
            for x in [a, b].into_iter().filter(|&x| axis.shows(x)) {
                prop_assert!(lo <= x && x <= hi);
                prop_assert!((0.0..=1.0).contains(&axis.place(x, [lo, hi])));
            }
            let ticks = axis.ticks_in([lo, hi]);
            prop_assert!((2..=12).contains(&ticks.len()), "{ticks:?}");
            prop_assert!(ticks.iter().all(|(x, _)| *x >= lo - 1e-9 * lo.abs() && *x <= hi + 1e-9 * hi.abs()));
        }
    }
}
