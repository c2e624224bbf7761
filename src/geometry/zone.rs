//! Zones: the part of the sphere between two polar angles.

use std::f64::consts::{PI, TAU};

use thiserror::Error;

/// A zone that cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error(
    "a zone needs 0 <= theta_min < theta_max <= 180 deg, not {theta_min_deg}..{theta_max_deg} deg: correct the two limits"
)]
pub struct ZoneError {
    /// The lower limit asked for, degrees.
    pub theta_min_deg: f64,
    /// The upper limit asked for, degrees.
    pub theta_max_deg: f64,
}

/// All directions with `theta_min <= theta <= theta_max`, at every azimuth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Zone {
    theta_min: f64,
    theta_max: f64,
    a: f64,
    b: f64,
}

impl Zone {
    /// The zone between two polar angles in radians.
    ///
    /// # Errors
    /// [`ZoneError`] unless 0 <= theta_min < theta_max <= pi.
    pub fn new(theta_min: f64, theta_max: f64) -> Result<Self, ZoneError> {
        if theta_min >= 0.0 && theta_min < theta_max && theta_max <= PI {
            Ok(Self { theta_min, theta_max, a: theta_min.cos(), b: cos_exact(theta_max) })
        } else {
            Err(ZoneError { theta_min_deg: theta_min.to_degrees(), theta_max_deg: theta_max.to_degrees() })
        }
    }

    /// The zone between two polar angles in degrees: see [`Zone::new`].
    ///
    /// # Errors
    /// [`ZoneError`] unless 0 <= theta_min < theta_max <= 180.
    pub fn from_degrees(theta_min_deg: f64, theta_max_deg: f64) -> Result<Self, ZoneError> {
        Self::new(theta_min_deg.to_radians(), theta_max_deg.to_radians())
    }

    /// The whole sphere, where the zonal basis is the basis of real spherical harmonics.
    pub fn sphere() -> Self {
        Self { theta_min: 0.0, theta_max: PI, a: 1.0, b: -1.0 }
    }

    /// The upper hemisphere.
    pub fn hemisphere() -> Self {
        Self { theta_min: 0.0, theta_max: PI / 2.0, a: 1.0, b: 0.0 }
    }

    /// Smallest polar angle, radians.
    pub fn theta_min(&self) -> f64 {
        self.theta_min
    }

    /// Largest polar angle, radians.
    pub fn theta_max(&self) -> f64 {
        self.theta_max
    }

    /// `a = cos(theta_min)`, the larger of the two cosines.
    pub fn cos_min(&self) -> f64 {
        self.a
    }

    /// `b = cos(theta_max)`, the smaller of the two cosines.
    pub fn cos_max(&self) -> f64 {
        self.b
    }

    /// |Z| = 2 pi (a - b), steradians.
    pub fn solid_angle(&self) -> f64 {
        TAU * (self.a - self.b)
    }

    /// Integral of cos(theta) over the zone, pi (a^2 - b^2), steradians.
    pub fn projected_solid_angle(&self) -> f64 {
        PI * (self.a * self.a - self.b * self.b)
    }

    /// Whether the polar angle `theta` (radians) lies in the zone, its limits included.
    pub fn contains(&self, theta: f64) -> bool {
        (self.theta_min..=self.theta_max).contains(&theta)
    }

    /// Whether both limits are those of `other` to 1e-6 radians: files hold degrees.
    pub fn is_close(&self, other: &Self) -> bool {
        (self.theta_min - other.theta_min).abs().max((self.theta_max - other.theta_max).abs()) < 1e-6
    }
}

/// cos(theta) that is exactly 0 at a right angle, so that the horizon stays the horizon.
fn cos_exact(theta: f64) -> f64 {
    if theta == PI / 2.0 { 0.0 } else { theta.cos() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The thesis says 51%; its own angles give 44.3% of the hemisphere and 67.9% of the projected one.
    #[test]
    fn built_zone_covers_what_its_angles_say() {
        let z = Zone::from_degrees(9.0, 57.0).unwrap();
        assert!((z.solid_angle() / TAU - 0.443).abs() < 5e-4);
        assert!((z.projected_solid_angle() / PI - 0.679).abs() < 5e-4);
        let full = Zone::from_degrees(9.0, 90.0).unwrap();
        assert!((full.solid_angle() / TAU - 0.988).abs() < 5e-4);
        assert_eq!(full.cos_max(), 0.0);
    }

    #[test]
    fn inverted_zones_are_refused() {
        assert!(Zone::from_degrees(57.0, 9.0).is_err());
        assert!(Zone::from_degrees(f64::NAN, 57.0).is_err());
        assert!(Zone::from_degrees(9.0, 181.0).is_err());
    }
}
