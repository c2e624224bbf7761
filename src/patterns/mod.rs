//! What the projector shows: lobes of the zonal basis and fringes as frames, and the acquisition plan as data.

mod fringes;
mod lobes;
mod plan;
mod scheme;
mod tag;

pub use fringes::{Coordinate, Fringes};
pub use lobes::{Lobe, LobePair, Lobes, Pattern, Primary, Sign};
pub use plan::{Adaptive, AutomaticBracket, Colour, Exitant, ExposureBracket, Plan, PlanError, RigTime, Stage, Timing};
pub use scheme::{HIGHEST_MIXED, Mixture, Scheme, SchemeError, Step, noise_advantage};
pub use tag::{Rect, TagBit, TagLayout};
