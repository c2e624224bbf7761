//! OpenEXR images with any number of named planes and attributes.

use std::io::Cursor;
use std::path::Path;

use exr::prelude::*;
use half::f16;

use super::{StoreError, read, write};

/// Version of the planes and attributes this program writes and the newest it reads.
const FORMAT: f64 = 1.0;

/// The samples of one named plane, row by row.
#[derive(Debug, Clone, PartialEq)]
pub enum Plane {
    /// 32-bit floats.
    Float(Vec<f32>),
    /// 16-bit floats: 11 significant bits, up to 65504.
    Half(Vec<f16>),
}

impl Plane {
    /// Halves if storing `values` so changes none by more than `tolerance(i)`, else floats.
    pub fn compact(values: &[f32], tolerance: impl Fn(usize) -> f32) -> Self {
        let half: Vec<f16> = values.iter().map(|&v| f16::from_f32(v)).collect();
        let fits = |(i, (h, v)): (usize, (&f16, &f32))| v.is_nan() || (h.to_f32() - v).abs() <= tolerance(i);
        if half.iter().zip(values).enumerate().all(fits) { Plane::Half(half) } else { Plane::Float(values.to_vec()) }
    }

    /// The samples as 32-bit floats.
    pub fn to_f32(&self) -> Vec<f32> {
        match self {
            Plane::Float(v) => v.clone(),
            Plane::Half(v) => v.iter().map(|h| h.to_f32()).collect(),
        }
    }
}

/// The value of an attribute.
#[derive(Debug, Clone, PartialEq)]
pub enum Attribute {
    /// Text.
    Text(String),
    /// A number; stored as a double.
    Number(f64),
}

impl From<&str> for Attribute {
    fn from(text: &str) -> Self {
        Attribute::Text(text.into())
    }
}

impl From<f64> for Attribute {
    fn from(value: f64) -> Self {
        Attribute::Number(value)
    }
}

/// An image of named planes of one size.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Layers {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Planes by name; a name `layer.R` groups with `layer.G` and `layer.B`.
    pub planes: Vec<(String, Plane)>,
    /// Header attributes by name.
    pub attributes: Vec<(String, Attribute)>,
}

