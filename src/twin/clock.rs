//! Time on the simulated rig: as fast as it can be computed, or as slow as it would be.

use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use crate::capture::Clock;

/// A clock that waiting itself moves on: a minute on the rig takes what its computation takes.
#[derive(Debug, Default)]
pub struct VirtualClock {
    nanoseconds: AtomicU64,
}

impl Clock for VirtualClock {
    fn now_s(&self) -> f64 {
        self.nanoseconds.load(Ordering::Relaxed) as f64 * 1e-9
    }

    fn sleep_until_s(&self, time_s: f64) {
        // Rounded up: who waits for a moment must find it come.
        self.nanoseconds.fetch_max((time_s.max(0.0) * 1e9).ceil() as u64, Ordering::Relaxed);
    }
}

/// The system's monotonic clock, from the moment this was made.
#[derive(Debug)]
pub struct RealClock {
    start: Instant,
}

impl RealClock {
    /// A clock that begins now.
    pub fn start() -> Self {
        Self { start: Instant::now() }
    }
}

impl Clock for RealClock {
    fn now_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    fn sleep_until_s(&self, time_s: f64) {
        let left_s = time_s - self.now_s();
        if left_s > 0.0 {
            thread::sleep(Duration::from_secs_f64(left_s));
        }
    }
}
