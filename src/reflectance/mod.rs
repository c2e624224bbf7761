//! Reflection models and tables: one trait, closed forms, and readers of measured files.

use crate::geometry::{Direction, Sample};

/// A BRDF over the upper hemisphere.
pub trait Brdf: Send + Sync {
    /// f(wi, wo) in 1/sr, linear RGB; `wi` points to the light, `wo` to the camera. 0 where either is not above the
    /// surface. Does *not* contain cos(theta_i).
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3];

    /// f_cos = f cos(theta_i), 1/sr: what the rig measures.
    fn eval_cos(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        self.eval(wi, wo).map(|f| f * wi.cos_theta().max(0.0))
    }

    /// Whether f depends on the azimuths only through phi_i - phi_o (a mirror symmetry is not implied).
    fn is_isotropic(&self) -> bool;
}
