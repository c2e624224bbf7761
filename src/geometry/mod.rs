//! Directions in frames, zones of the hemisphere, quadrature and direction grids. Pure.

mod direction;
mod great_circles;
mod grid;
pub mod quadrature;
mod zone;

pub use direction::{Direction, Rig, Sample};
pub use great_circles::{Fineness, zone_about_mirror};
pub use grid::ExitantGrid;
pub use zone::{Zone, ZoneError};
