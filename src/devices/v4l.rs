//! Cameras of the kernel's Video4Linux: they run freely, and every frame says when it began.

use std::io;

use v4l::capability::Flags as Capability;
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Capabilities, Device, Format, FourCC, Fraction};

use super::v4l_camera::V4lCamera;
use super::v4l_controls::{Controls, ExposureControl, Former};
use super::v4l_list;
use super::v4l_timing::Timing;
use super::{Stamp, Unpacker, V4lSettings};
use crate::capture::{Camera, CameraFactory, CameraLimits, CaptureError, Triggering};

pub(super) use super::v4l_list::list;

/// Rate of cameras that do not tell theirs, Hz: slow, so that nothing is expected too early.
const UNKNOWN_RATE_HZ: f64 = 5.0;

/// A camera before it is opened.
pub struct V4l(V4lSettings);

/// A format in force.
struct Mode {
    unpacker: Unpacker,
    frame_s: f64,
}

/// Everything that is put back.
pub(super) struct Found {
    format: Format,
    rate: Option<Parameters>,
    pub controls: Former,
}

impl V4l {
    /// One of these settings; nothing is opened.
    pub fn new(settings: &V4lSettings) -> Self {
        Self(settings.clone())
    }

    fn cannot(&self, problem: String, remedy: &'static str) -> CaptureError {
        CaptureError::Limits { device: "camera", name: self.0.device.display().to_string(), problem, remedy }
    }

    fn failed(&self, step: &str, error: &io::Error) -> CaptureError {
        failed(&self.0, step, error)
    }

    /// Opens the node and sees that it takes pictures.
    fn node(&self) -> Result<(Device, Capabilities), CaptureError> {
        let device = Device::with_path(&self.0.device).map_err(|e| match e.raw_os_error() {
            Some(libc::ENOENT | libc::ENXIO | libc::ENODEV) => {
                self.cannot("is not there".into(), "`zonal devices` lists what is; check cable and power")
            }
            Some(libc::EACCES | libc::EPERM) => self.cannot(
                "may not be opened by you".into(),
                "join the group that owns it (`sudo usermod -aG video $USER`) and log in again",
            ),
            Some(libc::EBUSY) => self.failed("open", &e),
            _ => self.cannot(format!("cannot be opened as a camera ({e})"), "`zonal devices` lists those there are"),
        })?;
        // ENOTTY is what a node of another kind says.
        let caps = device
            .query_caps()
            .ok()
            .filter(|c| c.capabilities.contains(Capability::VIDEO_CAPTURE | Capability::STREAMING));
        let caps = caps.ok_or_else(|| {
            self.cannot("is no camera that streams single-plane frames".into(), "`zonal devices` lists those that do")
        })?;
        Ok((device, caps))
    }

    fn found(&self, device: &Device) -> Result<Found, CaptureError> {
        let format = device.format().map_err(|e| self.failed("read its format", &e))?;
        Ok(Found { format, rate: device.params().ok(), controls: Former::default() })
    }

    /// Sets format, size and rate.
    fn configure(&self, device: &Device) -> Result<Mode, CaptureError> {
        let s = &self.0;
        let formats = device.enum_formats().map_err(|e| self.failed("list its formats", &e))?;
        let code = FourCC::new(&s.format.fourcc());
        let there = formats.iter().any(|f| f.fourcc == code);
        let wanted = Format::new(s.width_px, s.height_px, code);
        let set = device.set_format(&wanted).map_err(|e| self.failed("set its format", &e))?;
        if !there || set.fourcc != code || (set.width, set.height) != (s.width_px, s.height_px) {
            let problem = format!(
                "has no {} of {} x {} px; it has {}",
                s.format,
                s.width_px,
                s.height_px,
                v4l_list::formats(device).join("; ")
            );
            return Err(self.cannot(problem, "choose one of these in the devices file"));
        }
        if let Some(rate_hz) = s.frame_rate_hz {
            let interval = Fraction::new(1000, (1000.0 * rate_hz).round() as u32);
            device.set_params(&Parameters::new(interval)).map_err(|e| self.failed("set its frame rate", &e))?;
        }
        let told_s = device.params().ok().map(|p| f64::from(p.interval.numerator) / f64::from(p.interval.denominator));
        let frame_s = told_s.filter(|s| s.is_finite() && *s > 0.0);
        let frame_s = frame_s.unwrap_or_else(|| 1.0 / s.frame_rate_hz.unwrap_or(UNKNOWN_RATE_HZ));
        let (width, height) = (set.width as usize, set.height as usize);
        let unpacker = Unpacker::new(s.format, width, height, set.stride as usize, s.bits, s.shift);
        Ok(Mode { unpacker, frame_s })
    }

    /// Shortest and longest exposure, s.
    fn exposures(&self, exposure: Option<&ExposureControl>, frame_s: f64) -> Result<[f64; 2], CaptureError> {
        match (exposure, self.0.fixed_exposure_s) {
            (Some(e), None) => {
                let longest_s = e.maximum as f64 * e.unit_s;
                let longest_s = if self.0.slows_down { longest_s } else { longest_s.min(frame_s) };
                Ok([e.minimum as f64 * e.unit_s, longest_s])
            }
            (None, Some(fixed_s)) => Ok([fixed_s, fixed_s]),
            (None, None) => Err(self.cannot(
                "does not let its exposure be set".into(),
                "say `fixed_exposure_s` in the devices file; for a sensor with `exposure` in lines, `exposure_unit_s`",
            )),
            (Some(_), Some(_)) => {
                Err(self.cannot("lets its exposure be set".into(), "leave `fixed_exposure_s` out of the devices file"))
            }
        }
    }

