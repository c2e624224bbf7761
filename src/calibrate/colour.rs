//! Colours of the projector as the camera sees them.

use super::CalibrateError;
use crate::capture::{Bench, Crop, Placement, ResponseImage, capture_sequence};
use crate::optics::Rig;
use crate::patterns::{Pattern, Plan, Primary, Timing};
use crate::radiometry::ColourMatrix;

/// Measures what each channel gets from each primary: full frames in red, green and blue on the gray card, and a black one.
///
/// # Errors
/// [`CalibrateError`]; a camera without colour filters is [`CalibrateError::Colour`].
pub fn colour(rig: &Rig, bench: &mut dyn Bench) -> Result<ColourMatrix, CalibrateError> {
    bench.place(Placement::GrayCard)?;
    let full = |code| Pattern::full(rig.projector.width_px, rig.projector.height_px, code);
    let mut patterns = vec![full(0)];
    patterns.extend(Primary::ALL.map(|light| full(255).in_light(light)));
    let exposures_s = Plan::of_order(0).exposures_s(&Timing::of(rig));
    let images = capture_sequence(rig, bench, &patterns, &exposures_s, Crop::of_zone(rig))?;
    let seen: Vec<[[f64; 2]; 3]> = images.iter().map(|image| means(rig, image)).collect();
    let light = [0, 1, 2].map(|c| [0, 1, 2].map(|p| seen[p + 1][c][0] - seen[0][c][0]));
    let variance = [0, 1, 2].map(|c| [0, 1, 2].map(|p| seen[p + 1][c][1] + seen[0][c][1]));
    Ok(ColourMatrix::of(light, variance)?)
}

/// Mean rate of each channel and its variance.
fn means(rig: &Rig, image: &ResponseImage) -> [[f64; 2]; 3] {
    let mut sums = [[0.0; 3]; 3];
    for (p, (&rate, &variance)) in image.rate.iter().zip(&image.variance).enumerate() {
        let (column, row) = image.crop.sensor_pixel(p);
        if rate.is_finite() {
            for &c in rig.camera.mosaic.channels(column, row) {
                let add = [f64::from(rate), f64::from(variance), 1.0];
                sums[c].iter_mut().zip(add).for_each(|(sum, x)| *sum += x);
            }
        }
    }
    sums.map(|[rate, variance, n]| [rate / n, variance / (n * n)])
}
