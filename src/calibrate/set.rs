//! Calibrations as files that a run copies in.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{AxisAlignment, CalibrateError, GrayCardCheck, Maps, RigMap, procedures};
use crate::capture::{Bench, Progress};
use crate::optics::Rig;
use crate::radiometry::{FlatField, Response};
use crate::reduce::ChannelScale;
use crate::store::{self, Layers, Plane, StoreError};

/// Version of the calibration files.
const FORMAT: u32 = 1;

/// All that a measurement uses beyond the nominal rig.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationSet {
    /// The projector's response.
    pub response: Response,
    /// The projector's flat field.
    pub flat: FlatField,
    /// Scale of the channels.
    pub scale: ChannelScale,
    /// What the gray card said of the rig.
    pub check: GrayCardCheck,
    /// Where devices and mirrors stand; nominal without it.
    pub map: Option<RigMap>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ResponseFile {
    format: u32,
    rig: String,
    /// White over black light.
    contrast: f64,
    /// Light above black of codes 0..=255, 0..1.
    levels: Vec<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct GrayCardFile {
    format: u32,
    rig: String,
    scale: ChannelScale,
    check: GrayCardCheck,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MapFile {
    format: u32,
    rig: String,
    map: RigMap,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct AlignFile {
    format: u32,
    rig: String,
    alignment: AxisAlignment,
}

const ALIGN: &str = "align.json";
const MAP: &str = "map.json";
const RESPONSE: &str = "response.json";
const FLAT_FIELD: &str = "flat-field.exr";
const GRAY_CARD: &str = "gray-card.json";

impl CalibrationSet {
    /// Makes the three calibrations that every measurement needs: response, flat field, gray card of order 2. `map` says
    /// where devices and mirrors stand; nominal without it.
    ///
    /// # Errors
    /// [`CalibrateError`], among them [`CalibrateError::ZoneBeyondMap`].
    pub fn make(
        rig: &Rig,
        bench: &mut dyn Bench,
        map: Option<RigMap>,
        progress: &mut Progress<'_>,
    ) -> Result<Self, CalibrateError> {
        let response = procedures::response(rig, bench)?;
        let flat = procedures::flat_field(rig, bench, map.as_ref())?;
        let plan = procedures::gray_card_plan(rig);
        let (scale, check) = procedures::gray_card(rig, bench, &plan, &response, &flat, map.as_ref(), progress)?;
        Ok(Self { response, flat, scale, check, map })
    }

    /// The maps of both devices: calibrated where there is a map, nominal elsewhere.
    pub fn maps(&self, rig: &Rig) -> Maps {
        Maps::of(rig, self.map.as_ref())
    }

    /// Reads the three files of a calibration folder, and its map if there is one.
    ///
    /// # Errors
    /// [`CalibrateError::Store`] for a missing or damaged file, [`CalibrateError::OtherRig`] for a foreign one.
    pub fn read(folder: &Path, rig: &Rig) -> Result<Self, CalibrateError> {
        let gray_path = folder.join(GRAY_CARD);
        let gray: GrayCardFile = store::read_versioned(&gray_path, FORMAT)?;
        belongs(&gray_path, &gray.rig, rig)?;
        let zone = rig.zone();
        let positive =
            |channel| [zone.theta_min(), zone.theta_max()].iter().all(|&t| gray.scale.at(&zone, t, channel) > 0.0);
        if !(0..3).all(positive) {
            return Err(
                StoreError::invalid(&gray_path, "the scale of a channel is not positive: calibrate again").into()
            );
        }
        let response = Self::read_response(folder, rig)?;
        let flat = Self::read_flat_field(folder, rig)?;
        let map = Self::read_map(folder, rig)?;
        Ok(Self { response, flat, scale: gray.scale, check: gray.check, map })
    }

    /// Writes the three files, and the map if there is one, creating the folder.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write(&self, folder: &Path, rig: &Rig) -> Result<(), StoreError> {
        store::create_dir(folder)?;
        Self::write_response(&self.response, folder, rig)?;
        Self::write_flat_field(&self.flat, folder, rig)?;
        if let Some(map) = &self.map {
            Self::write_map(map, folder, rig)?;
        }
        Self::write_gray_card(&self.scale, &self.check, folder, rig)
    }

    /// Reads `align.json`; `None` if there is none.
    ///
    /// # Errors
    /// As [`CalibrationSet::read`].
    pub fn read_align(folder: &Path, rig: &Rig) -> Result<Option<AxisAlignment>, CalibrateError> {
        let path = folder.join(ALIGN);
        if !path.exists() {
            return Ok(None);
        }
        let file: AlignFile = store::read_versioned(&path, FORMAT)?;
        belongs(&path, &file.rig, rig)?;
        Ok(Some(file.alignment))
    }

    /// Writes `align.json`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write_align(alignment: &AxisAlignment, folder: &Path, rig: &Rig) -> Result<(), StoreError> {
        let file = AlignFile { format: FORMAT, rig: rig.name.clone(), alignment: alignment.clone() };
        store::write_json(&folder.join(ALIGN), &file)
    }

    /// Reads `map.json`; `None` if there is none.
    ///
    /// # Errors
    /// As [`CalibrationSet::read`].
    pub fn read_map(folder: &Path, rig: &Rig) -> Result<Option<RigMap>, CalibrateError> {
        let path = folder.join(MAP);
        if !path.exists() {
            return Ok(None);
        }
        let file: MapFile = store::read_versioned(&path, FORMAT)?;
        belongs(&path, &file.rig, rig)?;
        Ok(Some(file.map))
    }

    /// Writes `map.json`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write_map(map: &RigMap, folder: &Path, rig: &Rig) -> Result<(), StoreError> {
        let file = MapFile { format: FORMAT, rig: rig.name.clone(), map: map.clone() };
        store::write_json(&folder.join(MAP), &file)
    }

    /// Reads `response.json`.
    ///
    /// # Errors
    /// As [`CalibrationSet::read`].
    pub fn read_response(folder: &Path, rig: &Rig) -> Result<Response, CalibrateError> {
        let path = folder.join(RESPONSE);
        let file: ResponseFile = store::read_versioned(&path, FORMAT)?;
        belongs(&path, &file.rig, rig)?;
        Response::from_levels(file.levels, file.contrast).map_err(|e| StoreError::invalid(&path, e.to_string()).into())
    }

    /// Writes `response.json`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write_response(response: &Response, folder: &Path, rig: &Rig) -> Result<(), StoreError> {
        let levels = (0..=255).map(|c| response.level(c)).collect();
        let file = ResponseFile { format: FORMAT, rig: rig.name.clone(), contrast: response.contrast(), levels };
        store::write_json(&folder.join(RESPONSE), &file)
    }

    /// Reads `flat-field.exr`.
    ///
    /// # Errors
    /// As [`CalibrationSet::read`].
    pub fn read_flat_field(folder: &Path, rig: &Rig) -> Result<FlatField, CalibrateError> {
        let path = folder.join(FLAT_FIELD);
        let image = Layers::read(&path)?;
        belongs(&path, image.text("zonal_rig").unwrap_or("?"), rig)?;
        let size = (image.width, image.height) == (rig.projector.width_px, rig.projector.height_px);
        let values = image.get("Y").filter(|_| size);
        let flat = values.and_then(|v| FlatField::from_light(image.width, image.height, v));
        flat.ok_or_else(|| {
            StoreError::invalid(&path, "not a positive plane `Y` of the panel's size: calibrate again").into()
        })
    }

    /// Writes `flat-field.exr`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write_flat_field(flat: &FlatField, folder: &Path, rig: &Rig) -> Result<(), StoreError> {
        let mut image = Layers::new(flat.width, flat.height);
        image.plane("Y", Plane::Float(flat.values.clone()));
        image.attribute("zonal_content", "light of each projector pixel at one code, relative to the brightest");
        image.attribute("zonal_rig", rig.name.as_str());
        image.write(&folder.join(FLAT_FIELD))
    }

    /// Writes `gray-card.json`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write_gray_card(
        scale: &ChannelScale,
        check: &GrayCardCheck,
        folder: &Path,
        rig: &Rig,
    ) -> Result<(), StoreError> {
        let file = GrayCardFile { format: FORMAT, rig: rig.name.clone(), scale: scale.clone(), check: check.clone() };
        store::write_json(&folder.join(GRAY_CARD), &file)
    }
}

fn belongs(path: &Path, found: &str, rig: &Rig) -> Result<(), CalibrateError> {
    if found == rig.name {
        return Ok(());
    }
    Err(CalibrateError::OtherRig { path: path.display().to_string(), found: found.into(), expected: rig.name.clone() })
}
