//! Frames that are no good: why, and how many of them end a capture.

use std::fmt;

use super::CaptureError;

/// Frames that may be no good one after the other.
const MAX_REJECTIONS: usize = 20;

/// Why a frame is not used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Rejection {
    /// None came in time.
    Missing,
    /// It came before, perhaps under another number.
    Repeated,
    /// It shows another pattern, or two of them.
    Stale,
    /// Its patch cannot be read.
    Unreadable,
    /// The camera marks it as damaged.
    Corrupt,
    /// It was taken with another exposure or gain.
    OtherExposure,
}

impl fmt::Display for Rejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Rejection::Missing => "missing",
            Rejection::Repeated => "repeated",
            Rejection::Stale => "of another pattern",
            Rejection::Unreadable => "unreadable patch",
            Rejection::Corrupt => "marked as damaged",
            Rejection::OtherExposure => "of another exposure",
        })
    }
}

/// Frames that were no good, one after the other.
#[derive(Default)]
pub(super) struct Rejections(Vec<Rejection>);

impl Rejections {
    /// Counts one, `waited_s` after the pattern was asked for.
    ///
    /// # Errors
    /// [`CaptureError::Rejected`] when it is one too many, [`CaptureError::Frozen`] if all show another pattern.
    pub fn add(&mut self, reason: Rejection, waited_s: f64) -> Result<(), CaptureError> {
        self.0.push(reason);
        if self.0.len() < MAX_REJECTIONS {
            return Ok(());
        }
        if self.0.iter().all(|&r| r == Rejection::Stale) {
            return Err(CaptureError::Frozen { waited_s });
        }
        let mut counts: Vec<(usize, Rejection)> = Vec::new();
        for &reason in &self.0 {
            match counts.iter_mut().find(|c| c.1 == reason) {
                Some(count) => count.0 += 1,
                None => counts.push((1, reason)),
            }
        }
        counts.sort_by_key(|c| std::cmp::Reverse(c.0));
        let reasons: Vec<String> = counts.iter().map(|(n, reason)| format!("{n} {reason}")).collect();
        Err(CaptureError::Rejected { count: self.0.len(), reasons: reasons.join(", ") })
    }
}
