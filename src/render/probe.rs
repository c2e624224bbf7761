//! Light probes: environments in latitude and longitude.

use std::f64::consts::{PI, TAU};
use std::io::Cursor;
use std::path::Path;

use nalgebra::Vector3;
use thiserror::Error;

use super::View;
use crate::geometry::Direction;
use crate::store::{self, Layers, StoreError};

/// Why a probe cannot be used.
#[derive(Debug, Error)]
pub enum ProbeError {
    /// The file cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A path of a kind no reader handles.
    #[error("{path} is no light probe: give a latitude-longitude image as .hdr or .exr")]
    UnknownKind {
        /// The path.
        path: String,
    },
    /// Not two to one.
    #[error(
        "a light probe of {width} x {height} pixels is not twice as wide as high: convert it to latitude-longitude"
    )]
    Shape {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A value that is no radiance.
    #[error("the light probe has the value {value} at column {column}, row {row}: clip it to a finite range")]
    NotFinite {
        /// The value.
        value: f32,
        /// Column from 0.
        column: usize,
        /// Row from 0.
        row: usize,
    },
}

/// Light from everywhere: radiance over all directions, linear RGB in any unit.
///
/// A latitude-longitude image in the frame [`View`], +y up: the top row looks up, the bottom row down. The centre is what
/// the camera would see straight ahead, -z; a quarter of the width to the right of it lies +x, and both ends show +z, the
/// light behind the camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Probe {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 3]>,
}

/// Rows of built-in probes: 1.4 deg each.
const BUILT_IN_ROWS: usize = 128;

impl Probe {
    /// A probe from radiances row by row; negative ones, as filters leave them, become 0.
    ///
    /// # Errors
    /// [`ProbeError::Shape`] or [`ProbeError::NotFinite`].
    pub fn new(width: usize, height: usize, mut pixels: Vec<[f32; 3]>) -> Result<Self, ProbeError> {
        if height == 0 || width != 2 * height || pixels.len() != width * height {
            return Err(ProbeError::Shape { width, height });
        }
        for (i, pixel) in pixels.iter_mut().enumerate() {
            if let Some(&value) = pixel.iter().find(|v| !v.is_finite()) {
                return Err(ProbeError::NotFinite { value, column: i % width, row: i / width });
            }
            *pixel = pixel.map(|v| v.max(0.0));
        }
        Ok(Self { width, height, pixels })
    }

    /// Reads a Radiance `.hdr` file, or an `.exr` file with the planes R, G and B.
    ///
    /// # Errors
    /// [`ProbeError`].
    pub fn read(path: &Path) -> Result<Self, ProbeError> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let (width, height, pixels) = match extension.as_deref() {
            Some("hdr") => read_hdr(path)?,
            Some("exr") => read_exr(path)?,
            _ => return Err(ProbeError::UnknownKind { path: path.display().to_string() }),
        };
        Self::new(width, height, pixels)
    }

    /// The same radiance from everywhere: a furnace.
    pub fn constant(radiance: [f32; 3]) -> Self {
        Self::from_fn(|_| radiance.map(f64::from))
    }

    /// A photographer's studio, built in: two soft boxes, a floor that brightens towards the front, a rim light behind.
    ///
    /// Radiances span more than three decades.
    pub fn studio() -> Self {
        Self::from_fn(|d| {
            let floor = smoothstep(0.05, -0.25, d.y);
            let front = 0.5 + 0.5 * d.z;
            let mut light = [0.008, 0.009, 0.011].map(|wall| wall * (1.0 - floor));
            let mut add = |amount: f64, colour: [f64; 3]| (0..3).for_each(|c| light[c] += amount * colour[c]);
            add(floor * (0.012 + 0.1 * front * front), [1.0, 0.94, 0.86]);
            add(5.0 * soft_box(d, [-0.75, 0.60, 0.70], [0.38, 0.30]), [1.0, 0.97, 0.92]);
            add(2.0 * soft_box(d, [0.95, 0.25, 0.30], [0.16, 0.55]), [0.84, 0.92, 1.0]);
            add(20.0 * soft_box(d, [0.55, 0.55, -0.80], [0.10, 0.10]), [1.0, 1.0, 1.0]);
            light
        })
    }

    fn from_fn(radiance: impl Fn(&Vector3<f64>) -> [f64; 3]) -> Self {
        let (width, height) = (2 * BUILT_IN_ROWS, BUILT_IN_ROWS);
        let mut probe = Self { width, height, pixels: Vec::new() };
        let pixel = |i: usize| radiance(&probe.direction(i % width, i / width).vector()).map(|v| v as f32);
        let pixels = (0..width * height).map(pixel).collect();
        probe.pixels = pixels;
        probe
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Radiance of a pixel, linear RGB.
    pub fn radiance(&self, column: usize, row: usize) -> [f32; 3] {
        self.pixels[row * self.width + column]
    }

    /// Towards the middle of a pixel.
    pub fn direction(&self, column: usize, row: usize) -> Direction<View> {
        let (sin_polar, cos_polar) = ((row as f64 + 0.5) / self.height as f64 * PI).sin_cos();
        let (sin_lon, cos_lon) = (((column as f64 + 0.5) / self.width as f64 - 0.5) * TAU).sin_cos();
        Direction::new_unchecked(Vector3::new(sin_polar * sin_lon, cos_polar, -sin_polar * cos_lon))
    }

    /// Solid angle of one pixel of a row, sr.
    pub fn solid_angle(&self, row: usize) -> f64 {
        let edge = |row: usize| (row as f64 / self.height as f64 * PI).cos();
        TAU / self.width as f64 * (edge(row) - edge(row + 1))
    }
}

