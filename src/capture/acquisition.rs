//! Open devices that take one frame after the other, each proved to show what it should.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::device::{Bench, Camera, CameraLimits, Clock, Frame, Projector, Triggering};
use super::journal::FrameEntry;
use super::limits::{check_devices, near};
use super::rejections::Rejections;
use super::tag_reader::{LIGHT_STEP, TagModel, TagReading, Verdict};
use super::{CaptureError, Crop, Rejection};
use crate::optics::Rig;
use crate::radiometry::{Lamp, Sensor};

/// What a frame may be late beyond its exposure and readout, s.
const FRAME_SLACK_S: f64 = 0.5;
/// Frame numbers remembered to tell a repeated frame.
const REMEMBERED: usize = 64;
/// Frames before and after the one that is judged whose light it might hold.
const SHOWN: usize = 4;
/// Readings remembered to tell a frame that is repeated under another number.
const READINGS: usize = 8;
/// The same clock twice.
pub(super) const ROUNDING_S: f64 = 1e-6;
/// What a projector may take to change a frame, s; then it is frozen.
pub(super) const FROZEN_S: f64 = 2.0;

/// A frame as it is merged: the samples of a part of the sensor, with what they mean.
#[derive(Debug, Clone, PartialEq)]
pub struct Taken {
    /// Samples of the crop, row by row, DN.
    pub samples: Vec<u16>,
    /// Exposure time, s.
    pub exposure_s: f64,
    /// The lamp's light during the exposure, relative to the start of the run.
    pub light: f64,
    /// The whole frame, where it is to be kept.
    pub frame: Option<Arc<Frame>>,
}

/// What the engine itself cost.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Effort {
    /// Frames accepted.
    pub frames: usize,
    /// Frames that were no good.
    pub rejected: usize,
    /// Frames a free-running camera took while settings or patterns changed.
    pub skipped: usize,
    /// Time spent neither in devices nor waiting for them, s.
    pub own_s: f64,
}

/// A frame that passed.
pub(super) struct Accepted {
    pub frame: Frame,
    /// The lamp's light as estimated, and the frame's own reading with its standard error.
    pub light: f64,
    pub reading: Option<[f64; 2]>,
}

/// A frame that did not pass, with the camera's number if there was one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Refused {
    pub reason: Rejection,
    pub sequence: Option<u64>,
}

/// Gets every frame of a lobe as soon as it is judged, with the position of its exposure.
pub(super) type Keep<'k> = dyn FnMut(usize, Result<Accepted, Refused>) -> Result<(), CaptureError> + 'k;

/// Devices that are open; they are restored when this is dropped.
pub(super) struct Acquisition<'a> {
    pub rig: &'a Rig,
    pub sensor: Sensor,
    pub camera: Box<dyn Camera>,
    pub camera_limits: CameraLimits,
    pub projector: Box<dyn Projector>,
    pub clock: Arc<dyn Clock>,
    pub tag: Option<TagModel>,
    pub tag_level: Option<u8>,
    pub lamp: Lamp,
    /// From a projector's word that a frame is lit to its light, at worst, s.
    pub latency_s: f64,
    /// What is asked of the projector, and from when on it is lit.
    shown: Option<(usize, f64)>,
    /// What was shown lately, the newest last.
    history: VecDeque<usize>,
    exposure_s: f64,
    /// Earliest start of the next exposure.
    ready_s: f64,
    /// A camera whose exposures begin late would see the next pattern: then it is shown only after the frame came.
    eager: bool,
    recent: VecDeque<u64>,
    readings: VecDeque<TagReading>,
    /// Light of the last frame, where it was not the lamp's.
    other_light: Option<f64>,
    pub effort: Effort,
    waited: Duration,
    restored: bool,
}

impl<'a> Acquisition<'a> {
    /// Compares what devices can do with rig and exposures, then opens them.
    ///
    /// # Errors
    /// [`CaptureError::Limits`] before anything is opened; [`CaptureError::Unusable`].
    pub fn open(rig: &'a Rig, bench: &mut dyn Bench, exposures_s: &[f64]) -> Result<Self, CaptureError> {
        let camera_limits = check_devices(rig, bench, exposures_s)?;
        let camera = bench.camera().open().map_err(CaptureError::at_the_start)?;
        let projector = bench.projector().open().map_err(CaptureError::at_the_start)?;
        Ok(Self {
            rig,
            sensor: sensor(rig),
            camera,
            camera_limits,
            projector,
            clock: bench.clock(),
            tag: None,
            tag_level: None,
            lamp: Lamp::new(1.0, 0.0),
            latency_s: 0.0,
            shown: None,
            history: VecDeque::new(),
            exposure_s: f64::NAN,
            ready_s: f64::NEG_INFINITY,
            eager: true,
            recent: VecDeque::new(),
            readings: VecDeque::new(),
            other_light: None,
            effort: Effort::default(),
            waited: Duration::ZERO,
            restored: false,
        })
    }

