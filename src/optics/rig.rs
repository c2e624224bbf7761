//! The rig file: what the instrument is made of, with units in every key.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{Coatings, Conic, Lens, Mirrors, OpticalMap, SearchTable, Tolerances};
use crate::geometry::{Zone, ZoneError};

/// Version of the rig file this program writes and the newest it reads.
pub const FORMAT: u32 = 1;

/// Why a rig cannot work.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RigError {
    /// The text is not a rig file.
    #[error("not a rig file, correct the marked line: {0}")]
    Toml(String),
    /// Written by a newer program.
    #[error("rig format {found} is newer than {FORMAT}, the newest this version reads: update zonal")]
    Format {
        /// The version found.
        found: u32,
    },
    /// A quantity outside its range.
    #[error("{key} = {value:?} is out of range: choose {expected}")]
    Range {
        /// The key, with its section.
        key: &'static str,
        /// The value found.
        value: f64,
        /// What it should be.
        expected: &'static str,
    },
    /// The zone's limits make no sense.
    #[error("[zone]: {0}")]
    Zone(#[from] ZoneError),
    /// No dome goes with these mirrors.
    #[error(
        "no ray from the lens reaches the dome's rim at {rim_radius_mm} mm: with vertex_height_mm = {vertex_height_mm} and \
         focal_length_mm = {focal_length_mm} the rays miss the dome; lengthen the rim, flatten the paraboloid or raise it"
    )]
    MissesDome {
        /// Rim radius, mm.
        rim_radius_mm: f64,
        /// Height of the paraboloid's vertex, mm.
        vertex_height_mm: f64,
        /// Its focal length, mm.
        focal_length_mm: f64,
    },
    /// The zone begins inside the paraboloid's shadow.
    #[error(
        "zone.theta_min_deg = {theta_min_deg} lies in the paraboloid's shadow, which ends at {shadow_deg:.2} deg: raise \
         theta_min_deg or reduce paraboloid.edge_radius_mm"
    )]
    Shadow {
        /// The zone's lower limit, degrees.
        theta_min_deg: f64,
        /// The end of the shadow, degrees.
        shadow_deg: f64,
    },
    /// The zone ends beyond the mirrors.
    #[error(
        "zone.theta_max_deg = {theta_max_deg} is beyond what the mirrors reach, {reach_deg:.2} deg: lower it or enlarge \
         dome.theta_max_deg and paraboloid.edge_radius_mm"
    )]
    Unreached {
        /// The zone's upper limit, degrees.
        theta_max_deg: f64,
        /// What mirrors reach, degrees.
        reach_deg: f64,
    },
    /// The zone's image does not fit the panel or sensor.
    #[error(
        "the zone's image needs a radius of {radius_px:.0} px but {device} has {available_px:.0}: use a shorter focal length"
    )]
    OffPanel {
        /// `camera` or `projector`.
        device: &'static str,
        /// Radius of the zone's image, px.
        radius_px: f64,
        /// Half of the shorter side, px.
        available_px: f64,
    },
}

/// A rig: nominal dimensions of mirrors, lenses and devices. Lengths in mm, the sample at height 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// File format version.
    pub format: u32,
    /// Name of the rig.
    pub name: String,
    /// Where its numbers come from.
    pub source: String,
    /// Height of the common centre of projection of camera and projector.
    pub centre_height_mm: f64,
    /// The measured zone.
    pub zone: ZoneLimits,
    /// The convex mirror.
    pub paraboloid: Paraboloid,
    /// The concave mirror.
    pub dome: Dome,
    /// The camera.
    pub camera: Camera,
    /// The projector.
    pub projector: Projector,
    /// Targets of `calibrate align` and `calibrate map`.
    #[serde(default, skip_serializing_if = "Alignment::is_default")]
    pub alignment: Alignment,
    /// What holds the paraboloid.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mount: Option<Mount>,
    /// What mirrors and splitter do to light.
    #[serde(default, skip_serializing_if = "Coatings::is_default")]
    pub coatings: Coatings,
    /// How well its parts are made and placed.
    #[serde(default, skip_serializing_if = "Tolerances::is_default")]
    pub tolerances: Tolerances,
    /// What a search for better dimensions starts from; no part of the instrument.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub search: Option<SearchTable>,
}