/// 0 before `from`, 1 beyond `to`, smooth between; `from` may exceed `to`.
fn smoothstep(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// 1 inside an upright rectangle of half-sizes `half` (tangents) about the direction `centre`, 0 outside, soft edges.
fn soft_box(d: &Vector3<f64>, centre: [f64; 3], half: [f64; 2]) -> f64 {
    const EDGE: f64 = 0.03;
    let axis = Vector3::from(centre).normalize();
    let right = Vector3::y().cross(&axis).normalize();
    let depth = d.dot(&axis);
    if depth <= 0.0 {
        return 0.0;
    }
    let (x, y) = (d.dot(&right) / depth, d.dot(&axis.cross(&right)) / depth);
    smoothstep(half[0] + EDGE, half[0] - EDGE, x.abs()) * smoothstep(half[1] + EDGE, half[1] - EDGE, y.abs())
}

type Raster = (usize, usize, Vec<[f32; 3]>);

fn read_hdr(path: &Path) -> Result<Raster, StoreError> {
    let bytes = Cursor::new(store::read(path)?);
    let image = ::image::ImageReader::with_format(bytes, ::image::ImageFormat::Hdr)
        .decode()
        .map_err(|e| StoreError::invalid(path, format!("not a readable Radiance image ({e}): get it again")))?
        .into_rgb32f();
    let (width, height) = image.dimensions();
    Ok((width as usize, height as usize, image.pixels().map(|p| p.0).collect()))
}

fn read_exr(path: &Path) -> Result<Raster, StoreError> {
    let layers = Layers::read(path)?;
    let plane = |name: &str| {
        let missing = || StoreError::invalid(path, format!("there is no plane `{name}`: save the probe as RGB"));
        layers.get(name).ok_or_else(missing)
    };
    let (r, g, b) = (plane("R")?, plane("G")?, plane("B")?);
    let pixels = r.into_iter().zip(g).zip(b).map(|((r, g), b)| [r, g, b]).collect();
    Ok((layers.width, layers.height, pixels))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::Image;

    #[test]
    fn the_centre_is_ahead_and_rows_cover_the_sphere() {
        let probe = Probe::studio();
        let (w, h) = (probe.width(), probe.height());
        let near = |column: usize, row: usize, want: [f64; 3]| {
            assert!(probe.direction(column, row).vector().dot(&Vector3::from(want)) > 0.999);
        };
        near(w / 2, h / 2, [0.0, 0.0, -1.0]);
        near(3 * w / 4, h / 2, [1.0, 0.0, 0.0]);
        near(0, h / 2, [0.0, 0.0, 1.0]);
        near(w / 2, 0, [0.0, 1.0, 0.0]);
        let sphere: f64 = (0..h).map(|row| probe.solid_angle(row) * w as f64).sum();
        assert!((sphere / (4.0 * PI) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_studio_spans_three_decades() {
        let probe = Probe::studio();
        let greens = probe.pixels.iter().map(|p| p[1]);
        let (dark, bright) = (greens.clone().fold(f32::MAX, f32::min), greens.fold(0.0, f32::max));
        assert!(dark > 0.0 && bright / dark > 1000.0, "{dark} {bright}");
    }

    #[test]
    fn probes_are_read_from_both_kinds_of_file() {
        let dir = tempfile::tempdir().unwrap();
        let pixels: Vec<[f32; 3]> = (0..32).map(|i| [i as f32, 0.5, 300.0]).collect();
        let exr = dir.path().join("a.exr");
        Image { width: 8, height: 4, pixels: pixels.clone() }.write_exr(&exr).unwrap();
        assert_eq!(Probe::read(&exr).unwrap().pixels, pixels);
        let hdr = dir.path().join("a.HDR");
        let colours: Vec<_> = pixels.iter().map(|p| ::image::Rgb(*p)).collect();
        let mut bytes = Vec::new();
        ::image::codecs::hdr::HdrEncoder::new(&mut bytes).encode(&colours, 8, 4).unwrap();
        store::write(&hdr, &bytes).unwrap();
        let read = Probe::read(&hdr).unwrap();
        assert_eq!((read.width(), read.height()), (8, 4));
        assert!((read.radiance(5, 1)[2] / 300.0 - 1.0).abs() < 0.01);
        store::write(&hdr, &bytes[..bytes.len() / 2]).unwrap();
        assert!(matches!(Probe::read(&hdr), Err(ProbeError::Store(StoreError::Invalid { .. }))));
    }

    #[test]
    fn what_is_no_probe_is_refused_with_a_remedy() {
        let error = |pixels: Vec<[f32; 3]>, w, h| Probe::new(w, h, pixels).unwrap_err().to_string();
        assert!(error(vec![[1.0; 3]; 16], 4, 4).contains("4 x 4"));
        assert!(error(vec![], 0, 0).contains("0 x 0"));
        assert!(error(vec![[f32::INFINITY; 3]; 8], 4, 2).contains("column 0, row 0"));
        assert!(matches!(Probe::read(Path::new("probe.jpg")), Err(ProbeError::UnknownKind { .. })));
        assert!(matches!(Probe::read(Path::new("missing.exr")), Err(ProbeError::Store(StoreError::Read { .. }))));
        assert_eq!(Probe::new(2, 1, vec![[-1.0; 3]; 2]).unwrap().radiance(0, 0), [0.0; 3]);
    }
}
