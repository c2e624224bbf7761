//! What each device of a bench can and cannot do, tried out one thing after the other.

use std::fmt;
use std::sync::Arc;

use serde::Serialize;

use crate::capture::{
    Bench, Camera, CameraLimits, CaptureError, Clock, Frame, Projector, ProjectorLimits, Triggering, check_devices,
};
use crate::optics::Rig;
use crate::patterns::Pattern;

/// Frames looked at for rate and bits.
const FRAMES: usize = 8;
/// Exposures tried, each twice the one before, from one refresh on.
const LADDER: usize = 5;
/// Changes of pattern that are timed.
const CHANGES: usize = 4;
/// Time for a projector to show what it is asked for and for a camera to see it, s.
const SETTLE_S: f64 = 0.5;
/// Time after which a change that is not seen never comes, s.
const PATIENCE_S: f64 = 3.0;
/// Pause after which a camera is looked at for frames of before, s.
const PAUSE_S: f64 = 1.0;
/// The least change of the mean that is light and not noise, DN, and as a multiple of the difference of two equal frames.
const LEAST_CHANGE_DN: f64 = 0.2;
const LEAST_CHANGE: f64 = 5.0;
/// A camera that is further than this from proportional is no linear camera as it is set.
const PROPORTIONAL: f64 = 0.01;

/// How something turned out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// It is as it should be.
    Good,
    /// It will do, or could not be told.
    Note,
    /// A measurement will fail or be wrong.
    Fails,
}

/// One thing found out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// `camera`, `projector` or `both`.
    pub device: &'static str,
    /// What was looked at.
    pub what: &'static str,
    /// How it turned out.
    pub verdict: Verdict,
    /// Figures, and what helps where it fails.
    pub said: String,
}

/// All that was found out.
#[derive(Debug, Clone, PartialEq, Serialize, Default)]
pub struct FirstLight {
    /// In the order it was tried.
    pub findings: Vec<Finding>,
}

impl FirstLight {
    /// Whether nothing fails.
    pub fn is_good(&self) -> bool {
        self.findings.iter().all(|f| f.verdict != Verdict::Fails)
    }

    fn add(&mut self, device: &'static str, what: &'static str, verdict: Verdict, said: impl Into<String>) {
        self.findings.push(Finding { device, what, verdict, said: said.into() });
    }

    /// The value, or a finding that says why there is none.
    fn got<T>(&mut self, device: &'static str, what: &'static str, result: Result<T, CaptureError>) -> Option<T> {
        result.map_err(|error| self.add(device, what, Verdict::Fails, error.to_string())).ok()
    }
}

impl fmt::Display for FirstLight {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, finding) in self.findings.iter().enumerate() {
            let verdict = match finding.verdict {
                Verdict::Good => "good ",
                Verdict::Note => "note ",
                Verdict::Fails => "FAILS",
            };
            let end = if i + 1 < self.findings.len() { "\n" } else { "" };
            write!(f, "{verdict} {:9} {:12} {}{end}", finding.device, finding.what, finding.said)?;
        }
        Ok(())
    }
}

/// Tries out the devices of a bench against what `rig` says of them. What fails is a finding, not an error; both devices are
/// put back as they were.
pub fn first_light(rig: &Rig, bench: &dyn Bench) -> FirstLight {
    let mut found = FirstLight::default();
    let camera = found.got("camera", "is there", bench.camera().limits());
    let projector = found.got("projector", "is there", bench.projector().limits());
    if let Some(limits) = &camera {
        found.add("camera", "is there", Verdict::Good, camera_text(limits));
    }
    if let Some(l) = &projector {
        let said = format!("{}: {} x {} px, {:.2} Hz", l.name, l.width, l.height, l.refresh_hz);
        found.add("projector", "is there", Verdict::Good, said);
    }
    let (Some(limits), Some(projector)) = (camera, projector) else { return found };
    if found.got("both", "rig file", check_devices(rig, bench, &[])).is_some() {
        found.add("both", "rig file", Verdict::Good, "sizes and refresh rate are the rig file's");
    }
    let Some(camera) = found.got("camera", "opens", bench.camera().open()) else { return found };
    let opened = found.got("projector", "opens", bench.projector().open());
    let mut look = Look { rig, limits, camera, clock: bench.clock(), exposure_s: f64::NAN };
    if let Some(opened) = opened {
        let mut opened = opened;
        let tried = look.all(opened.as_mut(), &projector, &mut found);
        found.got("camera", "goes on", tried);
        found.got("projector", "is put back", opened.restore());
    }
    found.got("camera", "is put back", look.camera.restore());
    found
}

