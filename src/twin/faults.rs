//! What simulated devices do wrong on request.

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

/// Faults of the simulated camera and projector. Probabilities are per frame or per change of pattern.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Faults {
    /// Seed of what happens when.
    pub seed: u64,
    /// A frame never arrives.
    pub drop: f64,
    /// The same frame arrives twice.
    pub duplicate: f64,
    /// The former frame's samples arrive under a new number.
    pub repeat: f64,
    /// A frame arrives after the one that follows it.
    pub reorder: f64,
    /// A frame is marked as damaged.
    pub flag: f64,
    /// A change of pattern comes late, by up to `late_s`.
    pub late: f64,
    /// See `late`.
    pub late_s: f64,
    /// The projector no longer changes after so many changes of pattern.
    pub stuck_after: Option<u64>,
    /// The camera is gone after so many frames.
    pub lost_after: Option<u64>,
}

impl Default for Faults {
    fn default() -> Self {
        Self {
            seed: 0,
            drop: 0.0,
            duplicate: 0.0,
            repeat: 0.0,
            reorder: 0.0,
            flag: 0.0,
            late: 0.0,
            late_s: 0.1,
            stuck_after: None,
            lost_after: None,
        }
    }
}

/// What happens to one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FrameFault {
    None,
    Drop,
    Duplicate,
    Repeat,
    Reorder,
    Flag,
}

impl Faults {
    /// What happens to the frame with this count.
    pub(super) fn of_frame(&self, count: u64) -> FrameFault {
        let chances = [
            (self.drop, FrameFault::Drop),
            (self.duplicate, FrameFault::Duplicate),
            (self.repeat, FrameFault::Repeat),
            (self.reorder, FrameFault::Reorder),
            (self.flag, FrameFault::Flag),
        ];
        let mut x: f64 = generator(self.seed, count, 1).random();
        for (chance, fault) in chances {
            if x < chance {
                return fault;
            }
            x -= chance;
        }
        FrameFault::None
    }

    /// What the change of pattern with this count is late by, s; `None` if it never comes.
    pub(super) fn of_change(&self, count: u64) -> Option<f64> {
        if self.stuck_after.is_some_and(|n| count >= n) {
            return None;
        }
        let mut rng = generator(self.seed, count, 2);
        Some(if rng.random::<f64>() < self.late { self.late_s * rng.random::<f64>() } else { 0.0 })
    }

    /// Whether a camera that has delivered so many frames is gone.
    pub(super) fn lost(&self, frames: u64) -> bool {
        self.lost_after.is_some_and(|n| frames >= n)
    }
}

fn generator(seed: u64, count: u64, what: u64) -> Xoshiro256PlusPlus {
    let mixed =
        seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (count + 1).wrapping_mul(0xD1B5_4A32_D192_ED03) ^ (what << 56);
    Xoshiro256PlusPlus::seed_from_u64(mixed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_come_as_often_as_asked() {
        let faults =
            Faults { drop: 0.1, repeat: 0.2, late: 0.5, late_s: 1.0, stuck_after: Some(9000), ..Faults::default() };
        let count = |fault| (0..10_000).filter(|&i| faults.of_frame(i) == fault).count() as f64;
        // Three standard deviations of a binomial.
        assert!((count(FrameFault::Drop) - 1000.0).abs() < 90.0);
        assert!((count(FrameFault::Repeat) - 2000.0).abs() < 120.0);
        assert_eq!(count(FrameFault::Flag), 0.0);
        let late: Vec<f64> = (0..9000).filter_map(|i| faults.of_change(i)).filter(|&s| s > 0.0).collect();
        assert!((late.len() as f64 - 4500.0).abs() < 150.0);
        assert!(late.iter().all(|&s| s <= 1.0));
        assert_eq!(faults.of_change(9000), None);
    }
}
