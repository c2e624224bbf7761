//! One file per format.

mod both_sides;
mod bsdf;
mod density;
mod sh;
mod tensor;

pub use both_sides::both_sides;
pub use bsdf::{BsdfError, bsdf_bytes, write_bsdf};
pub use density::write_density;
pub use sh::ShMaterial;
pub use tensor::TensorMaterial;
