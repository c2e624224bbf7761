//! Reflection models from measured coefficients, judged in the measured space.

mod forward;
mod observations;

pub use forward::{Fineness, Forward, Node};
pub use observations::{Observations, Station};
