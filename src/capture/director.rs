//! Which steps of a run are taken.

use std::time::Instant;

/// What a run has taken of the rig's time so far.
#[derive(Debug, Clone, Copy)]
pub struct Spent {
    /// Taking frames, s.
    pub frames_s: f64,
    /// Decisions before, s.
    decided_s: f64,
    /// Since when the rig has been waiting for this one.
    waiting_since: Option<Instant>,
}

impl Spent {
    /// Frames and decisions of so many seconds, while the rig waits for another decision.
    pub fn waiting(frames_s: f64, decided_s: f64, since: Instant) -> Self {
        Self { frames_s, decided_s, waiting_since: Some(since) }
    }

    /// Frames alone: whoever takes up a run does not ask anew whether there was time for what was begun.
    pub fn frames(frames_s: f64) -> Self {
        Self { frames_s, decided_s: 0.0, waiting_since: None }
    }

    /// All of it up to now, s: it grows while a decision is made.
    pub fn total_s(&self) -> f64 {
        self.frames_s + self.decided_s + self.waiting_since.map_or(0.0, |since| since.elapsed().as_secs_f64())
    }
}

/// Says which steps to take, a few at a time.
pub trait Director {
    /// Steps to take next; none ends the run. An adaptive director is asked when all before have reached the run's sink.
    fn next(&mut self, spent: &Spent) -> Vec<usize>;

    /// Whether it looks at what was taken before it says more.
    fn is_adaptive(&self) -> bool;

    /// Steps expected on the whole, for progress.
    fn expected(&self) -> usize;
}

/// All steps, in order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AllSteps {
    steps: usize,
    asked: bool,
}

impl AllSteps {
    /// A run of so many steps.
    pub fn new(steps: usize) -> Self {
        Self { steps, asked: false }
    }
}

impl Director for AllSteps {
    fn next(&mut self, _: &Spent) -> Vec<usize> {
        let first = !std::mem::replace(&mut self.asked, true);
        if first { (0..self.steps).collect() } else { Vec::new() }
    }

    fn is_adaptive(&self) -> bool {
        false
    }

    fn expected(&self) -> usize {
        self.steps
    }
}
