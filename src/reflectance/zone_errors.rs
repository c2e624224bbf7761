//! How much of the truth a conversion lost, inside and outside the measured zone.

use crate::geometry::quadrature::polar_about_mirror;
use crate::geometry::{Direction, Sample, Zone};

use super::Brdf;
use super::metric::{NODES, mean};

/// Polar angles of the exitant directions compared, degrees; phi_o = 0.
pub const EXITANT_DEG: [f64; 4] = [10.0, 25.0, 40.0, 55.0];

/// Errors of f_cos relative to its RMS over the hemisphere, mean of the colour channels.
///
/// Asks what a conversion made of the incident directions, for `wo` that were measured. To judge a model at all pairs of
/// directions, take [`super::Metric`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ZoneErrors {
    /// RMS difference over incident directions in the zone.
    pub inside: f64,
    /// RMS difference over the rest of the hemisphere.
    pub outside: f64,
}

impl ZoneErrors {
    /// Compares `model` with `truth`: mean over [`EXITANT_DEG`] of the relative RMS over incident directions.
    pub fn new(model: &dyn Brdf, truth: &dyn Brdf, zone: Zone) -> Self {
        Self::of(|wi, wo| mean(&model.eval_cos(wi, wo)), truth, zone)
    }

    /// The same for a model given as f_cos(wi, wo), mean of its channels.
    pub fn of(model: impl Fn(&Direction<Sample>, &Direction<Sample>) -> f64, truth: &dyn Brdf, zone: Zone) -> Self {
        let mut errors = Self { inside: 0.0, outside: 0.0 };
        for theta_o in EXITANT_DEG {
            let wo = Direction::from_angles(theta_o.to_radians(), 0.0);
            let (mut power, mut omega) = (0.0, 0.0);
            let mut parts = [(0.0, 0.0); 2];
            for (wi, w) in polar_about_mirror(&wo, NODES[0], NODES[1], std::f64::consts::FRAC_PI_2) {
                let f = mean(&truth.eval_cos(&wi, &wo));
                let part = &mut parts[usize::from(!zone.contains(wi.theta()))];
                part.0 += w * (model(&wi, &wo) - f).powi(2);
                part.1 += w;
                power += w * f * f;
                omega += w;
            }
            let relative = |(sum, omega_part): (f64, f64)| {
                if omega_part > 0.0 { (sum / omega_part / (power / omega)).sqrt() } else { 0.0 }
            };
            errors.inside += relative(parts[0]) / EXITANT_DEG.len() as f64;
            errors.outside += relative(parts[1]) / EXITANT_DEG.len() as f64;
        }
        errors
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::Lambert;

    #[test]
    fn a_scaled_model_errs_by_its_scale() {
        let truth = Lambert { albedo: [0.5; 3] };
        let zone = Zone::from_degrees(0.0, 90.0).unwrap();
        assert_eq!(ZoneErrors::new(&truth, &truth, zone).inside, 0.0);
        let brighter = Lambert { albedo: [0.6; 3] };
        let errors = ZoneErrors::new(&brighter, &truth, zone);
        assert!((errors.inside - 0.2).abs() < 1e-12 && errors.outside == 0.0);
    }
}
