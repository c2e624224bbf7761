//! What is measured before the first frame: how bright the coded patch may be, how late the projector is, what the patch
//! looks like.

use super::acquisition::{Acquisition, FROZEN_S, ROUNDING_S};
use super::device::Frame;
use super::rejections::Rejections;
use super::tag_reader::{TagModel, TagProblem, TagReading, Verdict};
use super::{CaptureError, Rejection};
use crate::patterns::{Pattern, TagLayout};
use crate::radiometry::Lamp;

/// Time given to a projector of unknown latency, s; doubled where it is not enough.
const SETTLE_S: f64 = 0.15;
/// Refresh periods from a projector's word to its light that are allowed for where no patch shows them: some hold a frame or two,
/// and another one passes until all of it is shown.
const UNSEEN_REFRESHES: f64 = 4.0;
/// Changes of pattern whose latency is measured.
const LATENCY_PROBES: usize = 2;
/// Refresh periods of the frames that changes are watched with and the patch is learned from; longer, up to the run's longest
/// exposure, where the patch is dim.
const LEARNING_REFRESHES: f64 = 4.0;
/// Share of the linear range that the patch may fill in the longest exposure.
const HEADROOM: f64 = 0.7;
/// Number of the first frame before a run: apart from the run's own.
const PROBE_FIRST: u64 = 1 << 40;
/// Number of the first frame the patch is learned from.
const LEARNING_FIRST: u64 = 1 << 41;
/// How often the patch is learned anew before it is given up.
const ATTEMPTS: usize = 16;
/// Noise of the patch's two ends over the change between them, at most: a share of it then tells when it came.
const CLEAR: f64 = 0.05;
/// A share of a change below which it is over.
const SETTLED: f64 = 0.02;

