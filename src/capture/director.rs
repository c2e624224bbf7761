//! Which steps of a run are taken.

/// Says which steps to take, a few at a time.
pub trait Director {
    /// Steps to take next; none ends the run. An adaptive director is asked when all before have reached the run's sink;
    /// `taken_s` is what they took on the rig, decisions not counted.
    fn next(&mut self, taken_s: f64) -> Vec<usize>;

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
    fn next(&mut self, _: f64) -> Vec<usize> {
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
