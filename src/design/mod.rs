//! Designing a rig: what a dome will measure, what its tolerances cost, and which dimensions serve best. Pure.

mod chief;
mod dimensions;
mod front;
mod objectives;
mod search;

pub use dimensions::{Dimensions, Optics};
pub use front::{dominates, hypervolume, nondominated};
pub use objectives::Values;
pub use search::{Design, Found, Search, SearchError};
