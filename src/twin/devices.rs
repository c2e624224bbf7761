//! The simulated camera and projector in time: a frame is the mean of what was shown while its shutter was open.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::Faults;
use super::faults::FrameFault;
use super::scene::Scene;
use crate::capture::{
    Camera, CameraFactory, CameraLimits, CaptureError, Clock, Frame, FrameFlags, Projector, ProjectorFactory,
    ProjectorLimits, Triggering,
};
use crate::patterns::Pattern;

/// Frames a free-running camera keeps for a reader that is slow; further ones are lost.
const BUFFERS: usize = 4;
/// Shortest and longest exposure of the simulated camera, s.
const EXPOSURES_S: [f64; 2] = [1e-5, 60.0];

/// Numbers of frames stay below this power of two: above it, the noise of one session is told from another's.
const SESSION_SHIFT: u32 = 44;

/// What a delivered frame really was: for tests, never for the engine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// The camera's number.
    pub sequence: u64,
    /// The pattern lit longest during the exposure.
    pub shown: Option<usize>,
    /// Share of the exposure in which it was lit.
    pub share: f64,
    /// Exposure time, s.
    pub exposure_s: f64,
    /// Whether these samples were delivered before, or the frame is marked as damaged.
    pub spoilt: bool,
}

/// All that camera and projector share.
pub(super) struct World {
    pub scene: Mutex<Scene>,
    pub state: Mutex<Devices>,
    pub clock: Arc<dyn Clock>,
    pub faults: Faults,
    pub triggering: Triggering,
}

/// Both devices in time.
#[derive(Default)]
pub(super) struct Devices {
    /// What is lit from when on, ascending; nothing before the first.
    display: Vec<(f64, usize)>,
    changes: u64,
    exposure_s: f64,
    /// The exposure of the frame that a free-running camera takes now, latched at its start.
    running: Option<Exposure>,
    /// A triggered exposure whose frame has not been read.
    triggered: VecDeque<Exposure>,
    /// Frames ready to be read.
    ready: VecDeque<Exposure>,
    sequence: u64,
    /// How often the camera was opened.
    opened: u64,
    /// See [`TwinBench::late_s`](super::TwinBench::late_s).
    pub late_s: f64,
    delivered: u64,
    last_start_s: f64,
    /// What was delivered last.
    former: Option<Vec<u16>>,
    /// Held back, to come after the next.
    held: Option<(Frame, Truth)>,
    /// To come before anything else.
    again: VecDeque<(Frame, Truth)>,
    pub truth: Vec<Truth>,
}

#[derive(Debug, Clone, Copy)]
struct Exposure {
    sequence: u64,
    start_s: f64,
    exposure_s: f64,
}

impl World {
    fn state(&self) -> MutexGuard<'_, Devices> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn scene(&self) -> MutexGuard<'_, Scene> {
        self.scene.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Renders an exposure: the frame and what it really shows.
    fn render(&self, exposure: Exposure) -> (Frame, Truth) {
        let (parts, session) = {
            let state = self.state();
            (state.parts(exposure), state.opened.saturating_sub(1))
        };
        let middle_s = exposure.start_s + 0.5 * exposure.exposure_s;
        let mut scene = self.scene();
        let samples = scene.expose(&parts, exposure.exposure_s, exposure.sequence ^ session << SESSION_SHIFT, middle_s);
        let (width, height) = scene.sensor_size();
        let longest = parts.iter().max_by(|a, b| a.1.total_cmp(&b.1));
        let truth = Truth {
            sequence: exposure.sequence,
            shown: longest.and_then(|p| p.0),
            share: longest.map_or(0.0, |p| p.1),
            exposure_s: exposure.exposure_s,
            spoilt: false,
        };
        let frame = Frame {
            width,
            height,
            samples,
            exposure_s: exposure.exposure_s,
            gain: 1.0,
            sequence: exposure.sequence,
            timestamp_s: exposure.start_s,
            flags: FrameFlags::default(),
        };
        (frame, truth)
    }

    /// Lets the faults have their way with a frame that is due; `None` if it does not arrive now.
    fn deliver(&self, exposure: Exposure) -> Option<(Frame, Truth)> {
        let fault = {
            let mut state = self.state();
            state.delivered += 1;
            self.faults.of_frame(state.delivered)
        };
        if fault == FrameFault::Drop {
            return None;
        }
        let (mut frame, mut truth) = self.render(exposure);
        let mut state = self.state();
        match fault {
            FrameFault::Repeat => {
                if let Some(former) = state.former.clone() {
                    frame.samples = former;
                    truth.spoilt = true;
                }
            }
            FrameFault::Flag => {
                frame.flags.corrupt = true;
                truth.spoilt = true;
            }
            FrameFault::Duplicate => state.again.push_back((frame.clone(), Truth { spoilt: true, ..truth })),
            FrameFault::Reorder if state.held.is_none() => {
                state.held = Some((frame, truth));
                return None;
            }
            _ => {}
        }
        if let Some(held) = state.held.take() {
            state.again.push_back(held);
        }
        state.former = Some(frame.samples.clone());
        Some((frame, truth))
    }
}

impl Devices {
    pub fn new(exposure_s: f64) -> Self {
        Self { exposure_s, last_start_s: f64::NEG_INFINITY, ..Self::default() }
    }

