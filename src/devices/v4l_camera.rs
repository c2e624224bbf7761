//! A V4L2 camera that is open.

use std::io;
use std::time::Duration;

use v4l::Device;
use v4l::buffer::{Metadata, Type};
use v4l::io::traits::CaptureStream;
use v4l::prelude::MmapStream;

use super::v4l::{Found, failed};
use super::v4l_controls::{Controls, ExposureControl};
use super::v4l_timing::Timing;
use super::{MonotonicClock, Unpacker, V4lSettings};
use crate::capture::{Camera, CaptureError, Clock, Frame, FrameFlags};

/// `V4L2_BUF_FLAG_ERROR`.
const DAMAGED: u32 = 0x40;

/// A camera that is open.
pub(super) struct V4lCamera {
    settings: V4lSettings,
    exposure: Option<ExposureControl>,
    timing: Timing,
    unpacker: Unpacker,
    /// `None` when it is put back.
    found: Option<Found>,
    numbers: Numbers,
    /// Buffers, while they are good.
    stream: Option<MmapStream<'static>>,
    device: Device,
}

/// Numbers of frames, counted on where the kernel begins anew.
#[derive(Debug, Default)]
struct Numbers {
    first: u64,
    /// The kernel's number of the first.
    base: Option<u32>,
    next: u64,
}

impl Numbers {
    fn from(first: u64) -> Self {
        Self { first, base: None, next: first }
    }

    fn of(&mut self, sequence: u32) -> u64 {
        let base = *self.base.get_or_insert(sequence);
        let number = self.first + u64::from(sequence.wrapping_sub(base));
        self.next = self.next.max(number + 1);
        number
    }
}

/// What came of waiting.
enum Received {
    Frame(Vec<u16>, bool, Metadata),
    TooLate,
    Interrupted,
}

impl V4lCamera {
    pub fn new(
        device: Device,
        settings: V4lSettings,
        found: Found,
        unpacker: Unpacker,
        timing: Timing,
        exposure: Option<ExposureControl>,
    ) -> Self {
        let (found, numbers, stream) = (Some(found), Numbers::default(), None);
        Self { settings, exposure, timing, unpacker, found, numbers, stream, device }
    }

    /// Turns off what acts on its own, and sets the gain; says what stays on.
    pub fn take_over(&mut self, controls: &Controls) -> Result<Option<String>, CaptureError> {
        let Some(found) = &mut self.found else { return Ok(None) };
        let failed = |step, e: &io::Error| failed(&self.settings, step, e);
        let off = controls.turn_off(&self.device, &mut found.controls);
        if let Err(stays_on) = off.map_err(|e| failed("turn off its automatics", &e))? {
            return Ok(Some(stays_on));
        }
        if let Some((gain, wanted)) = controls.gain().zip(self.settings.gain) {
            let set = gain.set(&self.device, &mut found.controls, wanted).map_err(|e| failed("set its gain", &e))?;
            if set != wanted {
                return Ok(Some(format!("gain at {set}")));
            }
        }
        if let Some(exposure) = &self.exposure {
            let kept = exposure.remember(&self.device, &mut found.controls);
            kept.map_err(|e| failed("read its exposure", &e))?;
        }
        if let Some(fixed_s) = self.settings.fixed_exposure_s {
            self.timing.change(fixed_s, f64::NEG_INFINITY);
        }
        Ok(None)
    }

    fn failed(&self, step: &str, error: &io::Error) -> CaptureError {
        failed(&self.settings, step, error)
    }

    /// Waits for a frame; a stream that gave none is of no use any more.
    fn next(&mut self, timeout: Duration) -> io::Result<Received> {
        if self.stream.is_none() {
            self.numbers = Numbers::from(self.numbers.next);
            self.stream = Some(MmapStream::with_buffers(&self.device, Type::VideoCapture, self.settings.buffers)?);
        }
        let Some(stream) = &mut self.stream else { return Ok(Received::TooLate) };
        stream.set_timeout(timeout);
        let received = match CaptureStream::next(stream) {
            Ok((bytes, meta)) => {
                let used = bytes.len().min(meta.bytesused as usize);
                let (samples, whole) = self.unpacker.unpack(&bytes[..used]);
                Ok(Received::Frame(samples, whole, *meta))
            }
            Err(e) if e.kind() == io::ErrorKind::TimedOut => Ok(Received::TooLate),
            Err(e) if e.kind() == io::ErrorKind::Interrupted => Ok(Received::Interrupted),
            Err(e) => Err(e),
        };
        if !matches!(received, Ok(Received::Frame(..))) {
            self.stream = None;
        }
        received
    }

