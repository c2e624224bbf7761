//! The devices file: which driver takes frames, which shows them, and how.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{DevicesError, PixelFormat};
use crate::store;

/// Version of devices files.
pub const DEVICES_FORMAT: u32 = 1;

/// A devices file. Times are seconds, sizes pixels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DevicesFile {
    /// [`DEVICES_FORMAT`].
    pub format: u32,
    /// The camera.
    pub camera: CameraSettings,
    /// The projector.
    pub projector: ProjectorSettings,
}

/// What takes frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "driver", rename_all = "kebab-case")]
pub enum CameraSettings {
    /// A camera of the kernel's Video4Linux.
    V4l(V4lSettings),
    /// A GenICam camera (USB3 Vision, GigE Vision).
    Aravis(AravisSettings),
    /// Any program that saves frames into a folder.
    Files(FilesCameraSettings),
}

/// What shows frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "driver", rename_all = "kebab-case")]
pub enum ProjectorSettings {
    /// An output of the graphics card without a desktop on it.
    Kms(KmsSettings),
    /// A borderless window on a monitor of the desktop.
    Window(WindowSettings),
    /// Any program that shows pictures from a folder.
    Files(FilesProjectorSettings),
}

/// A way to devices; those that are features carry the feature's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Driver {
    /// Video4Linux cameras.
    V4l,
    /// GenICam cameras.
    Aravis,
    /// Outputs of graphics cards.
    Kms,
    /// Windows of a desktop.
    Window,
    /// Folders; always there.
    Files,
}

impl Driver {
    /// All of them, cameras first.
    pub const ALL: [Self; 5] = [Self::V4l, Self::Aravis, Self::Kms, Self::Window, Self::Files];

    /// Whether this program holds it.
    pub fn is_built(self) -> bool {
        match self {
            Driver::V4l => cfg!(feature = "v4l"),
            Driver::Aravis => cfg!(feature = "aravis"),
            Driver::Kms => cfg!(feature = "kms"),
            Driver::Window => cfg!(feature = "window"),
            Driver::Files => true,
        }
    }

    /// What building it takes beyond Rust.
    pub fn needs(self) -> &'static str {
        match self {
            Driver::V4l => "libclang (Debian, Ubuntu: `apt install libclang1-14` or newer) to build, nothing to run",
            Driver::Aravis => "Aravis 0.8.25 or newer (Debian, Ubuntu: `apt install libaravis-dev libusb-1.0-0-dev`)",
            Driver::Kms | Driver::Window | Driver::Files => "nothing else",
        }
    }
}

impl fmt::Display for Driver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Driver::V4l => "v4l",
            Driver::Aravis => "aravis",
            Driver::Kms => "kms",
            Driver::Window => "window",
            Driver::Files => "files",
        })
    }
}

/// A Video4Linux camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct V4lSettings {
    /// Device node; a path under /dev/v4l/by-id stays the same camera when others are plugged in.
    #[serde(default = "first_node")]
    pub device: PathBuf,
    /// Format of its frames, one that is not compressed.
    pub format: PixelFormat,
    /// Columns the driver is asked for.
    pub width_px: u32,
    /// Rows the driver is asked for.
    pub height_px: u32,
    /// Frames per second to ask for; the camera's own where it is not said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_rate_hz: Option<f64>,
    /// Significant bits of a sample, where they are fewer than the format's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bits: Option<u32>,
    /// Bits below those that stay zero: samples are shifted right by so many.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub shift: u32,
    /// Value of the control `gain`; the camera's own where it is not said. Calibrations hold for it alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain: Option<i64>,
    /// Exposure time of a camera that does not let it be set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fixed_exposure_s: Option<f64>,
    /// What a unit of the control `exposure` is, for sensors without `exposure_time_absolute`: the time of a line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_unit_s: Option<f64>,
    /// Whether the camera slows down for exposures longer than a frame; others cut them off.
    #[serde(default)]
    pub slows_down: bool,
    /// Frames until a new exposure is in force for certain.
    #[serde(default = "two")]
    pub settling_frames: u32,
    /// What the driver's timestamps mean.
    #[serde(default)]
    pub timestamp: Stamp,
    /// Time from the end of an exposure to its last line; a frame where it is not said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readout_s: Option<f64>,
    /// Buffers of the kernel.
    #[serde(default = "four")]
    pub buffers: u32,
}

