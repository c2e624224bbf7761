//! Samples that say no more than "at or above": the normal law cut off at a threshold.
//!
//! In units of the noise, with `z` the mean above the threshold: a sample is seen with probability Phi(-z) and censored with
//! Phi(z), and `h = phi / Phi` is how far censoring alone would push an estimate up.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

/// One censored or seen sample's part in the likelihood of a location, at one value of it.
pub(super) struct Cut {
    /// Score of a censored sample: d ln Phi / dz.
    pub hazard: f64,
    /// Minus its slope: the information of a sample that is known to be censored.
    pub curvature: f64,
    /// Expected information of a sample not yet drawn: 1 far below the threshold, 0 far above.
    pub information: f64,
    /// E[U U'] + E[U''] / 2 of its score U: over the squared information it is the bias of maximum likelihood (Cox and
    /// Snell 1968).
    pub skew: f64,
}

impl Cut {
    pub fn at(z: f64) -> Self {
        // Below, the hazard is -z and its digits cancel; nothing there is censored.
        let z = z.max(-20.0);
        let density = (-0.5 * z * z).exp() / (2.0 * PI).sqrt();
        let above = 0.5 * libm::erfc(-z * FRAC_1_SQRT_2);
        let seen = 0.5 * libm::erfc(z * FRAC_1_SQRT_2);
        let hazard = density / above;
        let slope = -hazard * (z + hazard);
        let bend = -slope * (z + hazard) - hazard * (1.0 + slope);
        Self {
            hazard,
            curvature: -slope,
            information: seen + z * density + density * hazard,
            skew: density * (1.0 + slope) + 0.5 * above * bend,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sum over a fine grid of what a seen sample at `x` above the mean gives, plus what a censored one gives.
    fn expected(z: f64, seen: impl Fn(f64) -> f64, censored: f64) -> f64 {
        let step = 1e-3;
        let density = |x: f64| (-0.5 * x * x).exp() / (2.0 * PI).sqrt();
        let nodes = ((-z + 12.0) / step) as usize;
        let sum: f64 = (0..nodes).map(|i| -z - (i as f64 + 0.5) * step).map(|x| density(x) * seen(x) * step).sum();
        sum + 0.5 * libm::erfc(-z * FRAC_1_SQRT_2) * censored
    }

    #[test]
    fn the_score_has_mean_zero_and_its_square_is_the_information() {
        for z in [-6.0, -2.0, -0.5, 0.0, 1.0, 3.0, 6.0] {
            let cut = Cut::at(z);
            assert!(expected(z, |x| x, cut.hazard).abs() < 1e-6, "{z}");
            assert!((expected(z, |x| x * x, cut.hazard.powi(2)) - cut.information).abs() < 1e-6, "{z}");
            assert!((expected(z, |_| 1.0, cut.curvature) - cut.information).abs() < 1e-6, "{z}");
            let (d, e) = (Cut::at(z + 1e-4), Cut::at(z - 1e-4));
            let bend = -(d.curvature - e.curvature) / 2e-4;
            let skew = expected(z, |x| -x, -cut.hazard * cut.curvature + 0.5 * bend);
            assert!((skew - cut.skew).abs() < 1e-5, "{z}: {skew} {}", cut.skew);
        }
    }

    #[test]
    fn far_away_nothing_is_lost_or_all() {
        let (low, high) = (Cut::at(-40.0), Cut::at(40.0));
        assert!((low.information - 1.0).abs() < 1e-12 && low.skew.abs() < 1e-12);
        assert!(high.information.abs() < 1e-12 && high.hazard == 0.0 && high.skew == 0.0);
    }
}
