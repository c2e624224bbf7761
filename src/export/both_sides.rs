//! From measured coefficients to a tensor over both sides.

use crate::basis::{ExitantRule, Tensor, TensorError, edge_shift, size};
use crate::fit::CalibrationUncertainty;
use crate::reduce::Coefficients;

/// Expands exitant directions too: the tensor of each channel up to `exitant_order`, with its errors.
///
/// Systematic errors are those that would feign a lack of reciprocity: the gray card's curve, off by the calibration's
/// `scale_rel` at one end of the zone and by its negative at the other; both edges of the zone; and what a coarser rule
/// over the rings makes of the same data. `isotropic` as in [`Tensor::project`]: take [`crate::fit::Observations`]'s
/// `folded` to let the data decide.
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
    let edges = [true, false]
        .map(|inner| edge_shift(grid.zone(), coefficients.order, inner, calibration.edge_deg.to_radians()));
    let [inner, outer] = edges;
    let edges = [inner?, outer?];
    let plane = |planes: &[f32], k: usize, c: usize| -> Vec<f64> {
        planes[(k * 3 + c) * grid.len()..][..grid.len()].iter().map(|&z| f64::from(z)).collect()
    };
    let tilt = |cell: usize| {
        let ring = (cell / grid.sectors()) as f64 + 0.5;
        calibration.scale_rel * (2.0 * ring / grid.rings() as f64 - 1.0)
    };
    let of = |c: usize| -> Result<Tensor, TensorError> {
        let z = |k: usize| plane(&coefficients.values, k, c);
        let variance = |k: usize| plane(&coefficients.sigma, k, c).iter().map(|s| s * s).collect();
        let mut tensor = Tensor::project(&rule, coefficients.order, isotropic, z, variance)?;
        tensor.add_systematic(&rule, |k| z(k).iter().enumerate().map(|(cell, z)| tilt(cell) * z).collect());
        for edge in &edges {
            tensor.add_systematic(&rule, |k| {
                let mut change = vec![0.0; grid.len()];
                for other in (0..size(coefficients.order)).filter(|&other| edge[(k, other)] != 0.0) {
                    change.iter_mut().zip(z(other)).for_each(|(sum, z)| *sum += edge[(k, other)] * z);
                }
                change
            });
        }
        let rough = Tensor::project(&coarser, coefficients.order, isotropic, z, |_| vec![0.0; grid.len()])?;
        tensor.set_rule_error(&rough);
        Ok(tensor)
    };
    Ok([of(0)?, of(1)?, of(2)?])
}

/// Checks that every cell has a value and a standard error in all functions and channels.
fn complete(coefficients: &Coefficients) -> Result<(), TensorError> {
    let (cells, sectors) = (coefficients.grid.len(), coefficients.grid.sectors());
    let holds = |planes: &[f32], cell: usize| planes.iter().skip(cell).step_by(cells).all(|z| z.is_finite());
    let missing: Vec<usize> =
        (0..cells).filter(|&cell| !holds(&coefficients.values, cell) || !holds(&coefficients.sigma, cell)).collect();
    match missing.first() {
        Some(&first) => {
            Err(TensorError::Missing { missing: missing.len(), cells, ring: first / sectors, sector: first % sectors })
        }
        None => Ok(()),
    }
}
