//! Which exposures a pair of lobes gets.

use super::ResponseImage;

/// Chooses the exposures of each pair; both lobes get the same, so that black and ambient light cancel.
pub trait Exposer {
    /// Exposures of both lobes to begin with, s.
    fn first(&self) -> Vec<f64>;

    /// Exposures to add after those, s; `pair` holds what the first have shown of step `k`'s two frames. Also told of steps
    /// that an earlier session took, so that it goes on as if there had been one session.
    fn further(&mut self, k: usize, pair: [&ResponseImage; 2]) -> Vec<f64>;

    /// Whether [`Exposer::further`] can ever add any; where not, it is not asked.
    fn is_adaptive(&self) -> bool;

    /// Frames expected for a pair on the whole, for progress.
    fn expected_frames(&self) -> usize;
}

/// The same exposures for every pair.
#[derive(Debug, Clone, PartialEq)]
pub struct Bracket(
    /// Exposure times in the order they are taken, s.
    pub Vec<f64>,
);

impl Exposer for Bracket {
    fn first(&self) -> Vec<f64> {
        self.0.clone()
    }

    fn further(&mut self, _: usize, _: [&ResponseImage; 2]) -> Vec<f64> {
        Vec::new()
    }

    fn is_adaptive(&self) -> bool {
        false
    }

    fn expected_frames(&self) -> usize {
        2 * self.0.len()
    }
}
