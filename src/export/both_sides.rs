//! From measured coefficients to a tensor over both sides.

use nalgebra::{DMatrix, Rotation3, Vector3};

use crate::basis::{ExitantRule, Tensor, TensorError, edge_shift, rotation_shift};
use crate::fit::CalibrationUncertainty;
use crate::geometry::ExitantGrid;
use crate::reduce::Coefficients;

/// Degrees in theta_o of the curves by which the gray card's scale may be off.
const CURVES: i32 = 4;

/// Expands exitant directions too: the tensor of each channel up to `exitant_order`, with its errors.
///
/// Systematic errors are those that would feign a lack of reciprocity: smooth curves of the gray card's scale over
/// theta_o, the calibration's `scale_rel` at their ends; both edges of the zone, by `edge_deg`; what a coarser rule over
/// the rings makes of the same data; and of anisotropic samples, where nothing averages them out, slopes of the scale
/// across the field and turns of the sample by `edge_deg`. On top of all that everything may be off by `scale_rel`, without
/// a pattern. `isotropic` is as in [`Tensor::project`]:
/// [`crate::fit::Observations`] says in `folded` what the data are.
///
/// # Errors
/// [`TensorError::Missing`], [`TensorError::Grid`] or [`TensorError::Order`].
pub fn both_sides(
    coefficients: &Coefficients,
    exitant_order: usize,
    isotropic: bool,
    calibration: &CalibrationUncertainty,
) -> Result<[Tensor; 3], TensorError> {
    complete(coefficients)?;
    let grid = coefficients.grid;
    let rule = ExitantRule::new(grid, exitant_order)?;
    let coarser = ExitantRule::coarser(grid, exitant_order)?;
    let shifts = shifts(coefficients, isotropic, calibration.edge_deg.to_radians())?;
    let scales = scales(&grid, isotropic, calibration.scale_rel);
    let of = |c: usize| -> Result<Tensor, TensorError> {
        let plane = |planes: &[f32], k: usize| -> Vec<f64> {
            planes[(k * 3 + c) * grid.len()..][..grid.len()].iter().map(|&z| f64::from(z)).collect()
        };
        let z = |k: usize| plane(&coefficients.values, k);
        let variance = |k: usize| plane(&coefficients.sigma, k).iter().map(|s| s * s).collect();
        let mut tensor = Tensor::project(&rule, coefficients.order, isotropic, z, variance)?;
        tensor.rig_error = calibration.scale_rel;
        for scale in &scales {
            tensor.add_systematic(&rule, |k| z(k).iter().zip(scale).map(|(z, s)| z * s).collect());
        }
        for shift in &shifts {
            tensor.add_shift(shift);
        }
        tensor.set_rule_error(&Tensor::project(&coarser, coefficients.order, isotropic, z, |_| vec![0.0; grid.len()])?);
        Ok(tensor)
    };
    Ok([of(0)?, of(1)?, of(2)?])
}

/// What an error of directions by `angle` radians does to coefficients of incident directions.
fn shifts(coefficients: &Coefficients, isotropic: bool, angle: f64) -> Result<Vec<DMatrix<f64>>, TensorError> {
    let (zone, order) = (coefficients.grid.zone(), coefficients.order);
    let mut shifts = vec![edge_shift(zone, order, true, angle)?, edge_shift(zone, order, false, angle)?];
    if !isotropic {
        for axis in [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()] {
            shifts.push(rotation_shift(zone, order, &Rotation3::from_axis_angle(&axis, angle))?);
        }
    }
    Ok(shifts)
}

/// Relative errors of the scale in every cell, one for each independent source.
fn scales(grid: &ExitantGrid, isotropic: bool, scale_rel: f64) -> Vec<Vec<f64>> {
    let of = |scale: &dyn Fn(f64, f64) -> f64| -> Vec<f64> {
        let cell = |i: usize| {
            let (ring, sector) = (i / grid.sectors(), i % grid.sectors());
            scale_rel * scale((2.0 * ring as f64 + 1.0) / grid.rings() as f64 - 1.0, grid.phi(sector))
        };
        (0..grid.len()).map(cell).collect()
    };
    let mut scales: Vec<_> = (1..=CURVES).map(|degree| of(&|t, _| (f64::from(degree) * t.acos()).cos())).collect();
    if !isotropic {
        let radius = |t: f64| (1.0 + t) / 2.0;
        scales.extend([of(&|t, phi| radius(t) * phi.cos()), of(&|t, phi| radius(t) * phi.sin())]);
    }
    scales
}

/// Checks that every cell has a value and a standard error in all functions and channels.
fn complete(coefficients: &Coefficients) -> Result<(), TensorError> {
    let (cells, sectors) = (coefficients.grid.len(), coefficients.grid.sectors());
    let holds = |planes: &[f32], cell: usize| planes.iter().skip(cell).step_by(cells).all(|z| z.is_finite());
    let lacks = |cell: &usize| !holds(&coefficients.values, *cell) || !holds(&coefficients.sigma, *cell);
    let missing: Vec<usize> = (0..cells).filter(lacks).collect();
    match missing.first() {
        Some(&first) => {
            Err(TensorError::Missing { missing: missing.len(), cells, ring: first / sectors, sector: first % sectors })
        }
        None => Ok(()),
    }
}