    /// What was lit during an exposure, with its share of the time.
    fn parts(&self, exposure: Exposure) -> Vec<(Option<usize>, f64)> {
        let (start, end) = (exposure.start_s, exposure.start_s + exposure.exposure_s);
        let mut parts = Vec::new();
        let mut from = start;
        let mut lit = None;
        for &(at, index) in &self.display {
            if at >= end {
                break;
            }
            if at > from {
                parts.push((lit, (at - from) / exposure.exposure_s));
                from = at;
            }
            lit = Some(index);
        }
        parts.push((lit, (end - from) / exposure.exposure_s));
        parts
    }

    fn next_sequence(&mut self) -> u64 {
        self.sequence += 1;
        self.sequence - 1
    }
}

/// The simulated camera before it is opened.
pub(super) struct TwinCameraFactory(pub Arc<World>);

impl CameraFactory for TwinCameraFactory {
    fn limits(&self) -> Result<CameraLimits, CaptureError> {
        let scene = self.0.scene();
        let (width, height) = scene.sensor_size();
        Ok(CameraLimits {
            name: "simulated camera".into(),
            width,
            height,
            shortest_s: EXPOSURES_S[0],
            longest_s: EXPOSURES_S[1],
            exposure_step_s: 0.0,
            settling_frames: 0,
            triggering: self.0.triggering,
            frame_s: scene.frame_s(),
            readout_s: scene.readout_s(),
        })
    }

    fn open(&self) -> Result<Box<dyn Camera>, CaptureError> {
        let mut state = self.0.state();
        state.opened += 1;
        let former_s = state.exposure_s;
        Ok(Box::new(TwinCamera { world: self.0.clone(), former_s }))
    }
}

struct TwinCamera {
    world: Arc<World>,
    /// Exposure it was found with.
    former_s: f64,
}

impl TwinCamera {
    fn failed(step: &str, reason: &str) -> CaptureError {
        CaptureError::Device { device: "camera", step: step.into(), reason: reason.into() }
    }

    /// Seconds from one start of exposure to the next, and to the frame's delivery.
    fn times(&self, exposure_s: f64) -> (f64, f64) {
        let scene = self.world.scene();
        let done_s = exposure_s + scene.readout_s();
        (done_s.max(scene.frame_s()), done_s)
    }

    /// Moves frames of a free-running camera that are complete by now to those that can be read.
    fn run_on(&self, now_s: f64) {
        loop {
            let (running, exposure_s) = {
                let state = self.world.state();
                (state.running, state.exposure_s)
            };
            let Some(running) = running else { return };
            let (period_s, done_s) = self.times(running.exposure_s);
            if running.start_s + done_s > now_s {
                return;
            }
            let mut state = self.world.state();
            if state.ready.len() < BUFFERS {
                state.ready.push_back(running);
            }
            let sequence = state.next_sequence();
            state.running = Some(Exposure { sequence, start_s: running.start_s + period_s, exposure_s });
        }
    }

    fn next_free_running(&self, deadline_s: f64) -> Option<Exposure> {
        self.run_on(self.world.clock.now_s());
        if let Some(ready) = self.world.state().ready.pop_front() {
            return Some(ready);
        }
        let running = self.world.state().running?;
        let due_s = running.start_s + self.times(running.exposure_s).1;
        self.world.clock.sleep_until_s(due_s.min(deadline_s));
        self.run_on(due_s.min(deadline_s));
        self.world.state().ready.pop_front()
    }
}

impl Camera for TwinCamera {
    fn set_exposure(&mut self, exposure_s: f64) -> Result<f64, CaptureError> {
        // A free-running camera latches it at the start of the next frame.
        self.run_on(self.world.clock.now_s());
        self.world.state().exposure_s = exposure_s;
        Ok(exposure_s)
    }

    fn set_gain(&mut self, _: f64) -> Result<f64, CaptureError> {
        Ok(1.0)
    }

    fn start(&mut self, first: u64) -> Result<(), CaptureError> {
        let start_s = self.world.clock.now_s();
        let mut state = self.world.state();
        state.triggered.clear();
        state.ready.clear();
        state.again.clear();
        (state.held, state.former) = (None, None);
        state.sequence = first;
        state.running = None;
        if self.world.triggering == Triggering::FreeRunning {
            let exposure_s = state.exposure_s;
            let sequence = state.next_sequence();
            state.running = Some(Exposure { sequence, start_s, exposure_s });
        }
        Ok(())
    }

