//! Frames from a camera that runs freely: those that show the right pattern with a wanted exposure are picked.

use super::acquisition::{Acquisition, FROZEN_S, Keep, Refused};
use super::rejections::Rejections;
use super::{CaptureError, Rejection};

impl Acquisition<'_> {
    /// See [`Acquisition::take`]. Any wanted exposure is taken in whatever order it comes. The camera latches its exposure
    /// at the start of a frame, so the next one is set while the last is still under way; only the change of pattern
    /// costs a frame, and then one of the shortest exposure. One that takes frames to settle is left alone until it has.
    pub(super) fn take_free_running(
        &mut self,
        index: usize,
        exposures_s: &[f64],
        next: Option<usize>,
        keep: &mut Keep<'_>,
    ) -> Result<(), CaptureError> {
        let mut wanted: Vec<(usize, f64)> = exposures_s.iter().copied().enumerate().collect();
        self.show(index)?;
        let lit_s = self.lit_s();
        let mut asked = 0;
        self.set_exposure(wanted[asked].1)?;
        let settling = self.camera_limits.settling_frames;
        let all_s: f64 = exposures_s.iter().map(|&e| self.frame_time_s(e)).sum();
        let patience_s = FROZEN_S + all_s * f64::from(1 + settling);
        let mut rejections = Rejections::default();
        while !wanted.is_empty() {
            let Some(frame) = self.receive()? else {
                self.refuse(wanted[0].0, Refused { reason: Rejection::Missing, sequence: None }, keep)?;
                rejections.add(Rejection::Missing, self.waited_s())?;
                continue;
            };
            // The frame now under way has what was asked for last; ask for the one after it.
            if wanted.len() > 1 && settling == 0 {
                asked = (asked + 1) % wanted.len();
                self.set_exposure(wanted[asked].1)?;
            }
            let (sequence, began_s, exposure_s) = (frame.sequence, frame.timestamp_s, frame.exposure_s);
            let match_ = wanted.iter().position(|(_, e)| self.near(exposure_s, *e));
            let target_s = match_.map_or(wanted[0].1, |i| wanted[i].1);
            match (self.judge(frame, index, target_s, lit_s..f64::INFINITY), match_) {
                (Ok(accepted), Some(i)) => {
                    self.effort.frames += 1;
                    let (j, _) = wanted.remove(i);
                    keep(j, Ok(accepted))?;
                    rejections = Rejections::default();
                    if !wanted.is_empty() {
                        asked = if asked > i { asked - 1 } else { asked % wanted.len() };
                        self.set_exposure(wanted[asked].1)?;
                    }
                }
                (Ok(_) | Err(Rejection::OtherExposure | Rejection::Stale), _) => {
                    // The change of a setting or of the pattern is still on its way.
                    self.effort.skipped += 1;
                    if began_s > self.said_lit_s() + patience_s {
                        return Err(CaptureError::Frozen { waited_s: began_s - self.said_lit_s() });
                    }
                }
                (Err(reason), _) => {
                    let j = match_.map_or(wanted[0].0, |i| wanted[i].0);
                    self.refuse(j, Refused { reason, sequence: Some(sequence) }, keep)?;
                    rejections.add(reason, self.waited_s())?;
                }
            }
        }
        if let Some(next) = next {
            self.show(next)?;
        }
        Ok(())
    }
}
