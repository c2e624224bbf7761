//! GenICam cameras (USB3 Vision, GigE Vision) through the library Aravis.

use std::sync::{Mutex, OnceLock, PoisonError};

use aravis::Camera as Device;
use aravis::prelude::*;

use super::aravis_camera::AravisCamera;
use super::{AravisSettings, CameraSettings, Driver, Found, PixelFormat, Role, Unpacker};
use crate::capture::{Camera, CameraFactory, CameraLimits, CaptureError, Triggering};

/// What the library gives where something fails.
pub(super) type Failure = aravis::glib::Error;

/// Formats by their GenICam names, with the kernel's codes for the same bytes; packed ones are not among them.
const FORMATS: [(&str, &str); 19] = [
    ("Mono8", "GREY"),
    ("Mono10", "Y10"),
    ("Mono12", "Y12"),
    ("Mono16", "Y16"),
    ("BayerBG8", "BA81"),
    ("BayerGB8", "GBRG"),
    ("BayerGR8", "GRBG"),
    ("BayerRG8", "RGGB"),
    ("BayerBG10", "BG10"),
    ("BayerGB10", "GB10"),
    ("BayerGR10", "BA10"),
    ("BayerRG10", "RG10"),
    ("BayerBG12", "BG12"),
    ("BayerGB12", "GB12"),
    ("BayerGR12", "BA12"),
    ("BayerRG12", "RG12"),
    ("BayerBG16", "BYR2"),
    ("BayerGB16", "GB16"),
    ("BayerRG16", "RG16"),
];

/// Shortest time between frames of a camera that does not tell its rate, s.
const UNKNOWN_FRAME_S: f64 = 0.2;

/// Microseconds to seconds.
pub(super) const US: f64 = 1e-6;

/// A camera before it is opened.
pub struct Aravis {
    settings: AravisSettings,
}

/// A failure of a camera.
pub(super) fn failed(step: &str, reason: impl ToString) -> CaptureError {
    CaptureError::Device { device: "camera", step: step.into(), reason: reason.to_string() }
}

fn cannot(name: &str, problem: impl Into<String>, remedy: &'static str) -> CaptureError {
    CaptureError::Limits { device: "camera", name: name.into(), problem: problem.into(), remedy }
}

/// How bytes of a format, by its GenICam name, become samples.
fn unpacker(format: &str, width: usize, height: usize) -> Option<Unpacker> {
    let (_, code) = FORMATS.iter().find(|(name, _)| *name == format)?;
    let format: PixelFormat = code.parse().ok()?;
    Some(Unpacker::new(format, width, height, 0, None, 0))
}

/// Whether frames are asked for: of cameras that take a trigger by command.
pub(super) fn triggering(device: &Device) -> Triggering {
    let sources = device.dup_available_trigger_sources().unwrap_or_default();
    if sources.iter().any(|s| s.as_str() == "Software") { Triggering::Triggered } else { Triggering::FreeRunning }
}

impl Aravis {
    /// One of these settings; nothing is opened.
    pub fn new(settings: &AravisSettings) -> Self {
        Self { settings: settings.clone() }
    }

    fn device(&self) -> Result<Device, CaptureError> {
        let wanted = self.settings.camera.as_deref();
        Device::new(wanted).map_err(|e| {
            let problem = format!("cannot be opened ({})", e.message());
            let remedy = "`zonal devices` lists what is there; check cable and power, the address of a GigE camera, and that \
                          no other program has it";
            cannot(wanted.unwrap_or("first GenICam camera"), problem, remedy)
        })
    }

    fn unpacker(&self) -> Result<Unpacker, CaptureError> {
        let s = &self.settings;
        unpacker(&s.pixel_format, s.width_px as usize, s.height_px as usize).ok_or_else(|| {
            let names: Vec<&str> = FORMATS.iter().map(|f| f.0).collect();
            let problem = format!("is asked for {}, which is none of {}", s.pixel_format, names.join(", "));
            cannot("GenICam camera", problem, "choose one of these in the devices file")
        })
    }

    /// Format, size and gain against what the camera has.
    fn check(&self, device: &Device, name: &str) -> Result<(), CaptureError> {
        let (s, said) = (&self.settings, |e: Failure| failed("ask what it can do", e.message()));
        let formats = device.dup_available_pixel_formats_as_strings().map_err(said)?;
        if !formats.iter().any(|f| *f == s.pixel_format) {
            let formats: Vec<&str> = formats.iter().map(|f| f.as_str()).collect();
            let problem = format!("has no {}, only {}", s.pixel_format, formats.join(", "));
            return Err(cannot(name, problem, "change pixel_format in the devices file to an unpacked one of these"));
        }
        let (width, height) = device.sensor_size().map_err(said)?;
        if i64::from(s.width_px) > i64::from(width) || i64::from(s.height_px) > i64::from(height) {
            let problem =
                format!("has {width} x {height} px, the devices file asks for {} x {}", s.width_px, s.height_px);
            return Err(cannot(name, problem, "correct width_px and height_px in the devices file"));
        }
        if device.is_gain_available().map_err(said)? {
            let (least, most) = device.gain_bounds().map_err(said)?;
            if !(least..=most).contains(&s.gain) {
                let problem = format!("has gains {least}..={most}, not {}", s.gain);
                return Err(cannot(name, problem, "change gain in the devices file"));
            }
        }
        Ok(())
    }

