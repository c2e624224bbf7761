//! From frames to coefficients: least squares over what each step of a scheme tells.

use std::collections::BTreeSet;

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::isotropic::isotropic_sample;
use super::{CellResponse, ReduceError};
use crate::geometry::{ExitantGrid, Zone};
use crate::patterns::{Mixture, Step};

/// Shares of the greatest factor below which one is rounding.
const ROUNDING: f64 = 1e-12;

/// One step as it was taken.
pub(super) struct Taken<'a> {
    pub step: &'a Step,
    /// Divisor of the rates of each frame.
    pub gains: [f64; 2],
    pub frames: [&'a CellResponse; 2],
}

/// What a combination of frames tells: `mixture` is the sum of factor times rate over frames, `(step * 2 + part, factor)`.
pub(super) struct Row<'a> {
    pub mixture: &'a Mixture,
    frames: Vec<(usize, f64)>,
}

/// Coefficients before their scale: electrons per second.
pub(super) struct Rates {
    /// Which functions, ascending.
    pub functions: Vec<usize>,
    /// Value and variance: `[function][channel * cells + cell]`.
    pub cells: Vec<Vec<[f64; 2]>>,
    /// RMS deviation of the cells from what isotropy allows, beyond noise, for one coefficient; 0 where nothing is assumed.
    pub deviation: f64,
    /// RMS, radians, by which directions were off and are no more; 0 where nothing is assumed.
    pub displacement: f64,
}

pub(super) fn rows<'a>(taken: &[Taken<'a>]) -> Result<Vec<Row<'a>>, ReduceError> {
    let shows_black =
        |t: &Taken<'_>| matches!(t.step, Step::Parts(Mixture(terms)) if terms.iter().all(|&(k, _)| k == 0));
    let black = taken.iter().position(shows_black).map(|s| 2 * s + 1);
    let mut rows = Vec::new();
    for (s, t) in taken.iter().enumerate() {
        let [first, second] = t.gains.map(f64::recip);
        match t.step {
            Step::Parts(mixture) => rows.push(Row { mixture, frames: vec![(2 * s, first), (2 * s + 1, -second)] }),
            Step::Lights(both) => {
                let black = black.ok_or(ReduceError::NoBlack)?;
                for (part, (mixture, factor)) in both.iter().zip([first, second]).enumerate() {
                    rows.push(Row { mixture, frames: vec![(2 * s + part, factor), (black, -factor)] });
                }
            }
        }
    }
    Ok(rows)
}

