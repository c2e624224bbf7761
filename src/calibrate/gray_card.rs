//! The scale of the channels from a sample of known reflectance, and stray light from one that is black.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::reference::{Reference, gray_card_coefficients};
use super::{CalibrateError, Maps, RigMap};
use crate::basis::size;
use crate::capture::{AllSteps, Bench, Bracket, Control, Crop, Engine, Placement, Progress, Run, SensorMaps};
use crate::geometry::ExitantGrid;
use crate::optics::Rig;
use crate::patterns::{Exitant, Lobes, Pattern, Plan, Timing};
use crate::radiometry::{FlatField, Response};
use crate::reduce::{CellMap, ChannelScale, Coefficients, Reducer};

/// Degree of the curve over theta_o that the gray card gives each channel.
const SCALE_DEGREE: usize = 4;

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
    /// Compares measured coefficients with those of an ideal diffuser.
    pub fn new(measured: &Coefficients, albedo: f64) -> Self {
        let z = gray_card_coefficients(measured.grid.zone(), measured.order, albedo);
        let want: Vec<f64> = z.iter().flat_map(|&z| std::iter::repeat_n(z, 3 * measured.grid.len())).collect();
        Self::against(measured, &want)
    }

    /// Compares measured coefficients with those they should be, indexed alike.
    pub fn against(measured: &Coefficients, want: &[f64]) -> Self {
        let n = measured.grid.len();
        let mean = |plane: &mut dyn Iterator<Item = f64>| plane.sum::<f64>() / n as f64;
        let constant = |c: usize| mean(&mut want[c * n..][..n].iter().copied());
        let error = |k: usize, c: usize| {
            let want = &want[(k * 3 + c) * n..][..n];
            mean(&mut measured.plane(k, c).iter().zip(want).map(|(&z, w)| f64::from(z) - w)) / constant(c)
        };
        let functions = size(measured.order);
        let over_channels = |k: usize| if k < functions { (0..3).map(|c| error(k, c)).sum::<f64>() / 3.0 } else { 0.0 };
        let errors = (0..functions).flat_map(|k| (0..3).map(move |c| (k, c))).map(|(k, c)| error(k, c).abs());
        Self {
            z_10_error: over_channels(2),
            z_20_error: over_channels(6),
            worst_error: errors.fold(0.0, f64::max),
            white_balance: [1.0; 3],
            scale_sigma_rel: [0.0; 3],
        }
    }
}

/// The plan the gray card is measured with: order 2, on the finest of a few exitant grids that the camera can fill.
pub fn gray_card_plan(rig: &Rig) -> Plan {
    let plan = Plan::of_order(2);
    let Exitant { rings, sectors } = plan.exitant;
    let grids = [1, 2, 4, 8].map(|n| Exitant { rings: rings / n, sectors: sectors / n });
    let fills = |e: &Exitant| {
        let grid = ExitantGrid::new(rig.zone(), e.rings, e.sectors);
        CellMap::new(rig, &rig.camera_map(), Crop::of_zone(rig), grid).is_ok()
    };
    // Where none does, the finest tells why.
    Plan { exitant: grids.into_iter().find(fills).unwrap_or(plan.exitant), ..plan }
}

/// What a zonal measurement of a calibration uses of those made before.
#[derive(Clone, Copy)]
pub struct Known<'a> {
    /// The projector's response.
    pub response: &'a Response,
    /// The projector's flat field.
    pub flat: &'a FlatField,
    /// What is known of single pixels.
    pub sensor: Option<&'a SensorMaps>,
    /// Stray light, if it is calibrated.
    pub trap: Option<&'a Coefficients>,
    /// Where devices and mirrors stand; nominal without it.
    pub map: Option<&'a RigMap>,
}

