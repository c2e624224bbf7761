//! The lamp's light over time, from readings of a patch that is always equally bright.

/// Random walk of a lamp's light, per square root of a second: a warm lamp wanders by a percent in some minutes.
const WANDER_PER_ROOT_S: f64 = 5e-4;

/// Follows the light of a lamp relative to a reference: a Kalman filter of a random walk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lamp {
    light: f64,
    variance: f64,
}

impl Lamp {
    /// A lamp as it was when the reference was taken, known to a standard error of `sigma`.
    pub fn new(light: f64, sigma: f64) -> Self {
        Self { light, variance: sigma * sigma }
    }

    /// Takes a reading of the light, with its standard error, `passed_s` after the last; returns the best estimate then.
    pub fn update(&mut self, passed_s: f64, reading: f64, sigma: f64) -> f64 {
        self.variance += WANDER_PER_ROOT_S.powi(2) * passed_s;
        let gain = self.variance / (self.variance + sigma * sigma);
        self.light += gain * (reading - self.light);
        self.variance *= 1.0 - gain;
        self.light
    }

    /// The estimate.
    pub fn light(&self) -> f64 {
        self.light
    }

    /// Its standard error.
    pub fn sigma(&self) -> f64 {
        self.variance.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;

    use super::*;

    #[test]
    fn a_drift_is_followed_and_noise_is_not() {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
        let mut lamp = Lamp::new(1.0, 1e-3);
        let (sigma, mut steady, mut lag, mut n) = (2e-3, 0.0, 0.0, 0.0);
        for i in 0..6000 {
            let time = f64::from(i) / 15.0;
            // Half a minute of rest, then 1% in 30 s, then rest again.
            let light = 1.0 + 0.01 * ((time - 30.0) / 30.0).clamp(0.0, 1.0);
            let e: f64 = StandardNormal.sample(&mut rng);
            let got = lamp.update(1.0 / 15.0, light + sigma * e, sigma);
            if (450..900).contains(&i) {
                lag = f64::max(lag, (got - light).abs());
            } else if i > 2000 {
                steady += (got - light).powi(2);
                n += 1.0;
            }
        }
        assert!(lag < 3e-3, "{lag}");
        let spread = f64::sqrt(steady / n);
        assert!(spread < 0.4 * sigma && (spread / lamp.sigma() - 1.0).abs() < 0.5, "{spread} {}", lamp.sigma());
    }
}
