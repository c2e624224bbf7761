//! The zonal basis, real spherical harmonics, and the way from one to the other. Pure.
//!
//! Both bases are one family, [`Harmonics`], on different domains: the zone stretched to the sphere is the sphere. Index
//! `k = l(l+1) + m`, no Condon-Shortley phase, sin(|m| phi) for m < 0, orthonormal for dw = sin(theta) dtheta dphi.

mod batch;
mod conversion;
mod harmonics;
mod jacobi;
mod weighted;

pub use batch::{F32_ERROR, F32_MAX_ORDER, PrecisionError};
pub use conversion::{Block, Conversion, ConversionError, Method, gram_condition};
pub use harmonics::{Harmonics, MAX_ORDER, OrderError, index, lm, size};
pub use weighted::{DualSolution, WeightedDual};
