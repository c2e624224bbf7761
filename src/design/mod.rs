//! Designing a rig: what a dome will measure, what its tolerances cost, and which dimensions serve best. Pure.

mod chief;
mod dimensions;
mod front;
mod height;
mod measured;
mod objectives;
mod search;
mod seen;
mod survey;
mod tolerance;

pub use dimensions::{Dimensions, Optics};
pub use front::{dominates, hypervolume, nondominated};
pub use height::{HeightError, height_errors};
pub use measured::{MeasuredError, MeasuredProfile};
pub use objectives::Values;
pub use search::{Design, Found, Search, SearchError};
pub use survey::{Angle, Limit, Pair, Survey, SurveyError, View};
pub use tolerance::{Drawn, Row, ToleranceError, ToleranceTable};
