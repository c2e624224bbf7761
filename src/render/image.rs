//! Linear RGB images and their files.

use std::io::Cursor;
use std::path::Path;

use crate::store::{self, Layers, Plane, StoreError};

/// An image of linear RGB values in any unit of light.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Linear RGB, row by row from the top; negative values are kept.
    pub pixels: Vec<[f32; 3]>,
}

impl Image {
    /// A black image.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![[0.0; 3]; width * height] }
    }

    /// The image as 8-bit sRGB PNG: values times `exposure`, clamped to 0..=1. NaN becomes black, an empty image one black
    /// pixel, for PNG has no empty ones.
    pub fn to_png(&self, exposure: f32) -> Vec<u8> {
        let bytes = self.pixels.iter().flatten().map(|&v| srgb_byte(v * exposure)).collect();
        rgb_png(self.width, self.height, bytes)
    }

    /// Writes [`Image::to_png`] to a file, whole or not at all.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write_png(&self, path: &Path, exposure: f32) -> Result<(), StoreError> {
        store::write(path, &self.to_png(exposure))
    }

    /// Writes the linear values as 32-bit OpenEXR, whole or not at all.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write_exr(&self, path: &Path) -> Result<(), StoreError> {
        let mut layers = Layers::new(self.width, self.height);
        for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
            layers.plane(name, Plane::Float(self.pixels.iter().map(|p| p[c]).collect()));
        }
        layers.attribute("zonal_content", "linear RGB picture; values may be negative");
        layers.write(path)
    }

    /// The images in a row from the left, tops aligned, with a small black gap between neighbours.
    pub fn side_by_side(images: &[Self]) -> Self {
        let height = images.iter().map(|i| i.height).max().unwrap_or(0);
        let gap = height / 32;
        let width = images.iter().map(|i| i.width).sum::<usize>() + gap * images.len().saturating_sub(1);
        let mut row = Self::new(width, height);
        let mut left = 0;
        for image in images.iter().filter(|i| i.width > 0) {
            for (y, line) in image.pixels.chunks_exact(image.width).enumerate() {
                row.pixels[y * width + left..][..image.width].copy_from_slice(line);
            }
            left += image.width + gap;
        }
        row
    }

    /// Pixel by pixel, this image minus `reference`, signed; `None` if the sizes differ.
    pub fn difference(&self, reference: &Self) -> Option<Self> {
        let minus = |(a, b): (&[f32; 3], &[f32; 3])| [0, 1, 2].map(|c| a[c] - b[c]);
        self.same_size(reference).then(|| {
            let pixels = self.pixels.iter().zip(&reference.pixels).map(minus).collect();
            Self { pixels, ..*self }
        })
    }

    /// A signed image in colours, linear RGB: white is 0, red `full` or more, blue -`full` or less, in the mean of the channels.
    pub fn diverging(&self, full: f32) -> Self {
        let colour = |pixel: &[f32; 3]| {
            let t = (pixel.iter().sum::<f32>() / (3.0 * full)).clamp(-1.0, 1.0);
            let fade = 1.0 - t.abs();
            if t > 0.0 { [1.0, fade, fade] } else { [fade, fade, 1.0] }
        };
        Self { pixels: self.pixels.iter().map(colour).collect(), ..*self }
    }

    /// Mean of all values, pixels and channels alike; 0 of an empty image.
    pub fn mean(&self) -> f64 {
        let sum: f64 = self.pixels.iter().flatten().map(|&v| f64::from(v)).sum();
        sum / (3 * self.pixels.len()).max(1) as f64
    }

    /// Mean of the absolute difference to `reference` over the mean of `reference`, all pixels and channels alike.
    ///
    /// `None` if the sizes differ or the mean of the reference is not positive.
    pub fn relative_mean(&self, reference: &Self) -> Option<f64> {
        let difference = self.difference(reference)?;
        let absolute = Self { pixels: difference.pixels.iter().map(|p| p.map(f32::abs)).collect(), ..difference };
        let mean = reference.mean();
        (mean > 0.0).then(|| absolute.mean() / mean)
    }

    /// RMS of the difference to `reference` over the RMS of `reference`, all pixels and channels alike.
    ///
    /// `None` if the sizes differ or the reference is black.
    pub fn relative_rms(&self, reference: &Self) -> Option<f64> {
        let squares = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
        let flat = |image: &Self| image.pixels.clone().into_iter().flatten().map(f64::from);
        let power = squares(&mut flat(reference));
        (self.same_size(reference) && power > 0.0)
            .then(|| (squares(&mut flat(self).zip(flat(reference)).map(|(a, b)| a - b)) / power).sqrt())
    }

    fn same_size(&self, other: &Self) -> bool {
        (self.width, self.height) == (other.width, other.height)
    }
}

