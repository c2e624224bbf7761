//! Controls of V4L2 cameras: exposure and gain are set, everything automatic is off.

use std::collections::HashMap;
use std::io;
use std::panic::catch_unwind;

use v4l::Device;
use v4l::control::{Control, Description, Flags, Value};

use super::V4lSettings;

// From `linux/v4l2-controls.h`.
const GAIN: u32 = 0x0098_0913;
const ANALOGUE_GAIN: u32 = 0x009e_0903;
const EXPOSURE: u32 = 0x0098_0911;
const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;
/// Unit of `exposure_time_absolute`, s.
const ABSOLUTE_UNIT_S: f64 = 1e-4;

/// Controls that let the camera act on its own or change the picture, with the value that stops them.
const OFF: [(u32, i64); 18] = [
    (0x009a_0901, 1), // exposure: manual
    (0x009a_0903, 0), // frame rate that depends on the exposure
    (0x009a_090c, 0), // focus
    (0x009a_0914, 0), // white balance presets: manual
    (0x009a_0915, 0), // wide dynamic range
    (0x009a_0916, 0), // image stabilisation
    (0x009a_0918, 0), // ISO sensitivity: manual
    (0x009a_091a, 0), // scene modes
    (0x0098_090c, 0), // white balance
    (0x0098_0912, 0), // gain
    (0x0098_0914, 0), // mirrored left to right
    (0x0098_0915, 0), // mirrored upside down
    (0x0098_0919, 0), // hue
    (0x0098_091b, 0), // sharpening
    (0x0098_091c, 0), // backlight compensation
    (0x0098_091d, 0), // colour gain
    (0x0098_0920, 0), // brightness
    (0x0098_0922, 0), // rotation
];

/// What controls a camera has, by their numbers.
pub(super) struct Controls(HashMap<u32, Description>);

/// The control that sets the exposure time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ExposureControl {
    id: u32,
    /// Seconds for a unit.
    pub unit_s: f64,
    pub minimum: i64,
    pub maximum: i64,
    pub step: i64,
}

/// The control of the gain.
pub(super) struct GainControl {
    id: u32,
    pub minimum: i64,
    pub maximum: i64,
}

/// Controls as they were found, in the order they were changed.
#[derive(Default)]
pub(super) struct Former(Vec<(u32, i64)>);

impl Controls {
    pub fn of(device: &Device) -> io::Result<Self> {
        // The crate panics at types of controls that it does not know.
        let all = catch_unwind(std::panic::AssertUnwindSafe(|| device.query_controls()));
        let all = match all {
            Ok(Err(e)) if e.kind() == io::ErrorKind::InvalidInput => Vec::new(), // it has none
            Ok(all) => all?,
            Err(_) => return Err(io::Error::other("its controls are of kinds that are not known here")),
        };
        let usable = |c: &Description| !c.flags.intersects(Flags::DISABLED | Flags::READ_ONLY);
        Ok(Self(all.into_iter().filter(usable).map(|c| (c.id, c)).collect()))
    }

    pub fn exposure(&self, settings: &V4lSettings) -> Option<ExposureControl> {
        let of = |id, unit_s| {
            let c = self.0.get(&id)?;
            let step = i64::try_from(c.step).unwrap_or(1).max(1);
            Some(ExposureControl { id, unit_s, minimum: c.minimum.max(1), maximum: c.maximum, step })
        };
        of(EXPOSURE_ABSOLUTE, ABSOLUTE_UNIT_S).or_else(|| of(EXPOSURE, settings.exposure_unit_s?))
    }

    pub fn gain(&self) -> Option<GainControl> {
        let control = |id| self.0.get(&id);
        let c = control(GAIN).or_else(|| control(ANALOGUE_GAIN))?;
        Some(GainControl { id: c.id, minimum: c.minimum, maximum: c.maximum })
    }

    /// Turns off what acts on its own. The inner error names a control that stays on.
    pub fn turn_off(&self, device: &Device, former: &mut Former) -> io::Result<Result<(), String>> {
        for (id, off) in OFF {
            let Some(control) = self.0.get(&id) else { continue };
            // Some begin above zero: as far off as it goes.
            let off = off.clamp(control.minimum, control.maximum);
            let Some(value) = read(device, id)? else { continue };
            if value == off {
                continue;
            }
            let refused = former.set(device, id, off).is_err();
            if refused || read(device, id)? != Some(off) {
                return Ok(Err(control.name.clone()));
            }
        }
        Ok(Ok(()))
    }
}

impl GainControl {
    /// Sets it and returns what it is then.
    pub fn set(&self, device: &Device, former: &mut Former, value: i64) -> io::Result<i64> {
        former.set(device, self.id, value)?;
        Ok(read(device, self.id)?.unwrap_or(value))
    }
}

impl ExposureControl {
    /// Sets it to the nearest it can and returns what that is, s.
    pub fn set(&self, device: &Device, exposure_s: f64) -> io::Result<f64> {
        let steps = ((exposure_s / self.unit_s - self.minimum as f64) / self.step as f64).round() as i64;
        let value = (self.minimum + steps * self.step).clamp(self.minimum, self.maximum);
        device.set_control(Control { id: self.id, value: Value::Integer(value) })?;
        let set = read(device, self.id)?.unwrap_or(value);
        Ok(set as f64 * self.unit_s)
    }

    /// Keeps its value to be put back.
    pub fn remember(&self, device: &Device, former: &mut Former) -> io::Result<()> {
        former.remember(device, self.id)
    }
}

impl Former {
    fn remember(&mut self, device: &Device, id: u32) -> io::Result<()> {
        self.0.extend(read(device, id)?.map(|value| (id, value)));
        Ok(())
    }

    /// Sets a control whose value is put back later.
    pub fn set(&mut self, device: &Device, id: u32, value: i64) -> io::Result<()> {
        self.remember(device, id)?;
        device.set_control(Control { id, value: Value::Integer(value) })
    }

    /// Puts all back, the last first.
    pub fn restore(&mut self, device: &Device) -> io::Result<()> {
        let mut first = Ok(());
        for (id, value) in self.0.drain(..).rev() {
            first = first.and(device.set_control(Control { id, value: Value::Integer(value) }));
        }
        first
    }
}

/// A control's value; `None` if it has none that is a number.
fn read(device: &Device, id: u32) -> io::Result<Option<i64>> {
    match device.control(id) {
        Ok(Control { value: Value::Integer(value), .. }) => Ok(Some(value)),
        Ok(Control { value: Value::Boolean(value), .. }) => Ok(Some(value.into())),
        Ok(_) => Ok(None),
        // No number of the system's: the crate's own word for a kind it does not read.
        Err(e) if e.raw_os_error().is_none() => Ok(None),
        Err(e) => Err(e),
    }
}
