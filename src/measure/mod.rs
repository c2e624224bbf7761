//! A measurement: a plan run on a bench with a calibration, into a run folder that tells all.

mod adapting;
mod budget;
mod control;
mod exposing;
mod merging;
mod record;
mod reducing;
mod run;

use std::path::PathBuf;

use thiserror::Error;

use crate::basis::OrderError;
use crate::calibrate::CalibrateError;
use crate::capture::{CaptureError, RUN_FORMAT};
use crate::optics::RigError;
use crate::patterns::PlanError;
use crate::reduce::ReduceError;
use crate::store::StoreError;

pub use adapting::{Advice, Adviser, Decision, SoFar};
pub use budget::{Albedo, AlbedoAt, Assumptions, Budget, Component, Evidence, Kind, Remounts, budget_of, remounts};
pub use control::{ControlRun, ControlSeries, Signal, control_series};
pub use exposing::AutomaticExposer;
pub use merging::{Merged, merge};
pub use record::{CaptureRecord, Provenance, RunRecord};
pub use reducing::reduce_run;
pub use run::{Measurement, Request, lobe_pairs, measure, resume};

/// Why a measurement failed.
#[derive(Debug, Error)]
pub enum MeasureError {
    /// A calibration could not be used or made.
    #[error(transparent)]
    Calibrate(#[from] CalibrateError),
    /// Capturing failed.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// Reduction failed.
    #[error(transparent)]
    Reduce(#[from] ReduceError),
    /// The order is out of range.
    #[error(transparent)]
    Order(#[from] OrderError),
    /// The run's rig file is damaged.
    #[error("the run's rig.toml: {0}")]
    Rig(#[from] RigError),
    /// The run's plan file is damaged.
    #[error("the run's plan.toml: {0}")]
    Plan(#[from] PlanError),
    /// An adaptive plan asks somebody.
    #[error(
        "the plan is adaptive and nobody is there to say what a sample needs: measure with `zonal measure --adaptive`"
    )]
    NoAdviser,
    /// The run did not end.
    #[error(
        "{path} says `{status}`, not `complete`: end it with the same `zonal measure` command and --resume",
        path = path.display()
    )]
    NotComplete {
        /// The run's record.
        path: PathBuf,
        /// Its status.
        status: String,
    },
    /// The run has ended already.
    #[error("{path} says `complete`: there is nothing to resume", path = path.display())]
    Complete {
        /// The run's record.
        path: PathBuf,
    },
    /// The run was begun by a version that kept its frames otherwise.
    #[error("{path} has format {found}, runs of format {RUN_FORMAT} alone can be resumed: measure again", path = path.display())]
    OldRun {
        /// The run's record.
        path: PathBuf,
        /// Its format.
        found: u32,
    },
    /// A merged run has coefficients only.
    #[error("{path} is of merged runs, whose responses are elsewhere: reduce those, then `zonal merge` them again", path = path.display())]
    Merged {
        /// The run's record.
        path: PathBuf,
    },
    /// Runs that cannot be taken together.
    #[error("{path} differs from the first run in its {what}: leave it out, or measure again", path = path.display())]
    Unlike {
        /// The run.
        path: PathBuf,
        /// In what it differs.
        what: &'static str,
    },
    /// Too few runs to compare.
    #[error("{found} runs are too few to {purpose}: name at least {least}")]
    TooFew {
        /// How many there are.
        found: usize,
        /// How many it takes.
        least: usize,
        /// What for.
        purpose: &'static str,
    },
    /// A file of assumptions is none.
    #[error("not a budget file, correct the marked line: {0}")]
    Assumptions(String),
    /// A file could not be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
}
