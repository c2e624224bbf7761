//! What the projector shows: lobes of the zonal basis and fringes as frames, and the acquisition plan as data.

mod fringes;
mod lobes;
mod plan;
mod tag;

pub use fringes::{Coordinate, Fringes};
pub use lobes::{Lobe, LobePair, Lobes, Pattern, Primary, Sign};
pub use plan::{AutomaticBracket, Colour, Exitant, ExposureBracket, Plan, PlanError, RigTime, Timing};
pub use tag::{Rect, TagBit, TagLayout};
