//! Response, flat field and gray card.

use std::f64::consts::{PI, TAU};

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::CalibrateError;
use crate::basis::size;
use crate::capture::{
    Bench, Bracket, Control, Crop, Engine, Placement, Progress, ResponseImage, Run, capture_sequence,
};
use crate::geometry::{ExitantGrid, Zone};
use crate::optics::Rig;
use crate::patterns::{Exitant, LobePair, Lobes, Pattern, Plan, Timing};
use crate::radiometry::{FlatField, Response};
use crate::reduce::{CellMap, ChannelScale, Coefficients, Reducer};

/// Albedo of the photographic gray card.
pub const GRAY_CARD_ALBEDO: f64 = 0.18;

/// Codes between the points of the response curve.
const CODE_STEP: usize = 5;
/// The code of the flat field's photograph.
const MID_GRAY: u8 = 128;
/// Photographs the flat field is the mean of.
const FLAT_FIELD_SHOTS: usize = 4;
/// Standard deviation of the filter that smooths the flat field, projector pixels.
const FLAT_FIELD_SMOOTHING_PX: f64 = 4.0;
/// Degree of the curve over theta_o that the gray card gives each channel.
const SCALE_DEGREE: usize = 4;

/// Measures the projector's response: full frames of every fifth code on the gray card, the mean light of the zone.
///
/// # Errors
/// [`CalibrateError`].
pub fn response(rig: &Rig, bench: &mut dyn Bench) -> Result<Response, CalibrateError> {
    bench.place(Placement::GrayCard)?;
    let codes: Vec<u8> = (0..=255).step_by(CODE_STEP).collect();
    let full = |&code: &u8| Pattern::full(rig.projector.width_px, rig.projector.height_px, code);
    let patterns: Vec<Pattern> = codes.iter().map(full).collect();
    let exposures = Plan::of_order(0).exposures_s(&Timing::of(rig));
    let images = capture_sequence(rig, bench, &patterns, &exposures, Crop::of_zone(rig))?;
    let points: Vec<(u8, f64)> = codes.into_iter().zip(images.iter().map(mean_rate)).collect();
    Ok(Response::from_points(&points)?)
}

fn mean_rate(image: &ResponseImage) -> f64 {
    let usable = image.rate.iter().filter(|r| !r.is_nan());
    let (sum, n) = usable.fold((0.0, 0usize), |(s, n), &r| (s + f64::from(r), n + 1));
    sum / n as f64
}

/// Measures the flat field: photographs of mid-gray on a diffuse white screen at the focal distance, black subtracted.
///
/// Camera and projector share their centre of projection, so a camera pixel sees one direction of the projector. The
/// natural fall-off of both (cos^4 each) is divided out: what a rig's sample receives is radiance, not irradiance.
///
/// # Errors
/// [`CalibrateError`].
pub fn flat_field(rig: &Rig, bench: &mut dyn Bench) -> Result<FlatField, CalibrateError> {
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
    let (camera, projector) = (rig.camera.lens(), rig.projector.lens());
    let mut sums = vec![(0.0f64, 0.0f64); width * height];
    for p in 0..crop.len() {
        let (column, row) = crop.sensor_pixel(p);
        let ray = camera.ray(column as f64 + 0.5, row as f64 + 0.5);
        let (u, v) = projector.pixel(&ray);
        let light = mean(0, p) - mean(1, p);
        let inside = u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64;
        if inside && light.is_finite() {
            let channel = rig.camera.mosaic.channels(column, row)[0];
            let cell = &mut sums[v as usize * width + u as usize];
            cell.0 += light / (channel_means[channel] * ray.z.powi(8));
            cell.1 += 1.0;
        }
    }
    let mut values = smooth(&sums, width, height, FLAT_FIELD_SMOOTHING_PX);
    let zone = rig.projector_map().bounding_box(&rig.zone(), width, height);
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

/// How well the gray card's coefficients agree with those of an ideal diffuser, in units of its z_00.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GrayCardCheck {
    /// (mean z_10 over directions and channels - analytic) / z_00.
    pub z_10_error: f64,
    /// The same for z_20, whose analytic value is 0.
    pub z_20_error: f64,
    /// Largest deviation of any coefficient's mean over directions, per channel.
    pub worst_error: f64,
    /// Scale of red and blue relative to green: the white balance.
    pub white_balance: [f64; 3],
    /// Standard error of each channel's scale by the noise of the card's own measurement, relative, RMS over theta_o.
    #[serde(default)]
    pub scale_sigma_rel: [f64; 3],
}

