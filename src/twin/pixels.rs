//! Differences between the simulated sensor's pixels.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::SensorTruth;

/// One value for each pixel of the sensor.
pub(super) struct Pixels {
    /// Signal without light, electrons.
    pub offset_e: Vec<f32>,
    /// Dark current, electrons/s.
    pub dark_e_s: Vec<f32>,
    /// Response over the mean pixel's.
    pub response: Vec<f32>,
}

impl Pixels {
    /// Pixels as their seed makes them; `None` where all are alike.
    pub fn new(truth: &SensorTruth, count: usize) -> Option<Self> {
        if truth.hot_share == 0.0 && truth.dsnu_e == 0.0 && truth.prnu_rel == 0.0 {
            return None;
        }
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(truth.seed);
        let mut normal = |sigma: f64| -> Vec<f32> {
            (0..count).map(|_| (sigma * Distribution::<f64>::sample(&StandardNormal, &mut rng)) as f32).collect()
        };
        let offset_e = normal(truth.dsnu_e);
        let response = normal(truth.prnu_rel).into_iter().map(|x| 1.0 + x).collect();
        let hot = |_| if rng.random::<f64>() < truth.hot_share { truth.hot_e_s as f32 } else { 0.0 };
        let dark_e_s = (0..count).map(hot).collect();
        Some(Self { offset_e, dark_e_s, response })
    }
}
