//! The zonal basis, real spherical harmonics, and the way from one to the other. Pure.
//!
//! Both bases are one type, [`Harmonics`], on different domains: the zone stretched to the sphere is the sphere. Index
//! `k = l(l+1) + m`, no Condon-Shortley phase, sin(|m| phi) for m < 0, orthonormal for dw = sin(theta) dtheta dphi.
//! A [`Conversion`] takes zonal coefficients to the functions of a [`Family`] by a [`Method`].

mod batch;
mod conversion;
mod evidence;
mod factor;
mod family;
mod gains;
mod harmonics;
mod jacobi;
mod method;
mod prior;
mod projection;
mod slepian;
mod rotation;
mod tensor;
mod weighted;

pub use batch::{F32_ERROR, F32_MAX_ORDER, PrecisionError};
pub use conversion::{Block, Conversion, ConversionError, Estimate, gram_condition};
pub use evidence::{Evidence, HARMLESS_GAIN, Rule};
pub use family::Family;
pub use harmonics::{Harmonics, MAX_ORDER, OrderError, index, lm, size};
pub use method::{Method, Strength};
pub use prior::{Learned, Member, Population, RingBlock, RingMap, RingMean};
pub use projection::Projection;
pub use rotation::{ShRotation, about_normal, about_normal_variance};
pub use slepian::{Slepian, SlepianBlock};
pub use tensor::{
    ExitantRule, HarmonicTensor, RECIPROCAL_P, Reciprocity, Tensor, TensorBlock, TensorError, edge_shift, reciprocity,
    rotation_shift,
};
pub use weighted::{DualSolution, WeightedDual};
