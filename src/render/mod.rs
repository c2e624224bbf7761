//! Preview images: a sphere or a cylinder of a material under a directional light or a light probe.
//!
//! All happens in the frame [`View`] of the picture. Values are linear and may be negative, as reconstructions are; only
//! encoding to 8 bits clamps them.

mod image;
mod lights;
mod probe;
mod shape;

pub use image::Image;
pub(crate) use image::rgb_png;
pub use lights::ProbeLight;
pub use probe::{Probe, ProbeError};
pub use shape::Shape;

/// The frame of a picture: +x to its right, +y up, +z towards the camera, which looks along -z.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct View;
