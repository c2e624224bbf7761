//! The procedures that measure what a measurement must know of the rig, and the files they leave.

mod align;
mod crosses;
mod emva;
mod least_squares;
mod map;
mod pairs;
mod procedures;
mod set;

use thiserror::Error;

use crate::basis::OrderError;
use crate::capture::CaptureError;
use crate::radiometry::ResponseError;
use crate::reduce::ReduceError;
use crate::store::StoreError;

pub use align::{AxisAlignment, DeviceAlignment, align};
pub use emva::{EmvaDescription, EmvaError, EmvaGroup};
pub use map::{Maps, RigMap, map};
pub use procedures::{
    GRAY_CARD_ALBEDO, GrayCardCheck, flat_field, gray_card, gray_card_coefficients, gray_card_plan, response,
};
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
         zone.theta_min_deg and zone.theta_max_deg within it and calibrate flat field and gray card again, or align the rig",
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
    /// A file could not be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
}
