//! What the simulated rig is made of, as data that a run records.

use serde::{Deserialize, Serialize};

/// Misalignments of the simulated rig: what is left after an alignment, unknown to the reconstruction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Perturbation {
    /// Shift of the camera's optical axis on its sensor (column, row).
    pub camera_offset_px: [f64; 2],
    /// Shift of the projector's optical axis on its panel (column, row).
    pub projector_offset_px: [f64; 2],
    /// Decentre of the paraboloid (x, y).
    pub paraboloid_offset_mm: [f64; 2],
    /// Decentre of the dome (x, y).
    pub dome_offset_mm: [f64; 2],
    /// Tilt of the sample about x and y.
    pub sample_tilt_deg: [f64; 2],
    /// Height of the sample above the point both devices are aimed at.
    #[serde(default)]
    pub sample_height_mm: f64,
    /// Relative error of the camera's focal length.
    #[serde(default)]
    pub camera_scale_rel: f64,
    /// Relative error of the projector's focal length: it moves the edges of the zone that is lit.
    #[serde(default)]
    pub projector_scale_rel: f64,
}

impl Perturbation {
    /// The nominal rig itself.
    pub fn none() -> Self {
        Self {
            camera_offset_px: [0.0; 2],
            projector_offset_px: [0.0; 2],
            paraboloid_offset_mm: [0.0; 2],
            dome_offset_mm: [0.0; 2],
            sample_tilt_deg: [0.0; 2],
            sample_height_mm: 0.0,
            camera_scale_rel: 0.0,
            projector_scale_rel: 0.0,
        }
    }
}

/// The simulated rig beyond its nominal dimensions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwinConfig {
    /// Which model: `pinhole`.
    pub twin: String,
    /// Seed of all noise.
    pub seed: u64,
    /// Whether the camera has shot and dark noise; its quantisation stays.
    pub noise: bool,
    /// What is out of place.
    pub perturbation: Perturbation,
    /// Light of a white frame over that of a black one.
    pub contrast: f64,
    /// Exponent of the projector's response after black subtraction.
    pub response_exponent: f64,
    /// Share of a frame's mean light that spreads evenly over it.
    pub leakage: f64,
    /// Fall-off of the projector's light from the middle to a corner of the panel, and its tilt from left to right.
    pub falloff: f64,
    /// See `falloff`.
    pub tilt: f64,
    /// Sensitivity of red, green and blue pixels.
    pub channel_gains: [f64; 3],
    /// Light that reaches every pixel whatever is shown, electrons/s.
    pub ambient_e_s: f64,
    /// Exposure in which the white zone and an 18% gray card fill half of the full well of a green pixel, s.
    pub half_well_exposure_s: f64,
    /// Radiance of the border around the sample under white light, in units of white: retro-reflective tape.
    #[serde(default = "border_radiance")]
    pub border_radiance: f64,
    /// From a request to show a frame to the refresh that can show it, refresh periods.
    #[serde(default = "latency_refreshes")]
    pub latency_refreshes: f64,
    /// Growth of the lamp's light in a minute, relative.
    #[serde(default)]
    pub lamp_drift_per_min: f64,
    /// By how much the gray card in place reflects more than its stated albedo, relative.
    #[serde(default)]
    pub card_albedo_error_rel: f64,
}

fn border_radiance() -> f64 {
    0.15
}

fn latency_refreshes() -> f64 {
    1.3
}

impl TwinConfig {
    /// The default simulated devices: figures of a DMD projector (contrast 174:1, exponent 1.83) and a lamp that suits a
    /// longest exposure of 16/60 s.
    pub fn pinhole(seed: u64) -> Self {
        Self {
            twin: "pinhole".into(),
            seed,
            noise: true,
            perturbation: Perturbation {
                camera_offset_px: [0.08, -0.05],
                projector_offset_px: [-0.06, 0.07],
                paraboloid_offset_mm: [0.001, -0.0008],
                dome_offset_mm: [0.003, 0.002],
                sample_tilt_deg: [0.01, -0.008],
                ..Perturbation::none()
            },
            contrast: 174.0,
            response_exponent: 1.83,
            leakage: 6e-4,
            falloff: 0.12,
            tilt: 0.03,
            channel_gains: [0.92, 1.0, 0.85],
            ambient_e_s: 150.0,
            half_well_exposure_s: 16.0 / 60.0,
            border_radiance: border_radiance(),
            latency_refreshes: latency_refreshes(),
            lamp_drift_per_min: 0.0,
            card_albedo_error_rel: 0.0,
        }
    }

    /// The same devices without shot and dark noise.
    pub fn noiseless(self) -> Self {
        Self { noise: false, ..self }
    }

    /// Light that code `code` adds to black, 0..=1.
    pub fn response(&self, code: u8) -> f64 {
        (f64::from(code) / 255.0).powf(self.response_exponent)
    }

    /// Relative light of the projector's pixel (column, row).
    pub fn vignetting(&self, column: usize, row: usize, width: usize, height: usize) -> f64 {
        let x = (column as f64 + 0.5) / width as f64 * 2.0 - 1.0;
        let y = (row as f64 + 0.5) / height as f64 * 2.0 - 1.0;
        1.0 - self.falloff * (x * x + y * y) / 2.0 + self.tilt * x
    }
}
