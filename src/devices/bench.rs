//! A bench of real devices.

use std::fmt;
use std::io::{self, Write};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::time::{ClockId, clock_gettime};

use super::settings::{CameraSettings, DevicesFile, ProjectorSettings};
use super::{DevicesError, Painter, files, files_projector};
use crate::capture::{Bench, CameraFactory, CaptureError, Clock, Control, Placement, ProjectorFactory};
use crate::optics::Rig;

/// The kernel's monotonic clock, by which V4L2 and DRM stamp what they do.
#[derive(Debug, Clone, Copy, Default)]
pub struct MonotonicClock;

impl Clock for MonotonicClock {
    fn now_s(&self) -> f64 {
        let now = clock_gettime(ClockId::Monotonic);
        now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
    }

    fn sleep_until_s(&self, time_s: f64) {
        let left_s = time_s - self.now_s();
        if left_s > 0.0 {
            thread::sleep(Duration::from_secs_f64(left_s));
        }
    }
}

/// Who puts things into the rig's light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operator {
    /// Somebody at the terminal, who is asked and answers with Enter.
    AtTerminal,
    /// Nobody; what is needed first is in place already.
    Gone,
}

/// Real devices, and somebody who serves them.
pub struct DeviceBench {
    camera: Box<dyn CameraFactory>,
    projector: Box<dyn ProjectorFactory>,
    operator: Operator,
    control: Control,
    placed: Option<Placement>,
}

impl fmt::Debug for DeviceBench {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DeviceBench").field("operator", &self.operator).field("placed", &self.placed).finish()
    }
}

impl DeviceBench {
    /// The devices of a file, for a rig. Nothing is opened.
    ///
    /// # Errors
    /// [`DevicesError::NotBuilt`].
    pub fn new(devices: &DevicesFile, rig: &Rig, operator: Operator) -> Result<Self, DevicesError> {
        Self::steered(devices, rig, operator, &Control::default())
    }

    /// The same where `control` ends long waits: for another program's frame, for the operator.
    ///
    /// # Errors
    /// [`DevicesError::NotBuilt`].
    pub fn steered(
        devices: &DevicesFile,
        rig: &Rig,
        operator: Operator,
        control: &Control,
    ) -> Result<Self, DevicesError> {
        let (camera, projector) = (camera(&devices.camera, control)?, projector(&devices.projector, Painter::of(rig))?);
        Ok(Self { control: control.clone(), ..Self::of(camera, projector, operator) })
    }

    /// A bench of these two.
    pub fn of(camera: Box<dyn CameraFactory>, projector: Box<dyn ProjectorFactory>, operator: Operator) -> Self {
        Self { camera, projector, operator, control: Control::default(), placed: None }
    }
}

fn camera(settings: &CameraSettings, control: &Control) -> Result<Box<dyn CameraFactory>, DevicesError> {
    match settings {
        #[cfg(feature = "v4l")]
        CameraSettings::V4l(settings) => Ok(Box::new(super::v4l::V4l::new(settings))),
        #[cfg(feature = "aravis")]
        CameraSettings::Aravis(settings) => Ok(Box::new(super::aravis::Aravis::new(settings))),
        CameraSettings::Files(settings) => Ok(Box::new(files::FilesCameraFactory::new(settings, control))),
        #[allow(unreachable_patterns)] // none is left where all are built in
        other => Err(DevicesError::NotBuilt { driver: other.driver() }),
    }
}

fn projector(settings: &ProjectorSettings, painter: Painter) -> Result<Box<dyn ProjectorFactory>, DevicesError> {
    match settings {
        #[cfg(feature = "kms")]
        ProjectorSettings::Kms(settings) => Ok(Box::new(super::kms::Kms::new(settings, painter))),
        #[cfg(feature = "window")]
        ProjectorSettings::Window(settings) => Ok(Box::new(super::window::Window::new(settings, painter))),
        ProjectorSettings::Files(settings) => {
            Ok(Box::new(files_projector::FilesProjectorFactory::new(settings, painter)))
        }
        #[allow(unreachable_patterns)] // none is left where all are built in
        other => Err(DevicesError::NotBuilt { driver: other.driver() }),
    }
}

impl Bench for DeviceBench {
    fn camera(&self) -> &dyn CameraFactory {
        self.camera.as_ref()
    }

    fn projector(&self) -> &dyn ProjectorFactory {
        self.projector.as_ref()
    }

    fn clock(&self) -> Arc<dyn Clock> {
        Arc::new(MonotonicClock)
    }

    /// Asks for what is not in place yet.
    fn place(&mut self, what: Placement) -> Result<(), CaptureError> {
        if self.placed == Some(what) {
            return Ok(());
        }
        match self.operator {
            Operator::AtTerminal => asked(what, &self.control)?,
            Operator::Gone if self.placed.is_some() => return Err(CaptureError::NotPlaced { what }),
            Operator::Gone => {}
        }
        self.placed = Some(what);
        Ok(())
    }
}

/// How often a prompt looks whether it is to end.
const PROMPT_POLL: Timespec = Timespec { tv_sec: 0, tv_nsec: 100_000_000 };

/// Asks the operator and waits for Enter.
fn asked(what: Placement, control: &Control) -> Result<(), CaptureError> {
    let (mut stderr, stdin) = (io::stderr(), io::stdin());
    let asked = write!(stderr, "put in place: {what}; close the rig, then press Enter ").and_then(|()| stderr.flush());
    asked.map_err(|_| CaptureError::NotPlaced { what })?;
    loop {
        if control.aborted() {
            return Err(CaptureError::Declined { what });
        }
        match poll(&mut [PollFd::new(&stdin, PollFlags::IN)], Some(&PROMPT_POLL)) {
            Ok(0) | Err(Errno::INTR) => {}
            Ok(_) => break,
            Err(_) => return Err(CaptureError::NotPlaced { what }),
        }
    }
    match stdin.read_line(&mut String::new()) {
        // End of input is no Enter.
        Ok(0) | Err(_) => Err(CaptureError::NotPlaced { what }),
        Ok(_) => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_goes_on_and_waits() {
        let clock = MonotonicClock;
        let start_s = clock.now_s();
        clock.sleep_until_s(start_s + 0.02);
        assert!(clock.now_s() >= start_s + 0.02);
        clock.sleep_until_s(start_s);
    }

    #[test]
    fn with_nobody_there_one_thing_is_in_place_and_no_other() {
        let devices = DevicesFile {
            format: 1,
            camera: CameraSettings::Files(super::super::FilesCameraSettings {
                folder: "in".into(),
                width_px: 4,
                height_px: 4,
                timeout_s: 1.0,
                shortest_s: 1e-4,
                longest_s: 1.0,
            }),
            projector: ProjectorSettings::Files(super::super::FilesProjectorSettings {
                folder: "out".into(),
                width_px: 4,
                height_px: 4,
                refresh_hz: 60.0,
                settle_s: 0.0,
            }),
        };
        let rig = Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap();
        let mut bench = DeviceBench::new(&devices, &rig, Operator::Gone).unwrap();
        bench.place(Placement::PrintedCross).unwrap();
        bench.place(Placement::PrintedCross).unwrap();
        let error = bench.place(Placement::Crosses).unwrap_err();
        assert!(error.to_string().contains("the wire cross"), "{error}");
    }
}
