//! Response and flat field.

use super::{CalibrateError, Maps, RigMap};
use crate::capture::{Bench, Crop, Placement, ResponseImage, capture_sequence};
use crate::optics::{Device, Misaligned, Misalignment, Rig};
use crate::patterns::{Pattern, Plan, Timing};
use crate::radiometry::{FlatField, Response};

/// Codes between the points of the response curve.
const CODE_STEP: usize = 5;
/// The code of the flat field's photograph.
const MID_GRAY: u8 = 128;
/// Photographs the flat field is the mean of.
const FLAT_FIELD_SHOTS: usize = 4;
/// Standard deviation of the filter that smooths the flat field, projector pixels.
const FLAT_FIELD_SMOOTHING_PX: f64 = 4.0;

/// Measures the projector's response: full frames of every fifth code on the gray card, the mean light of the zone over all
/// pixels, which is what patterns are encoded with, and over those of red, green and blue.
///
/// # Errors
/// [`CalibrateError`].
pub fn response(rig: &Rig, bench: &mut dyn Bench) -> Result<(Response, [Response; 3]), CalibrateError> {
    bench.place(Placement::GrayCard)?;
    let codes: Vec<u8> = (0..=255).step_by(CODE_STEP).collect();
    let full = |&code: &u8| Pattern::full(rig.projector.width_px, rig.projector.height_px, code);
    let patterns: Vec<Pattern> = codes.iter().map(full).collect();
    let exposures = Plan::of_order(0).exposures_s(&Timing::of(rig));
    let images = capture_sequence(rig, bench, &patterns, &exposures, Crop::of_zone(rig))?;
    let curve = |channel: Option<usize>| {
        let light = images.iter().map(|image| mean_rate(rig, image, channel));
        Response::from_points(&codes.iter().copied().zip(light).collect::<Vec<_>>())
    };
    Ok((curve(None)?, [curve(Some(0))?, curve(Some(1))?, curve(Some(2))?]))
}

/// Mean over the pixels of a channel, or over all.
fn mean_rate(rig: &Rig, image: &ResponseImage, channel: Option<usize>) -> f64 {
    let counts = |p: usize| {
        let (column, row) = image.crop.sensor_pixel(p);
        channel.is_none_or(|c| rig.camera.mosaic.channels(column, row).contains(&c))
    };
    let usable = image.rate.iter().enumerate().filter(|(p, r)| !r.is_nan() && counts(*p));
    let (sum, n) = usable.fold((0.0, 0usize), |(s, n), (_, &r)| (s + f64::from(r), n + 1));
    sum / n as f64
}

