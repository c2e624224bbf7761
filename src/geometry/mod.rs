//! Directions in frames, zones of the hemisphere, quadrature and direction grids. Pure.

mod direction;
mod grid;
pub mod quadrature;
mod zone;

pub use direction::{Direction, Rig, Sample};
pub use grid::ExitantGrid;
pub use zone::{Zone, ZoneError};
