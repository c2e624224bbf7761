//! A GenICam camera that is open.

use aravis::prelude::*;
use aravis::{AcquisitionMode, Buffer, BufferStatus, Camera as Device, Stream};
use rustix::time::{ClockId, clock_gettime};

use super::aravis::{Failure, US, failed, triggering};
use super::{AravisSettings, MonotonicClock, Unpacker};
use crate::capture::{Camera, CaptureError, Clock, Frame, FrameFlags, Triggering};

/// Buffers in turn.
const BUFFERS: usize = 4;

/// What is put back.
struct Former {
    region: (i32, i32, i32, i32),
    pixel_format: String,
    exposure_us: f64,
    gain: Option<f64>,
    /// Features that are words.
    words: Vec<(&'static str, String)>,
}

/// Features that are words and are changed here, in the order in which they are put back.
const WORDS: [&str; 7] = [
    "AcquisitionMode",
    "TriggerSource",
    "TriggerMode",
    "ExposureAuto",
    "GainAuto",
    "BalanceWhiteAuto",
    "BlackLevelAuto",
];

/// The word that ends it.
const OFF: &str = "Off";

/// What acts on its own, wherever a camera has it.
const AUTOMATIC: [&str; 4] = ["ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto"];

/// Gains as near as this, in the camera's own unit, are the one that was set.
const SAME_GAIN: f64 = 0.05;

/// A camera that is open.
pub(super) struct AravisCamera {
    device: Device,
    stream: Option<Stream>,
    unpacker: Unpacker,
    triggering: Triggering,
    exposure_s: f64,
    /// The exposure before, which a free-running camera may still have used, and when it was changed.
    former_s: f64,
    changed_s: f64,
    /// When the frame under way was triggered.
    triggered_s: f64,
    numbers: Numbers,
    former: Option<Former>,
}

/// Numbers of frames, from those of the camera, which begin anew after 65535.
#[derive(Debug, Default, Clone, Copy)]
struct Numbers {
    next: u64,
    last: Option<u64>,
}

impl Numbers {
    fn of(&mut self, id: u64) -> u64 {
        let step = match self.last {
            Some(last) if id >= last => id - last,
            Some(_) => 1,
            None => 0,
        };
        self.last = Some(id);
        self.next += step;
        self.next
    }
}

impl Former {
    fn of(device: &Device) -> Result<Self, Failure> {
        let word = |name: &'static str| {
            let there = device.is_feature_available(name).unwrap_or(false);
            there.then(|| device.string(name).ok()).flatten().map(|value| (name, value.to_string()))
        };
        Ok(Self {
            region: device.region()?,
            pixel_format: device.pixel_format_as_string()?.to_string(),
            exposure_us: device.exposure_time()?,
            gain: if device.is_gain_available()? { Some(device.gain()?) } else { None },
            words: WORDS.into_iter().filter_map(word).collect(),
        })
    }

    fn restore(&self, device: &Device) -> Result<(), Failure> {
        let (x, y, width, height) = self.region;
        device.set_pixel_format_from_string(&self.pixel_format)?;
        device.set_region(x, y, width, height)?;
        device.set_exposure_time(self.exposure_us)?;
        self.gain.map_or(Ok(()), |gain| device.set_gain(gain))?;
        self.words.iter().try_for_each(|(name, value)| device.set_string(name, value))
    }
}

impl AravisCamera {
    /// Takes the camera over: format, size, gain, trigger; nothing of it acts on its own any more.
    pub fn new(device: Device, settings: &AravisSettings, unpacker: Unpacker) -> Result<Self, CaptureError> {
        let former = Former::of(&device).map_err(|e| failed("read its settings", e.message()))?;
        let triggering = triggering(&device);
        let mut camera = Self {
            device,
            stream: None,
            unpacker,
            triggering,
            exposure_s: f64::NAN,
            former_s: f64::NAN,
            changed_s: f64::NEG_INFINITY,
            triggered_s: f64::NAN,
            numbers: Numbers::default(),
            former: Some(former),
        };
        let set = camera.configure(settings);
        set.map_err(|e| {
            failed("set format, size, gain and trigger", format!("{}: change the devices file", e.message()))
        })?;
        camera.check(settings)?;
        Ok(camera)
    }

    fn configure(&mut self, settings: &AravisSettings) -> Result<(), Failure> {
        let d = &self.device;
        d.set_pixel_format_from_string(&settings.pixel_format)?;
        d.set_region(0, 0, settings.width_px as i32, settings.height_px as i32)?;
        for name in AUTOMATIC {
            if d.is_feature_available(name)? {
                d.set_string(name, OFF)?;
            }
        }
        if d.is_gain_available()? {
            d.set_gain(settings.gain)?;
        }
        if d.is_gv_device() {
            match settings.packet_size_bytes {
                Some(bytes) => d.gv_set_packet_size(bytes as i32)?,
                // Where the network does not say, the camera's own stays.
                None => drop(d.gv_auto_packet_size()),
            }
            settings.packet_delay_s.map_or(Ok(()), |s| d.gv_set_packet_delay((1e9 * s) as i64))?;
        }
        d.set_acquisition_mode(AcquisitionMode::Continuous)?;
        match self.triggering {
            Triggering::Triggered => d.set_trigger("Software")?,
            Triggering::FreeRunning => d.clear_triggers()?,
        }
        self.exposure_s = d.exposure_time()? * US;
        Ok(())
    }

