//! One file per format.

mod bsdf;
mod sh;

pub use bsdf::{BsdfError, bsdf_bytes, write_bsdf};
pub use sh::ShMaterial;
