//! When frames of a camera began that only stamps them, and how long they were exposed.

use super::Stamp;

/// From `linux/videodev2.h`: which clock a stamp is of, and whether it tells the start.
const CLOCK_MASK: u32 = 0xe000;
const CLOCK_MONOTONIC: u32 = 0x2000;
const STAMPED_AT_START: u32 = 0x0001_0000;

/// The way from stamps to exposures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Timing {
    stamp: Stamp,
    frame_s: f64,
    readout_s: f64,
    settling_frames: u32,
    /// Exposure time before the last change; NaN if it was not known for certain.
    former_s: f64,
    exposure_s: f64,
    changed_s: f64,
}

impl Timing {
    /// Of a camera with these figures, whose exposure is not known yet.
    pub fn new(stamp: Stamp, frame_s: f64, readout_s: f64, settling_frames: u32) -> Self {
        let (former_s, exposure_s, changed_s) = (f64::NAN, f64::NAN, f64::NEG_INFINITY);
        Self { stamp, frame_s, readout_s, settling_frames, former_s, exposure_s, changed_s }
    }

    /// Notes that the exposure is changed now.
    pub fn change(&mut self, exposure_s: f64, now_s: f64) {
        self.former_s = if now_s >= self.settled_s() { self.exposure_s } else { f64::NAN };
        (self.exposure_s, self.changed_s) = (exposure_s, now_s);
    }

    /// From when on frames have the exposure last set.
    fn settled_s(&self) -> f64 {
        let period_s = self.frame_s.max(self.exposure_s).max(self.former_s);
        self.changed_s + f64::from(self.settling_frames) * period_s
    }

    /// Start and length of the exposure of a frame stamped `stamp_s` with these flags that arrived at `now_s`, s. The start is
    /// rather too early than too late where it is not certain; the length is NaN while a change is on its way.
    pub fn of(&self, stamp_s: f64, flags: u32, now_s: f64) -> [f64; 2] {
        let (stamp, stamp_s) = if flags & CLOCK_MASK == CLOCK_MONOTONIC {
            (self.stamp, stamp_s)
        } else {
            // Another clock's time says nothing: it has been read out by now.
            (Stamp::Readout, now_s)
        };
        let start_s = |exposure_s: f64| match stamp {
            Stamp::Start => stamp_s,
            Stamp::End => stamp_s - exposure_s,
            Stamp::Auto if flags & STAMPED_AT_START != 0 => stamp_s,
            Stamp::Auto | Stamp::Readout => stamp_s - exposure_s - self.readout_s,
        };
        if start_s(self.exposure_s) >= self.settled_s() {
            return [start_s(self.exposure_s), self.exposure_s];
        }
        let before = start_s(self.former_s) < self.changed_s;
        [start_s(self.exposure_s.max(self.former_s)), if before { self.former_s } else { f64::NAN }]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: u32 = CLOCK_MONOTONIC | STAMPED_AT_START;

    /// 30 frames a second, 10 ms of readout, two frames to settle; exposed for 20 ms since long ago.
    fn timing(stamp: Stamp) -> Timing {
        let mut timing = Timing::new(stamp, 0.033, 0.01, 2);
        timing.change(0.02, 0.0);
        timing
    }

    fn near(found: [f64; 2], expected: [f64; 2]) {
        for (f, e) in found.into_iter().zip(expected) {
            assert!((f - e).abs() < 1e-9 || f.is_nan() && e.is_nan(), "{found:?} instead of {expected:?}");
        }
    }

    #[test]
    fn stamps_mean_what_flags_and_settings_say() {
        near(timing(Stamp::Auto).of(5.0, START, 5.1), [5.0, 0.02]);
        near(timing(Stamp::Auto).of(5.0, CLOCK_MONOTONIC, 5.1), [4.97, 0.02]);
        near(timing(Stamp::End).of(5.0, START, 5.1), [4.98, 0.02]);
        near(timing(Stamp::Start).of(5.0, CLOCK_MONOTONIC, 5.1), [5.0, 0.02]);
        // The time of day is no time of this clock.
        near(timing(Stamp::Auto).of(1.7e9, 0, 5.1), [5.07, 0.02]);
    }

    #[test]
    fn a_change_is_believed_when_it_has_settled() {
        let mut timing = timing(Stamp::Start);
        timing.change(0.08, 10.0);
        near(timing.of(9.99, START, 10.1), [9.99, 0.02]);
        near(timing.of(10.05, START, 10.1), [10.05, f64::NAN]);
        near(timing.of(10.15, START, 10.3), [10.15, f64::NAN]);
        near(timing.of(10.17, START, 10.3), [10.17, 0.08]);
        // Changed again before it settled: nothing is known of frames in between.
        timing.change(0.02, 10.1);
        near(timing.of(10.05, START, 10.3), [10.05, f64::NAN]);
        near(timing.of(10.19, START, 10.3), [10.19, 0.02]);
    }

    #[test]
    fn an_uncertain_start_is_early() {
        let mut timing = timing(Stamp::End);
        timing.change(0.08, 10.0);
        near(timing.of(10.1, START, 10.2), [10.02, f64::NAN]);
        near(timing.of(10.01, START, 10.2), [9.93, 0.02]);
    }
}
