//! All calibrations of a rig, which a run copies in.

use std::collections::BTreeMap;
use std::path::Path;

use super::files::Folder;
use super::gray_card::{self, Known};
use super::header::{Acceptance, Header, Kind, Origin, in_order};
use super::{CalibrateError, CameraFigures, GrayCardCheck, Maps, Reference, RigMap, procedures};
use crate::capture::{Bench, Progress, SensorMaps};
use crate::optics::Rig;
use crate::radiometry::{ColourMatrix, ColourSpace, FlatField, Response};
use crate::reduce::{ChannelScale, Coefficients};
use crate::store::{self, StoreError};

/// All that a measurement uses beyond the nominal rig. What is `None` is not calibrated.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationSet {
    /// The projector's response.
    pub response: Response,
    /// The same as red, green and blue pixels see it.
    pub channels: Option<[Response; 3]>,
    /// The projector's flat field.
    pub flat: FlatField,
    /// Scale of the channels.
    pub scale: ChannelScale,
    /// What the gray card said of the rig.
    pub check: GrayCardCheck,
    /// Stray light: coefficients in electrons per second, before the scale.
    pub black_trap: Option<Coefficients>,
    /// The camera's figures, used instead of the rig file's.
    pub camera: Option<CameraFigures>,
    /// The camera's single pixels.
    pub sensor: Option<SensorMaps>,
    /// Colours of the projector as the camera sees them.
    pub colour: Option<ColourMatrix>,
    /// Where devices and mirrors stand; nominal without it.
    pub map: Option<RigMap>,
    /// Heads of the files these come from.
    pub headers: BTreeMap<Kind, Header>,
}

impl CalibrationSet {
    /// Makes what every measurement needs on a bench: response, flat field, gray card of order 2. `map` says where devices
    /// and mirrors stand; nominal without it.
    ///
    /// # Errors
    /// [`CalibrateError`], among them [`CalibrateError::ZoneBeyondMap`].
    pub fn make(
        rig: &Rig,
        bench: &mut dyn Bench,
        map: Option<RigMap>,
        progress: &mut Progress<'_>,
    ) -> Result<Self, CalibrateError> {
        let (response, channels) = procedures::response(rig, bench)?;
        let flat = procedures::flat_field(rig, bench, map.as_ref())?;
        let known = Known { response: &response, flat: &flat, sensor: None, trap: None, map: map.as_ref() };
        let plan = gray_card::gray_card_plan(rig);
        let (scale, check) = gray_card::gray_card(rig, bench, &plan, known, &Reference::default(), progress)?;
        Ok(Self {
            response,
            channels: Some(channels),
            flat,
            scale,
            check,
            black_trap: None,
            camera: None,
            sensor: None,
            colour: None,
            map,
            headers: BTreeMap::new(),
        })
    }

    /// The maps of both devices: calibrated where there is a map, nominal elsewhere.
    pub fn maps(&self, rig: &Rig) -> Maps {
        Maps::of(rig, self.map.as_ref())
    }

    /// The same set with the origin of all its parts.
    pub fn made(mut self, rig: &Rig, origin: &Origin) -> Self {
        self.headers = self.kinds().into_iter().map(|kind| (kind, Header::new(kind, rig, Some(origin)))).collect();
        self
    }

    /// What it holds.
    fn kinds(&self) -> Vec<Kind> {
        let optional = [
            (Kind::BlackTrap, self.black_trap.is_some()),
            (Kind::Camera, self.camera.is_some()),
            (Kind::CameraMaps, self.sensor.is_some()),
            (Kind::Colour, self.colour.is_some()),
            (Kind::Map, self.map.is_some()),
        ];
        let there = optional.into_iter().filter(|o| o.1).map(|o| o.0);
        [Kind::Response, Kind::FlatField, Kind::GrayCard].into_iter().chain(there).collect()
    }

    /// Reads a calibration folder, whatever its age and the devices it was made on.
    ///
    /// # Errors
    /// [`CalibrateError`] for a missing or damaged file or one of another rig.
    pub fn read(folder: &Path, rig: &Rig) -> Result<Self, CalibrateError> {
        Self::read_for(folder, rig, &Acceptance::default())
    }