    fn put_back(&mut self) -> Result<(), CaptureError> {
        self.stream = None;
        let restored = self.found.take().map_or(Ok(()), |mut found| found.restore(&self.device));
        restored.map_err(|e| self.failed("put back its settings", &e))
    }
}

impl Camera for V4lCamera {
    fn set_exposure(&mut self, exposure_s: f64) -> Result<f64, CaptureError> {
        let Some(control) = &self.exposure else {
            return Ok(self.settings.fixed_exposure_s.unwrap_or(f64::NAN));
        };
        let asked_s = MonotonicClock.now_s();
        let set_s = control.set(&self.device, exposure_s).map_err(|e| self.failed("set its exposure", &e))?;
        self.timing.change(set_s, asked_s);
        Ok(set_s)
    }

    fn set_gain(&mut self, _: f64) -> Result<f64, CaptureError> {
        // The unit of `gain` is the maker's secret: there is the calibrated one and no other.
        Ok(1.0)
    }

    fn start(&mut self, first: u64) -> Result<(), CaptureError> {
        // Frames of before are not worth waiting for.
        self.stream = None;
        self.numbers = Numbers::from(first);
        Ok(())
    }

    fn trigger(&mut self) -> Result<(), CaptureError> {
        let reason = "it runs freely: do not trigger it".into();
        Err(CaptureError::Device { device: "camera", step: "trigger".into(), reason })
    }

    fn receive(&mut self, timeout_s: f64) -> Result<Option<Frame>, CaptureError> {
        let deadline_s = MonotonicClock.now_s() + timeout_s;
        loop {
            let left_s = (deadline_s - MonotonicClock.now_s()).max(1e-3);
            let received = self.next(Duration::from_secs_f64(left_s)).map_err(|e| self.failed("receive", &e))?;
            let (samples, whole, meta) = match received {
                Received::Frame(samples, whole, meta) => (samples, whole, meta),
                Received::TooLate => return Ok(None),
                Received::Interrupted => continue,
            };
            let flags = FrameFlags { corrupt: meta.flags.bits() & DAMAGED != 0, incomplete: !whole };
            if flags.good() {
                let reason =
                    |e| CaptureError::Device { device: "camera", step: "receive".into(), reason: format!("{e}") };
                self.unpacker.check(&samples).map_err(reason)?;
            }
            let stamp_s = Duration::from(meta.timestamp).as_secs_f64();
            let [timestamp_s, exposure_s] = self.timing.of(stamp_s, meta.flags.bits(), MonotonicClock.now_s());
            let [width, height] = self.unpacker.size();
            let sequence = self.numbers.of(meta.sequence);
            return Ok(Some(Frame { width, height, samples, exposure_s, gain: 1.0, sequence, timestamp_s, flags }));
        }
    }

    fn restore(&mut self) -> Result<(), CaptureError> {
        self.put_back()
    }
}

impl Drop for V4lCamera {
    fn drop(&mut self) {
        // An error is on its way, and is the one to report.
        let _ = self.put_back();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_go_on_where_the_kernel_begins_anew() {
        let mut numbers = Numbers::from(100);
        assert_eq!([7, 8, 11].map(|n| numbers.of(n)), [100, 101, 104]);
        let mut numbers = Numbers::from(numbers.next);
        assert_eq!([0, 0, 1].map(|n| numbers.of(n)), [105, 105, 106]);
        // 32 bits end after four years at 30 frames a second, or where a driver begins near the end.
        let mut numbers = Numbers::from(0);
        assert_eq!([u32::MAX, 0, 1].map(|n| numbers.of(n)), [0, 1, 2]);
    }
}