impl GrayCardCheck {
    /// Compares measured coefficients with the analytic ones.
    pub fn new(measured: &Coefficients, albedo: f64) -> Self {
        let want = gray_card_coefficients(measured.grid.zone(), measured.order, albedo);
        let n = measured.grid.len() as f64;
        let mean = |k: usize, c: usize| measured.plane(k, c).iter().map(|&z| f64::from(z)).sum::<f64>() / n;
        let error = |k: usize, c: usize| (mean(k, c) - want[k]) / want[0];
        let over_channels =
            |k: usize| if k < want.len() { (0..3).map(|c| error(k, c)).sum::<f64>() / 3.0 } else { 0.0 };
        let worst_error = (0..want.len()).flat_map(|k| (0..3).map(move |c| (k, c))).map(|(k, c)| error(k, c).abs());
        Self {
            z_10_error: over_channels(2),
            z_20_error: over_channels(6),
            worst_error: worst_error.fold(0.0, f64::max),
            white_balance: [1.0; 3],
            scale_sigma_rel: [0.0; 3],
        }
    }
}

/// Zonal coefficients of a diffuser: z_00 = albedo (a+b) sqrt((a-b)/2pi), z_10 = albedo (a-b)^1.5 / sqrt(6pi), others 0.
pub fn gray_card_coefficients(zone: Zone, order: usize, albedo: f64) -> Vec<f64> {
    let (a, b) = (zone.cos_min(), zone.cos_max());
    let mut z = vec![0.0; size(order)];
    z[0] = albedo * (a + b) * ((a - b) / TAU).sqrt();
    if order > 0 {
        z[2] = albedo * (a - b).powf(1.5) / (6.0 * PI).sqrt();
    }
    z
}

/// The plan the gray card is measured with: order 2, on the finest of a few exitant grids that the camera can fill.
pub fn gray_card_plan(rig: &Rig) -> Plan {
    let plan = Plan::of_order(2);
    let Exitant { rings, sectors } = plan.exitant;
    let grids = [1, 2, 4, 8].map(|n| Exitant { rings: rings / n, sectors: sectors / n });
    let fills =
        |e: &Exitant| CellMap::new(rig, Crop::of_zone(rig), ExitantGrid::new(rig.zone(), e.rings, e.sectors)).is_ok();
    // Where none does, the finest tells why.
    Plan { exitant: grids.into_iter().find(fills).unwrap_or(plan.exitant), ..plan }
}

/// Measures the gray card and scales every channel so that its z_00 is right; the other coefficients check the rig.
///
/// # Errors
/// [`CalibrateError`].
pub fn gray_card(
    rig: &Rig,
    bench: &mut dyn Bench,
    plan: &Plan,
    response: &Response,
    flat: &FlatField,
    progress: &mut Progress<'_>,
) -> Result<(ChannelScale, GrayCardCheck), CalibrateError> {
    bench.place(Placement::GrayCard)?;
    let (w, h) = (rig.projector.width_px, rig.projector.height_px);
    let lobes = Lobes::new(&rig.projector_map(), rig.zone(), plan.order, w, h)?;
    let pairs: Vec<LobePair> = (0..size(plan.order)).map(|k| lobes.encode(k, response, flat)).collect();
    let patterns: Vec<Pattern> = pairs.iter().flat_map(|p| p.patterns.clone()).collect();
    let grid = ExitantGrid::new(rig.zone(), plan.exitant.rings, plan.exitant.sectors);
    let cells = CellMap::new(rig, Crop::of_zone(rig), grid)?;
    let gains = pairs.iter().map(|p| p.gain).collect();
    let mut reducer =
        Reducer::new(cells, plan.order, gains, ChannelScale::unit(), format!("gray card; rig {}", rig.name));
    let exposures_s = plan.exposures_s(&Timing::of(rig));
    let longest_s = exposures_s.iter().copied().fold(0.0, f64::max);
    let mut exposer = Bracket(exposures_s);
    let crop = Crop::of_zone(rig);
    let run = Run {
        patterns: &patterns,
        repeats: plan.repeats,
        exposer: &mut exposer,
        longest_s,
        crop,
        maps: None,
        folder: None,
    };
    Engine::new(rig, bench, Control::default()).run(run, progress, |lobe, image| reducer.add(lobe, &image))?;
    let raw = reducer.finish()?;
    let want = gray_card_coefficients(rig.zone(), plan.order, GRAY_CARD_ALBEDO)[0];
    let scale = ChannelScale { coefficients: [0, 1, 2].map(|c| scale_curve(&raw, c, want)) };
    let positive = |ring: usize| (0..3).all(|c| scale.at(&grid.zone(), grid.theta(ring), c) > 0.0);
    if !(0..grid.rings()).all(positive) {
        return Err(CalibrateError::DarkGrayCard);
    }
    let mut check = GrayCardCheck::new(&rescaled(&raw, &scale), GRAY_CARD_ALBEDO);
    let middle = (rig.zone().theta_min() + rig.zone().theta_max()) / 2.0;
    let at = |c: usize| scale.at(&rig.zone(), middle, c);
    check.white_balance = [0, 1, 2].map(|c| at(c) / at(1));
    check.scale_sigma_rel = [0, 1, 2].map(|c| scale_sigma_rel(&raw, c));
    Ok((scale, check))
}