/// Limits of the measured zone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ZoneLimits {
    /// Smallest polar angle.
    pub theta_min_deg: f64,
    /// Largest polar angle.
    pub theta_max_deg: f64,
}

/// What alignment looks at: a wire cross in the dome's opening, its wires at 45 deg to x and y, and a printed cross along x
/// and y on a white screen in the sample's plane.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Alignment {
    /// Height of the wire cross above the sample's plane.
    pub wire_height_mm: f64,
    /// Thickness of its wires.
    pub wire_width_mm: f64,
    /// Height of the screen above the sample's plane.
    pub screen_height_mm: f64,
    /// Width of the lines printed on the screen.
    pub line_width_mm: f64,
    /// Radius of the dome's opening, at the height of the wire cross.
    pub opening_radius_mm: f64,
}

impl Default for Alignment {
    /// A dome 220 mm high whose opening lets the whole zone's light pass: 11.7 mm and 0.365 of the projector's pupil.
    fn default() -> Self {
        Self {
            wire_height_mm: 220.0,
            wire_width_mm: 2.0,
            screen_height_mm: 0.0,
            line_width_mm: 1.0,
            opening_radius_mm: 16.3,
        }
    }
}

impl Alignment {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// The convex paraboloid above the sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Paraboloid {
    /// Focal length f of z = h - rho^2 / (4 f).
    pub focal_length_mm: f64,
    /// Height h of its vertex above the sample.
    pub vertex_height_mm: f64,
    /// Radius it is trimmed to; without it, the radius of the edge ray that meets the dome's rim.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub edge_radius_mm: Option<f64>,
    /// Conic constant: -1, unless given, is a paraboloid; a little below it a hyperboloid.
    #[serde(default = "paraboloid", skip_serializing_if = "is_paraboloid")]
    pub conic: f64,
}

fn paraboloid() -> f64 {
    -1.0
}

fn is_paraboloid(conic: &f64) -> bool {
    *conic == -1.0
}

/// What holds the paraboloid from below: a disc as seen from the sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mount {
    /// Its radius.
    pub radius_mm: f64,
    /// Its height above the sample's plane.
    pub height_mm: f64,
}

/// The concave dome.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dome {
    /// Radius of the (possibly virtual) rim in the sample's plane: fixes the profile.
    pub rim_radius_mm: f64,
    /// Polar angle, seen from the sample, at which the dome as built ends.
    pub theta_max_deg: f64,
}

/// Which arm of the beam splitter a device looks through.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Arm {
    /// Straight through.
    Transmitted,
    /// Reflected: mirrors phi to -phi.
    Reflected,
}

impl Arm {
    /// +1, or -1 where the arm mirrors the image.
    pub fn handedness(self) -> f64 {
        match self {
            Arm::Transmitted => 1.0,
            Arm::Reflected => -1.0,
        }
    }
}

/// Arrangement of colour filters on the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mosaic {
    /// Bayer: red at even column and even row, blue at odd and odd, green elsewhere.
    Rggb,
    /// No filters: the one channel serves as red, green and blue.
    Mono,
}

impl Mosaic {
    /// The channels (0 red, 1 green, 2 blue) to which pixel (column, row) contributes.
    pub fn channels(self, column: usize, row: usize) -> &'static [usize] {
        match (self, column % 2, row % 2) {
            (Mosaic::Mono, _, _) => &[0, 1, 2],
            (Mosaic::Rggb, 0, 0) => &[0],
            (Mosaic::Rggb, 1, 1) => &[2],
            (Mosaic::Rggb, _, _) => &[1],
        }
    }
}

