//! What a plan will cost and bring, which plan makes the most of some seconds, and what the next step of an adaptive run is worth.

mod advice;
mod budget;
mod expected;
mod learn;
mod noise;
mod outlook;

pub use advice::FitAdviser;
pub use budget::{adaptive_plan, best_plan, candidates};
pub use expected::{Expected, Signs};
pub use learn::{contrast, ideal_coefficients, learn};
pub use noise::NoiseModel;
pub use outlook::{AtOrder, Class, ClassTable, Forecast, NoPlan, Outlook};