/// What a timestamp tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stamp {
    /// What the driver says it does; of `uvcvideo` the end of the exposure, since it stamps the first packet to arrive.
    #[default]
    Auto,
    /// The start of the exposure.
    Start,
    /// The end of the exposure.
    End,
    /// The last line's arrival.
    Readout,
}

/// A GenICam camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AravisSettings {
    /// Name as `zonal devices` lists it; the first camera found where it is not said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// Its `PixelFormat`, e.g. `Mono12` or `BayerRG12`.
    pub pixel_format: String,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Its `Gain`, in its own unit; 0 where it is not said. Calibrations hold for it alone.
    #[serde(default)]
    pub gain: f64,
    /// Time from the end of an exposure to the frame's delivery.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readout_s: Option<f64>,
    /// Size of a packet (GigE Vision), bytes; found out where it is not said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub packet_size_bytes: Option<u32>,
    /// Pause between packets (GigE Vision).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub packet_delay_s: Option<f64>,
}

/// Frames that another program saves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilesCameraSettings {
    /// Where it saves them, as grey PNG or PGM of 8 or 16 bits; `shots.csv` in it says what is asked for.
    pub folder: PathBuf,
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// How long a frame is waited for.
    #[serde(default = "two_minutes")]
    pub timeout_s: f64,
    /// Shortest exposure the camera can be set to.
    #[serde(default = "a_tenth_of_a_millisecond")]
    pub shortest_s: f64,
    /// Longest exposure the camera can be set to.
    #[serde(default = "a_minute")]
    pub longest_s: f64,
}

/// Frames that another program shows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilesProjectorSettings {
    /// Where frames are written: the sequence as numbered PNGs, the one to show as `current.png`, and `shown.csv`.
    pub folder: PathBuf,
    /// Columns of the projector.
    pub width_px: usize,
    /// Rows of the projector.
    pub height_px: usize,
    /// Its refresh rate.
    pub refresh_hz: f64,
    /// What the other program takes to show a new frame.
    #[serde(default = "half_a_second")]
    pub settle_s: f64,
}

/// An output of a graphics card.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KmsSettings {
    /// Device node.
    #[serde(default = "first_card")]
    pub card: PathBuf,
    /// Connector, e.g. `HDMI-A-1`; the only one in use where it is not said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub connector: Option<String>,
    /// Columns of the mode; its preferred mode where nothing is said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width_px: Option<u32>,
    /// Rows of the mode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height_px: Option<u32>,
    /// Refresh rate of the mode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refresh_hz: Option<f64>,
}

/// A window on a desktop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WindowSettings {
    /// X display, e.g. `:0`; that of the environment where it is not said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub display: Option<String>,
    /// Monitor, e.g. `HDMI-1`; the only one beside the primary where it is not said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub monitor: Option<String>,
    /// Refresh rate, where the desktop does not know it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refresh_hz: Option<f64>,
}

fn first_node() -> PathBuf {
    "/dev/video0".into()
}

fn first_card() -> PathBuf {
    "/dev/dri/card0".into()
}

fn two() -> u32 {
    2
}

fn four() -> u32 {
    4
}

fn half_a_second() -> f64 {
    0.5
}

fn two_minutes() -> f64 {
    120.0
}

fn a_minute() -> f64 {
    60.0
}

fn a_tenth_of_a_millisecond() -> f64 {
    1e-4
}

fn is_zero(x: &u32) -> bool {
    *x == 0
}

