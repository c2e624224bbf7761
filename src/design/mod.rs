//! Designing a rig: what a dome will measure, what its tolerances cost, and which dimensions serve best. Pure.

mod height;
mod measured;
mod seen;
mod survey;
mod tolerance;

pub use height::{HeightError, height_errors};
pub use measured::{MeasuredError, MeasuredProfile};
pub use survey::{Angle, Limit, Pair, Survey, SurveyError, View};
pub use tolerance::{Drawn, Row, ToleranceError, ToleranceTable};
