//! What every calibration file says of itself, and what it must say to be used.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use jiff::Timestamp;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::CalibrateError;
use crate::optics::Rig;
use crate::store::{self, Layers, StoreError};

/// Version of the calibration files. Format 1 knew neither fingerprints nor dates.
pub const CALIBRATION_FORMAT: u32 = 2;

/// What is calibrated: one file each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The projector's response.
    Response,
    /// The projector's light over its panel.
    FlatField,
    /// The scale of the channels.
    GrayCard,
    /// Stray light.
    BlackTrap,
    /// The camera's figures.
    Camera,
    /// The camera's single pixels.
    CameraMaps,
    /// Colours of the projector as the camera sees them.
    Colour,
    /// Where the devices stand to the optical axis.
    Align,
    /// The optical map: where devices, mirrors and sample stand.
    Map,
}

impl Kind {
    /// What it is measured with: newer files of these make it worthless. The gray card's scale is of electrons as the camera's
    /// gain counts them, of lobes as response, flat field and map make them, and of light without what the trap saw.
    pub fn made_with(self) -> &'static [Self] {
        match self {
            Kind::FlatField => &[Kind::Map],
            Kind::CameraMaps => &[Kind::Camera],
            Kind::BlackTrap => &[Kind::Camera, Kind::Response, Kind::FlatField, Kind::Map],
            Kind::GrayCard => &[Kind::Camera, Kind::Response, Kind::FlatField, Kind::Map, Kind::BlackTrap],
            _ => &[],
        }
    }

    /// The command that makes it: a kind of `zonal calibrate`.
    pub fn command(self) -> String {
        match self {
            Kind::Camera | Kind::CameraMaps => "noise".into(),
            kind => kind.to_string(),
        }
    }

    /// Name of its file.
    pub fn file(self) -> &'static str {
        match self {
            Kind::Response => "response.json",
            Kind::FlatField => "flat-field.exr",
            Kind::GrayCard => "gray-card.json",
            Kind::BlackTrap => "black-trap.exr",
            Kind::Camera => "camera.json",
            Kind::CameraMaps => "camera-maps.exr",
            Kind::Colour => "colour.json",
            Kind::Align => "align.json",
            Kind::Map => "map.json",
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Kind::Response => "response",
            Kind::FlatField => "flat-field",
            Kind::GrayCard => "gray-card",
            Kind::BlackTrap => "black-trap",
            Kind::Camera => "camera",
            Kind::CameraMaps => "camera-maps",
            Kind::Colour => "colour",
            Kind::Align => "align",
            Kind::Map => "map",
        })
    }
}

/// The devices a calibration was made on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Devices {
    /// Real ones.
    Real,
    /// A simulated rig.
    Simulated {
        /// Seed of its noise.
        seed: u64,
    },
}

/// When and on what a calibration is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Origin {
    /// Date, UTC.
    pub date: Timestamp,
    /// On what.
    pub devices: Devices,
}

/// The head of a calibration file. What files of format 1 do not say is `None`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// What the file holds.
    pub kind: Option<Kind>,
    /// Name of the rig.
    pub rig: String,
    /// [`fingerprint`] of the rig.
    pub rig_fingerprint: Option<String>,
    /// When it was made, UTC, ISO 8601.
    pub date: Option<Timestamp>,
    /// Program and version.
    pub software: Option<String>,
    /// On what it was made.
    pub devices: Option<Devices>,
}

/// What a calibration must be, beyond one of this rig.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Acceptance {
    /// Whether it is for a simulated rig; where not said, both will do.
    pub simulated: Option<bool>,
    /// How old it may be; where not said, any age will do.
    pub freshness: Option<Freshness>,
}

/// A limit of age.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Freshness {
    /// The present.
    pub now: Timestamp,
    /// Greatest age, days.
    pub max_age_days: f64,
}

const DAY_S: f64 = 86_400.0;

/// A number that changes with anything in the rig file: FNV-1a (Fowler, Noll, Vo) of 64 bits over its TOML as this program
/// writes it, in 16 hexadecimal digits.
pub fn fingerprint(rig: &Rig) -> String {
    let hash = rig
        .to_toml()
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3));
    format!("{hash:016x}")
}