/// Least-squares polynomial over the rings through analytic over measured z_00.
fn scale_curve(raw: &Coefficients, channel: usize, want: f64) -> Vec<f64> {
    let (rings, sectors) = (raw.grid.rings(), raw.grid.sectors());
    let terms = (SCALE_DEGREE + 1).min(rings);
    let x = |r: usize| (2.0 * r as f64 + 1.0) / rings as f64 - 1.0;
    let mean = |r: usize| {
        raw.plane(0, channel)[r * sectors..(r + 1) * sectors].iter().map(|&z| f64::from(z)).sum::<f64>()
            / sectors as f64
    };
    let powers = DMatrix::from_fn(rings, terms, |r, i| x(r).powi(i as i32));
    let ratios = DVector::from_fn(rings, |r, _| want / mean(r));
    let normal = powers.transpose() * &powers;
    let solution = normal.cholesky().map(|c| c.solve(&(powers.transpose() * ratios)));
    solution.map_or_else(|| vec![f64::NAN], |s| s.iter().copied().collect())
}

/// Standard error of [`scale_curve`], relative, RMS over the rings: a polynomial spends its terms over all cells.
fn scale_sigma_rel(raw: &Coefficients, channel: usize) -> f64 {
    let n = raw.grid.len();
    let cells = raw.plane(0, channel).iter().zip(&raw.sigma[channel * n..][..n]);
    let variance = cells.map(|(&z, &s)| (f64::from(s) / f64::from(z)).powi(2)).filter(|v| v.is_finite()).sum::<f64>();
    let terms = (SCALE_DEGREE + 1).min(raw.grid.rings());
    (variance / n as f64 * terms as f64 / n as f64).sqrt()
}

fn rescaled(raw: &Coefficients, scale: &ChannelScale) -> Coefficients {
    let mut scaled = raw.clone();
    let grid = raw.grid;
    for (i, (value, sigma)) in scaled.values.iter_mut().zip(&mut scaled.sigma).enumerate() {
        let factor = scale.at(&grid.zone(), grid.theta(i % grid.len() / grid.sectors()), i / grid.len() % 3) as f32;
        *value *= factor;
        *sigma *= factor;
    }
    scaled
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values stated in the derivation, five digits.
    #[test]
    fn analytic_values_of_the_gray_card() {
        let built = gray_card_coefficients(Zone::from_degrees(9.0, 57.0).unwrap(), 2, 0.18);
        let full = gray_card_coefficients(Zone::from_degrees(9.0, 90.0).unwrap(), 2, 0.18);
        for (got, want) in [(built[0], 0.07324), (built[2], 0.01223), (full[0], 0.07049), (full[2], 0.04070)] {
            assert!((got - want).abs() < 5e-6, "{got} {want}");
        }
        assert!(built.iter().enumerate().all(|(k, z)| k == 0 || k == 2 || *z == 0.0));
    }

    #[test]
    fn smoothing_keeps_a_plane_and_fills_holes() {
        let cells: Vec<_> = (0..40 * 30).map(|p| if p % 7 == 0 { (0.0, 0.0) } else { (2.0, 1.0) }).collect();
        assert!(smooth(&cells, 40, 30, 2.0).iter().all(|v| (v - 2.0).abs() < 1e-6));
    }
}
