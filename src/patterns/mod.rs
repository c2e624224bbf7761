//! What the projector shows: lobes of the zonal basis as frames, and the acquisition plan as data.

mod lobes;
mod plan;

pub use lobes::{Lobe, LobePair, Lobes, Pattern, Sign};
pub use plan::{Event, Exitant, ExposureBracket, Plan, PlanError, RigTime, Timing};