    fn check_gain(&self, controls: &Controls) -> Result<(), CaptureError> {
        let Some(wanted) = self.0.gain else { return Ok(()) };
        match controls.gain() {
            None => Err(self.cannot("has no control `gain`".into(), "leave `gain` out of the devices file")),
            Some(g) if !(g.minimum..=g.maximum).contains(&wanted) => {
                let problem = format!("has gains {}..={}, not {wanted}", g.minimum, g.maximum);
                Err(self.cannot(problem, "change `gain` in the devices file"))
            }
            Some(_) => Ok(()),
        }
    }

    fn controls(&self, device: &Device) -> Result<Controls, CaptureError> {
        Controls::of(device).map_err(|e| self.failed("list its controls", &e))
    }

    /// What it can do in the mode it is in.
    fn limits_in(&self, mode: &Mode, controls: &Controls, name: String) -> Result<CameraLimits, CaptureError> {
        self.check_gain(controls)?;
        let exposure = controls.exposure(&self.0);
        let [shortest_s, longest_s] = self.exposures(exposure.as_ref(), mode.frame_s)?;
        let [width, height] = mode.unpacker.size();
        Ok(CameraLimits {
            name,
            width,
            height,
            shortest_s,
            longest_s,
            exposure_step_s: exposure.map_or(0.0, |e| e.step as f64 * e.unit_s),
            settling_frames: exposure.map_or(0, |_| self.0.settling_frames),
            triggering: Triggering::FreeRunning,
            frame_s: mode.frame_s,
            readout_s: self.0.readout_s.unwrap_or(mode.frame_s),
        })
    }
}

/// What the system's word means for a camera, and what helps.
pub(super) fn failed(settings: &V4lSettings, step: &str, error: &io::Error) -> CaptureError {
    let device = settings.device.display();
    let reason = match error.raw_os_error() {
        Some(libc::ENODEV | libc::ENXIO | libc::ESHUTDOWN) => {
            format!("{device} is gone: check its cable and power, connect it again, then resume the run")
        }
        Some(libc::EBUSY) => {
            format!("{device} is used by another program: `fuser -v {device}` says which; end that one")
        }
        Some(libc::ENOSPC) => {
            format!("{device} gets no bandwidth on its bus: unplug other cameras or lower the frame rate")
        }
        _ => format!("{device}: {error}"),
    };
    CaptureError::Device { device: "camera", step: step.into(), reason }
}

impl Found {
    /// Puts all back; the first refusal is returned.
    pub fn restore(&mut self, device: &Device) -> io::Result<()> {
        let controls = self.controls.restore(device);
        let format = device.set_format(&self.format).map(drop);
        // A camera that does not take its own rate back has none to set.
        self.rate.take().map(|rate| device.set_params(&rate));
        controls.and(format)
    }
}

impl CameraFactory for V4l {
    fn limits(&self) -> Result<CameraLimits, CaptureError> {
        let (device, caps) = self.node()?;
        let mut found = self.found(&device)?;
        // What it can do is known only in the mode; a camera that another program streams from refuses here.
        let limits = self.configure(&device).and_then(|mode| {
            let controls = self.controls(&device)?;
            self.limits_in(&mode, &controls, format!("{} ({})", caps.card, self.0.device.display()))
        });
        let restored = found.restore(&device).map_err(|e| self.failed("put back its format", &e));
        limits.and_then(|limits| restored.map(|()| limits))
    }

    fn open(&self) -> Result<Box<dyn Camera>, CaptureError> {
        let (device, caps) = self.node()?;
        let mut found = self.found(&device)?;
        let ready = self.configure(&device).and_then(|mode| {
            let controls = self.controls(&device)?;
            let limits = self.limits_in(&mode, &controls, String::new())?;
            Ok((mode, controls, limits))
        });
        let (mode, controls, limits) = match ready {
            Ok(ready) => ready,
            Err(error) => {
                // The one to report.
                let _ = found.restore(&device);
                return Err(error);
            }
        };
        let stamp = match self.0.timestamp {
            // It stamps the first packet of a frame, which is sent when the exposure is over.
            Stamp::Auto if caps.driver == "uvcvideo" => Stamp::End,
            stamp => stamp,
        };
        let timing = Timing::new(stamp, mode.frame_s, limits.readout_s, self.0.settling_frames);
        let exposure = controls.exposure(&self.0);
        let mut camera = V4lCamera::new(device, self.0.clone(), found, mode.unpacker, timing, exposure);
        // From here on, dropping it puts everything back.
        if let Some(stays_on) = camera.take_over(&controls)? {
            let remedy = "turn it off with the maker's program, or use another camera";
            return Err(self.cannot(format!("keeps `{stays_on}` on"), remedy));
        }
        Ok(Box::new(camera))
    }
}