    /// Whether the camera took what it was told.
    fn check(&self, settings: &AravisSettings) -> Result<(), CaptureError> {
        let said = |e: Failure| failed("read its settings", e.message());
        let (_, _, width, height) = self.device.region().map_err(said)?;
        if (width, height) != (settings.width_px as i32, settings.height_px as i32) {
            let reason = format!("it takes {width} x {height} px: correct width_px and height_px in the devices file");
            return Err(failed("set its size", reason));
        }
        for name in AUTOMATIC {
            if self.device.is_feature_available(name).map_err(said)? {
                let set = self.device.string(name).map_err(said)?;
                if set != OFF {
                    let reason = format!("it stays {set}: turn it off with the maker's program, or use another camera");
                    return Err(failed(&format!("turn off {name}"), reason));
                }
            }
        }
        if self.device.is_gain_available().map_err(said)? {
            let gain = self.device.gain().map_err(said)?;
            if (gain - settings.gain).abs() > SAME_GAIN {
                return Err(failed("set its gain", format!("it sets {gain}: say so with gain in the devices file")));
            }
        }
        Ok(())
    }

    /// When the exposure of a frame began, and how long it took as far as that is known, s.
    fn exposure_of(&self, buffer: &Buffer) -> (f64, f64) {
        if self.triggering == Triggering::Triggered {
            return (self.triggered_s, self.exposure_s);
        }
        // The library stamps by the clock on the wall, when the first packet comes: at the end of the exposure.
        let wall = clock_gettime(ClockId::Realtime);
        let age_s = wall.tv_sec as f64 + 1e-9 * wall.tv_nsec as f64 - 1e-9 * buffer.system_timestamp() as f64;
        let end_s = MonotonicClock.now_s() - age_s.max(0.0);
        if end_s - self.exposure_s >= self.changed_s {
            (end_s - self.exposure_s, self.exposure_s)
        } else if end_s < self.changed_s {
            (end_s - self.former_s, self.former_s)
        } else {
            (end_s - self.exposure_s.max(self.former_s), f64::NAN)
        }
    }

    fn stop(&mut self) -> Result<(), Failure> {
        let Some(stream) = self.stream.take() else { return Ok(()) };
        let stopped = self.device.stop_acquisition();
        drop(stream);
        stopped
    }

    fn put_back(&mut self) -> Result<(), CaptureError> {
        let Some(former) = self.former.take() else { return Ok(()) };
        let stopped = self.stop();
        let restored = former.restore(&self.device);
        stopped.and(restored).map_err(|e| failed("put back its settings", e.message()))
    }
}

impl Camera for AravisCamera {
    fn set_exposure(&mut self, exposure_s: f64) -> Result<f64, CaptureError> {
        let set = self.device.set_exposure_time(exposure_s / US).and_then(|()| self.device.exposure_time());
        self.former_s = self.exposure_s;
        self.exposure_s = set.map_err(|e| failed("set its exposure", e.message()))? * US;
        self.changed_s = MonotonicClock.now_s();
        Ok(self.exposure_s)
    }

    fn set_gain(&mut self, _: f64) -> Result<f64, CaptureError> {
        // Decibels or a maker's own unit: there is the calibrated one and no other.
        Ok(1.0)
    }

    fn start(&mut self, first: u64) -> Result<(), CaptureError> {
        let started = self.stop().and_then(|()| {
            let stream = self.device.create_stream()?;
            let size = self.device.payload()? as usize;
            (0..BUFFERS).for_each(|_| stream.push_buffer(Buffer::new_allocate(size)));
            self.device.start_acquisition()?;
            self.stream = Some(stream);
            Ok(())
        });
        self.numbers = Numbers { next: first, last: None };
        started.map_err(|e| failed("start", e.message()))
    }

    fn trigger(&mut self) -> Result<(), CaptureError> {
        self.triggered_s = MonotonicClock.now_s();
        self.device.software_trigger().map_err(|e| failed("trigger", e.message()))
    }

    fn receive(&mut self, timeout_s: f64) -> Result<Option<Frame>, CaptureError> {
        let stream = self.stream.as_ref().ok_or_else(|| failed("receive", "it was not started"))?;
        let Some(buffer) = stream.timeout_pop_buffer((timeout_s / US) as u64) else { return Ok(None) };
        let status = buffer.status();
        let incomplete = matches!(status, BufferStatus::Timeout | BufferStatus::MissingPackets);
        // What did not arrive as an image has none to be looked at.
        let bytes = if status == BufferStatus::Success { buffer.image_data() } else { Vec::new() };
        let (samples, whole) = self.unpacker.unpack(&bytes);
        let (timestamp_s, exposure_s) = self.exposure_of(&buffer);
        let sequence = self.numbers.of(buffer.frame_id());
        stream.push_buffer(buffer);
        let corrupt = status != BufferStatus::Success && !incomplete;
        let flags = FrameFlags { corrupt, incomplete: incomplete || (!corrupt && !whole) };
        if flags.good() {
            self.unpacker.check(&samples).map_err(|e| failed("receive", e))?;
        }
        let [width, height] = self.unpacker.size();
        Ok(Some(Frame { width, height, samples, exposure_s, gain: 1.0, sequence, timestamp_s, flags }))
    }

    fn restore(&mut self) -> Result<(), CaptureError> {
        self.put_back()
    }
}

impl Drop for AravisCamera {
    fn drop(&mut self) {
        // An error is on its way, and is the one to report.
        let _ = self.put_back();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_go_on_where_the_camera_begins_anew() {
        let mut numbers = Numbers { next: 100, last: None };
        assert_eq!([7, 8, 8, 11, 65535, 1].map(|id| numbers.of(id)), [100, 101, 101, 104, 65628, 65629]);
    }
}
