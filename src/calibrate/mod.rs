//! The procedures that measure what a measurement must know of the rig, and the files they leave.

mod align;
mod camera;
mod camera_codes;
mod colour;
mod crosses;
mod emva;
mod files;
mod gray_card;
mod header;
mod least_squares;
mod map;
mod pairs;
mod procedures;
mod reference;
mod set;

use jiff::Timestamp;
use thiserror::Error;

use crate::basis::OrderError;
use crate::capture::CaptureError;
use crate::radiometry::{ColourError, LinearityError, ResponseError, StackError, TransferError};
use crate::reduce::ReduceError;
use crate::reflectance::MaterialError;
use crate::store::StoreError;

pub use align::{AxisAlignment, DeviceAlignment, align};
pub use camera::{CameraFigures, NoiseFigures, linearity, noise};
pub use camera_codes::{ResponseMethod, camera_codes};
pub use colour::colour;
pub use emva::{EmvaDescription, EmvaError, EmvaGroup};
pub use files::Folder;
pub use gray_card::{GrayCardCheck, Known, black_trap, gray_card, gray_card_plan};
pub use header::{Acceptance, CALIBRATION_FORMAT, Devices, Freshness, Header, Kind, Origin, fingerprint, in_order};
pub use map::{Maps, RigMap, map};
pub use procedures::{flat_field, response};
pub use reference::{FactorTable, GRAY_CARD_ALBEDO, Reference, gray_card_coefficients};
pub use set::CalibrationSet;

/// Why a calibration failed.
#[derive(Debug, Error)]
pub enum CalibrateError {
    /// Capturing failed.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// Reduction failed.
    #[error(transparent)]
    Reduce(#[from] ReduceError),
    /// The projector's light is no response curve.
    #[error(transparent)]
    Response(#[from] ResponseError),
    /// The order is out of range.
    #[error(transparent)]
    Order(#[from] OrderError),
    /// The photograph of the screen has dark spots.
    #[error(
        "the flat field is not positive everywhere in the zone: is the screen in front of the mirrors and lit evenly?"
    )]
    DarkFlatField,
    /// The gray card gives no scale.
    #[error(
        "the gray card answers with no light in some ring or channel: is it in the sample's place, and the lamp on?"
    )]
    DarkGrayCard,
    /// A cross was not found.
    #[error(
        "the {which} cross is not to be seen: is it in place, the paraboloid removed, the lamp on, and everything within \
         some mm and deg of the axis?"
    )]
    NoCross {
        /// Which one.
        which: &'static str,
    },
    /// Too few pixels see fringes.
    #[error(
        "only {pairs} pixels see fringes in the mirror, too few for a map: is the mirror in the sample's place, clean and \
         flat, and the lamp on?"
    )]
    NoFringes {
        /// Pixels that see them.
        pairs: usize,
    },
    /// The rig asks for a zone that its misaligned mirrors do not give.
    #[error(
        "the rig's zone {:.2}..{:.2} deg reaches beyond what its map allows, {:.2}..{:.2} deg at every azimuth: set \
         zone.theta_min_deg and zone.theta_max_deg within it and calibrate anew, or align the rig",
        asked_deg[0], asked_deg[1], allowed_deg[0], allowed_deg[1]
    )]
    ZoneBeyondMap {
        /// Limits of the rig's zone, degrees.
        asked_deg: [f64; 2],
        /// Limits of what all azimuths show, degrees.
        allowed_deg: [f64; 2],
    },
    /// A calibration belongs to another rig.
    #[error("{path} was made for the rig `{found}`, this is `{expected}`: calibrate this rig")]
    OtherRig {
        /// The file.
        path: String,
        /// Rig it was made for.
        found: String,
        /// Rig in use.
        expected: String,
    },
    /// A calibration was made for another rig of this name.
    #[error(
        "{path} was made for the rig `{rig}` when its file was another (fingerprint {found}, now {expected}): calibrate \
         again, or put the rig file back"
    )]
    ChangedRig {
        /// The file.
        path: String,
        /// Name of both rigs.
        rig: String,
        /// Fingerprint it was made for.
        found: String,
        /// Fingerprint of the rig in use.
        expected: String,
    },
    /// A calibration belongs to other devices.
    #[error("{path} was made on {found} devices, these are {expected}: calibrate these")]
    OtherDevices {
        /// The file.
        path: String,
        /// `real` or `simulated`.
        found: &'static str,
        /// `real` or `simulated`.
        expected: &'static str,
    },
    /// A calibration is too old.
    #[error(
        "{path} is {age_days:.0} days old (made {date}), {max_age_days} are allowed: run `zonal calibrate {}` again, or \
         raise --max-age-days",
        kind.command()
    )]
    TooOld {
        /// The file.
        path: String,
        /// When it was made.
        date: Timestamp,
        /// Its age, days.
        age_days: f64,
        /// Greatest age allowed, days.
        max_age_days: f64,
        /// What it holds.
        kind: Kind,
    },
    /// A calibration was made with files that have since been replaced.
    #[error(
        "{path} was made before {newer} beside it, with which it is measured: run `zonal calibrate {}` again",
        kind.command()
    )]
    Outdated {
        /// The file.
        path: String,
        /// File that is newer.
        newer: &'static str,
        /// What it holds.
        kind: Kind,
    },
    /// The projector's colours are wanted and not known.
    #[error(
        "the projector's colours need colour.json in the calibration folder: run `zonal calibrate colour`, or ask for \
         `--colour camera`"
    )]
    NoColour,
    /// Light of three colours gives no matrix.
    #[error(transparent)]
    Colour(#[from] ColourError),
    /// A camera of many codes needs no response.
    #[error(
        "the camera delivers samples up to {brightest}, more than the 256 codes of a camera that is not linear: leave this out, \
         and see with `zonal calibrate linearity` how linear it is"
    )]
    ManyCodes {
        /// Greatest sample.
        brightest: u16,
    },
    /// Photographs show no response.
    #[error(transparent)]
    Stack(#[from] StackError),
    /// Frames give no figures of the camera.
    #[error(transparent)]
    Transfer(#[from] TransferError),
    /// Frames show no linear range.
    #[error(transparent)]
    Linearity(#[from] LinearityError),
    /// The reference cannot be opened.
    #[error(transparent)]
    Reference(#[from] MaterialError),
    /// A data set of frames cannot be used.
    #[error(transparent)]
    Emva(#[from] EmvaError),
    /// A file could not be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
}
