//! How far a sensor's response is straight.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::transfer::relative_line;

/// Why means over exposures show no linear range.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum LinearityError {
    /// Too few points, or not in order.
    #[error("a linear range needs {MIN_POINTS} exposures or more, ascending, with positive means: take more")]
    Points,
    /// Nothing is straight.
    #[error("not even the {MIN_POINTS} shortest exposures lie on a line to {deviation}: is the light steady?")]
    Bent {
        /// Deviation asked for.
        deviation: f64,
    },
}

/// Points a line must pass through before it says anything.
const MIN_POINTS: usize = 4;
/// Signals below this part of a line's greatest are not judged: noise of the black level is all they deviate by.
const JUDGED_FROM: f64 = 0.05;

/// The straight part of a response.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinearRange {
    /// Value without light.
    pub black_level_dn: f64,
    /// Signal for one second.
    pub slope_dn_per_s: f64,
    /// Value at which the response leaves the line; the greatest mean if it never does.
    pub end_dn: f64,
    /// Whether it leaves it at all.
    pub ends: bool,
}

impl LinearRange {
    /// The linear range of `(exposure in s, mean in DN)` under steady light, exposures ascending: the longest run of points
    /// from the shortest exposure on that differ from their own line by no more than `deviation` of the signal. The line has
    /// the least relative deviations, and its end is interpolated to where it is left by just as much.
    ///
    /// # Errors
    /// [`LinearityError`].
    pub fn of(points: &[(f64, f64)], deviation: f64) -> Result<Self, LinearityError> {
        let ascending = points.windows(2).all(|p| p[0].0 < p[1].0);
        let positive = points.iter().all(|p| p.0.is_finite() && p.1.is_finite() && p.1 > 0.0);
        if !ascending || !positive || points.len() < MIN_POINTS {
            return Err(LinearityError::Points);
        }
        let fits = (MIN_POINTS..=points.len()).rev().map(|n| (n, Line::through(&points[..n])));
        let Some((n, line)) = { fits }.find(|(n, line)| line.holds(&points[..*n], deviation)) else {
            return Err(LinearityError::Bent { deviation });
        };
        let last = points[n - 1];
        let mut end_dn = last.1;
        if let Some(&next) = points.get(n) {
            let (before, after) = (line.off(last), line.off(next));
            let left = deviation.copysign(after);
            let share = if before == after { 0.0 } else { ((left - before) / (after - before)).clamp(0.0, 1.0) };
            end_dn += share * (next.1 - last.1);
        }
        let Line { black, slope } = line;
        Ok(Self { black_level_dn: black, slope_dn_per_s: slope, end_dn, ends: n < points.len() })
    }
}

struct Line {
    black: f64,
    slope: f64,
}

impl Line {
    fn through(points: &[(f64, f64)]) -> Self {
        let [black, slope] = relative_line(points);
        Self { black, slope }
    }

    /// Deviation of a point, relative to its signal.
    fn off(&self, (exposure, mean): (f64, f64)) -> f64 {
        (mean - self.black) / (self.slope * exposure) - 1.0
    }

    fn holds(&self, points: &[(f64, f64)], deviation: f64) -> bool {
        let longest = points[points.len() - 1].0;
        points.iter().filter(|p| p.0 >= JUDGED_FROM * longest).all(|&p| self.off(p).abs() <= deviation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(response: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
        (1..=60).map(|i| 1e-3 * f64::from(i)).map(|t| (t, response(t))).collect()
    }

    /// A line to 3,900 DN, then half as steep, then saturation.
    #[test]
    fn the_end_of_a_broken_line_is_found() {
        let bent = |t: f64| {
            let straight = 14.7 + 1e5 * t;
            (straight.min(3900.0) + 0.5 * (straight - 3900.0).max(0.0)).min(4095.0)
        };
        let got = LinearRange::of(&points(bent), 0.005).unwrap();
        assert!((got.black_level_dn - 14.7).abs() < 0.5, "{got:?}");
        assert!((got.slope_dn_per_s / 1e5 - 1.0).abs() < 1e-3, "{got:?}");
        assert!(got.ends && (3890.0..3960.0).contains(&got.end_dn), "{got:?}");
    }

    /// Values off by up to 0.05% are within a deviation of 0.5%, and a line that is never left ends with the data.
    #[test]
    fn a_straight_response_ends_with_the_data() {
        let wavy = |t: f64| 20.0 + 5e4 * t * (1.0 + 5e-4 * (3e3 * t).sin());
        let data = points(wavy);
        let got = LinearRange::of(&data, 0.005).unwrap();
        assert!(!got.ends);
        assert_eq!(got.end_dn, data[59].1);
        assert!((got.black_level_dn - 20.0).abs() < 1.0);
    }

    /// A response that bends all the way: less deviation, an earlier end.
    #[test]
    fn a_stricter_deviation_ends_sooner() {
        let soft = |t: f64| 10.0 + 6e4 * t - 1.5e5 * t * t;
        let end = |deviation: f64| LinearRange::of(&points(soft), deviation).unwrap().end_dn;
        assert!(end(0.003) < 0.7 * end(0.01), "{} {}", end(0.003), end(0.01));
    }

    #[test]
    fn what_has_no_linear_range_is_refused() {
        assert_eq!(LinearRange::of(&[(1.0, 1.0), (2.0, 2.0)], 0.01), Err(LinearityError::Points));
        let flicker: Vec<_> = (1..20).map(|i| (f64::from(i), f64::from(i) * [0.5, 1.5][i as usize % 2])).collect();
        assert_eq!(LinearRange::of(&flicker, 0.01), Err(LinearityError::Bent { deviation: 0.01 }));
    }
}
