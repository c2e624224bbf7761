//! The procedures that measure what a measurement must know of the rig, and the files they leave.

mod emva;
mod procedures;
mod set;

use thiserror::Error;

use crate::basis::OrderError;
use crate::capture::CaptureError;
use crate::radiometry::ResponseError;
use crate::reduce::ReduceError;
use crate::store::StoreError;

pub use emva::{EmvaDescription, EmvaError, EmvaGroup};
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