/// All functions that any row shows.
pub(super) fn functions(rows: &[Row<'_>]) -> Vec<usize> {
    let all: BTreeSet<usize> = rows.iter().flat_map(|r| r.mixture.0.iter().map(|&(k, _)| k)).collect();
    all.into_iter().collect()
}

/// The least-squares inverse of a tall matrix.
pub(super) fn inverse(matrix: &DMatrix<f64>) -> Result<DMatrix<f64>, ReduceError> {
    let undetermined = ReduceError::Undetermined { rows: matrix.nrows(), functions: matrix.ncols() };
    if matrix.nrows() < matrix.ncols() {
        return Err(undetermined);
    }
    let normal = matrix.tr_mul(matrix).cholesky().ok_or(undetermined)?;
    Ok(normal.solve(&matrix.transpose()))
}

/// Every cell by itself: nothing is assumed of the sample.
pub(super) fn any_sample(taken: &[Taken<'_>], cells: usize) -> Result<Rates, ReduceError> {
    let rows = rows(taken)?;
    let functions = functions(&rows);
    let mut shown = DMatrix::zeros(rows.len(), functions.len());
    for (r, row) in rows.iter().enumerate() {
        for &(k, factor) in &row.mixture.0 {
            shown[(r, functions.binary_search(&k).expect("collected from the rows"))] = factor;
        }
    }
    let inverse = inverse(&shown)?;
    let values = |f: usize| -> Vec<[f64; 2]> {
        let mut factors = vec![0.0; 2 * taken.len()];
        for (r, row) in rows.iter().enumerate() {
            row.frames.iter().for_each(|&(frame, factor)| factors[frame] += inverse[(f, r)] * factor);
        }
        let greatest = factors.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        // A frame that says nothing of this function must not spoil it where it is saturated.
        let used: Vec<(usize, f64)> =
            factors.into_iter().enumerate().filter(|(_, x)| x.abs() > ROUNDING * greatest).collect();
        let at = |i: usize| {
            used.iter().fold([0.0; 2], |[value, variance], &(frame, factor)| {
                let response = taken[frame / 2].frames[frame % 2];
                [value + factor * response.rate[i], variance + factor * factor * response.variance[i]]
            })
        };
        (0..cells).map(at).collect()
    };
    let cells = (0..functions.len()).into_par_iter().map(values).collect();
    Ok(Rates { functions, cells, deviation: 0.0, displacement: 0.0 })
}

/// Value and variance of a row in one cell, stray light taken off.
pub(super) fn datum(
    taken: &[Taken<'_>],
    row: &Row<'_>,
    i: usize,
    stray: &(dyn Fn(usize, usize) -> Option<[f64; 2]> + Sync),
) -> [f64; 2] {
    let frames = row.frames.iter().fold([0.0; 2], |[value, variance], &(frame, factor)| {
        let response = taken[frame / 2].frames[frame % 2];
        [value + factor * response.rate[i], variance + factor * factor * response.variance[i]]
    });
    row.mixture.0.iter().fold(frames, |[value, variance], &(k, factor)| {
        let [light, sigma] = stray(k, i).unwrap_or_default();
        [value - factor * light, variance + (factor * sigma).powi(2)]
    })
}

/// Variances of the coefficients that `steps` tell, `(k, variance)`, when the rates of each step's frames have these variances
/// over all directions. Isotropic samples are averaged over `sectors` azimuths as in [`super::Coefficients`]: as if each cell had
/// been measured by itself.
///
/// # Errors
/// [`ReduceError::NoBlack`], [`ReduceError::Undetermined`].
pub fn coefficient_variances(
    zone: Zone,
    steps: &[Step],
    gains: &[[f64; 2]],
    variances: &[[f64; 2]],
    isotropic: bool,
    sectors: usize,
) -> Result<Vec<(usize, f64)>, ReduceError> {
    let grid = ExitantGrid::new(zone, 1, if isotropic { sectors } else { 1 });
    let n = 3 * grid.len();
    let response = |variance: f64| CellResponse { rate: vec![0.0; n], variance: vec![variance; n] };
    let responses: Vec<[CellResponse; 2]> = variances.iter().map(|v| v.map(response)).collect();
    let taken: Vec<Taken<'_>> = (steps.iter().zip(gains).zip(&responses))
        .map(|((step, &gains), frames)| Taken { step, gains, frames: frames.each_ref() })
        .collect();
    let rates = if isotropic { isotropic_sample(&taken, grid, &|_, _| None)? } else { any_sample(&taken, n)? };
    Ok(rates.functions.iter().zip(&rates.cells).map(|(&k, cells)| (k, cells[0][1])).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::patterns::Scheme;

    fn built() -> Zone {
        Zone::from_degrees(9.0, 57.0).unwrap()
    }

    fn variances(steps: &[Step], isotropic: bool, sectors: usize) -> Result<Vec<(usize, f64)>, ReduceError> {
        let ones = vec![[1.0; 2]; steps.len()];
        coefficient_variances(built(), steps, &ones, &ones, isotropic, sectors)
    }

    #[test]
    fn every_scheme_tells_every_function() {
        for scheme in Scheme::ALL {
            let steps = scheme.steps(built(), 4).unwrap();
            let found = variances(&steps, scheme.is_isotropic(), 64).unwrap();
            assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), (0..25).collect::<Vec<_>>(), "{scheme}");
            assert!(found.iter().all(|&(_, v)| v > 0.0 && v.is_finite()), "{scheme}");
        }
        // A pair of frames of variance 1 each, of a function shown to scale 1.
        assert!(
            variances(&Scheme::Pairs.steps(built(), 2).unwrap(), false, 1)
                .unwrap()
                .iter()
                .all(|f| (f.1 - 2.0).abs() < 1e-12)
        );
    }

    #[test]
    fn what_cannot_be_told_is_an_error() {
        let offset = Scheme::Offset.steps(built(), 2).unwrap();
        assert!(matches!(variances(&offset[1..], false, 1), Err(ReduceError::NoBlack)));
        let mixtures = Scheme::Isotropic.steps(built(), 4).unwrap();
        assert!(matches!(variances(&mixtures[..3], true, 64), Err(ReduceError::Undetermined { .. })));
        // Five mixtures at two azimuths are ten data for fifteen coefficients.
        assert!(matches!(variances(&mixtures, true, 2), Err(ReduceError::Undetermined { .. })));
    }
}
