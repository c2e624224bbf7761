//! The files of a calibration folder.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::header::{Acceptance, Header, Kind};
use super::{AxisAlignment, CalibrateError, CameraFigures, GrayCardCheck, RigMap};
use crate::capture::SensorMaps;
use crate::optics::Rig;
use crate::radiometry::{ColourMatrix, FlatField, Response};
use crate::reduce::{ChannelScale, Coefficients};
use crate::store::{Layers, Plane, StoreError};

/// A folder of calibrations of one rig, and what its files must be.
#[derive(Clone, Copy)]
pub struct Folder<'a> {
    /// The folder.
    pub path: &'a Path,
    /// The rig as in its file.
    pub rig: &'a Rig,
    /// What files must be to be read.
    pub accept: Acceptance,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ResponseFile {
    /// White over black light.
    contrast: f64,
    /// Light above black of codes 0..=255, 0..1.
    levels: Vec<f64>,
    /// The same of red, green and blue alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    channels: Option<[ChannelFile; 3]>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ChannelFile {
    contrast: f64,
    levels: Vec<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct GrayCardFile {
    scale: ChannelScale,
    check: GrayCardCheck,
}

type Read<T> = Result<(Header, T), CalibrateError>;

impl Folder<'_> {
    fn file(&self, kind: Kind) -> PathBuf {
        self.path.join(kind.file())
    }

    /// Reads a file that may be missing.
    pub fn if_there<T>(&self, kind: Kind, read: impl FnOnce(&Self) -> Read<T>) -> Option<Read<T>> {
        self.file(kind).is_file().then(|| read(self))
    }

    fn json<T: for<'d> Deserialize<'d>>(&self, kind: Kind) -> Read<T> {
        let path = self.file(kind);
        let (head, content) = Header::read_json(&path)?;
        head.check(&path, kind, self.rig, &self.accept)?;
        Ok((head, content))
    }

    fn image(&self, kind: Kind) -> Read<Layers> {
        let path = self.file(kind);
        let image = Layers::read(&path)?;
        let head = Header::of_image(&image, &path)?;
        head.check(&path, kind, self.rig, &self.accept)?;
        Ok((head, image))
    }

    /// Reads `response.json`.
    ///
    /// # Errors
    /// [`CalibrateError`], as for all files here.
    pub fn read_response(&self) -> Read<(Response, Option<[Response; 3]>)> {
        let (head, file) = self.json::<ResponseFile>(Kind::Response)?;
        let curve = |levels, contrast| {
            let curve = Response::from_levels(levels, contrast);
            curve.map_err(|e| StoreError::invalid(&self.file(Kind::Response), e.to_string()))
        };
        let channels = match file.channels.map(|all| all.map(|c| curve(c.levels, c.contrast))) {
            Some([red, green, blue]) => Some([red?, green?, blue?]),
            None => None,
        };
        Ok((head, (curve(file.levels, file.contrast)?, channels)))
    }

    /// Writes `response.json`.
    ///
    /// # Errors
    /// [`StoreError`], as for all files here.
    pub fn write_response(
        &self,
        head: &Header,
        response: &Response,
        channels: Option<&[Response; 3]>,
    ) -> Result<(), StoreError> {
        let levels = |response: &Response| (0..=255).map(|c| response.level(c)).collect();
        let channel = |c: &Response| ChannelFile { contrast: c.contrast(), levels: levels(c) };
        let channels = channels.map(|all| all.each_ref().map(channel));
        let file = ResponseFile { contrast: response.contrast(), levels: levels(response), channels };
        head.write_json(&self.file(Kind::Response), &file)
    }

    /// Reads `flat-field.exr`.
    pub fn read_flat_field(&self) -> Read<FlatField> {
        let (head, image) = self.image(Kind::FlatField)?;
        let size = (image.width, image.height) == (self.rig.projector.width_px, self.rig.projector.height_px);
        let values = image.get("Y").filter(|_| size);
        let flat = values.and_then(|v| FlatField::from_light(image.width, image.height, v));
        let flat = flat.ok_or_else(|| {
            let reason = "not a positive plane `Y` of the panel's size: calibrate again";
            StoreError::invalid(&self.file(Kind::FlatField), reason)
        })?;
        Ok((head, flat))
    }

    /// Writes `flat-field.exr`.
    pub fn write_flat_field(&self, head: &Header, flat: &FlatField) -> Result<(), StoreError> {
        let mut image = Layers::new(flat.width, flat.height);
        image.plane("Y", Plane::Float(flat.values.clone()));
        image.attribute("zonal_content", "light of each projector pixel at one code, relative to the brightest");
        head.mark(&mut image);
        image.write(&self.file(Kind::FlatField))
    }

    /// Reads `gray-card.json`.
    pub fn read_gray_card(&self) -> Read<(ChannelScale, GrayCardCheck)> {
        let (head, file) = self.json::<GrayCardFile>(Kind::GrayCard)?;
        let zone = self.rig.zone();
        let positive =
            |channel| [zone.theta_min(), zone.theta_max()].iter().all(|&t| file.scale.at(&zone, t, channel) > 0.0);
        if !(0..3).all(positive) {
            let reason = "the scale of a channel is not positive: calibrate again";
            return Err(StoreError::invalid(&self.file(Kind::GrayCard), reason).into());
        }
        Ok((head, (file.scale, file.check)))
    }

    /// Writes `gray-card.json`.
    pub fn write_gray_card(
        &self,
        head: &Header,
        scale: &ChannelScale,
        check: &GrayCardCheck,
    ) -> Result<(), StoreError> {
        let file = GrayCardFile { scale: scale.clone(), check: check.clone() };
        head.write_json(&self.file(Kind::GrayCard), &file)
    }

    /// Reads `black-trap.exr`.
    pub fn read_black_trap(&self) -> Read<Coefficients> {
        let (head, image) = self.image(Kind::BlackTrap)?;
        Ok((head, Coefficients::of_planes(&image, &self.file(Kind::BlackTrap))?))
    }

    /// Writes `black-trap.exr`.
    pub fn write_black_trap(&self, head: &Header, trap: &Coefficients) -> Result<(), StoreError> {
        let mut image = trap.planes();
        image.attribute("zonal_content", "stray light: lobe differences seen with a black trap in the sample's place");
        image.attribute("zonal_units", "electrons/s for functions in 1/sqrt(sr), before the gray card's scale");
        head.mark(&mut image);
        image.write(&self.file(Kind::BlackTrap))
    }

    /// Reads `camera.json`.
    pub fn read_camera(&self) -> Read<CameraFigures> {
        let (head, figures) = self.json::<CameraFigures>(Kind::Camera)?;
        figures.check().map_err(|reason| StoreError::invalid(&self.file(Kind::Camera), reason))?;
        Ok((head, figures))
    }

    /// Writes `camera.json`.
    pub fn write_camera(&self, head: &Header, figures: &CameraFigures) -> Result<(), StoreError> {
        head.write_json(&self.file(Kind::Camera), figures)
    }

    /// Reads `camera-maps.exr`.
    pub fn read_maps(&self) -> Read<SensorMaps> {
        let (head, image) = self.image(Kind::CameraMaps)?;
        let size = (image.width, image.height) == (self.rig.camera.width_px, self.rig.camera.height_px);
        let planes = (image.get("black_dn").filter(|_| size), image.get("bad"));
        let (Some(black_dn), Some(bad)) = planes else {
            let reason = "not planes `black_dn` and `bad` of the sensor's size: calibrate again";
            return Err(StoreError::invalid(&self.file(Kind::CameraMaps), reason).into());
        };
        let bad = bad.into_iter().map(|b| b != 0.0).collect();
        Ok((head, SensorMaps { width: image.width, black_dn, bad }))
    }

    /// Writes `camera-maps.exr`.
    pub fn write_maps(&self, head: &Header, maps: &SensorMaps) -> Result<(), StoreError> {
        let mut image = Layers::new(maps.width, maps.black_dn.len() / maps.width);
        image.plane("black_dn", Plane::Float(maps.black_dn.clone()));
        image.plane("bad", Plane::Float(maps.bad.iter().map(|&b| f32::from(u8::from(b))).collect()));
        image.attribute(
            "zonal_content",
            "pixels of the sensor: mean value in darkness, and 1 where a pixel is not used",
        );
        image.attribute("zonal_units", "black_dn: DN; bad: 0 or 1");
        head.mark(&mut image);
        image.write(&self.file(Kind::CameraMaps))
    }

    /// Reads `colour.json`.
    pub fn read_colour(&self) -> Read<ColourMatrix> {
        self.json(Kind::Colour)
    }

    /// Writes `colour.json`.
    pub fn write_colour(&self, head: &Header, colour: &ColourMatrix) -> Result<(), StoreError> {
        head.write_json(&self.file(Kind::Colour), colour)
    }

    /// Reads `align.json`.
    pub fn read_align(&self) -> Read<AxisAlignment> {
        self.json(Kind::Align)
    }

    /// Writes `align.json`.
    pub fn write_align(&self, head: &Header, alignment: &AxisAlignment) -> Result<(), StoreError> {
        head.write_json(&self.file(Kind::Align), alignment)
    }

    /// Reads `map.json`.
    pub fn read_map(&self) -> Read<RigMap> {
        self.json(Kind::Map)
    }

    /// Writes `map.json`.
    pub fn write_map(&self, head: &Header, map: &RigMap) -> Result<(), StoreError> {
        head.write_json(&self.file(Kind::Map), map)
    }
}
