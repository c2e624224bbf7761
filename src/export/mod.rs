//! One file per format.

mod sh;

pub use sh::ShMaterial;