    /// Whether frames have to be asked for.
    pub fn is_triggered(&self) -> bool {
        self.camera_limits.triggering == Triggering::Triggered
    }

    /// Lets the camera begin anew with frames counted from `first`.
    pub fn restart(&mut self, first: u64) -> Result<(), CaptureError> {
        self.recent.clear();
        self.readings.clear();
        self.timed(|a| a.camera.start(first))
    }

    /// Loads a sequence of frames; nothing of it is shown yet.
    pub fn load(&mut self, sequence: &[crate::patterns::Pattern]) -> Result<(), CaptureError> {
        self.shown = None;
        self.history.clear();
        self.timed(|a| a.projector.load(sequence))
    }

    /// Asks the projector for a frame unless it is shown already.
    pub fn show(&mut self, index: usize) -> Result<(), CaptureError> {
        if self.shown.is_none_or(|(shown, _)| shown != index) {
            let lit_s = self.timed(|a| a.projector.show(index))?;
            self.shown = Some((index, lit_s));
            self.history.push_back(index);
            if self.history.len() > SHOWN {
                self.history.pop_front();
            }
        }
        Ok(())
    }

    /// Time from which what is shown is lit for certain.
    pub fn lit_s(&self) -> f64 {
        self.shown.map_or(f64::NEG_INFINITY, |(_, lit_s)| lit_s) + self.latency_s
    }

    /// The projector's own word of it.
    pub fn said_lit_s(&self) -> f64 {
        self.shown.map_or(f64::NEG_INFINITY, |(_, lit_s)| lit_s)
    }

    /// Time since the projector was asked for what it should show, s.
    pub fn waited_s(&self) -> f64 {
        self.clock.now_s() - self.said_lit_s()
    }

    /// Sets the exposure of frames to come.
    pub fn set_exposure(&mut self, wanted_s: f64) -> Result<(), CaptureError> {
        if self.exposure_s == wanted_s {
            return Ok(());
        }
        let achieved_s = self.timed(|a| a.camera.set_exposure(wanted_s))?;
        if !self.near(achieved_s, wanted_s) {
            return Err(CaptureError::Exposure { wanted_s, achieved_s });
        }
        self.exposure_s = wanted_s;
        Ok(())
    }

    /// Triggers a frame at `start_s` at the earliest and returns when its exposure has ended, with a time before which it
    /// did not begin.
    pub fn expose(&mut self, start_s: f64) -> Result<f64, CaptureError> {
        let start_s = start_s.max(self.ready_s);
        let triggered_s = self.timed(|a| {
            a.clock.sleep_until_s(start_s);
            let now_s = a.clock.now_s();
            a.camera.trigger().map(|()| now_s)
        })?;
        // While the trigger was on its way the exposure may have begun, or not yet.
        let begun_s = self.clock.now_s();
        self.ready_s = begun_s + self.frame_time_s(self.exposure_s);
        let end_s = begun_s + self.exposure_s;
        self.timed(|a| a.clock.sleep_until_s(end_s));
        Ok(triggered_s)
    }

    /// The next frame, whatever it shows; `None` if none came in time.
    pub fn receive(&mut self) -> Result<Option<Frame>, CaptureError> {
        let l = &self.camera_limits;
        self.receive_within(self.exposure_s.max(l.frame_s) + l.readout_s + l.frame_s + FRAME_SLACK_S)
    }

    fn receive_within(&mut self, timeout_s: f64) -> Result<Option<Frame>, CaptureError> {
        let mut frame = self.timed(|a| a.camera.receive(timeout_s))?;
        if let Some(frame) = &mut frame {
            let (width, height) = (self.rig.camera.width_px, self.rig.camera.height_px);
            if (frame.width, frame.height) != (width, height) || frame.samples.len() != width * height {
                let problem = format!("delivers {} x {} px, not {width} x {height}", frame.width, frame.height);
                return Err(self.camera_cannot(problem, "correct camera.width_px and camera.height_px in the rig file"));
            }
            if let Some(codes_dn) = &self.rig.camera.codes_dn {
                // From here on the camera is linear.
                let last = codes_dn.len() - 1;
                frame.samples.iter_mut().for_each(|s| *s = codes_dn[usize::from(*s).min(last)]);
            }
        }
        Ok(frame)
    }