/// Three bytes for each pixel as PNG; one black pixel if there are none.
pub(crate) fn rgb_png(width: usize, height: usize, bytes: Vec<u8>) -> Vec<u8> {
    if bytes.is_empty() {
        return rgb_png(1, 1, vec![0; 3]);
    }
    let image = ::image::RgbImage::from_raw(width as u32, height as u32, bytes).expect("three bytes for each pixel");
    let mut png = Cursor::new(Vec::new());
    image.write_to(&mut png, ::image::ImageFormat::Png).expect("memory takes any PNG");
    png.into_inner()
}

/// The 8-bit sRGB code of a linear value, clamped (IEC 61966-2-1).
fn srgb_byte(linear: f32) -> u8 {
    let v = linear.clamp(0.0, 1.0);
    let encoded = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn constant(width: usize, height: usize, value: f32) -> Image {
        Image { width, height, pixels: vec![[value; 3]; width * height] }
    }

    #[test]
    fn png_has_the_size_and_the_codes_of_srgb() {
        let mut image = constant(5, 3, 0.214_041_14);
        image.pixels[0] = [-1.0, 2.0, f32::NAN];
        let decoded = ::image::load_from_memory(&image.to_png(1.0)).unwrap().to_rgb8();
        assert_eq!(decoded.dimensions(), (5, 3));
        assert_eq!(decoded.get_pixel(0, 0).0, [0, 255, 0]);
        // Linear 0.2140 is the middle of sRGB.
        assert_eq!(decoded.get_pixel(4, 2).0, [128; 3]);
    }

    #[test]
    fn files_keep_negative_values() {
        let dir = tempfile::tempdir().unwrap();
        let image = constant(2, 2, -0.25);
        image.write_exr(&dir.path().join("a.exr")).unwrap();
        image.write_png(&dir.path().join("a.png"), 1.0).unwrap();
        assert_eq!(Layers::read(&dir.path().join("a.exr")).unwrap().get("G"), Some(vec![-0.25; 4]));
    }

    #[test]
    fn differences_are_white_red_and_blue() {
        let colour = |value| constant(1, 1, value).diverging(2.0).pixels[0];
        assert_eq!(colour(0.0), [1.0; 3]);
        assert_eq!((colour(1.0), colour(5.0)), ([1.0, 0.5, 0.5], [1.0, 0.0, 0.0]));
        assert_eq!(colour(-2.0), [0.0, 0.0, 1.0]);
    }

    #[test]
    fn rows_hold_their_images_and_differences_are_relative() {
        let row = Image::side_by_side(&[constant(64, 64, 1.0), constant(32, 32, 2.0)]);
        assert_eq!((row.width, row.height), (98, 64));
        assert_eq!((row.pixels[63][0], row.pixels[65][0], row.pixels[66][0]), (1.0, 0.0, 2.0));
        assert_eq!(Image::side_by_side(&[]), Image::new(0, 0));
        assert!(::image::load_from_memory(&Image::new(0, 0).to_png(1.0)).is_ok());
        let (a, b) = (constant(4, 4, 0.75), constant(4, 4, 1.0));
        assert_eq!(a.difference(&b), Some(constant(4, 4, -0.25)));
        assert_eq!((a.relative_mean(&b), a.difference(&constant(4, 5, 1.0))), (Some(0.25), None));
        let difference = constant(4, 4, 1.1).relative_rms(&constant(4, 4, 1.0)).unwrap();
        assert!((difference - 0.1).abs() < 1e-6);
        assert_eq!(constant(4, 4, 1.0).relative_rms(&constant(4, 5, 1.0)), None);
        assert_eq!(constant(4, 4, 1.0).relative_rms(&constant(4, 4, 0.0)), None);
    }
}