/// Camera: lens and sensor. Its sensor figures follow EMVA 1288.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Arm of the beam splitter.
    pub arm: Arm,
    /// Focal length of the (thin) lens.
    pub focal_length_mm: f64,
    /// Distance it is focused at.
    pub focus_mm: f64,
    /// Focal length over pupil diameter.
    pub f_number: f64,
    /// Pixel pitch, micrometres.
    pub pitch_um: f64,
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Colour filters.
    pub mosaic: Mosaic,
    /// Bits per sample.
    pub bits: u32,
    /// Conversion gain, DN per electron.
    pub gain_dn_per_e: f64,
    /// Temporal dark noise, electrons.
    pub dark_noise_e: f64,
    /// Saturation capacity, electrons.
    pub full_well_e: f64,
    /// Mean value in darkness, DN.
    pub black_level_dn: f64,
    /// End of the linear range, DN: samples at or above it are not used.
    pub linear_limit_dn: f64,
    /// Fastest frame rate, Hz.
    pub max_frame_rate_hz: f64,
    /// Time from the end of an exposure to the frame's delivery, in which no other can begin, s.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub readout_s: f64,
    /// What each code of a camera that is not linear stands for, DN, from code 0 on; samples are DN where there is none. It is
    /// calibrated and no part of a rig file.
    #[serde(skip)]
    pub codes_dn: Option<Arc<[u16]>>,
}

/// Projector: lens, panel and timing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Projector {
    /// Arm of the beam splitter.
    pub arm: Arm,
    /// Focal length of the (thin) lens.
    pub focal_length_mm: f64,
    /// Distance it is focused at.
    pub focus_mm: f64,
    /// Focal length over pupil diameter.
    pub f_number: f64,
    /// Pixel pitch, micrometres.
    pub pitch_um: f64,
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Refresh rate, Hz; its colours follow each other within one refresh, so exposures are whole multiples of 1/rate.
    pub refresh_hz: f64,
    /// Whether frames carry a coded patch beside the mirrors' image, where it falls on the border around the sample.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub tag: bool,
}

fn yes() -> bool {
    true
}

fn is_yes(x: &bool) -> bool {
    *x
}

fn is_zero(x: &f64) -> bool {
    *x == 0.0
}

impl Rig {
    /// Reads and checks a rig file's text.
    ///
    /// # Errors
    /// [`RigError`], naming key and remedy.
    pub fn from_toml(text: &str) -> Result<Self, RigError> {
        let rig: Self = toml::from_str(text).map_err(|e| RigError::Toml(e.to_string()))?;
        rig.check()?;
        Ok(rig)
    }

    /// The rig as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).expect("plain numbers and strings")
    }

    /// The measured zone.
    pub fn zone(&self) -> Zone {
        Zone::from_degrees(self.zone.theta_min_deg, self.zone.theta_max_deg).expect("checked when read")
    }

    /// The mirrors.
    pub fn mirrors(&self) -> Mirrors {
        self.try_mirrors().expect("checked when read")
    }

    /// Radius of the paraboloid as made, mm.
    pub fn paraboloid_radius_mm(&self) -> f64 {
        self.paraboloid.edge_radius_mm.unwrap_or(f64::INFINITY).min(self.mirrors().edge_radius())
    }

    /// The camera's nominal map.
    pub fn camera_map(&self) -> OpticalMap {
        OpticalMap::new(self.mirrors(), self.camera.lens(), self.dome.theta_max_deg.to_radians())
    }

    /// The projector's nominal map.
    pub fn projector_map(&self) -> OpticalMap {
        OpticalMap::new(self.mirrors(), self.projector.lens(), self.dome.theta_max_deg.to_radians())
    }

    pub(super) fn try_mirrors(&self) -> Option<Mirrors> {
        let p = &self.paraboloid;
        let convex = Conic { vertex_height: p.vertex_height_mm, radius: 2.0 * p.focal_length_mm, constant: p.conic };
        Mirrors::new(self.centre_height_mm, convex, self.dome.rim_radius_mm)
    }
}

impl Camera {
    /// The nominal lens, its axis through the middle of the sensor.
    pub fn lens(&self) -> Lens {
        lens(self.arm, self.focal_length_mm, self.focus_mm, self.pitch_um, self.width_px, self.height_px)
    }

    /// Radius of the pupil, mm.
    pub fn pupil_mm(&self) -> f64 {
        self.focal_length_mm / self.f_number / 2.0
    }

    /// Largest value a sample can have.
    pub fn white_dn(&self) -> u16 {
        ((1u32 << self.bits) - 1) as u16
    }
}

