//! One file per format.

mod bsdf;
mod density;
mod sh;

pub use bsdf::{BsdfError, bsdf_bytes, write_bsdf};
pub use density::write_density;
pub use sh::ShMaterial;