    fn camera_cannot(&self, problem: String, remedy: &'static str) -> CaptureError {
        CaptureError::Limits { device: "camera", name: self.camera_limits.name.clone(), problem, remedy }
    }

    /// Takes one frame of the sequence's frame `index` for each exposure and hands each to `keep` as soon as it is proved,
    /// and each that is none. When the last exposure has ended, `next` is shown while its frame is still under way.
    ///
    /// # Errors
    /// [`CaptureError::Rejected`] or [`CaptureError::Frozen`] if frames stay away; what `keep` returns.
    pub fn take(
        &mut self,
        index: usize,
        exposures_s: &[f64],
        next: Option<usize>,
        keep: &mut Keep<'_>,
    ) -> Result<(), CaptureError> {
        let (started, waited) = (Instant::now(), self.waited);
        let result = if self.is_triggered() {
            self.take_triggered(index, exposures_s, next, keep)
        } else {
            self.take_free_running(index, exposures_s, next, keep)
        };
        let own = started.elapsed().saturating_sub(self.waited - waited);
        self.effort.own_s += own.as_secs_f64();
        result
    }

    fn take_triggered(
        &mut self,
        index: usize,
        exposures_s: &[f64],
        next: Option<usize>,
        keep: &mut Keep<'_>,
    ) -> Result<(), CaptureError> {
        for (j, &exposure_s) in exposures_s.iter().enumerate() {
            let mut rejections = Rejections::default();
            loop {
                self.show(index)?;
                self.set_exposure(exposure_s)?;
                let triggered_s = self.expose(self.lit_s())?;
                let ahead = next.filter(|_| self.eager && j + 1 == exposures_s.len());
                let mut lit_s = triggered_s..f64::INFINITY;
                if let Some(next) = ahead {
                    lit_s.end = self.clock.now_s();
                    self.show(next)?;
                }
                let mut frame = self.receive()?;
                let accepted = loop {
                    let Some(received) = frame else {
                        self.refuse(j, Refused { reason: Rejection::Missing, sequence: None }, keep)?;
                        rejections.add(Rejection::Missing, self.waited_s())?;
                        break None;
                    };
                    let sequence = Some(received.sequence);
                    match self.judge(received, index, exposure_s, lit_s.clone()) {
                        Ok(accepted) => break Some(accepted),
                        Err(reason) => {
                            // It may have seen the next pattern: from now on that waits for the frame.
                            self.eager &= !(ahead.is_some() && reason == Rejection::Stale);
                            self.refuse(j, Refused { reason, sequence }, keep)?;
                            rejections.add(reason, self.waited_s())?;
                            // One that should have come earlier may be followed by the one asked for.
                            frame = self.receive_within(self.camera_limits.frame_s)?;
                            if frame.is_none() {
                                break None;
                            }
                        }
                    }
                };
                if let Some(accepted) = accepted {
                    self.effort.frames += 1;
                    keep(j, Ok(accepted))?;
                    break;
                }
            }
        }
        Ok(())
    }

    /// Counts a frame that is no good.
    pub(super) fn refuse(&mut self, j: usize, refused: Refused, keep: &mut Keep<'_>) -> Result<(), CaptureError> {
        self.effort.rejected += 1;
        keep(j, Err(refused))
    }

