//! The engine's states, and what leads from one to the next: a table, so that nothing else can happen.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

/// Where a run is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// Nothing is open.
    Idle,
    /// Plan, rig, devices and folder are compared; nothing moves.
    Checking,
    /// Devices are open; the coded patch is learned and the latency measured.
    Preparing,
    /// Frames are taken.
    Running,
    /// Between two frames, until told to go on.
    Paused,
    /// All frames are there; the last responses are merged and stored.
    Finishing,
    /// Devices get their former settings back.
    Restoring,
    /// The end: all is there, or the folder holds what is.
    Done,
}

/// What happens to a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Input {
    /// A plan is given.
    Begin,
    /// Everything fits.
    Checked,
    /// Devices are ready.
    Prepared,
    /// Somebody asks to wait.
    Pause,
    /// Somebody asks to go on.
    Resume,
    /// The plan has no more frames.
    Exhausted,
    /// The last response is stored.
    Stored,
    /// Somebody asks to stop.
    Abort,
    /// Something failed.
    Fault,
    /// Devices are as they were.
    Restored,
}

/// Every transition there is.
const TABLE: [(State, Input, State); 18] = {
    use Input::*;
    use State::*;
    [
        (Idle, Begin, Checking),
        (Checking, Checked, Preparing),
        (Checking, Fault, Done),
        (Preparing, Prepared, Running),
        (Preparing, Abort, Restoring),
        (Preparing, Fault, Restoring),
        (Running, Pause, Paused),
        (Running, Exhausted, Finishing),
        (Running, Abort, Restoring),
        (Running, Fault, Restoring),
        (Paused, Resume, Running),
        (Paused, Abort, Restoring),
        (Paused, Fault, Restoring),
        (Finishing, Stored, Restoring),
        (Finishing, Fault, Restoring),
        (Restoring, Restored, Done),
        (Restoring, Fault, Done),
        (Done, Begin, Checking),
    ]
};

impl State {
    /// The state after `input`; `None` if that cannot happen here.
    pub fn after(self, input: Input) -> Option<Self> {
        TABLE.iter().find(|(from, by, _)| *from == self && *by == input).map(|(_, _, to)| *to)
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            State::Idle => "idle",
            State::Checking => "checking",
            State::Preparing => "preparing",
            State::Running => "running",
            State::Paused => "paused",
            State::Finishing => "finishing",
            State::Restoring => "restoring",
            State::Done => "done",
        })
    }
}

/// A way to pause, resume and stop a run from outside: a signal handler, a console. Clones steer the same run.
#[derive(Debug, Clone, Default)]
pub struct Control(Arc<AtomicU8>);

const GO: u8 = 0;
const PAUSE: u8 = 1;
const STOP: u8 = 2;

impl Control {
    /// Asks to wait after the frame under way. A run that was told to stop still stops.
    pub fn pause(&self) {
        let _ = self.0.compare_exchange(GO, PAUSE, Ordering::Relaxed, Ordering::Relaxed);
    }

    /// Asks to go on.
    pub fn resume(&self) {
        let _ = self.0.compare_exchange(PAUSE, GO, Ordering::Relaxed, Ordering::Relaxed);
    }

    /// Asks to stop after the frame under way; the run can be resumed later.
    pub fn abort(&self) {
        self.0.store(STOP, Ordering::Relaxed);
    }

    /// Whether the run should wait.
    pub fn paused(&self) -> bool {
        self.0.load(Ordering::Relaxed) == PAUSE
    }

    /// Whether the run should stop.
    pub fn aborted(&self) -> bool {
        self.0.load(Ordering::Relaxed) == STOP
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn no_transition_is_said_twice_and_every_state_leads_to_the_end() {
        let sources: HashSet<_> = TABLE.iter().map(|(from, by, _)| (*from, *by)).collect();
        assert_eq!(sources.len(), TABLE.len());
        for (start, ..) in TABLE {
            let mut reached = HashSet::from([start]);
            for _ in 0..TABLE.len() {
                let next: Vec<_> =
                    TABLE.iter().filter(|(from, ..)| reached.contains(from)).map(|(.., to)| *to).collect();
                reached.extend(next);
            }
            assert!(reached.contains(&State::Done), "{start}");
        }
    }

    #[test]
    fn open_devices_are_restored_on_every_way_out() {
        for (from, by, to) in TABLE {
            let open = |s| !matches!(s, State::Idle | State::Checking | State::Done);
            let ends = open(from) && !open(to);
            assert!(!ends || from == State::Restoring, "{from} ends by {by:?} without restoring");
        }
    }

    #[test]
    fn a_stop_outlives_a_pause_and_what_cannot_happen_does_not() {
        let control = Control::default();
        control.pause();
        assert!(control.paused());
        control.clone().resume();
        assert!(!control.paused());
        control.abort();
        control.pause();
        control.resume();
        assert!(control.aborted());
        assert_eq!(State::Idle.after(Input::Resume), None);
        assert_eq!(State::Paused.after(Input::Exhausted), None);
    }
}
