//! The HDR response to one pattern: value and variance of every pixel that sees the zone.

use std::path::Path;

use super::Taken;
use crate::optics::{OpticalMap, Rig};
use crate::radiometry::{ExposedRows, PixelMaps, Rows, Sensor};
use crate::store::{Layers, Plane, StoreError};

/// A rectangle of the sensor: half-open, in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Crop {
    /// First column.
    pub u0: usize,
    /// First row.
    pub v0: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Crop {
    /// The part of a nominal rig's sensor that sees its zone.
    pub fn of_zone(rig: &Rig) -> Self {
        Self::of_map(rig, &rig.camera_map())
    }

    /// The part of a rig's sensor that sees its zone by the camera's map, nominal or calibrated.
    ///
    /// # Panics
    /// If the map does not reach the zone; that of a checked rig does.
    pub fn of_map(rig: &Rig, map: &OpticalMap) -> Self {
        let c = &rig.camera;
        let [u0, v0, u1, v1] =
            map.bounding_box(&rig.zone(), c.width_px, c.height_px).expect("a checked rig shows its zone");
        Self { u0, v0, width: u1 - u0, height: v1 - v0 }
    }

    /// A rig's whole sensor.
    pub fn whole(rig: &Rig) -> Self {
        Self { u0: 0, v0: 0, width: rig.camera.width_px, height: rig.camera.height_px }
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// Whether it holds no pixel.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Sensor column and row of pixel `p` of the crop.
    pub fn sensor_pixel(&self, p: usize) -> (usize, usize) {
        (self.u0 + p % self.width, self.v0 + p / self.width)
    }
}

/// What dark frames tell of the single pixels of a sensor, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorMaps {
    /// Columns of the sensor.
    pub width: usize,
    /// Mean value in darkness, DN.
    pub black_dn: Vec<f32>,
    /// Pixels that are not to be used.
    pub bad: Vec<bool>,
}

impl SensorMaps {
    /// The part of the maps that a crop covers.
    fn part(&self, crop: Crop) -> PixelMaps<'_> {
        let (first, stride) = (crop.v0 * self.width + crop.u0, self.width);
        PixelMaps {
            black_level_dn: Some(Rows { values: &self.black_dn[first..], stride }),
            bad: Some(Rows { values: &self.bad[first..], stride }),
        }
    }
}

/// A merged response in electrons per second. Pixels saturated in every exposure are NaN.
#[derive(Debug, Clone, PartialEq)]
pub struct ResponseImage {
    /// The part of the sensor it covers.
    pub crop: Crop,
    /// Signed rate, e-/s.
    pub rate: Vec<f32>,
    /// Its variance, (e-/s)^2.
    pub variance: Vec<f32>,
}

/// Rounding of a stored rate stays below this share of its standard error.
const ROUNDING_OF_SIGMA: f32 = 0.1;
/// Rounding of a stored variance stays below this share of it.
const ROUNDING_OF_VARIANCE: f32 = 1e-3;

impl ResponseImage {
    /// Merges the exposures of one pattern, each with the lamp's light while it was taken. Bad pixels are NaN.
    pub fn merge(sensor: &Sensor, maps: Option<&SensorMaps>, crop: Crop, frames: &[Taken]) -> Self {
        let rows: Vec<_> = frames
            .iter()
            .map(|f| ExposedRows {
                samples: Rows { values: &f.samples, stride: crop.width },
                exposure_s: f.exposure_s,
                light: f.light,
            })
            .collect();
        let (mut rate, mut variance) = (vec![0.0; crop.len()], vec![0.0; crop.len()]);
        let maps = maps.map_or_else(PixelMaps::default, |maps| maps.part(crop));
        sensor.merge_into(crop.width, &rows, &maps, &mut rate, &mut variance);
        Self { crop, rate, variance }
    }