    /// Whether a frame is what it should be: new, whole, of the right exposure, and of the right pattern all the time: that is
    /// lit during `lit_s` for certain, by the camera's clock.
    pub fn judge(
        &mut self,
        frame: Frame,
        index: usize,
        exposure_s: f64,
        lit_s: Range<f64>,
    ) -> Result<Accepted, Rejection> {
        if self.recent.contains(&frame.sequence) {
            return Err(Rejection::Repeated);
        }
        self.recent.push_back(frame.sequence);
        if self.recent.len() > REMEMBERED {
            self.recent.pop_front();
        }
        let Some(tag) = &self.tag else {
            if !frame.flags.good() {
                return Err(Rejection::Corrupt);
            }
            // Without a patch, the camera's clock must do.
            let ended_s = frame.timestamp_s + frame.exposure_s;
            if frame.timestamp_s < lit_s.start - ROUNDING_S || ended_s > lit_s.end + ROUNDING_S {
                return Err(Rejection::Stale);
            }
            if !self.near(frame.exposure_s, exposure_s) || frame.gain != 1.0 {
                return Err(Rejection::OtherExposure);
            }
            return Ok(Accepted { frame, light: self.lamp.light(), reading: None });
        };
        let reading = tag.read(&frame);
        if self.readings.contains(&reading) {
            // Equal to the last bit: the same light cannot have been measured twice.
            return Err(Rejection::Repeated);
        }
        let others: Vec<usize> = self.history.iter().map(|&i| tag.layout().code(i)).collect();
        let verdict = tag.judge(&reading, tag.layout().code(index), &others, self.lamp.light());
        self.readings.push_back(reading);
        if self.readings.len() > READINGS {
            self.readings.pop_front();
        }
        if !frame.flags.good() {
            return Err(Rejection::Corrupt);
        }
        if !self.near(frame.exposure_s, exposure_s) || frame.gain != 1.0 {
            return Err(Rejection::OtherExposure);
        }
        match verdict {
            Verdict::Expected { light, sigma } => {
                self.other_light = None;
                let estimate = self.lamp.update(self.frame_time_s(exposure_s), light, sigma);
                Ok(Accepted { frame, light: estimate, reading: Some([light, sigma]) })
            }
            // No two frames are dark for the same part of their time: the lamp itself has changed.
            Verdict::OtherLight { light, sigma }
                if self.other_light.is_some_and(|before| (light / before - 1.0).abs() < LIGHT_STEP) =>
            {
                self.other_light = None;
                self.lamp = Lamp::new(light, sigma);
                Ok(Accepted { frame, light, reading: Some([light, sigma]) })
            }
            Verdict::OtherLight { light, .. } => {
                self.other_light = Some(light);
                Err(Rejection::Stale)
            }
            Verdict::Other => Err(Rejection::Stale),
            Verdict::Unreadable => Err(Rejection::Unreadable),
        }
    }

    /// Follows the lamp through the frames of earlier sessions. What the patch's contrast says now counts only where it
    /// contradicts that: a lamp that was switched off meanwhile.
    pub fn recall_lamp(&mut self, frames: &[FrameEntry]) {
        let now = self.lamp;
        let mut lamp = Lamp::new(1.0, now.sigma());
        for frame in frames {
            if let Some([reading, sigma]) = frame.light_reading {
                lamp.update(self.frame_time_s(frame.exposure_s), reading, sigma);
            }
        }
        let apart = (now.light() - lamp.light()).abs();
        if !frames.is_empty() && apart < 4.0 * now.sigma().hypot(lamp.sigma()) {
            self.lamp = lamp;
        }
    }

    /// Whether an exposure is the one that was wanted, as nearly as the camera can set it.
    pub(super) fn near(&self, achieved_s: f64, wanted_s: f64) -> bool {
        near(achieved_s, wanted_s, self.camera_limits.exposure_step_s)
    }

    /// Time from the start of an exposure to that of the next, s.
    pub(super) fn frame_time_s(&self, exposure_s: f64) -> f64 {
        (exposure_s + self.camera_limits.readout_s).max(self.camera_limits.frame_s)
    }

    /// The part of a frame that is merged.
    pub fn cut(frame: &Frame, crop: Crop) -> Vec<u16> {
        let mut samples = Vec::with_capacity(crop.len());
        for v in crop.v0..crop.v0 + crop.height {
            samples.extend_from_slice(&frame.samples[v * frame.width + crop.u0..][..crop.width]);
        }
        samples
    }

    /// Runs something that waits for a device; its time is not the engine's.
    pub fn timed<T>(&mut self, step: impl FnOnce(&mut Self) -> T) -> T {
        let started = Instant::now();
        let result = step(self);
        self.waited += started.elapsed();
        result
    }

    /// Gives devices their former settings back.
    ///
    /// # Errors
    /// The first [`CaptureError::Device`]; the other device is restored all the same.
    pub fn restore(&mut self) -> Result<(), CaptureError> {
        self.restored = true;
        let camera = self.camera.restore();
        let projector = self.projector.restore();
        camera.and(projector)
    }
}

impl Drop for Acquisition<'_> {
    fn drop(&mut self) {
        if !self.restored {
            // An error or a panic is on its way, and is the one to report.
            let _ = self.restore();
        }
    }
}

/// The sensor's figures as the HDR estimate needs them.
pub fn sensor(rig: &Rig) -> Sensor {
    let c = &rig.camera;
    Sensor {
        gain_dn_per_e: c.gain_dn_per_e,
        dark_noise_e: c.dark_noise_e,
        black_level_dn: c.black_level_dn,
        limit_dn: c.linear_limit_dn,
    }
}