impl CameraSettings {
    /// The driver it names.
    pub fn driver(&self) -> Driver {
        match self {
            CameraSettings::V4l(_) => Driver::V4l,
            CameraSettings::Aravis(_) => Driver::Aravis,
            CameraSettings::Files(_) => Driver::Files,
        }
    }
}

impl ProjectorSettings {
    /// The driver it names.
    pub fn driver(&self) -> Driver {
        match self {
            ProjectorSettings::Kms(_) => Driver::Kms,
            ProjectorSettings::Window(_) => Driver::Window,
            ProjectorSettings::Files(_) => Driver::Files,
        }
    }
}

impl DevicesFile {
    /// Reads and checks a devices file's text.
    ///
    /// # Errors
    /// [`DevicesError::Syntax`], [`DevicesError::Format`] or [`DevicesError::Range`]. A driver that is not built in is no
    /// error here.
    pub fn from_toml(text: &str) -> Result<Self, DevicesError> {
        #[derive(Deserialize)]
        struct Version {
            format: u32,
        }
        // A file of another version may hold keys of another version.
        let Version { format } = toml::from_str(text)?;
        if format != DEVICES_FORMAT {
            return Err(DevicesError::Format { found: format, expected: DEVICES_FORMAT });
        }
        let file: Self = toml::from_str(text)?;
        file.check()?;
        Ok(file)
    }

    /// Reads and checks a devices file. Folders in it are relative to where the program runs.
    ///
    /// # Errors
    /// As [`DevicesFile::from_toml`], and [`DevicesError::Store`].
    pub fn read(path: &Path) -> Result<Self, DevicesError> {
        Self::from_toml(&store::read_text(path)?)
    }

    /// The same with folders that do not depend on where the program runs.
    ///
    /// # Errors
    /// [`DevicesError::Store`] if that is not known.
    pub fn from_anywhere(mut self) -> Result<Self, DevicesError> {
        let camera = if let CameraSettings::Files(s) = &mut self.camera { Some(&mut s.folder) } else { None };
        let projector = if let ProjectorSettings::Files(s) = &mut self.projector { Some(&mut s.folder) } else { None };
        for folder in camera.into_iter().chain(projector) {
            *folder = std::path::absolute(&*folder)
                .map_err(|source| store::StoreError::Read { path: folder.clone(), source })?;
        }
        Ok(self)
    }

    /// The file's text.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("plain data")
    }

    fn check(&self) -> Result<(), DevicesError> {
        match &self.camera {
            CameraSettings::V4l(s) => s.check()?,
            CameraSettings::Aravis(s) => {
                size("camera.width_px", s.width_px as usize)?;
                size("camera.height_px", s.height_px as usize)?;
                duration("camera.readout_s", 0.0, s.readout_s)?;
                duration("camera.packet_delay_s", 0.0, s.packet_delay_s)?;
            }
            CameraSettings::Files(s) => {
                size("camera.width_px", s.width_px)?;
                size("camera.height_px", s.height_px)?;
                duration("camera.timeout_s", f64::MIN_POSITIVE, Some(s.timeout_s))?;
                duration("camera.shortest_s", f64::MIN_POSITIVE, Some(s.shortest_s))?;
                duration("camera.longest_s", f64::MIN_POSITIVE, Some(s.longest_s))?;
                if s.longest_s < s.shortest_s {
                    return Err(out_of_range("camera.longest_s", s.longest_s, "camera.shortest_s or more"));
                }
            }
        }
        match &self.projector {
            ProjectorSettings::Kms(s) => {
                let [width, height] = [s.width_px, s.height_px].map(|x| x.map(|x| x as usize));
                width.map_or(Ok(()), |w| size("projector.width_px", w))?;
                height.map_or(Ok(()), |h| size("projector.height_px", h))?;
                if width.is_some() != height.is_some() {
                    return Err(out_of_range(
                        "projector.width_px",
                        "one of two",
                        "both width_px and height_px, or none",
                    ));
                }
                positive("projector.refresh_hz", s.refresh_hz)
            }
            ProjectorSettings::Window(s) => positive("projector.refresh_hz", s.refresh_hz),
            ProjectorSettings::Files(s) => {
                size("projector.width_px", s.width_px)?;
                size("projector.height_px", s.height_px)?;
                positive("projector.refresh_hz", Some(s.refresh_hz))?;
                duration("projector.settle_s", 0.0, Some(s.settle_s))
            }
        }
    }
}

