//! How well parts are made and placed: standard deviations.

use serde::{Deserialize, Serialize};

/// Standard deviations of what is off in a rig. Of pairs in x and y each has the one given.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Tolerances {
    /// Lateral place of the camera's pupil.
    pub camera_displacement_mm: f64,
    /// Turn of the camera about x and y.
    pub camera_turn_deg: f64,
    /// Height of the camera's pupil.
    pub camera_height_mm: f64,
    /// Distance the camera is focused at.
    pub camera_focus_mm: f64,
    /// Focal length of the camera, relative.
    pub camera_scale_rel: f64,
    /// Lateral place of the projector's pupil.
    pub projector_displacement_mm: f64,
    /// Turn of the projector about x and y.
    pub projector_turn_deg: f64,
    /// Height of the projector's pupil.
    pub projector_height_mm: f64,
    /// Distance the projector is focused at.
    pub projector_focus_mm: f64,
    /// Focal length of the projector, relative.
    pub projector_scale_rel: f64,
    /// Decentre of the paraboloid.
    pub paraboloid_offset_mm: f64,
    /// Tilt of the paraboloid.
    pub paraboloid_tilt_deg: f64,
    /// Height of the paraboloid.
    pub paraboloid_height_mm: f64,
    /// RMS slope of the paraboloid's surface about its figure, in each direction.
    pub paraboloid_slope_mrad: f64,
    /// Decentre of the dome.
    pub dome_offset_mm: f64,
    /// Tilt of the dome.
    pub dome_tilt_deg: f64,
    /// Height of the dome.
    pub dome_height_mm: f64,
    /// Each of the dome's figure errors: Legendre polynomials P_0 to P_3 along its meridian.
    pub dome_figure_mm: f64,
    /// RMS slope of the dome's surface about its figure, in each direction.
    pub dome_slope_mrad: f64,
    /// Height of the sample.
    pub sample_height_mm: f64,
    /// Tilt of the sample.
    pub sample_tilt_deg: f64,
}

impl Default for Tolerances {
    /// A careful workshop and an alignment by eye, before any calibration.
    fn default() -> Self {
        Self {
            camera_displacement_mm: 0.1,
            camera_turn_deg: 0.02,
            camera_height_mm: 0.2,
            camera_focus_mm: 1.0,
            camera_scale_rel: 1e-3,
            projector_displacement_mm: 0.1,
            projector_turn_deg: 0.02,
            projector_height_mm: 0.2,
            projector_focus_mm: 1.0,
            projector_scale_rel: 1e-3,
            paraboloid_offset_mm: 0.02,
            paraboloid_tilt_deg: 0.02,
            paraboloid_height_mm: 0.05,
            paraboloid_slope_mrad: 0.3,
            dome_offset_mm: 0.05,
            dome_tilt_deg: 0.02,
            dome_height_mm: 0.1,
            dome_figure_mm: 0.02,
            dome_slope_mrad: 0.3,
            sample_height_mm: 0.1,
            sample_tilt_deg: 0.05,
        }
    }
}

impl Tolerances {
    /// Whether none is given beside the default.
    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// All, with their keys.
    pub fn entries(&self) -> [(&'static str, f64); 21] {
        [
            ("camera_displacement_mm", self.camera_displacement_mm),
            ("camera_turn_deg", self.camera_turn_deg),
            ("camera_height_mm", self.camera_height_mm),
            ("camera_focus_mm", self.camera_focus_mm),
            ("camera_scale_rel", self.camera_scale_rel),
            ("projector_displacement_mm", self.projector_displacement_mm),
            ("projector_turn_deg", self.projector_turn_deg),
            ("projector_height_mm", self.projector_height_mm),
            ("projector_focus_mm", self.projector_focus_mm),
            ("projector_scale_rel", self.projector_scale_rel),
            ("paraboloid_offset_mm", self.paraboloid_offset_mm),
            ("paraboloid_tilt_deg", self.paraboloid_tilt_deg),
            ("paraboloid_height_mm", self.paraboloid_height_mm),
            ("paraboloid_slope_mrad", self.paraboloid_slope_mrad),
            ("dome_offset_mm", self.dome_offset_mm),
            ("dome_tilt_deg", self.dome_tilt_deg),
            ("dome_height_mm", self.dome_height_mm),
            ("dome_figure_mm", self.dome_figure_mm),
            ("dome_slope_mrad", self.dome_slope_mrad),
            ("sample_height_mm", self.sample_height_mm),
            ("sample_tilt_deg", self.sample_tilt_deg),
        ]
    }
}

/// What mirrors and beam splitter do to light.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Coatings {
    /// Refractive index of both mirrors' metal: real part.
    pub mirror_n: f64,
    /// Its extinction coefficient.
    pub mirror_k: f64,
    /// Share of light the splitter lets through.
    pub splitter_transmitted: f64,
    /// Share of light it reflects.
    pub splitter_reflected: f64,
}

impl Default for Coatings {
    /// Aluminium at 550 nm, an even splitter.
    fn default() -> Self {
        Self { mirror_n: 0.96, mirror_k: 6.69, splitter_transmitted: 0.5, splitter_reflected: 0.5 }
    }
}

impl Coatings {
    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Reflectance of a mirror for light across and along the plane of incidence, at an angle of incidence in radians: Fresnel's
    /// equations for a metal in air.
    pub fn reflectance(&self, incidence: f64) -> [f64; 2] {
        use nalgebra::Complex;
        let (sin, cos) = incidence.sin_cos();
        let n = Complex::new(self.mirror_n, self.mirror_k);
        let inside = (n * n - sin * sin).sqrt();
        let across = (Complex::from(cos) - inside) / (Complex::from(cos) + inside);
        let along = (n * n * cos - inside) / (n * n * cos + inside);
        [across.norm_sqr(), along.norm_sqr()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metals_reflect_as_fresnel_says() {
        let coatings = Coatings::default();
        let [across, along] = coatings.reflectance(0.0);
        // |n - 1|^2 / |n + 1|^2 at normal incidence, for both.
        let want = (0.04f64.powi(2) + 6.69f64.powi(2)) / (1.96f64.powi(2) + 6.69f64.powi(2));
        assert!((across - want).abs() < 1e-12 && (along - want).abs() < 1e-12);
        let [across, along] = coatings.reflectance(1.0);
        assert!(across > want && along < want);
        let [across, along] = coatings.reflectance(std::f64::consts::FRAC_PI_2);
        assert!((across - 1.0).abs() < 1e-9 && (along - 1.0).abs() < 1e-6);
    }
}
