//! Half vectors and the coordinates of Rusinkiewicz (1998).

use nalgebra::Vector3;

use crate::geometry::{Direction, Sample};

/// The half vector of two directions above the surface, of unit length.
pub(super) fn half_vector(wi: &Direction<Sample>, wo: &Direction<Sample>) -> Vector3<f64> {
    (wi.vector() + wo.vector()).normalize()
}

/// Half vector and difference vector of a pair of directions: all an isotropic BRDF depends on.
#[derive(Debug, Clone, Copy)]
pub(super) struct HalfDifference {
    /// sin(theta_h), cos(theta_h): the angle between normal and half vector.
    pub half: (f64, f64),
    /// wi in the frame whose +z is the half vector and whose x-z plane holds the normal: theta_d lies between it and
    /// +z, phi_d is its azimuth from +x.
    pub difference: Vector3<f64>,
}

impl HalfDifference {
    /// The coordinates of two directions above the surface; phi_h is taken as 0 where the half vector is the normal.
    pub fn new(wi: &Direction<Sample>, wo: &Direction<Sample>) -> Self {
        let h = half_vector(wi, wo);
        let sin_h = (h.x * h.x + h.y * h.y).sqrt();
        let (cos_phi, sin_phi) = if sin_h > 0.0 { (h.x / sin_h, h.y / sin_h) } else { (1.0, 0.0) };
        let v = wi.vector();
        // wi turned by -phi_h about the normal, then by -theta_h about y.
        let (x, y) = (cos_phi * v.x + sin_phi * v.y, cos_phi * v.y - sin_phi * v.x);
        Self { half: (sin_h, h.z), difference: Vector3::new(h.z * x - sin_h * v.z, y, sin_h * x + h.z * v.z) }
    }

    /// theta_h, radians, 0..=pi/2.
    pub fn theta_h(&self) -> f64 {
        self.half.0.atan2(self.half.1)
    }

    /// theta_d, radians, 0..=pi/2.
    pub fn theta_d(&self) -> f64 {
        let d = &self.difference;
        (d.x * d.x + d.y * d.y).sqrt().atan2(d.z)
    }

    /// phi_d, radians, in (-pi, pi].
    pub fn phi_d(&self) -> f64 {
        self.difference.y.atan2(self.difference.x)
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_support::upper;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn changing_places_turns_phi_d_by_pi(wi in upper(), wo in upper()) {
            let (p, q) = (HalfDifference::new(&wi, &wo), HalfDifference::new(&wo, &wi));
            prop_assert!((p.theta_h() - q.theta_h()).abs() < 1e-12);
            prop_assert!((p.theta_d() - q.theta_d()).abs() < 1e-7);
            prop_assert!((p.difference + q.difference - 2.0 * p.difference.z * Vector3::z()).norm() < 1e-12);
        }

        #[test]
        fn turning_both_changes_nothing(wi in upper(), wo in upper(), angle in -3.0..3.0f64) {
            let p = HalfDifference::new(&wi, &wo);
            let q = HalfDifference::new(&wi.rotated_about_normal(angle), &wo.rotated_about_normal(angle));
            prop_assume!(p.half.0 > 1e-3);
            prop_assert!((p.difference - q.difference).norm() < 1e-9);
        }
    }
}