fn camera_text(l: &CameraLimits) -> String {
    let triggering = match l.triggering {
        Triggering::Triggered => "waits for a trigger",
        Triggering::FreeRunning => "runs freely",
    };
    let step =
        if l.exposure_step_s > 0.0 { format!(" in steps of {:.3} ms", 1e3 * l.exposure_step_s) } else { String::new() };
    format!(
        "{}: {} x {} px, exposes {:.3}..{:.1} ms{step}, {triggering}",
        l.name,
        l.width,
        l.height,
        1e3 * l.shortest_s,
        1e3 * l.longest_s
    )
}

/// A camera being looked at.
struct Look<'a> {
    rig: &'a Rig,
    limits: CameraLimits,
    camera: Box<dyn Camera>,
    clock: Arc<dyn Clock>,
    exposure_s: f64,
}

impl Look<'_> {
    fn all(
        &mut self,
        projector: &mut dyn Projector,
        limits: &ProjectorLimits,
        found: &mut FirstLight,
    ) -> Result<(), CaptureError> {
        let frame = |code| Pattern::full(limits.width, limits.height, code);
        projector.load(&[frame(0), frame(255)])?;
        self.show(projector, 1)?;
        self.camera.start(0)?;
        self.expose(1.0 / limits.refresh_hz)?;
        self.frames(found)?;
        if self.limits.triggering == Triggering::FreeRunning {
            self.pause(found)?;
        }
        let lit = self.changes(projector, found)?;
        self.exposures(limits, lit, found)?;
        self.refresh(projector, limits, found)
    }

    fn show(&self, projector: &mut dyn Projector, index: usize) -> Result<(), CaptureError> {
        let lit_s = projector.show(index)?;
        self.clock.sleep_until_s(lit_s + SETTLE_S);
        Ok(())
    }

    fn expose(&mut self, exposure_s: f64) -> Result<f64, CaptureError> {
        let wanted_s = exposure_s.max(self.limits.shortest_s).min(self.limits.longest_s);
        self.exposure_s = self.camera.set_exposure(wanted_s)?;
        Ok(self.exposure_s)
    }

    /// The next frame, whatever it is.
    fn next(&mut self) -> Result<Option<Frame>, CaptureError> {
        if self.limits.triggering == Triggering::Triggered {
            self.camera.trigger()?;
        }
        let l = &self.limits;
        self.camera.receive(2.0 * (self.exposure_s.max(l.frame_s) + l.readout_s + l.frame_s) + SETTLE_S)
    }

    /// The first good frame with the exposure last set that began at `from_s` or later.
    fn fresh(&mut self, from_s: f64) -> Result<Frame, CaptureError> {
        let deadline_s = self.clock.now_s() + PATIENCE_S + 10.0 * self.exposure_s.max(self.limits.frame_s);
        loop {
            let good = self.next()?.filter(|f| {
                let near = (f.exposure_s / self.exposure_s - 1.0).abs() < 1e-3;
                f.flags.good() && near && f.timestamp_s >= from_s - 1e-6
            });
            if let Some(frame) = good {
                return Ok(frame);
            }
            if self.clock.now_s() > deadline_s {
                let reason = format!("no good frame of {:.3} ms came in time", 1e3 * self.exposure_s);
                return Err(CaptureError::Device { device: "camera", step: "receive".into(), reason });
            }
        }
    }

    /// Rate, gaps and bits.
    fn frames(&mut self, found: &mut FirstLight) -> Result<(), CaptureError> {
        let mut frames = vec![self.fresh(f64::NEG_INFINITY)?];
        let (mut missing, mut damaged, mut delay_s) = (0, 0, 0.0f64);
        while frames.len() + missing < FRAMES {
            match self.next()? {
                None => missing += 1,
                Some(frame) => {
                    damaged += usize::from(!frame.flags.good());
                    delay_s = delay_s.max(self.clock.now_s() - frame.timestamp_s - self.exposure_s);
                    frames.push(frame);
                }
            }
        }
        let (first, last) = (&frames[0], &frames[frames.len() - 1]);
        let numbers = last.sequence.saturating_sub(first.sequence);
        let period_s = (last.timestamp_s - first.timestamp_s) / numbers.max(1) as f64;
        let gaps = (numbers + 1).saturating_sub(frames.len() as u64);
        let said = format!(
            "one each {:.1} ms, delivered up to {:.1} ms after their exposure; of {FRAMES} {missing} missing, {gaps} skipped, \
             {damaged} damaged",
            1e3 * period_s,
            1e3 * delay_s
        );
        let verdict = match (missing + damaged, gaps) {
            (0, 0) => Verdict::Good,
            (0, _) => Verdict::Note,
            _ => Verdict::Fails,
        };
        found.add("camera", "frames", verdict, said);
        self.bits(&frames, found);
        Ok(())
    }

    fn bits(&self, frames: &[Frame], found: &mut FirstLight) {
        let samples = || frames.iter().flat_map(|f| f.samples.iter().copied());
        let any = samples().fold(0u16, |any, s| any | s);
        let (low, high) = samples().fold((u16::MAX, 0), |(low, high), s| (low.min(s), high.max(s)));
        let (bits, zeros) = (self.rig.camera.bits, any.trailing_zeros());
        let (verdict, what) = if low == high {
            (Verdict::Fails, "all alike: is the lens capped?".to_owned())
        } else if zeros > 0 {
            (
                Verdict::Fails,
                format!("the lowest {zeros} bits are always zero: set `shift = {zeros}` in the devices file"),
            )
        } else if u32::from(high) >> bits != 0 {
            (Verdict::Fails, format!("more than the {bits} bits of the rig file: correct camera.bits"))
        } else {
            (Verdict::Good, format!("{bits} bits in the rig file"))
        };
        found.add("camera", "samples", verdict, format!("{low}..{high} DN; {what}"));
    }

    /// Frames of before a pause that still come after it.
    fn pause(&mut self, found: &mut FirstLight) -> Result<(), CaptureError> {
        let resumed_s = self.clock.now_s() + PAUSE_S;
        self.clock.sleep_until_s(resumed_s);
        let mut old = 0;
        while let Some(frame) = self.next()? {
            if frame.timestamp_s + self.exposure_s + self.limits.readout_s >= resumed_s || old > 64 {
                break;
            }
            old += 1;
        }
        let said = format!("{old} after a pause of {PAUSE_S} s; the engine passes over them");
        found.add("camera", "old frames", Verdict::Note, said);
        Ok(())
    }

    /// From a request to its light; whether that is seen at all.
    fn changes(&mut self, projector: &mut dyn Projector, found: &mut FirstLight) -> Result<bool, CaptureError> {
        self.show(projector, 0)?;
        let dark = [self.now()?, self.now()?];
        self.show(projector, 1)?;
        let white = self.now()?;
        let change = white - dark[1];
        if change < LEAST_CHANGE_DN.max(LEAST_CHANGE * (dark[0] - dark[1]).abs()) {
            let said = format!(
                "the camera does not see the projector: mean {:.1} DN under black, {white:.1} DN under white; is it on, on \
                 the right input, uncovered, and something white in place?",
                dark[1]
            );
            found.add("both", "light", Verdict::Fails, said);
            return Ok(false);
        }
        let said = format!("mean {:.1} DN under black, {white:.1} DN under white", dark[1]);
        found.add("both", "light", Verdict::Good, said);
        let mut latencies_s = Vec::new();
        for i in 0..CHANGES {
            let asked_s = self.clock.now_s();
            projector.show(i % 2)?;
            loop {
                let Some(frame) = self.next()? else { continue };
                let share = (mean(&frame) - dark[1]) / change;
                if (i % 2 == 0) == (share < 0.5) && frame.timestamp_s + self.exposure_s > asked_s {
                    latencies_s.push(frame.timestamp_s + 0.5 * self.exposure_s - asked_s);
                    break;
                }
                if self.clock.now_s() > asked_s + PATIENCE_S {
                    found.add("both", "latency", Verdict::Fails, "a change of pattern was not seen within 3 s");
                    return Ok(true);
                }
            }
            self.clock.sleep_until_s(self.clock.now_s() + SETTLE_S);
        }
        let (least, most) = latencies_s.iter().fold((f64::MAX, 0.0f64), |(a, b), &x| (a.min(x), b.max(x)));
        let said =
            format!("{:.0}..{:.0} ms from the request to the frame that sees it", 1e3 * least.max(0.0), 1e3 * most);
        found.add("both", "latency", Verdict::Good, said);
        Ok(true)
    }

    /// Mean of a frame that begins now.
    fn now(&mut self) -> Result<f64, CaptureError> {
        let from_s = self.clock.now_s();
        Ok(mean(&self.fresh(from_s)?))
    }

    /// Whether twice the time is twice the light.
    fn exposures(&mut self, p: &ProjectorLimits, lit: bool, found: &mut FirstLight) -> Result<(), CaptureError> {
        if self.limits.shortest_s == self.limits.longest_s {
            let said = format!("fixed at {:.3} ms: plans of one exposure alone", 1e3 * self.limits.shortest_s);
            found.add("camera", "exposure", Verdict::Note, said);
            return Ok(());
        }
        let mut rates = Vec::new();
        let mut set_ms = Vec::new();
        for i in 0..LADDER {
            let wanted_s = f64::from(1u32 << i) / p.refresh_hz;
            if wanted_s > self.limits.longest_s {
                break;
            }
            let set_s = self.expose(wanted_s)?;
            set_ms.push(format!("{:.3}", 1e3 * set_s));
            let from_s = self.clock.now_s();
            let frame = self.fresh(from_s)?;
            let saturated = frame.samples.iter().any(|&s| f64::from(s) >= self.rig.camera.linear_limit_dn);
            if !saturated {
                rates.push((mean(&frame) - self.rig.camera.black_level_dn) / frame.exposure_s);
            }
        }
        let said = format!("sets {} ms", set_ms.join(", "));
        if !lit || rates.len() < 2 {
            let why =
                if lit { "too bright to compare: close the lens or dim the projector" } else { "no light to compare" };
            found.add("camera", "exposure", Verdict::Note, format!("{said}; {why}"));
            return Ok(());
        }
        let middle = rates.iter().sum::<f64>() / rates.len() as f64;
        let off = rates.iter().map(|r| (r / middle - 1.0).abs()).fold(0.0, f64::max);
        let (verdict, what) = if off <= PROPORTIONAL {
            (Verdict::Good, "proportional")
        } else {
            (
                Verdict::Fails,
                "not proportional: check camera.black_level_dn of the rig file, gamma and automatics of the camera; one that \
                 is not linear needs `zonal calibrate camera-response`",
            )
        };
        found.add("camera", "exposure", verdict, format!("{said}; light within {:.2}%: {what}", 100.0 * off));
        Ok(())
    }

    /// How fast the projector changes by its own word.
    fn refresh(
        &mut self,
        projector: &mut dyn Projector,
        limits: &ProjectorLimits,
        found: &mut FirstLight,
    ) -> Result<(), CaptureError> {
        let mut lit_s = Vec::new();
        for i in 0..=CHANGES {
            let at_s = projector.show(i % 2)?;
            self.clock.sleep_until_s(at_s);
            lit_s.push(at_s);
        }
        let period_s = (lit_s[CHANGES] - lit_s[0]) / CHANGES as f64;
        let said = format!("{:.2} Hz by its mode", limits.refresh_hz);
        let said = if period_s > 0.5 / limits.refresh_hz {
            format!("{said}; a new pattern each {:.1} ms", 1e3 * period_s)
        } else {
            format!("{said}; it does not say when a pattern is lit, so that the coded patch must")
        };
        found.add("projector", "refresh", Verdict::Note, said);
        Ok(())
    }
}

fn mean(frame: &Frame) -> f64 {
    frame.samples.iter().map(|&s| f64::from(s)).sum::<f64>() / frame.samples.len() as f64
}
