//! Cameras and projectors as the engine sees them: a factory that can be asked and opened, and an open session.
//!
//! All times are seconds on one monotonic clock, the bench's: a camera's timestamps, the moment a projector is lit and the
//! engine's own waiting.

use std::fmt;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::CaptureError;
use crate::patterns::Pattern;

/// The clock that devices and engine share.
pub trait Clock: Send + Sync {
    /// Seconds since some moment before the run.
    fn now_s(&self) -> f64;

    /// Returns at `time_s`, at once if that has passed.
    fn sleep_until_s(&self, time_s: f64);
}

/// What a camera does when it is not asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Triggering {
    /// It waits for [`Camera::trigger`].
    Triggered,
    /// It takes frame after frame; the engine picks those that show the right pattern.
    FreeRunning,
}

/// What a camera can do.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraLimits {
    /// Make, model and address, for messages.
    pub name: String,
    /// Columns of a frame.
    pub width: usize,
    /// Rows of a frame.
    pub height: usize,
    /// Shortest exposure time, s.
    pub shortest_s: f64,
    /// Longest exposure time, s.
    pub longest_s: f64,
    /// Step in which its exposure time can be set, s; 0 where any can.
    pub exposure_step_s: f64,
    /// Frames of a free-running camera from a change of exposure until the new one is in force for certain; 0 where the next
    /// frame has it.
    pub settling_frames: u32,
    /// How frames are asked for.
    pub triggering: Triggering,
    /// Shortest time from one start of exposure to the next, s.
    pub frame_s: f64,
    /// Time from the end of an exposure to the frame's delivery, s.
    pub readout_s: f64,
}

/// What a projector can do.
#[derive(Debug, Clone, PartialEq)]
pub struct ProjectorLimits {
    /// Make, model and address, for messages.
    pub name: String,
    /// Columns of a frame.
    pub width: usize,
    /// Rows of a frame.
    pub height: usize,
    /// Refresh rate, Hz.
    pub refresh_hz: f64,
    /// Frames it can hold, if it is one with pattern memory.
    pub memory: Option<usize>,
}

/// What a camera says against a frame of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameFlags {
    /// The driver marks it as damaged.
    pub corrupt: bool,
    /// Lines or packets are missing.
    pub incomplete: bool,
}

impl FrameFlags {
    /// Whether nothing speaks against the frame.
    pub fn good(self) -> bool {
        self == Self::default()
    }
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
    /// Exposure time the frame was taken with, s; NaN while it is changed and the camera does not say.
    pub exposure_s: f64,
    /// Gain the frame was taken with; 1 is the calibrated one.
    pub gain: f64,
    /// Consecutive number given by the camera.
    pub sequence: u64,
    /// Start of exposure, s.
    pub timestamp_s: f64,
    /// What speaks against it.
    pub flags: FrameFlags,
}

/// A camera that can be opened.
pub trait CameraFactory {
    /// What it can do, as far as is known before it is opened.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn limits(&self) -> Result<CameraLimits, CaptureError>;

    /// Opens it; its settings are kept to be restored.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn open(&self) -> Result<Box<dyn Camera>, CaptureError>;
}

/// A camera that is open.
pub trait Camera: Send {
    /// Sets the exposure time of frames to come and returns the one achieved, s.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn set_exposure(&mut self, exposure_s: f64) -> Result<f64, CaptureError>;

    /// Sets the gain of frames to come and returns the one achieved; 1 is the calibrated one.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn set_gain(&mut self, gain: f64) -> Result<f64, CaptureError>;

    /// Begins to deliver frames, counted from `first` where the camera lets its counter be set.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn start(&mut self, first: u64) -> Result<(), CaptureError>;

    /// Begins an exposure and returns at once, or, of a camera that does not tell when it begins, when it is over; only for
    /// [`Triggering::Triggered`].
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn trigger(&mut self) -> Result<(), CaptureError>;

    /// The next frame, or `None` if none came within `timeout_s`.
    ///
    /// # Errors
    /// [`CaptureError::Device`] if the camera is lost.
    fn receive(&mut self, timeout_s: f64) -> Result<Option<Frame>, CaptureError>;

    /// Stops, and puts back the settings it was opened with.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn restore(&mut self) -> Result<(), CaptureError>;
}

/// A projector that can be opened.
pub trait ProjectorFactory {
    /// What it can do, as far as is known before it is opened.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn limits(&self) -> Result<ProjectorLimits, CaptureError>;

    /// Opens it; its mode is kept to be restored.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn open(&self) -> Result<Box<dyn Projector>, CaptureError>;
}

/// A projector that is open.
pub trait Projector: Send {
    /// Hands over a sequence of frames, replacing an earlier one. Projectors with pattern memory upload it.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn load(&mut self, sequence: &[Pattern]) -> Result<(), CaptureError>;

    /// Asks for one frame of the sequence and returns, without waiting, the time from which all of it is lit as far as the
    /// projector knows; what it does not know, the engine measures.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn show(&mut self, index: usize) -> Result<f64, CaptureError>;

    /// Puts back the mode it was opened with.
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn restore(&mut self) -> Result<(), CaptureError>;
}

/// What stands in the light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Placement {
    /// The sample to measure.
    Sample,
    /// The 18% gray card in the sample's place.
    GrayCard,
    /// A black trap in the sample's place: what is seen then is stray light.
    BlackTrap,
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
            Placement::BlackTrap => "the black trap in the sample's place",
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
    fn camera(&self) -> &dyn CameraFactory;

    /// The projector.
    fn projector(&self) -> &dyn ProjectorFactory;

    /// The clock of both.
    fn clock(&self) -> Arc<dyn Clock>;

    /// Has `what` put in place (an operator is asked; a simulation obeys).
    ///
    /// # Errors
    /// [`CaptureError::Device`].
    fn place(&mut self, what: Placement) -> Result<(), CaptureError>;

    /// Is told what will be shown of the thing in place, before devices are made ready: a simulation computes it all at once.
    fn foresee(&mut self, _patterns: &[Pattern]) {}
}
