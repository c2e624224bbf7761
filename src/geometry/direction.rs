//! Unit directions that know their frame.

use std::marker::PhantomData;

use nalgebra::{Rotation3, Vector3};

/// The frame of the sample: origin on its surface, +z its shading normal, +x its grain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sample;

/// The frame of the rig: origin where the sample should be, +z the optical axis towards the camera, millimetres.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rig;

/// A unit vector in the frame `F`.
///
/// Directions of different frames do not mix:
/// ```compile_fail
/// use zonal::geometry::{Direction, Rig, Sample};
/// let wi: Direction<Sample> = Direction::<Rig>::from_angles(0.5, 0.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Direction<F = Sample> {
    v: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Direction<F> {
    /// The direction of `v`, which need not be normalised but must not be zero.
    pub fn new(v: Vector3<f64>) -> Self {
        Self::new_unchecked(v.normalize())
    }

    /// A direction from a vector known to be of unit length.
    pub fn new_unchecked(v: Vector3<f64>) -> Self {
        debug_assert!((v.norm_squared() - 1.0).abs() < 1e-6);
        Self { v, frame: PhantomData }
    }

    /// The direction at the polar angle `theta` from +z and the azimuth `phi` from +x, both in radians.
    pub fn from_angles(theta: f64, phi: f64) -> Self {
        let (sin_theta, cos_theta) = theta.sin_cos();
        let (sin_phi, cos_phi) = phi.sin_cos();
        Self::new_unchecked(Vector3::new(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta))
    }

    /// The direction with `cos(theta) = mu`, -1 <= mu <= 1, at the azimuth `phi` in radians.
    pub fn from_mu_phi(mu: f64, phi: f64) -> Self {
        let sin_theta = (1.0 - mu * mu).max(0.0).sqrt();
        let (sin_phi, cos_phi) = phi.sin_cos();
        Self::new_unchecked(Vector3::new(sin_theta * cos_phi, sin_theta * sin_phi, mu))
    }

    /// The unit vector.
    pub fn vector(&self) -> Vector3<f64> {
        self.v
    }

    /// Cosine of the polar angle.
    pub fn cos_theta(&self) -> f64 {
        self.v.z
    }

    /// Polar angle from +z in radians, accurate near the pole too.
    pub fn theta(&self) -> f64 {
        self.v.x.hypot(self.v.y).atan2(self.v.z)
    }

    /// Azimuth from +x in radians, in (-pi, pi].
    pub fn phi(&self) -> f64 {
        self.v.y.atan2(self.v.x)
    }

    /// Cosine of the angle to `other`.
    pub fn dot(&self, other: &Self) -> f64 {
        self.v.dot(&other.v)
    }

    /// The mirror image of this direction at the surface's normal: (-x, -y, z).
    pub fn mirrored(&self) -> Self {
        Self::new_unchecked(Vector3::new(-self.v.x, -self.v.y, self.v.z))
    }

    /// This direction rotated about the normal by `angle` radians.
    pub fn rotated_about_normal(&self, angle: f64) -> Self {
        let (s, c) = angle.sin_cos();
        Self::new_unchecked(Vector3::new(c * self.v.x - s * self.v.y, s * self.v.x + c * self.v.y, self.v.z))
    }
}

impl Direction<Rig> {
    /// The same direction seen from the sample, whose axes in the rig are the columns of `rig_from_sample`.
    pub fn to_sample(&self, rig_from_sample: &Rotation3<f64>) -> Direction<Sample> {
        Direction::new_unchecked(rig_from_sample.inverse_transform_vector(&self.v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn angles_and_directions_are_inverse(theta in 1e-6..3.1f64, phi in -3.1..3.1f64) {
            let d = Direction::<Sample>::from_angles(theta, phi);
            prop_assert!((d.theta() - theta).abs() < 1e-12);
            prop_assert!((d.phi() - phi).abs() < 1e-9);
        }
    }
}