    /// Reads a calibration folder whose files must be what `accept` says.
    ///
    /// # Errors
    /// [`CalibrateError`].
    pub fn read_for(folder: &Path, rig: &Rig, accept: &Acceptance) -> Result<Self, CalibrateError> {
        let files = Folder { path: folder, rig, accept: *accept };
        let mut headers = BTreeMap::new();
        let (head, (scale, check)) = files.read_gray_card()?;
        headers.insert(Kind::GrayCard, head);
        let (head, (response, channels)) = files.read_response()?;
        headers.insert(Kind::Response, head);
        let (head, flat) = files.read_flat_field()?;
        headers.insert(Kind::FlatField, head);
        fn part<T>(
            headers: &mut BTreeMap<Kind, Header>,
            kind: Kind,
            file: Option<Result<(Header, T), CalibrateError>>,
        ) -> Result<Option<T>, CalibrateError> {
            let Some((head, content)) = file.transpose()? else { return Ok(None) };
            headers.insert(kind, head);
            Ok(Some(content))
        }
        let black_trap = part(&mut headers, Kind::BlackTrap, files.if_there(Kind::BlackTrap, Folder::read_black_trap))?;
        let camera = part(&mut headers, Kind::Camera, files.if_there(Kind::Camera, Folder::read_camera))?;
        let sensor = part(&mut headers, Kind::CameraMaps, files.if_there(Kind::CameraMaps, Folder::read_maps))?;
        let colour = part(&mut headers, Kind::Colour, files.if_there(Kind::Colour, Folder::read_colour))?;
        let map = part(&mut headers, Kind::Map, files.if_there(Kind::Map, Folder::read_map))?;
        // What a finished run holds stays as valid as it was.
        if accept.freshness.is_some() {
            in_order(folder, &headers)?;
        }
        Ok(Self { response, channels, flat, scale, check, black_trap, camera, sensor, colour, map, headers })
    }

    /// Writes all files, creating the folder.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write(&self, folder: &Path, rig: &Rig) -> Result<(), StoreError> {
        store::create_dir(folder)?;
        self.kinds().into_iter().try_for_each(|kind| self.write_part(kind, folder, rig))
    }

    /// Writes one of its files, if there is one.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write_part(&self, kind: Kind, folder: &Path, rig: &Rig) -> Result<(), StoreError> {
        let files = Folder { path: folder, rig, accept: Acceptance::default() };
        let head = self.headers.get(&kind).cloned().unwrap_or_else(|| Header::new(kind, rig, None));
        match kind {
            Kind::Response => files.write_response(&head, &self.response, self.channels.as_ref()),
            Kind::FlatField => files.write_flat_field(&head, &self.flat),
            Kind::GrayCard => files.write_gray_card(&head, &self.scale, &self.check),
            Kind::BlackTrap => self.black_trap.as_ref().map_or(Ok(()), |trap| files.write_black_trap(&head, trap)),
            Kind::Camera => self.camera.as_ref().map_or(Ok(()), |camera| files.write_camera(&head, camera)),
            Kind::CameraMaps => self.sensor.as_ref().map_or(Ok(()), |sensor| files.write_maps(&head, sensor)),
            Kind::Colour => self.colour.as_ref().map_or(Ok(()), |colour| files.write_colour(&head, colour)),
            Kind::Map => self.map.as_ref().map_or(Ok(()), |map| files.write_map(&head, map)),
            // Offsets to be turned away by hand: no part of a measurement.
            Kind::Align => Ok(()),
        }
    }

    /// Writes one of its files over that of another set, which goes if there is none in its place.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn replace_part(&self, kind: Kind, folder: &Path, rig: &Rig) -> Result<(), StoreError> {
        let path = folder.join(kind.file());
        if !self.kinds().contains(&kind) && path.is_file() {
            return store::remove(&path);
        }
        self.write_part(kind, folder, rig)
    }

    /// The rig with the camera's measured figures in place of those of its file.
    pub fn rig(&self, rig: &Rig) -> Rig {
        self.camera.as_ref().map_or_else(|| rig.clone(), |camera| camera.of_rig(rig))
    }

    /// What takes the camera's channels to the colours wanted; `None` where they are those.
    ///
    /// # Errors
    /// [`CalibrateError::NoColour`] if the projector's are wanted and not calibrated, [`CalibrateError::Colour`].
    pub fn to_colours(&self, space: ColourSpace) -> Result<Option<[[f64; 3]; 3]>, CalibrateError> {
        match (space, &self.colour) {
            (ColourSpace::Camera, _) => Ok(None),
            (ColourSpace::Projector, Some(colour)) => Ok(Some(colour.inverse()?)),
            (ColourSpace::Projector, None) => Err(CalibrateError::NoColour),
        }
    }
}