/// Measures the flat field: photographs of mid-gray on a diffuse white screen at the focal distance, black subtracted.
///
/// A camera pixel sees one point of the screen, and a projector pixel lights it: `map` says which, without one both devices
/// share their centre of projection. The natural fall-off of both (cos^4 each) is divided out: what a rig's sample receives
/// is radiance, not irradiance.
///
/// # Errors
/// [`CalibrateError`].
pub fn flat_field(rig: &Rig, bench: &mut dyn Bench, map: Option<&RigMap>) -> Result<FlatField, CalibrateError> {
    bench.place(Placement::Screen)?;
    let (width, height) = (rig.projector.width_px, rig.projector.height_px);
    let full = |code| Pattern::full(width, height, code);
    let patterns: Vec<Pattern> = (0..2 * FLAT_FIELD_SHOTS).map(|i| full([MID_GRAY, 0][i % 2])).collect();
    let exposures = Plan::of_order(0).exposures_s(&Timing::of(rig));
    let crop = Crop::whole(rig);
    let images = capture_sequence(rig, bench, &patterns, &exposures, crop)?;
    let mean = |start: usize, p: usize| {
        images.iter().skip(start).step_by(2).map(|i| f64::from(i.rate[p])).sum::<f64>() / FLAT_FIELD_SHOTS as f64
    };
    let channel_means = channel_means(rig, crop, |p| mean(0, p) - mean(1, p));
    let off = map.map_or(Misalignment::none(), |m| m.misalignment);
    let (camera, projector) =
        (Misaligned::new(rig, &off, Device::Camera), Misaligned::new(rig, &off, Device::Projector));
    let screen_mm = rig.centre_height_mm - rig.projector.focus_mm;
    let mut sums = vec![(0.0f64, 0.0f64); width * height];
    for p in 0..crop.len() {
        let (column, row) = crop.sensor_pixel(p);
        let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
        let (u, v) = projector.image(&camera.on_plane(x, y, screen_mm));
        let light = mean(0, p) - mean(1, p);
        let inside = u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64;
        if inside && light.is_finite() {
            let channel = rig.camera.mosaic.channels(column, row)[0];
            let cell = &mut sums[v as usize * width + u as usize];
            let falloff = (camera.lens().ray(x, y).z * projector.lens().ray(u, v).z).powi(4);
            cell.0 += light / (channel_means[channel] * falloff);
            cell.1 += 1.0;
        }
    }
    let mut values = smooth(&sums, width, height, FLAT_FIELD_SMOOTHING_PX);
    let zone = Maps::of(rig, map).projector.bounding_box(&rig.zone(), width, height);
    let [u0, v0, u1, v1] = zone.expect("a checked rig shows its zone");
    if (v0..v1).any(|v| values[v * width + u0..v * width + u1].iter().any(|x| !(*x > 0.0 && x.is_finite()))) {
        return Err(CalibrateError::DarkFlatField);
    }
    // A projector may reach beyond the camera's field: what neither sees of the zone does not matter.
    let brightest = values.iter().copied().filter(|x| x.is_finite()).fold(0.0, f32::max);
    values.iter_mut().filter(|x| !(**x > 0.0 && x.is_finite())).for_each(|x| *x = brightest);
    FlatField::from_light(width, height, values).ok_or(CalibrateError::DarkFlatField)
}

/// Mean of a quantity over the middle half of the crop, for each colour.
fn channel_means(rig: &Rig, crop: Crop, value: impl Fn(usize) -> f64) -> [f64; 3] {
    let mut sums = [(0.0, 0.0); 3];
    for p in 0..crop.len() {
        let (column, row) = crop.sensor_pixel(p);
        let middle = |x: usize, n: usize| (n / 4..3 * n / 4).contains(&x);
        let v = value(p);
        if middle(column, rig.camera.width_px) && middle(row, rig.camera.height_px) && v.is_finite() {
            for &c in rig.camera.mosaic.channels(column, row) {
                sums[c].0 += v;
                sums[c].1 += 1.0;
            }
        }
    }
    sums.map(|(s, n)| s / n)
}

/// A Gaussian filter of (sum, weight) pairs: neighbours fill pixels without weight.
fn smooth(cells: &[(f64, f64)], width: usize, height: usize, sigma: f64) -> Vec<f32> {
    let radius = (3.0 * sigma).ceil() as isize;
    let kernel: Vec<f64> = (-radius..=radius).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect();
    let pass = |input: &[(f64, f64)], step: isize, at: &dyn Fn(usize) -> (isize, isize)| -> Vec<(f64, f64)> {
        (0..input.len())
            .map(|p| {
                let (position, n) = at(p);
                let lo = -radius.min(position);
                let hi = radius.min(n - 1 - position);
                (lo..=hi).fold((0.0, 0.0), |sum, d| {
                    let (s, w) = input[(p as isize + d * step) as usize];
                    let k = kernel[(d + radius) as usize];
                    (sum.0 + k * s, sum.1 + k * w)
                })
            })
            .collect()
    };
    let rows = pass(cells, 1, &|p| ((p % width) as isize, width as isize));
    let both = pass(&rows, width as isize, &|p| ((p / width) as isize, height as isize));
    both.into_iter().map(|(s, w)| (s / w) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoothing_keeps_a_plane_and_fills_holes() {
        let cells: Vec<_> = (0..40 * 30).map(|p| if p % 7 == 0 { (0.0, 0.0) } else { (2.0, 1.0) }).collect();
        assert!(smooth(&cells, 40, 30, 2.0).iter().all(|v| (v - 2.0).abs() < 1e-6));
    }
}
