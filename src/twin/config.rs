//! What the simulated rig is made of, as data that a run records.

use serde::{Deserialize, Serialize};

use super::FiniteOptics;
use crate::optics::Misalignment;

/// The simulated rig beyond its nominal dimensions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwinConfig {
    /// Which model: `pinhole` or `finite`.
    pub twin: String,
    /// Seed of all noise.
    pub seed: u64,
    /// Whether the camera has shot and dark noise; its quantisation stays.
    pub noise: bool,
    /// What is out of place: left after an alignment, unknown to the reconstruction.
    pub perturbation: Misalignment,
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
    /// Stray light on the whole sensor whatever is in the sample's place: a share of what the gray card sends under even
    /// light of the pattern's mean over the zone. 0.01 adds 1% of that, more on one side of the sensor than on the other.
    #[serde(default)]
    pub stray_share: f64,
    /// What a camera channel gets from each primary of the projector, `[channel][primary]`. Materials are given by what
    /// they reflect of each primary.
    #[serde(default = "identity")]
    pub crosstalk: [[f64; 3]; 3],
    /// How the camera differs from the rig file.
    #[serde(default)]
    pub sensor: SensorTruth,
    /// By how much the gray card in place reflects more than its stated albedo, relative.
    #[serde(default)]
    pub card_albedo_error_rel: f64,
    /// What the pupils of camera and projector do; without it, rays are chief rays.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finite: Option<FiniteOptics>,
}

/// The simulated camera beside what the rig file says of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorTruth {
    /// Conversion gain over the rig file's.
    pub gain: f64,
    /// Dark noise over the rig file's.
    pub dark_noise: f64,
    /// Full well over the rig file's.
    pub full_well: f64,
    /// Black level less the rig file's, DN.
    pub black_level_dn: f64,
    /// Share of pixels that are hot.
    pub hot_share: f64,
    /// Dark current of a hot pixel, electrons/s.
    pub hot_e_s: f64,
    /// Standard deviation of the dark signal between pixels, electrons.
    pub dsnu_e: f64,
    /// Relative standard deviation of the response between pixels.
    pub prnu_rel: f64,
    /// Exponent of the response: 1 delivers samples in proportion to light, others codes of 8 bits, 255 (DN / white)^(1 / gamma).
    pub gamma: f64,
    /// Seed of the differences between pixels, which stay when the noise changes.
    pub seed: u64,
}

impl Default for SensorTruth {
    /// As in the rig file, all pixels alike.
    fn default() -> Self {
        Self {
            gain: 1.0,
            dark_noise: 1.0,
            full_well: 1.0,
            black_level_dn: 0.0,
            hot_share: 0.0,
            hot_e_s: 0.0,
            dsnu_e: 0.0,
            prnu_rel: 0.0,
            gamma: 1.0,
            seed: 0,
        }
    }
}

fn identity() -> [[f64; 3]; 3] {
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
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
            perturbation: Misalignment {
                camera_offset_px: [0.08, -0.05],
                projector_offset_px: [-0.06, 0.07],
                paraboloid_offset_mm: [0.001, -0.0008],
                dome_offset_mm: [0.003, 0.002],
                sample_tilt_deg: [0.01, -0.008],
                ..Misalignment::none()
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
            stray_share: 0.0,
            crosstalk: identity(),
            sensor: SensorTruth::default(),
            card_albedo_error_rel: 0.0,
            finite: None,
        }
    }

    /// The same devices with finite pupils and all they do, 0.2% of stray light, a sample 0.05 mm too high, and camera,
    /// projector and mirrors as far off as `calibrate align` and careful hands leave them.
    pub fn finite(seed: u64) -> Self {
        let pinhole = Self::pinhole(seed);
        Self {
            twin: "finite".into(),
            perturbation: Misalignment {
                camera_displacement_mm: [0.002, -0.001],
                camera_turn_deg: [0.001, -0.001],
                projector_displacement_mm: [-0.015, 0.01],
                projector_turn_deg: [0.002, 0.001],
                paraboloid_offset_mm: [0.003, -0.002],
                dome_offset_mm: [0.005, 0.004],
                sample_tilt_deg: [0.02, -0.015],
                sample_height_mm: 0.05,
                ..pinhole.perturbation
            },
            stray_share: 0.002,
            finite: Some(FiniteOptics::all()),
            ..pinhole
        }
    }

    /// The simulated devices called `name`: `pinhole` or `finite`.
    pub fn named(name: &str, seed: u64) -> Option<Self> {
        match name {
            "pinhole" => Some(Self::pinhole(seed)),
            "finite" => Some(Self::finite(seed)),
            _ => None,
        }
    }

    /// What is out of place for chief rays: through finite pupils that blur they do not feel the sample's height.
    pub fn of_chief_rays(&self) -> Misalignment {
        let m = self.perturbation;
        if self.finite.is_some_and(|finite| finite.blur) { Misalignment { sample_height_mm: 0.0, ..m } } else { m }
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
