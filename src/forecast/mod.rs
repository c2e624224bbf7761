//! What a plan will cost and bring, and what the next step of an adaptive run is worth.

mod advice;

pub use advice::FitAdviser;