/// Checks that nothing in `folder` was made before what it was measured with. Files without a date are taken as they are.
///
/// # Errors
/// [`CalibrateError::Outdated`].
pub fn in_order(folder: &Path, headers: &BTreeMap<Kind, Header>) -> Result<(), CalibrateError> {
    let date = |kind: Kind| headers.get(&kind).and_then(|header| header.date);
    for &kind in headers.keys() {
        let newer = kind.made_with().iter().find(|&&used| date(used).zip(date(kind)).is_some_and(|(u, k)| u > k));
        if let Some(&newer) = newer {
            let path = folder.join(kind.file()).display().to_string();
            return Err(CalibrateError::Outdated { path, newer: newer.file(), kind });
        }
    }
    Ok(())
}

impl Header {
    /// The head of a file of `kind` for a rig; without an origin neither date nor devices are told.
    pub fn new(kind: Kind, rig: &Rig, origin: Option<&Origin>) -> Self {
        Self {
            kind: Some(kind),
            rig: rig.name.clone(),
            rig_fingerprint: Some(fingerprint(rig)),
            date: origin.map(|o| Timestamp::from_second(o.date.as_second()).unwrap_or(o.date)),
            software: Some(concat!("zonal ", env!("CARGO_PKG_VERSION")).into()),
            devices: origin.map(|o| o.devices),
        }
    }

    /// Whether the file at `path` may be used as `kind` for `rig`.
    ///
    /// # Errors
    /// [`CalibrateError`] that says what differs and what to do.
    pub fn check(&self, path: &Path, kind: Kind, rig: &Rig, accept: &Acceptance) -> Result<(), CalibrateError> {
        let path_text = path.display().to_string();
        if let Some(found) = self.kind.filter(|&k| k != kind) {
            let reason = format!("it holds `{found}`, not `{kind}`: calibrate again");
            return Err(StoreError::invalid(path, reason).into());
        }
        if self.rig != rig.name {
            let (found, expected) = (self.rig.clone(), rig.name.clone());
            return Err(CalibrateError::OtherRig { path: path_text, found, expected });
        }
        let expected = fingerprint(rig);
        if let Some(found) = self.rig_fingerprint.clone().filter(|f| *f != expected) {
            return Err(CalibrateError::ChangedRig { path: path_text, rig: rig.name.clone(), found, expected });
        }
        if let (Some(devices), Some(simulated)) = (self.devices, accept.simulated)
            && matches!(devices, Devices::Simulated { .. }) != simulated
        {
            let name = |simulated| if simulated { "simulated" } else { "real" };
            return Err(CalibrateError::OtherDevices {
                path: path_text,
                found: name(!simulated),
                expected: name(simulated),
            });
        }
        if let (Some(date), Some(Freshness { now, max_age_days })) = (self.date, accept.freshness) {
            let age_days = now.duration_since(date).as_secs_f64() / DAY_S;
            if age_days > max_age_days {
                return Err(CalibrateError::TooOld { path: path_text, date, age_days, max_age_days, kind });
            }
        }
        Ok(())
    }

    /// Reads a JSON file: its head and what it holds.
    ///
    /// # Errors
    /// [`StoreError`]; a newer format is [`StoreError::Invalid`].
    pub(super) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<(Self, T), StoreError> {
        let mut file: Map<String, Value> = store::read_versioned(path, CALIBRATION_FORMAT)?;
        let damaged = |e: serde_json::Error| StoreError::invalid(path, format!("{e}: calibrate again"));
        file.remove("format");
        let header = match file.remove("header") {
            Some(header) => serde_json::from_value(header).map_err(damaged)?,
            None => Self::of_format_1(file.remove("rig").as_ref().and_then(Value::as_str)),
        };
        Ok((header, serde_json::from_value(Value::Object(file)).map_err(damaged)?))
    }

    /// Writes a JSON file.
    ///
    /// # Errors
    /// [`StoreError`].
    pub(super) fn write_json<T: Serialize>(&self, path: &Path, content: &T) -> Result<(), StoreError> {
        let invalid = |e: serde_json::Error| StoreError::invalid(path, e.to_string());
        let mut file = serde_json::to_value(content).map_err(invalid)?;
        file["format"] = CALIBRATION_FORMAT.into();
        file["header"] = serde_json::to_value(self).map_err(invalid)?;
        store::write_json(path, &file)
    }

