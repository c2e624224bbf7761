//! Response curves, the camera's noise, and the HDR estimate of one pixel's exposures. Pure.

mod censored;
mod flat_field;
mod hdr;
mod response;

pub use flat_field::FlatField;
pub use hdr::{Estimate, ExposedRows, PixelMaps, Rows, Sensor};
pub use response::{Response, ResponseError};