impl V4lSettings {
    fn check(&self) -> Result<(), DevicesError> {
        size("camera.width_px", self.width_px as usize)?;
        size("camera.height_px", self.height_px as usize)?;
        positive("camera.frame_rate_hz", self.frame_rate_hz)?;
        duration("camera.fixed_exposure_s", f64::MIN_POSITIVE, self.fixed_exposure_s)?;
        duration("camera.exposure_unit_s", f64::MIN_POSITIVE, self.exposure_unit_s)?;
        duration("camera.readout_s", 0.0, self.readout_s)?;
        let most = self.format.container_bits();
        if let Some(bits) = self.bits.filter(|b| *b == 0 || b + self.shift > most) {
            let range =
                format!("1..={} for {} with shift = {}", most - self.shift.min(most - 1), self.format, self.shift);
            return Err(out_of_range("camera.bits", bits, range));
        }
        if self.shift >= most {
            return Err(out_of_range("camera.shift", self.shift, format!("0..={} for {}", most - 1, self.format)));
        }
        if !(2..=32).contains(&self.buffers) {
            return Err(out_of_range("camera.buffers", self.buffers, "2..=32"));
        }
        if self.settling_frames > 30 {
            return Err(out_of_range("camera.settling_frames", self.settling_frames, "0..=30"));
        }
        Ok(())
    }
}

/// The longest side of a sensor or a panel that is believed, px.
const LONGEST_SIDE_PX: usize = 20_000;

fn out_of_range(key: &'static str, value: impl ToString, range: impl Into<String>) -> DevicesError {
    DevicesError::Range { key, value: value.to_string(), range: range.into() }
}

fn size(key: &'static str, value: usize) -> Result<(), DevicesError> {
    if (2..=LONGEST_SIDE_PX).contains(&value) {
        return Ok(());
    }
    Err(out_of_range(key, value, format!("2..={LONGEST_SIDE_PX}")))
}

fn positive(key: &'static str, value: Option<f64>) -> Result<(), DevicesError> {
    match value.filter(|x| !(x.is_finite() && *x > 0.0)) {
        Some(bad) => Err(out_of_range(key, bad, "a number above 0")),
        None => Ok(()),
    }
}

/// The longest time that is believed, s.
const LONGEST_S: f64 = 3600.0;

fn duration(key: &'static str, least_s: f64, value_s: Option<f64>) -> Result<(), DevicesError> {
    // NaN is in no range.
    match value_s.filter(|x| !(least_s..=LONGEST_S).contains(x)) {
        Some(bad) => {
            let from = if least_s > 0.0 { "above 0" } else { "0 or more" };
            Err(out_of_range(key, bad, format!("seconds {from}, up to {LONGEST_S}")))
        }
        None => Ok(()),
    }
}

/// The table `[camera]` of these settings.
pub(super) fn camera_table(camera: &CameraSettings) -> String {
    #[derive(Serialize)]
    struct Table<'a> {
        camera: &'a CameraSettings,
    }
    toml::to_string(&Table { camera }).expect("plain data")
}

/// The table `[projector]` of these settings.
pub(super) fn projector_table(projector: &ProjectorSettings) -> String {
    #[derive(Serialize)]
    struct Table<'a> {
        projector: &'a ProjectorSettings,
    }
    toml::to_string(&Table { projector }).expect("plain data")
}

#[cfg(test)]
#[path = "settings_tests.rs"]
mod tests;