/// Zonal coefficients of what is in the sample's place, before any scale: lobe differences in electrons per second.
fn unscaled(
    rig: &Rig,
    bench: &mut dyn Bench,
    plan: &Plan,
    known: Known<'_>,
    what: &str,
    progress: &mut Progress<'_>,
) -> Result<Coefficients, CalibrateError> {
    if let Some(map) = known.map {
        map.check_zone(rig)?;
    }
    let (w, h) = (rig.projector.width_px, rig.projector.height_px);
    let maps = Maps::of(rig, known.map);
    let steps = plan.steps(rig.zone());
    let lobes = Lobes::new(&maps.projector, rig.zone(), steps.clone(), w, h)?;
    let pairs = lobes.encode_all(known.response, known.flat);
    let patterns: Vec<Pattern> = pairs.iter().flat_map(|p| p.patterns.clone()).collect();
    let grid = ExitantGrid::new(rig.zone(), plan.exitant.rings, plan.exitant.sectors);
    let crop = Crop::of_map(rig, &maps.camera);
    let cells = CellMap::new(rig, &maps.camera, crop, grid)?;
    let gains = pairs.iter().map(|p| p.gains).collect();
    let history = format!("{what}; rig {}", rig.name);
    let mut reducer = Reducer::new(cells, steps, gains, ChannelScale::unit(), history);
    if let Some(trap) = known.trap {
        reducer = reducer.less_stray(trap)?;
    }
    let exposures_s = plan.exposures_s(&Timing::of(rig));
    let longest_s = exposures_s.iter().copied().fold(0.0, f64::max);
    let mut exposer = Bracket(exposures_s);
    let run = Run {
        patterns: &patterns,
        mixed: plan.is_mixed(),
        director: &mut AllSteps::new(pairs.len()),
        repeats: plan.repeats,
        exposer: &mut exposer,
        longest_s,
        crop,
        maps: known.sensor,
        folder: None,
        begin: &mut || Ok(()),
    };
    Engine::new(rig, bench, Control::default()).run(run, progress, |lobe, image| reducer.add(lobe, &image))?;
    let all: Vec<usize> = (0..pairs.len()).collect();
    Ok(reducer.finish_dark(&all, plan.scheme.is_isotropic())?.coefficients)
}

/// Measures stray light: what reaches the camera from a black trap in the sample's place. Zonal coefficients in electrons
/// per second, before any scale, so that the gray card, whose scale is not known yet, can be freed of it too.
///
/// # Errors
/// [`CalibrateError`].
pub fn black_trap(
    rig: &Rig,
    bench: &mut dyn Bench,
    plan: &Plan,
    known: Known<'_>,
    progress: &mut Progress<'_>,
) -> Result<Coefficients, CalibrateError> {
    bench.place(Placement::BlackTrap)?;
    unscaled(rig, bench, plan, Known { trap: None, ..known }, "black trap", progress)
}

/// Measures the gray card and scales every channel so that its z_00 is that of `reference`; the other coefficients check the
/// rig.
///
/// # Errors
/// [`CalibrateError`].
pub fn gray_card(
    rig: &Rig,
    bench: &mut dyn Bench,
    plan: &Plan,
    known: Known<'_>,
    reference: &Reference,
    progress: &mut Progress<'_>,
) -> Result<(ChannelScale, GrayCardCheck), CalibrateError> {
    bench.place(Placement::GrayCard)?;
    let raw = unscaled(rig, bench, plan, known, "gray card", progress)?;
    let grid = raw.grid;
    let want = reference.coefficients(grid, plan.order)?;
    let scale = ChannelScale { coefficients: [0, 1, 2].map(|c| scale_curve(&raw, c, &want)) };
    let positive = |ring: usize| (0..3).all(|c| scale.at(&grid.zone(), grid.theta(ring), c) > 0.0);
    if !(0..grid.rings()).all(positive) {
        return Err(CalibrateError::DarkGrayCard);
    }
    let mut check = GrayCardCheck::against(&rescaled(&raw, &scale), &want);
    let middle = (rig.zone().theta_min() + rig.zone().theta_max()) / 2.0;
    let at = |c: usize| scale.at(&rig.zone(), middle, c);
    check.white_balance = [0, 1, 2].map(|c| at(c) / at(1));
    check.scale_sigma_rel = [0, 1, 2].map(|c| scale_sigma_rel(&raw, c));
    Ok((scale, check))
}

/// Least-squares polynomial over the rings through true over measured z_00.
fn scale_curve(raw: &Coefficients, channel: usize, want: &[f64]) -> Vec<f64> {
    let (rings, sectors) = (raw.grid.rings(), raw.grid.sectors());
    let terms = (SCALE_DEGREE + 1).min(rings);
    let x = |r: usize| (2.0 * r as f64 + 1.0) / rings as f64 - 1.0;
    let sum = |r: usize| raw.plane(0, channel)[r * sectors..][..sectors].iter().map(|&z| f64::from(z)).sum::<f64>();
    let wanted = |r: usize| want[channel * raw.grid.len() + r * sectors..][..sectors].iter().sum::<f64>();
    let powers = DMatrix::from_fn(rings, terms, |r, i| x(r).powi(i as i32));
    let ratios = DVector::from_fn(rings, |r, _| wanted(r) / sum(r));
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
