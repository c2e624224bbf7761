//! Response curves, the camera's noise, and the HDR estimate of one pixel's exposures. Pure.

mod bounded;
mod camera_response;
mod censored;
mod colour;
mod flat_field;
mod hdr;
mod lamp;
mod linearity;
mod response;
mod transfer;

pub use camera_response::{CODES, CameraResponse, Stack, StackError, UNIT_CODE};
pub use colour::{ColourError, ColourMatrix, ColourSpace};
pub use flat_field::FlatField;
pub use hdr::{Estimate, ExposedRows, PixelMaps, Rows, Sensor};
pub use lamp::Lamp;
pub use linearity::{LinearRange, LinearityError};
pub use response::{Response, ResponseError};
pub use transfer::{DarkMaps, Level, MIN_STACK, NonUniformity, PairMoments, PhotonTransfer, TransferError};
