//! From HDR responses to zonal coefficients with standard errors. Works on any stored run.

mod cells;
mod coefficients;
mod decoder;
mod displacement;
mod isotropic;
mod reducer;
mod turning;

use thiserror::Error;

use crate::basis::OrderError;
use crate::store::StoreError;

pub use cells::{CellMap, CellResponse, EDGE_RING};
pub use coefficients::{CHANNEL_NAMES, CONVENTION, Coefficients};
pub use decoder::coefficient_variances;
pub use reducer::{ChannelScale, Reduced, Reducer};

/// Why responses cannot be reduced.
#[derive(Debug, Error)]
pub enum ReduceError {
    /// A cell of the exitant grid has too few pixels.
    #[error(
        "exitant cell (ring {ring}, sector {sector}) has too few {channel} pixels: ask for fewer exitant.rings or \
         exitant.sectors in the plan"
    )]
    EmptyCell {
        /// Ring.
        ring: usize,
        /// Sector.
        sector: usize,
        /// Colour.
        channel: &'static str,
    },
    /// A response is missing.
    #[error("the responses end after {found} of {expected} frames: measure again")]
    Incomplete {
        /// Frames of steps whose both frames were seen.
        found: usize,
        /// Frames that are needed.
        expected: usize,
    },
    /// Frames that are no pairs need a black one.
    #[error("no black frame was taken, which frames of this scheme are to be compared with: measure again")]
    NoBlack,
    /// Frames that do not tell their functions apart.
    #[error(
        "{rows} combinations of frames do not determine {functions} coefficients: ask for more exitant.sectors in the plan"
    )]
    Undetermined {
        /// Combinations with a meaning.
        rows: usize,
        /// Coefficients wanted.
        functions: usize,
    },
    /// No noise can be given for a measurement without a signal.
    #[error(
        "the constant function left no signal ({saturated_percent:.0}% of pixels saturated): change the plan's exposures"
    )]
    NoSignal {
        /// Share of saturated pixels, percent.
        saturated_percent: f64,
    },
    /// Stray light was measured otherwise.
    #[error(
        "stray light is calibrated to order {order} on {} x {} directions, order {wanted_order} on {} x {} is needed: \
         calibrate the trap with this plan (`zonal calibrate black-trap --plan PLAN`), or take black-trap.exr out of the \
         calibration folder",
        grid[0], grid[1], wanted_grid[0], wanted_grid[1]
    )]
    Stray {
        /// Order measured.
        order: usize,
        /// Rings and sectors measured.
        grid: [usize; 2],
        /// Order needed.
        wanted_order: usize,
        /// Rings and sectors needed.
        wanted_grid: [usize; 2],
    },
    /// The order is out of range.
    #[error(transparent)]
    Order(#[from] OrderError),
    /// A file could not be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
}
