//! Planes and patterns as PNG.

use crate::capture::Crop;
use crate::patterns::Pattern;
use crate::render::rgb_png;

/// What stands for NaN: no gray.
const MAGENTA: [u8; 3] = [255, 0, 255];
/// Decades a logarithmic picture shows below its largest value.
const DECADES: f32 = 3.0;
/// Share of the values that a linear picture shows unclipped: single hot pixels do not darken it.
const UNCLIPPED: f64 = 0.998;

/// A plane as a gray PNG. NaN is magenta, what is not above 0 black.
///
/// Linear: brightness (sRGB) follows the value; white is the value that 0.2% of the pixels exceed. With `log`, grays are
/// even steps of the logarithm over three decades below the largest value.
///
/// # Panics
/// If `plane` does not hold `width * height` values.
pub fn plane_png(width: usize, height: usize, plane: &[f32], log: bool) -> Vec<u8> {
    assert_eq!(plane.len(), width * height, "one value for each pixel");
    let mut sorted: Vec<f32> = plane.iter().copied().filter(|v| v.is_finite() && *v > 0.0).collect();
    sorted.sort_by(f32::total_cmp);
    let clipped = ((sorted.len() as f64 * (1.0 - UNCLIPPED)) as usize).min(sorted.len().saturating_sub(1));
    let white = sorted.len().checked_sub(1 + if log { 0 } else { clipped }).map_or(1.0, |i| sorted[i]);
    let gray = |v: f32| {
        let share = (v / white).clamp(0.0, 1.0);
        let tone = match log {
            true if share > 0.0 => 1.0 + share.log10() / DECADES,
            true => 0.0,
            false => share.powf(1.0 / 2.2),
        };
        [(tone.clamp(0.0, 1.0) * 255.0).round() as u8; 3]
    };
    let bytes = plane.iter().flat_map(|&v| if v.is_nan() { MAGENTA } else { gray(v) }).collect();
    rgb_png(width, height, bytes)
}

/// The part of a pattern inside `crop` as a gray PNG of its codes; what lies beyond the pattern is cut off,
/// and nothing at all becomes one black pixel.
pub fn pattern_png(pattern: &Pattern, crop: Crop) -> Vec<u8> {
    let within = |from: usize, n: usize, end: usize| from.min(end)..from.saturating_add(n).min(end);
    let columns = within(crop.u0, crop.width, pattern.width);
    let rows = within(crop.v0, crop.height, pattern.height);
    let (width, height) = (columns.len(), rows.len());
    let codes = rows.flat_map(|v| &pattern.codes[v * pattern.width..][columns.clone()]);
    rgb_png(width, height, codes.flat_map(|&code| [code; 3]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decode(png: &[u8]) -> image::RgbImage {
        image::load_from_memory(png).unwrap().to_rgb8()
    }

    #[test]
    fn planes_show_nan_and_both_scales() {
        let plane = [f32::NAN, -1.0, 0.0, 1.0, 10.0, 1000.0];
        let linear = decode(&plane_png(3, 2, &plane, false));
        assert_eq!(linear.dimensions(), (3, 2));
        assert_eq!((linear.get_pixel(0, 0).0, linear.get_pixel(1, 0).0), (MAGENTA, [0; 3]));
        assert_eq!(linear.get_pixel(2, 1).0, [255; 3]);
        let log = decode(&plane_png(3, 2, &plane, true));
        assert_eq!((log.get_pixel(0, 1).0, log.get_pixel(1, 1).0, log.get_pixel(2, 1).0), ([0; 3], [85; 3], [255; 3]));
        for plane in [[f32::NAN; 2], [0.0; 2], [f32::INFINITY; 2]] {
            decode(&plane_png(2, 1, &plane, true));
            decode(&plane_png(2, 1, &plane, false));
        }
    }

    #[test]
    fn patterns_are_cropped_to_what_there_is() {
        let codes: Vec<u8> = (0..12).collect();
        let pattern = Pattern { width: 4, height: 3, codes: codes.into(), light: crate::patterns::Primary::White };
        let image = decode(&pattern_png(&pattern, Crop { u0: 1, v0: 1, width: 2, height: 9 }));
        assert_eq!(image.dimensions(), (2, 2));
        assert_eq!((image.get_pixel(0, 0).0[0], image.get_pixel(1, 1).0[0]), (5, 10));
        let beyond = Crop { u0: 7, v0: 0, width: usize::MAX, height: 2 };
        assert_eq!(decode(&pattern_png(&pattern, beyond)).dimensions(), (1, 1));
    }
}