    fn limits_of(&self, device: &Device) -> Result<CameraLimits, CaptureError> {
        let [width, height] = self.unpacker()?.size();
        let said = |e: Failure| failed("ask what it can do", e.message());
        let name = name_of(device).map_err(said)?;
        self.check(device, &name)?;
        let (shortest, longest) = device.exposure_time_bounds().map_err(said)?;
        let step = device.device().and_then(|d| d.float_feature_increment("ExposureTime").ok());
        let fastest = device
            .is_frame_rate_available()
            .and_then(|there| if there { device.frame_rate_bounds().map(|bounds| bounds.1) } else { Ok(f64::NAN) });
        let frame_s = fastest.map_err(said)?.recip();
        let frame_s = if frame_s.is_finite() && frame_s > 0.0 { frame_s } else { UNKNOWN_FRAME_S };
        Ok(CameraLimits {
            name,
            width,
            height,
            shortest_s: shortest * US,
            longest_s: longest * US,
            // The smallest number there is stands for none.
            exposure_step_s: step.filter(|s| s.is_finite() && *s > 1e-3).map_or(0.0, |s| s * US),
            settling_frames: if triggering(device) == Triggering::Triggered { 0 } else { 2 },
            triggering: triggering(device),
            frame_s,
            readout_s: self.settings.readout_s.unwrap_or(frame_s),
        })
    }
}

fn name_of(device: &Device) -> Result<String, Failure> {
    Ok(format!("{} {} {}", device.vendor_name()?, device.model_name()?, device.device_serial_number()?))
}

impl CameraFactory for Aravis {
    fn limits(&self) -> Result<CameraLimits, CaptureError> {
        self.limits_of(&self.device()?)
    }

    fn open(&self) -> Result<Box<dyn Camera>, CaptureError> {
        let device = self.device()?;
        Ok(Box::new(AravisCamera::new(device, &self.settings, self.unpacker()?)?))
    }
}

/// Every camera that answers; those that cannot be used with the reason.
///
/// # Errors
/// [`CaptureError::Device`].
pub(super) fn list() -> Result<Vec<Found>, CaptureError> {
    static LIBRARY: OnceLock<Option<Mutex<aravis::Aravis>>> = OnceLock::new();
    let library = LIBRARY.get_or_init(|| aravis::Aravis::initialize().ok().map(Mutex::new)).as_ref();
    let library = library.ok_or_else(|| failed("look for cameras", "another part of the program uses Aravis"))?;
    let all = library.lock().unwrap_or_else(PoisonError::into_inner).get_device_list();
    Ok(all.iter().map(|info| one(&info.id.to_string_lossy(), &info.protocol.to_string_lossy())).collect())
}

fn one(id: &str, protocol: &str) -> Found {
    let name = format!("{id} ({protocol})");
    let described = Device::new(Some(id)).and_then(|device| Ok((suggested(&device, id)?, device)));
    match described {
        Ok((Some(settings), device)) => {
            let details = details(&device).unwrap_or_default();
            Found::camera(name, details, &CameraSettings::Aravis(settings))
        }
        Ok((None, _)) => {
            Found::unusable(Role::Camera, Driver::Aravis, name, "it has no unpacked grey or Bayer format".into())
        }
        Err(e) => Found::unusable(
            Role::Camera,
            Driver::Aravis,
            name,
            format!("{}: does another program use it?", e.message()),
        ),
    }
}

/// Settings with all pixels, and the format with the most bits.
fn suggested(device: &Device, id: &str) -> Result<Option<AravisSettings>, Failure> {
    let there = device.dup_available_pixel_formats_as_strings()?;
    let readable = there.iter().filter_map(|name| {
        let (name, code) = FORMATS.iter().find(|(known, _)| *known == name.as_str())?;
        Some((code.parse::<PixelFormat>().ok()?.bits(), (*name).to_owned()))
    });
    let Some((_, pixel_format)) = readable.max_by_key(|(bits, _)| *bits) else { return Ok(None) };
    let (width, height) = device.sensor_size()?;
    Ok(Some(AravisSettings {
        camera: Some(id.into()),
        pixel_format,
        width_px: width as u32,
        height_px: height as u32,
        gain: 0.0,
        readout_s: None,
        packet_size_bytes: None,
        packet_delay_s: None,
    }))
}

fn details(device: &Device) -> Result<Vec<String>, Failure> {
    let (width, height) = device.sensor_size()?;
    let formats = device.dup_available_pixel_formats_as_strings()?;
    let formats: Vec<&str> = formats.iter().map(|f| f.as_str()).collect();
    let (shortest, longest) = device.exposure_time_bounds()?;
    let how = if triggering(device) == Triggering::Triggered { "triggered by command" } else { "free-running" };
    Ok(vec![
        format!("{width} x {height} px: {}", formats.join(", ")),
        format!("exposure {:.3}..{:.0} ms, {how}", 1e-3 * shortest, 1e-3 * longest),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn genicam_names_decode_as_the_kernels_formats_do() {
        let bytes: Vec<u8> = [0u16, 1, 0x0abc, 4095].iter().flat_map(|s| s.to_le_bytes()).collect();
        for (format, bits) in [("Mono12", 12), ("Mono16", 16)] {
            let (samples, whole) = unpacker(format, 2, 2).unwrap().unpack(&bytes);
            assert_eq!((samples, whole), (vec![0, 1, 0x0abc, 4095], true), "{format} of {bits} bits");
        }
        assert!(unpacker("Mono12", 2, 2).unwrap().check(&[4096]).is_err());
        assert!(unpacker("Mono12Packed", 2, 2).is_none());
        assert!(FORMATS.iter().all(|(name, _)| unpacker(name, 4, 4).is_some()));
    }
}