impl Projector {
    /// The nominal lens, its axis through the middle of the panel.
    pub fn lens(&self) -> Lens {
        lens(self.arm, self.focal_length_mm, self.focus_mm, self.pitch_um, self.width_px, self.height_px)
    }

    /// Radius of the pupil, mm.
    pub fn pupil_mm(&self) -> f64 {
        self.focal_length_mm / self.f_number / 2.0
    }
}

/// A thin lens focused at `focus`: the image lies at 1 / (1/f - 1/focus).
fn lens(arm: Arm, focal_length_mm: f64, focus_mm: f64, pitch_um: f64, width: usize, height: usize) -> Lens {
    let image_mm = 1.0 / (1.0 / focal_length_mm - 1.0 / focus_mm);
    Lens { focal_px: image_mm / (pitch_um * 1e-3), centre_u: width as f64 / 2.0, centre_v: height as f64 / 2.0, arm }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BUILT: &str = include_str!("../../optics/ghosh-2007-built.toml");
    const FULL: &str = include_str!("../../optics/ghosh-2007-full.toml");
    const SEED_PROJECTOR: &str = include_str!("../../optics/ghosh-2007-seed-projector.toml");

    #[test]
    fn all_thesis_rigs_are_consistent() {
        let built = Rig::from_toml(BUILT).unwrap();
        assert!((built.camera.lens().focal_px - 5903.0).abs() < 1.0);
        assert!((built.projector.lens().focal_px - 4450.0).abs() < 1.0);
        assert!((built.projector_map().radius_px(57f64.to_radians()).unwrap() - 167.0).abs() < 1.0);
        let full = Rig::from_toml(FULL).unwrap();
        assert!((full.projector_map().radius_px(90f64.to_radians()).unwrap() - 281.0).abs() < 1.0);
        let seed = Rig::from_toml(SEED_PROJECTOR).unwrap();
        assert!((seed.projector.lens().focal_px - 1701.0).abs() < 1.0);
        // Both pupils after the rule of footprints: what a sample may be off in height, mm.
        let height = |rig: &Rig| (0.0363 * rig.projector.pupil_mm() - 0.0748 * rig.camera.pupil_mm()) / 1.70;
        assert!((height(&seed) - 0.05).abs() < 1e-3 && (height(&built) - 0.198).abs() < 1e-3);
        // Nothing but the projector differs.
        let same =
            Rig { name: built.name.clone(), source: built.source.clone(), projector: built.projector.clone(), ..seed };
        assert_eq!(same, built);
    }

    #[test]
    fn rig_files_survive_a_round_trip() {
        let rig = Rig::from_toml(BUILT).unwrap();
        assert_eq!(Rig::from_toml(&rig.to_toml()).unwrap(), rig);
    }

    #[test]
    fn each_impossible_rig_is_named() {
        let error = |from: &str, to: &str| {
            let text = BUILT.replacen(from, to, 1);
            assert_ne!(text, BUILT, "{from}");
            Rig::from_toml(&text).unwrap_err()
        };
        assert!(matches!(error("theta_min_deg = 9.0", "theta_min_deg = 60.0"), RigError::Zone(_)));
        assert!(matches!(error("theta_min_deg = 9.0", "theta_min_deg = 5.0"), RigError::Shadow { .. }));
        assert!(matches!(error("theta_max_deg = 57.0", "theta_max_deg = 80.0"), RigError::Unreached { .. }));
        assert!(matches!(error("rim_radius_mm = 126.5", "rim_radius_mm = 0.5"), RigError::MissesDome { .. }));
        assert!(matches!(error("pitch_um = 4.65", "pitch_um = 0.65"), RigError::OffPanel { device: "camera", .. }));
        assert!(matches!(error("format = 1", "format = 9"), RigError::Format { found: 9 }));
        let wrong_unit = error("vertex_height_mm = 135.0", "vertex_height_cm = 13.5").to_string();
        assert!(wrong_unit.contains("vertex_height_cm") && wrong_unit.contains("line"), "{wrong_unit}");
        assert!(matches!(error("vertex_height_mm = 135.0", "vertex_height_mm = nan"), RigError::Range { .. }));
    }
}
