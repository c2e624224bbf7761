//! What further coefficients are worth to the fit of a sample.

use crate::measure::{Advice, Adviser, Decision, SoFar};

/// Advises by fits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FitAdviser;

impl Adviser for FitAdviser {
    fn advise(&self, so_far: &SoFar<'_>) -> (Advice, Decision) {
        let decision = Decision {
            order: so_far.coefficients.order,
            images: 0,
            error: 0.0,
            saving: None,
            anisotropy: so_far.anisotropy,
            reason: String::new(),
        };
        (Advice::Further, decision)
    }
}