    /// The head of an image.
    ///
    /// # Errors
    /// [`StoreError::Invalid`].
    pub(super) fn of_image(image: &Layers, path: &Path) -> Result<Self, StoreError> {
        let newest = f64::from(CALIBRATION_FORMAT);
        if let Some(found) = image.number("zonal_calibration_format").filter(|&f| f > newest) {
            let reason = format!("format {found} is newer than {newest}, the newest this version reads: update zonal");
            return Err(StoreError::invalid(path, reason));
        }
        match image.text("zonal_header") {
            Some(text) => serde_json::from_str(text)
                .map_err(|e| StoreError::invalid(path, format!("zonal_header: {e}: calibrate again"))),
            None => Ok(Self::of_format_1(image.text("zonal_rig"))),
        }
    }

    /// Puts the head into an image.
    pub(super) fn mark(&self, image: &mut Layers) {
        image.attribute("zonal_calibration_format", f64::from(CALIBRATION_FORMAT));
        image.attribute("zonal_rig", self.rig.as_str());
        image.attribute("zonal_header", serde_json::to_string(self).expect("plain data").as_str());
    }

    fn of_format_1(rig: Option<&str>) -> Self {
        let rig = rig.unwrap_or("?").into();
        Self { kind: None, rig, rig_fingerprint: None, date: None, software: None, devices: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig() -> Rig {
        Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap()
    }

    #[test]
    fn fingerprints_change_with_any_figure() {
        let mut other = rig();
        assert_eq!(fingerprint(&rig()), fingerprint(&other));
        assert_eq!(fingerprint(&rig()).len(), 16);
        other.camera.dark_noise_e += 1e-9;
        assert_ne!(fingerprint(&rig()), fingerprint(&other));
    }

    #[test]
    fn age_devices_and_rigs_are_judged() {
        let date: Timestamp = "2026-01-10T12:00:00Z".parse().unwrap();
        let origin = Origin { date, devices: Devices::Simulated { seed: 3 } };
        let header = Header::new(Kind::Response, &rig(), Some(&origin));
        let path = Path::new("cal/response.json");
        let told = |rig: &Rig, accept: Acceptance| {
            header.check(path, Kind::Response, rig, &accept).err().map_or(String::new(), |e| e.to_string())
        };
        let aged = |now: &str| Acceptance {
            freshness: Some(Freshness { now: now.parse().unwrap(), max_age_days: 30.0 }),
            ..Acceptance::default()
        };
        assert_eq!(told(&rig(), Acceptance { simulated: Some(true), ..aged("2026-02-09T11:59:59Z") }), "");
        let old = told(&rig(), aged("2026-02-10T12:00:00Z"));
        assert!(old.contains("31") && old.contains("--max-age-days") && old.contains("response.json"), "{old}");
        let real = told(&rig(), Acceptance { simulated: Some(false), freshness: None });
        assert!(real.contains("simulated") && real.contains("real"), "{real}");
        let mut longer = rig();
        longer.centre_height_mm += 0.1;
        assert!(told(&longer, Acceptance::default()).contains(&fingerprint(&longer)));
        let wrong = header.check(path, Kind::GrayCard, &rig(), &Acceptance::default()).unwrap_err().to_string();
        assert!(wrong.contains("`response`, not `gray-card`"), "{wrong}");
    }

    #[test]
    fn what_was_made_before_its_ingredients_is_outdated() {
        let header = |kind, date: &str| {
            let origin = Origin { date: date.parse().unwrap(), devices: Devices::Real };
            (kind, Header::new(kind, &rig(), Some(&origin)))
        };
        let (early, late) = ("2026-01-10T12:00:00Z", "2026-01-10T12:00:01Z");
        let mut all = BTreeMap::from([header(Kind::Response, early), header(Kind::GrayCard, early)]);
        let folder = Path::new("cal");
        assert!(in_order(folder, &all).is_ok());
        all.extend([header(Kind::Colour, late)]);
        assert!(in_order(folder, &all).is_ok());
        all.extend([header(Kind::Map, late)]);
        let told = in_order(folder, &all).unwrap_err().to_string();
        assert!(
            ["cal/gray-card.json", "map.json", "zonal calibrate gray-card"].iter().all(|w| told.contains(w)),
            "{told}"
        );
        all.extend([header(Kind::GrayCard, late)]);
        assert!(in_order(folder, &all).is_ok());
    }
}
