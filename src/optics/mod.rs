//! Mirrors, lenses and the map from pixels to directions. Pure.

mod map;
mod mirrors;
mod rig;

pub use map::{Lens, OpticalMap};
pub use mirrors::{Mirrors, Path};
pub use rig::{Arm, Camera, Dome, Mosaic, Paraboloid, Projector, Rig, RigError, ZoneLimits};
