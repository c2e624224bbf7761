//! Cameras and projectors as traits, and the engine that runs a plan on them.

mod acquisition;
mod device;
mod director;
mod engine;
mod exposer;
mod free_running;
mod journal;
mod limits;
mod prepare;
mod rejections;
mod response_image;
mod run_folder;
mod sequence;
mod state;
mod tag_reader;
mod worker;

use thiserror::Error;

use crate::store::StoreError;

pub use acquisition::{Effort, Taken, sensor};
pub use device::{
    Bench, Camera, CameraFactory, CameraLimits, Clock, Frame, FrameFlags, Placement, Projector, ProjectorFactory,
    ProjectorLimits, Triggering,
};
pub use director::{AllSteps, Director, Spent};
pub use engine::{Engine, Progress, Run, RunSummary};
pub use exposer::{Bracket, Exposer};
pub use journal::{Journal, JournalEntry, Recorded};
pub use limits::check_devices;
pub use rejections::Rejection;
pub use response_image::{Crop, ResponseImage, SensorMaps};
pub use run_folder::{RUN_FORMAT, RunFolder};
pub use sequence::{KeepFrame, capture_frames, capture_sequence};
pub use state::{Control, Input, State};
pub use tag_reader::{TagModel, TagProblem, TagReading, Verdict};

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
    /// A device could not be used from the start: nothing was shown, nothing is stored.
    #[error(transparent)]
    Unusable(Box<CaptureError>),
    /// A device cannot do what rig and plan ask for.
    #[error("the {device} {name} {problem}: {remedy}")]
    Limits {
        /// `camera` or `projector`.
        device: &'static str,
        /// Its name.
        name: String,
        /// What it cannot do.
        problem: String,
        /// What to change.
        remedy: &'static str,
    },
    /// The camera cannot take the exposure the plan wants.
    #[error("the camera sets {achieved_s} s where the plan wants {wanted_s} s: change the plan's exposures")]
    Exposure {
        /// Exposure time asked for, s.
        wanted_s: f64,
        /// Exposure time set, s.
        achieved_s: f64,
    },
    /// Nothing of the coded patch can be read.
    #[error(
        "the camera does not see the coded patch ({problem}): put a white, better a retro-reflective ring around the \
         sample beyond the paraboloid's shadow, or set `tag = false` in the rig's [projector] if there is no room for one"
    )]
    NoTag {
        /// What was seen instead.
        problem: String,
    },
    /// The projector does not change what it shows.
    #[error(
        "the projector still shows its former frame {waited_s:.1} s after it was asked for another: is it frozen, on \
         another input or mirrored to another screen? Then resume the run"
    )]
    Frozen {
        /// Time waited, s.
        waited_s: f64,
    },
    /// Frame after frame was no good.
    #[error(
        "{count} frames in a row were no good ({reasons}): check the cable, the bandwidth and other users of the camera, \
         then resume the run"
    )]
    Rejected {
        /// How many.
        count: usize,
        /// Why, the commonest first.
        reasons: String,
    },
    /// Somebody asked to stop.
    #[error("stopped on request after {done} of {total} frames: resume with the same command and --resume")]
    Stopped {
        /// Frames taken.
        done: usize,
        /// Frames planned.
        total: usize,
    },
    /// Where in a run something else went wrong.
    #[error("frame {index} ({lobe}, exposure {exposure_ms:.1} ms): {source}")]
    At {
        /// Position of the frame in the run.
        index: usize,
        /// What was shown.
        lobe: String,
        /// Exposure time, ms.
        exposure_ms: f64,
        /// What went wrong.
        source: Box<CaptureError>,
    },
    /// Nobody is there to put something in place.
    #[error("{what} must be put in place: run this in a terminal, where you are asked for it")]
    NotPlaced {
        /// What is needed.
        what: Placement,
    },
    /// Somebody asked to stop instead of putting something in place.
    #[error("stopped on request before this was in place: {what}")]
    Declined {
        /// What is needed.
        what: Placement,
    },
    /// A file could not be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl CaptureError {
    /// The error itself, without the place where it happened.
    pub fn cause(&self) -> &Self {
        match self {
            CaptureError::At { source, .. } => source.cause(),
            other => other,
        }
    }

    /// The same of a device that has not shown or taken anything yet.
    fn at_the_start(self) -> Self {
        match self {
            CaptureError::Device { .. } => CaptureError::Unusable(Box::new(self)),
            other => other,
        }
    }
}