impl Acquisition<'_> {
    /// Makes the devices ready for `patterns`, each with its code drawn in. Measures the latency, learns the patch, loads
    /// the sequence; `first_contrast` is the patch's contrast when the run began, `first` the number of the next frame.
    ///
    /// # Errors
    /// [`CaptureError`].
    pub fn prepare(
        &mut self,
        patterns: &[Pattern],
        longest_s: f64,
        first_contrast: Option<f64>,
        first: u64,
    ) -> Result<(), CaptureError> {
        let layout = if self.rig.projector.tag { TagLayout::of(self.rig) } else { None };
        match layout {
            None => {
                // Nothing shows when a frame is lit: what the projector says must do, with a margin.
                self.latency_s = UNSEEN_REFRESHES / self.rig.projector.refresh_hz;
                self.load(patterns)?;
            }
            Some(layout) => {
                let model = self.learn_tag(&layout, &patterns[0], longest_s)?;
                let light = first_contrast.map_or(1.0, |first| model.total() / first);
                self.lamp = Lamp::new(light, light * model.total_sigma() / model.total());
                let level = self.tag_level.expect("found with the model");
                let sequence: Vec<Pattern> =
                    patterns.iter().enumerate().map(|(i, p)| layout.draw(p, layout.code(i), level)).collect();
                self.load(&sequence)?;
                self.tag = Some(model);
            }
        }
        self.restart(first)
    }

    /// Finds level and latency and learns the patch; again where a frame was late or lost on the way.
    fn learn_tag(&mut self, layout: &TagLayout, any: &Pattern, longest_s: f64) -> Result<TagModel, CaptureError> {
        let mut problem = TagProblem::Repeated;
        let mut exposure_s = LEARNING_REFRESHES / self.rig.projector.refresh_hz;
        for _ in 0..ATTEMPTS {
            match self.try_learn_tag(layout, any, longest_s, exposure_s)? {
                Ok(model) => return Ok(model),
                Err(reason) => problem = reason,
            }
            if matches!(problem, TagProblem::Dim { .. }) {
                exposure_s = (2.0 * exposure_s).min(longest_s).max(exposure_s);
            }
        }
        Err(CaptureError::NoTag { problem: problem.to_string() })
    }

    /// One attempt; the inner error says what did not fit together.
    fn try_learn_tag(
        &mut self,
        layout: &TagLayout,
        any: &Pattern,
        longest_s: f64,
        exposure_s: f64,
    ) -> Result<Result<TagModel, TagProblem>, CaptureError> {
        self.latency_s = 0.0;
        self.restart(PROBE_FIRST)?;
        let level = self.find_tag_level(layout, longest_s)?;
        self.tag_level = Some(level);
        let blank = Pattern { codes: vec![0; any.codes.len()].into(), ..*any };
        let singles = (0..layout.bits().len()).map(|bit| 1 << bit);
        // Code 0, every single bit, and the opposite of 0 for the clearest change.
        let opposite = layout.codes() - 1;
        let codes: Vec<usize> = std::iter::once(0).chain(singles).chain([opposite]).collect();
        let probes: Vec<Pattern> = codes.iter().map(|&code| layout.draw(&blank, code, level)).collect();
        self.load(&probes)?;
        let [first, check] = self.ends(layout, probes.len() - 1, exposure_s, longest_s)?;
        if first.samples == check.samples {
            return Ok(Err(TagProblem::Repeated));
        }
        let exposure_s = first.exposure_s;
        self.latency_s = self.measure_latency(layout, [&first, &check])?;
        self.restart(LEARNING_FIRST)?;
        let mut frames: Vec<Frame> = Vec::with_capacity(probes.len() - 1);
        frames.push(first);
        for _ in 0..ATTEMPTS * probes.len() {
            if frames.len() == probes.len() - 1 {
                break;
            }
            let next = frames.len() + 1;
            let frame = self.fresh(frames.len(), exposure_s, 0.0, Some(next).filter(|&n| n < probes.len() - 1))?;
            // Every probe differs from the one before: equal samples are a frame that came twice.
            if frames.last().is_none_or(|former| former.samples != frame.samples) {
                frames.push(frame);
            }
        }
        if frames.len() < probes.len() - 1 {
            return Ok(Err(TagProblem::Repeated));
        }
        let codes = self.rig.camera.codes_dn.is_some();
        Ok(TagModel::learn(layout.clone(), self.sensor, &frames).and_then(|model| {
            let model = if codes { model.of_codes() } else { model };
            match model.judge(&model.read(&check), opposite, &[], 1.0) {
                Verdict::Expected { .. } => Ok(model),
                _ => Err(TagProblem::Unsteady),
            }
        }))
    }

    /// The brightest projector code at which the patch saturates in no exposure up to `longest_s`.
    fn find_tag_level(&mut self, layout: &TagLayout, longest_s: f64) -> Result<u8, CaptureError> {
        let p = &self.rig.projector;
        let shortest_s = 1.0 / p.refresh_hz;
        let blank = Pattern::full(p.width_px, p.height_px, 0);
        let mut level = 255u8;
        loop {
            self.load(&[layout.draw(&blank, 0, level)])?;
            let frame = self.fresh(0, shortest_s, SETTLE_S, None)?;
            let reading = TagReading::of(layout, &self.sensor, &frame);
            let range = self.sensor.limit_dn - self.sensor.black_level_dn;
            let used = f64::from(reading.brightest_dn) - self.sensor.black_level_dn;
            // Noise makes the brightest of many samples brighter than the rest: on the safe side.
            let share = used.max(0.0) / range * longest_s.max(shortest_s) / shortest_s;
            if used < range && share <= HEADROOM {
                return Ok(level);
            }
            // Light grows faster than codes, so this dims by more than it must.
            let factor = if used < range { HEADROOM / share } else { 0.5 };
            level = (f64::from(level) * factor).floor().max(1.0) as u8;
            if used < range || level == 1 {
                return Ok(level);
            }
        }
    }

    /// A frame of `exposure_s` that begins when frame `index` has been lit for `settle_s`. `next` is shown as soon as a
    /// triggered exposure has ended.
    fn fresh(
        &mut self,
        index: usize,
        exposure_s: f64,
        settle_s: f64,
        next: Option<usize>,
    ) -> Result<Frame, CaptureError> {
        self.set_exposure(exposure_s)?;
        let mut rejections = Rejections::default();
        loop {
            // Again where the next one was shown already and this one did not arrive.
            self.show(index)?;
            let start_s = self.lit_s() + settle_s;
            if let Some(frame) = self.frame_from(start_s, exposure_s, next)? {
                return Ok(frame);
            }
            rejections.add(Rejection::Missing, self.waited_s())?;
        }
    }

    /// The first good frame of `exposure_s` whose exposure begins at `start_s` or later; `None` if a triggered one
    /// does not come.
    fn frame_from(
        &mut self,
        start_s: f64,
        exposure_s: f64,
        next: Option<usize>,
    ) -> Result<Option<Frame>, CaptureError> {
        if self.is_triggered() {
            self.expose(start_s)?;
            next.map_or(Ok(()), |next| self.show(next))?;
        }
        let mut rejections = Rejections::default();
        loop {
            let received = self.receive()?;
            if received.is_none() && self.is_triggered() {
                return Ok(None);
            }
            let good = received.filter(|frame| {
                frame.flags.good()
                    && frame.timestamp_s >= start_s - ROUNDING_S
                    && self.near(frame.exposure_s, exposure_s)
            });
            if good.is_some() {
                return Ok(good);
            }
            // Frames from before may have to be read first.
            if self.clock.now_s() > start_s.max(self.said_lit_s()) + FROZEN_S + exposure_s {
                rejections.add(Rejection::OtherExposure, self.waited_s())?;
            }
        }
    }

    /// Frames of probe 0 and of `other`, between which all cells change: with more time to settle and a longer exposure until
    /// they differ clearly.
    fn ends(
        &mut self,
        layout: &TagLayout,
        other: usize,
        exposure_s: f64,
        longest_s: f64,
    ) -> Result<[Frame; 2], CaptureError> {
        let (mut exposure_s, mut settle_s) = (exposure_s, SETTLE_S);
        loop {
            let ends = [self.fresh(0, exposure_s, settle_s, None)?, self.fresh(other, exposure_s, settle_s, None)?];
            let [unlit, lit] = ends.each_ref().map(|frame| self.contrast(layout, frame));
            let noise = TagReading::of(layout, &self.sensor, &ends[0]).variance.iter().sum::<f64>().sqrt();
            // Equal samples are a frame that came twice, which says nothing of how clear the change is.
            if CLEAR * (lit - unlit) > noise || ends[0].samples == ends[1].samples {
                return Ok(ends);
            }
            settle_s *= 2.0;
            if settle_s > FROZEN_S {
                let problem =
                    format!("it changes by {:.0} e-/s when all its cells do, noise is {noise:.0} e-/s", lit - unlit);
                return Err(CaptureError::NoTag { problem });
            }
            exposure_s = (2.0 * exposure_s).min(longest_s).max(exposure_s);
        }
    }

    /// Sum of the contrasts of all bits, e-/s.
    fn contrast(&self, layout: &TagLayout, frame: &Frame) -> f64 {
        TagReading::of(layout, &self.sensor, frame).contrast.iter().sum()
    }

    /// Watches the change between the first and the last probe, which look like `ends`, both ways, and returns the worst time
    /// it took beyond the projector's own word, with a refresh period for the phase that was not met.
    fn measure_latency(&mut self, layout: &TagLayout, ends: [&Frame; 2]) -> Result<f64, CaptureError> {
        let refresh_s = 1.0 / self.rig.projector.refresh_hz;
        let (probe_s, other) = (ends[0].exposure_s, layout.bits().len() + 1);
        let ends = ends.map(|frame| self.contrast(layout, frame));
        let mut worst_s = 0.0f64;
        let mut missing = Rejections::default();
        for probe in 0..LATENCY_PROBES {
            let target = if probe % 2 == 0 { 0 } else { other };
            self.show(target)?;
            let said_s = self.said_lit_s();
            let mut changed_s = None;
            loop {
                let now_s = self.clock.now_s();
                let start_s = if self.is_triggered() { now_s } else { f64::NEG_INFINITY };
                let Some(frame) = self.frame_from(start_s, probe_s, None)? else {
                    missing.add(Rejection::Missing, self.waited_s())?;
                    continue;
                };
                let share = (self.contrast(layout, &frame) - ends[0]) / (ends[1] - ends[0]);
                let done = if target == 0 { 1.0 - share } else { share };
                if done > SETTLED && done < 1.0 - SETTLED {
                    changed_s = Some(frame.timestamp_s + (1.0 - done) * frame.exposure_s);
                } else if done >= 1.0 - SETTLED {
                    // A change between two exposures was over when this one began.
                    worst_s = worst_s.max(changed_s.unwrap_or(frame.timestamp_s) - said_s);
                    break;
                }
                if frame.timestamp_s > said_s + FROZEN_S {
                    return Err(CaptureError::Frozen { waited_s: frame.timestamp_s - said_s });
                }
            }
        }
        Ok(worst_s.max(0.0) + refresh_s)
    }
}