impl Layers {
    /// An empty image of a size.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, ..Self::default() }
    }

    /// Adds a plane; `samples` must be width x height.
    pub fn plane(&mut self, name: impl Into<String>, samples: Plane) {
        self.planes.push((name.into(), samples));
    }

    /// Adds an attribute.
    pub fn attribute(&mut self, name: &str, value: impl Into<Attribute>) {
        self.attributes.push((name.into(), value.into()));
    }

    /// The plane of a name as 32-bit floats.
    pub fn get(&self, name: &str) -> Option<Vec<f32>> {
        self.planes.iter().find(|(n, _)| n == name).map(|(_, p)| p.to_f32())
    }

    /// The text attribute of a name.
    pub fn text(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find_map(|(n, a)| match a {
            Attribute::Text(t) if n == name => Some(t.as_str()),
            _ => None,
        })
    }

    /// The numeric attribute of a name.
    pub fn number(&self, name: &str) -> Option<f64> {
        self.attributes.iter().find_map(|(n, a)| match a {
            Attribute::Number(x) if n == name => Some(*x),
            _ => None,
        })
    }

    /// Writes an OpenEXR file, whole or not at all, with the attributes `zonal_format` and `zonal_software` added.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write(&self, path: &Path) -> std::result::Result<(), StoreError> {
        let channels = self.planes.iter().map(|(name, plane)| {
            let samples = match plane {
                Plane::Float(v) => FlatSamples::F32(v.clone()),
                Plane::Half(v) => FlatSamples::F16(v.clone()),
            };
            AnyChannel::new(name.as_str(), samples)
        });
        let channels = AnyChannels::sort(channels.collect());
        let mut attributes = LayerAttributes::default();
        let format = ("zonal_format".to_owned(), Attribute::Number(FORMAT));
        let software = ("zonal_software".to_owned(), Attribute::from(concat!("zonal ", env!("CARGO_PKG_VERSION"))));
        for (name, value) in [&format, &software].into_iter().chain(&self.attributes) {
            let value = match value {
                Attribute::Text(t) => AttributeValue::Text(Text::from(t.as_str())),
                Attribute::Number(x) => AttributeValue::F64(*x),
            };
            attributes.other.insert(Text::from(name.as_str()), value);
        }
        let encoding = Encoding { compression: Compression::ZIP16, ..Encoding::default() };
        let layer = Layer::new((self.width, self.height), attributes, encoding, channels);
        let mut bytes = Cursor::new(Vec::new());
        Image::from_layer(layer)
            .write()
            .to_buffered(&mut bytes)
            .map_err(|e| StoreError::invalid(path, format!("cannot encode OpenEXR: {e}")))?;
        write(path, &bytes.into_inner())
    }

    /// Reads an OpenEXR file of flat half or float planes.
    ///
    /// # Errors
    /// [`StoreError`]; a truncated or foreign file and one of a newer program are [`StoreError::Invalid`].
    pub fn read(path: &Path) -> std::result::Result<Self, StoreError> {
        let invalid =
            |e: Error| StoreError::invalid(path, format!("not a readable OpenEXR image ({e}): make it again"));
        let image = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .from_buffered(Cursor::new(read(path)?))
            .map_err(invalid)?;
        let layer = image.layer_data;
        let mut layers = Layers::new(layer.size.width(), layer.size.height());
        for channel in layer.channel_data.list {
            let plane = match channel.sample_data {
                FlatSamples::F32(v) => Plane::Float(v),
                FlatSamples::F16(v) => Plane::Half(v),
                FlatSamples::U32(v) => Plane::Float(v.into_iter().map(|x| x as f32).collect()),
            };
            layers.plane(channel.name.to_string(), plane);
        }
        for (name, value) in layer.attributes.other {
            match value {
                AttributeValue::Text(t) => layers.attribute(&name.to_string(), t.to_string().as_str()),
                AttributeValue::F64(x) => layers.attribute(&name.to_string(), x),
                AttributeValue::F32(x) => layers.attribute(&name.to_string(), f64::from(x)),
                _ => {}
            }
        }
        match layers.number("zonal_format") {
            Some(found) if found > FORMAT => {
                let reason =
                    format!("format {found} is newer than {FORMAT}, the newest this version reads: update zonal");
                Err(StoreError::invalid(path, reason))
            }
            _ => Ok(layers),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_and_attributes_survive_a_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.exr");
        let mut image = Layers::new(3, 2);
        image.plane("z_000.R", Plane::Float(vec![1.0, -2.5, 3e-9, 4.0, 5.0, 6.0]));
        image.plane("z_000.G", Plane::compact(&[0.5; 6], |_| 0.0));
        image.attribute("units", "1/sr");
        image.attribute("exposure_s", 0.25);
        image.write(&path).unwrap();
        let back = Layers::read(&path).unwrap();
        assert_eq!((back.width, back.height), (3, 2));
        assert_eq!(back.get("z_000.R"), image.get("z_000.R"));
        assert!(matches!(back.planes[0].1, Plane::Half(_)));
        assert_eq!((back.text("units"), back.number("exposure_s")), (Some("1/sr"), Some(0.25)));
        let bytes = super::super::read(&path).unwrap();
        super::super::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert!(matches!(Layers::read(&path), Err(StoreError::Invalid { .. })));
    }

    #[test]
    fn halves_are_chosen_only_where_rounding_allows() {
        assert!(matches!(Plane::compact(&[1.0, 1.0003], |_| 1e-3), Plane::Half(_)));
        assert!(matches!(Plane::compact(&[1.0, 1.0003], |_| 1e-5), Plane::Float(_)));
        assert!(matches!(Plane::compact(&[1e6], |_| 1.0), Plane::Float(_)));
    }
}
