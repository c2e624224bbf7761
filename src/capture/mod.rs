//! Cameras and projectors as traits, and the engine that runs a plan on them.

mod engine;
mod response_image;
mod run_folder;

use std::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::patterns::Pattern;
use crate::store::StoreError;

pub use engine::{Engine, Progress, capture_sequence};
pub use response_image::{Crop, ResponseImage};
pub use run_folder::{JournalEntry, RUN_FORMAT, RunFolder};

/// Why a capture ended early.
#[derive(Debug, Error)]
pub enum CaptureError {
    /// A device refused or failed.
    #[error("the {device} failed at {step}: {reason}")]
    Device {
        /// `camera` or `projector`.
        device: &'static str,
        /// What it was asked to do.
        step: String,
        /// Cause and remedy.
        reason: String,
    },
    /// A frame does not have the size the rig file states.
    #[error(
        "the camera delivers {got_width} x {got_height} px, the rig file says {width} x {height}: correct the rig file"
    )]
    FrameSize {
        /// Columns delivered.
        got_width: usize,
        /// Rows delivered.
        got_height: usize,
        /// Columns expected.
        width: usize,
        /// Rows expected.
        height: usize,
    },
    /// The camera cannot take the exposure the plan wants.
    #[error("the camera sets {achieved_s} s where the plan wants {wanted_s} s: change the plan's exposures")]
    Exposure {
        /// Exposure time asked for, s.
        wanted_s: f64,
        /// Exposure time set, s.
        achieved_s: f64,
    },
    /// A file could not be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// A camera frame: linear sensor values, row by row, and what the camera says of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Values in DN.
    pub samples: Vec<u16>,
    /// Exposure time the frame was taken with, s.
    pub exposure_s: f64,
    /// Consecutive number given by the camera.
    pub sequence: u64,
    /// Start of exposure on the camera's clock, s.
    pub timestamp_s: f64,
}

/// A camera that is open.
pub trait Camera {
    /// Sets the exposure time and returns the one achieved, s.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn set_exposure(&mut self, exposure_s: f64) -> Result<f64, CaptureError>;

    /// Takes one frame of what the projector shows now.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn grab(&mut self) -> Result<Frame, CaptureError>;
}

/// A projector that is open.
pub trait Projector {
    /// Hands over a sequence of frames, replacing an earlier one. Projectors with pattern memory upload it.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn load(&mut self, sequence: &[Pattern]) -> Result<(), CaptureError>;

    /// Shows one frame of the sequence and returns when it is lit.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn show(&mut self, index: usize) -> Result<(), CaptureError>;
}

/// What stands in the light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Placement {
    /// The sample to measure.
    Sample,
    /// The 18% gray card in the sample's place.
    GrayCard,
    /// A diffuse white screen at the focal distance, in front of the mirrors.
    Screen,
    /// A white screen with a printed cross in the sample's place, the paraboloid removed.
    PrintedCross,
    /// The same with a wire cross in the dome's opening.
    Crosses,
    /// A front-surface mirror in the sample's place, a diffuse white border around it.
    Mirror,
}

impl fmt::Display for Placement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Placement::Sample => "the sample",
            Placement::GrayCard => "the gray card",
            Placement::Screen => "the white screen at the focal distance",
            Placement::PrintedCross => "the screen with the printed cross, without paraboloid and wire cross",
            Placement::Crosses => "the wire cross above the screen with the printed cross, without paraboloid",
            Placement::Mirror => "the mirror with its white border",
        })
    }
}

/// A rig's devices, and a way to have things put into its light.
pub trait Bench {
    /// The camera.
    fn camera(&mut self) -> &mut dyn Camera;

    /// The projector.
    fn projector(&mut self) -> &mut dyn Projector;

    /// Has `what` put in place (an operator is asked; a simulation obeys).
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn place(&mut self, what: Placement) -> Result<(), CaptureError>;
}