    fn trigger(&mut self) -> Result<(), CaptureError> {
        if self.world.triggering == Triggering::FreeRunning {
            return Err(Self::failed("trigger", "it runs freely: do not trigger it"));
        }
        let frame_s = self.times(0.0).0;
        let now_s = self.world.clock.now_s();
        let mut state = self.world.state();
        let start_s = now_s.max(state.last_start_s + frame_s);
        state.last_start_s = start_s;
        let exposure = Exposure { sequence: state.next_sequence(), start_s, exposure_s: state.exposure_s };
        state.triggered.push_back(exposure);
        Ok(())
    }

    fn receive(&mut self, timeout_s: f64) -> Result<Option<Frame>, CaptureError> {
        let deadline_s = self.world.clock.now_s() + timeout_s;
        loop {
            if self.world.faults.lost(self.world.state().delivered) {
                return Err(Self::failed("receive", "it is gone: check its cable and power, then resume the run"));
            }
            let again = self.world.state().again.pop_front();
            if let Some((frame, truth)) = again {
                self.world.state().truth.push(truth);
                return Ok(Some(frame));
            }
            let exposure = match self.world.triggering {
                Triggering::Triggered => self.world.state().triggered.pop_front(),
                Triggering::FreeRunning => self.next_free_running(deadline_s),
            };
            let Some(exposure) = exposure else {
                self.world.clock.sleep_until_s(deadline_s);
                return Ok(None);
            };
            let (period_s, done_s) = self.times(exposure.exposure_s);
            let due_s = exposure.start_s + done_s;
            let ready_s = self.world.clock.now_s().max(exposure.start_s + period_s);
            let delivered = self.world.deliver(exposure);
            let late_s = (self.world.clock.now_s() - ready_s).max(0.0);
            self.world.state().late_s += late_s;
            self.world.clock.sleep_until_s(due_s);
            if let Some((frame, truth)) = delivered {
                self.world.state().truth.push(truth);
                return Ok(Some(frame));
            }
        }
    }

    fn restore(&mut self) -> Result<(), CaptureError> {
        let mut state = self.world.state();
        state.running = None;
        state.exposure_s = self.former_s;
        Ok(())
    }
}

/// The simulated projector before it is opened.
pub(super) struct TwinProjectorFactory(pub Arc<World>);

impl ProjectorFactory for TwinProjectorFactory {
    fn limits(&self) -> Result<ProjectorLimits, CaptureError> {
        let scene = self.0.scene();
        let (width, height) = scene.panel_size();
        Ok(ProjectorLimits {
            name: "simulated projector".into(),
            width,
            height,
            refresh_hz: scene.refresh_hz(),
            memory: None,
        })
    }

    fn open(&self) -> Result<Box<dyn Projector>, CaptureError> {
        Ok(Box::new(TwinProjector(self.0.clone())))
    }
}

struct TwinProjector(Arc<World>);

impl TwinProjector {
    fn failed(step: String, reason: String) -> CaptureError {
        CaptureError::Device { device: "projector", step, reason }
    }
}

impl Projector for TwinProjector {
    fn load(&mut self, sequence: &[Pattern]) -> Result<(), CaptureError> {
        let mut scene = self.0.scene();
        let (width, height) = scene.panel_size();
        if let Some(bad) = sequence.iter().find(|s| (s.width, s.height) != (width, height)) {
            let reason = format!("a {} x {} frame on a {width} x {height} panel", bad.width, bad.height);
            return Err(Self::failed("load".into(), reason));
        }
        scene.load(sequence);
        self.0.state().display.clear();
        Ok(())
    }

    fn show(&mut self, index: usize) -> Result<f64, CaptureError> {
        let (frames, latency_s, refresh_hz) = {
            let scene = self.0.scene();
            (scene.frames(), scene.latency_s(), scene.refresh_hz())
        };
        if index >= frames {
            return Err(Self::failed(format!("show frame {index}"), format!("the sequence has {frames} frames")));
        }
        let now_s = self.0.clock.now_s();
        let mut state = self.0.state();
        state.changes += 1;
        if let Some(late_s) = self.0.faults.of_change(state.changes) {
            // A frame begins with a refresh.
            let lit_s = ((now_s + latency_s + late_s) * refresh_hz).ceil() / refresh_hz;
            // A later request cannot be overtaken by one that was late.
            state.display.retain(|&(at, _)| at < lit_s);
            state.display.push((lit_s, index));
        }
        Ok(now_s)
    }

    fn restore(&mut self) -> Result<(), CaptureError> {
        self.0.state().display.clear();
        Ok(())
    }
}
