//! The ideal diffuser.

use std::f64::consts::FRAC_1_PI;

use serde::{Deserialize, Serialize};

use super::Brdf;
use crate::geometry::{Direction, Sample};

/// f = albedo / pi in every direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lambert {
    /// Reflected share of the light, linear RGB, 0..=1.
    pub albedo: [f64; 3],
}

impl Lambert {
    /// A neutral diffuser.
    pub fn gray(albedo: f64) -> Self {
        Self { albedo: [albedo; 3] }
    }
}

impl Brdf for Lambert {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        if wi.cos_theta() > 0.0 && wo.cos_theta() > 0.0 { self.albedo.map(|a| a * FRAC_1_PI) } else { [0.0; 3] }
    }

    fn is_isotropic(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_support::*;
    use super::*;

    #[test]
    fn albedo_is_exact_at_every_angle() {
        // The rule's own error, on a domain whose edge bends sharply when wo is near the horizon.
        const RULE: f64 = 1e-9;
        let lambert = Lambert { albedo: [0.18, 0.5, 0.99] };
        for theta in [0.0, 0.3, 0.8, 1.2, 1.5] {
            for (got, want) in lambert.albedo(&Direction::from_angles(theta, 0.7)).into_iter().zip(lambert.albedo) {
                assert!((got / want - 1.0).abs() < RULE, "theta {theta}: {got} instead of {want}");
            }
        }
    }

    #[test]
    fn f_cos_carries_the_cosine_of_the_light() {
        let (wi, wo) = (Direction::from_angles(0.3, 0.2), Direction::from_angles(1.1, 2.0));
        let f_cos = Lambert::gray(0.5).eval_cos(&wi, &wo)[0];
        assert!((f_cos - 0.5 / std::f64::consts::PI * 0.3f64.cos()).abs() < 1e-15);
    }

    #[test]
    fn is_black_below_the_surface() {
        black_below(&Lambert::gray(0.5));
    }
}
