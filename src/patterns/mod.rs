//! What the projector shows: lobes of the zonal basis and fringes as frames, and the acquisition plan as data.

mod fringes;
mod lobes;
mod plan;

pub use fringes::{Coordinate, Fringes};
pub use lobes::{Lobe, LobePair, Lobes, Pattern, Sign};
pub use plan::{Event, Exitant, ExposureBracket, Plan, PlanError, RigTime, Timing};
