//! The V4L2 cameras there are.

use std::fs;
use std::path::{Path, PathBuf};

use v4l::Device;
use v4l::capability::Flags as Capability;
use v4l::context::enum_devices;
use v4l::framesize::FrameSizeEnum;
use v4l::video::Capture;

use super::v4l_controls::Controls;
use super::{CameraSettings, Driver, Found, PixelFormat, Role, Stamp, V4lSettings};
use crate::capture::CaptureError;

/// Every camera with its formats; those that may not be opened with what helps.
///
/// # Errors
/// None: a camera that fails is listed as one.
pub(super) fn list() -> Result<Vec<Found>, CaptureError> {
    let mut nodes: Vec<PathBuf> = enum_devices().iter().map(|node| node.path().to_owned()).collect();
    nodes.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
    Ok(nodes.iter().filter_map(|path| one(path)).collect())
}

/// The device at a node; `None` if it is no camera.
fn one(path: &Path) -> Option<Found> {
    let unusable = |why| Some(Found::unusable(Role::Camera, Driver::V4l, path.display().to_string(), why));
    let device = match Device::with_path(path) {
        Ok(device) => device,
        Err(e) if e.raw_os_error() == Some(libc::EACCES) => {
            return unusable(format!(
                "{e}: join the group that owns it (`sudo usermod -aG video $USER`) and log in again"
            ));
        }
        Err(e) => return unusable(e.to_string()),
    };
    let caps = device.query_caps().ok()?;
    if !caps.capabilities.contains(Capability::VIDEO_CAPTURE | Capability::STREAMING) {
        return None;
    }
    let name = format!("{} ({}, driver {}, {})", caps.card, path.display(), caps.driver, caps.bus);
    let Some(settings) = suggested(&device, path) else {
        let has = formats_of(&device);
        return Some(Found {
            name,
            ..unusable(format!("no format of it is uncompressed grey or Bayer; it has {}", has.join(", ")))?
        });
    };
    let mut details: Vec<String> = formats(&device);
    let controls = Controls::of(&device).ok();
    let mut settings = settings;
    match controls.as_ref().and_then(|c| c.exposure(&settings)) {
        Some(e) => details.push(format!(
            "exposure {:.1}..{:.1} ms in steps of {:.1} ms",
            1e3 * e.minimum as f64 * e.unit_s,
            1e3 * e.maximum as f64 * e.unit_s,
            1e3 * e.step as f64 * e.unit_s
        )),
        None => {
            details.push("its exposure cannot be set: fixed_exposure_s below is a guess, correct it".into());
            settings.fixed_exposure_s = Some(1.0 / 60.0);
        }
    }
    if let Some(gain) = controls.as_ref().and_then(Controls::gain) {
        details.push(format!("gain {}..{}", gain.minimum, gain.maximum));
    }
    Some(Found::camera(name, details, &CameraSettings::V4l(settings)))
}

/// The format with most bits in its largest size.
fn suggested(device: &Device, path: &Path) -> Option<V4lSettings> {
    let readable = device.enum_formats().ok()?.into_iter().filter_map(|f| PixelFormat::of_fourcc(f.fourcc.repr));
    let format = readable.max_by_key(|f| (f.bits(), f.delivered(2, 2) == [2, 2]))?;
    let now = device.format().ok()?;
    let [width_px, height_px] = sizes(device, format).into_iter().max().unwrap_or([now.width, now.height]);
    Some(V4lSettings {
        device: stable(path),
        format,
        width_px,
        height_px,
        frame_rate_hz: None,
        bits: None,
        shift: 0,
        gain: None,
        fixed_exposure_s: None,
        exposure_unit_s: None,
        slows_down: false,
        settling_frames: 2,
        timestamp: Stamp::Auto,
        readout_s: None,
        buffers: 4,
    })
}

/// The name of a node that stays when other cameras are plugged in.
fn stable(path: &Path) -> PathBuf {
    let links = fs::read_dir("/dev/v4l/by-id").into_iter().flatten().flatten();
    let mut names = links.map(|link| link.path()).filter(|link| fs::canonicalize(link).is_ok_and(|to| to == path));
    names.next().unwrap_or_else(|| path.to_owned())
}

/// Sizes of a format, the largest of those that come in steps; none if the camera does not tell.
fn sizes(device: &Device, format: PixelFormat) -> Vec<[u32; 2]> {
    let sizes = device.enum_framesizes(v4l::FourCC::new(&format.fourcc())).unwrap_or_default();
    let size = |size: FrameSizeEnum| match size {
        FrameSizeEnum::Discrete(s) => [s.width, s.height],
        FrameSizeEnum::Stepwise(s) => [s.max_width, s.max_height],
    };
    sizes.into_iter().map(|s| size(s.size)).collect()
}

/// Formats that can be read, with their sizes, a line each.
pub(super) fn formats(device: &Device) -> Vec<String> {
    let all = device.enum_formats().unwrap_or_default();
    let readable = all.iter().filter_map(|f| PixelFormat::of_fourcc(f.fourcc.repr));
    let mut lines: Vec<String> = Vec::new();
    for format in readable {
        let sizes = sizes(device, format);
        let list: Vec<String> = sizes.iter().map(|[w, h]| format!("{w} x {h}")).collect();
        let list = if list.is_empty() { "sizes as its input has them".into() } else { list.join(", ") };
        lines.push(format!("{format} ({} bits): {list}", format.bits()));
    }
    if lines.is_empty() {
        lines.push(format!("none that is uncompressed grey or Bayer, but {}", formats_of(device).join(", ")));
    }
    lines
}

/// Codes of all formats.
fn formats_of(device: &Device) -> Vec<String> {
    let all = device.enum_formats().unwrap_or_default();
    all.iter().map(|f| String::from_utf8_lossy(&f.fourcc.repr).trim_end().to_owned()).collect()
}