    /// The mean of several responses to the same pattern.
    pub fn mean(images: &[Self]) -> Self {
        let n = images.len() as f32;
        let pixel = |p: usize| images.iter().map(|i| i.rate[p]).sum::<f32>() / n;
        let variance = |p: usize| images.iter().map(|i| i.variance[p]).sum::<f32>() / (n * n);
        let crop = images[0].crop;
        Self { crop, rate: (0..crop.len()).map(pixel).collect(), variance: (0..crop.len()).map(variance).collect() }
    }

    /// Number of pixels without a usable exposure.
    pub fn saturated(&self) -> usize {
        self.rate.iter().filter(|r| r.is_nan()).count()
    }

    /// The planes as they are stored: halves where their rounding stays below the noise.
    fn planes(&self) -> [Plane; 2] {
        [
            Plane::compact(&self.rate, |i| ROUNDING_OF_SIGMA * self.variance[i].sqrt()),
            Plane::compact(&self.variance, |i| ROUNDING_OF_VARIANCE * self.variance[i]),
        ]
    }

    /// This response with the rounding that storing it brings, so that a later reduction finds the same numbers.
    pub fn as_stored(&self) -> Self {
        let [rate, variance] = self.planes();
        Self { crop: self.crop, rate: rate.to_f32(), variance: variance.to_f32() }
    }

    /// Writes planes `rate` and `variance` as OpenEXR.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write(&self, path: &Path) -> Result<(), StoreError> {
        let mut image = Layers::new(self.crop.width, self.crop.height);
        let [rate, variance] = self.planes();
        image.plane("rate", rate);
        image.plane("variance", variance);
        image.attribute(
            "zonal_content",
            "HDR response to one pattern, sensor mosaic; NaN where every exposure saturated",
        );
        image.attribute("zonal_units", "rate: electrons/s, variance: (electrons/s)^2");
        image.attribute("zonal_crop_u0_px", self.crop.u0 as f64);
        image.attribute("zonal_crop_v0_px", self.crop.v0 as f64);
        image.write(path)
    }

    /// Reads what [`ResponseImage::write`] wrote.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn read(path: &Path) -> Result<Self, StoreError> {
        let image = Layers::read(path)?;
        let missing = |what: &str| StoreError::invalid(path, format!("`{what}` is missing: measure again"));
        let number = |name: &str| image.number(name).map(|x| x as usize).ok_or_else(|| missing(name));
        let crop = Crop {
            u0: number("zonal_crop_u0_px")?,
            v0: number("zonal_crop_v0_px")?,
            width: image.width,
            height: image.height,
        };
        let plane = |name: &str| image.get(name).ok_or_else(|| missing(name));
        Ok(Self { crop, rate: plane("rate")?, variance: plane("variance")? })
    }

    /// As [`ResponseImage::read`], for a response that must cover `crop`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn read_of(path: &Path, crop: Crop) -> Result<Self, StoreError> {
        let response = Self::read(path)?;
        if response.crop == crop {
            return Ok(response);
        }
        Err(StoreError::invalid(path, "it shows another part of the sensor: measure again"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_and_remembered_responses_are_the_same() {
        let crop = Crop { u0: 3, v0: 5, width: 4, height: 2 };
        let rate = vec![1e3, -20.0, 3.3e5, f32::NAN, 0.0, 7.7, 123.4, 9e4];
        let variance = vec![9e4, 8e4, 9e6, f32::NAN, 8e4, 8e4, 8e4, 1e6];
        let image = ResponseImage { crop, rate, variance };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("r.exr");
        image.write(&path).unwrap();
        let back = ResponseImage::read(&path).unwrap();
        let kept = image.as_stored();
        assert_eq!(back.crop, crop);
        for i in 0..8 {
            assert!(back.rate[i].to_bits() == kept.rate[i].to_bits() || i == 3);
            assert!(back.variance[i].to_bits() == kept.variance[i].to_bits() || i == 3);
        }
        assert_eq!(back.saturated(), 1);
    }
}
