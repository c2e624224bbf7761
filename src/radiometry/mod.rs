//! Response curves, the camera's noise, and the HDR estimate of one pixel's exposures. Pure.

mod flat_field;
mod hdr;
mod lamp;
mod response;

pub use flat_field::FlatField;
pub use lamp::Lamp;
pub use hdr::{Estimate, Sensor};
pub use response::{Response, ResponseError};
