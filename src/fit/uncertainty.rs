//! What noise and calibration leave uncertain about fitted parameters.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::family::Family;
use super::forward::fineness_of;
use super::likelihood::Likelihood;
use super::search::{Minimum, derivative};
use super::{Forward, Observations};
use crate::basis::OrderError;
use crate::calibrate::gray_card_coefficients;
use crate::geometry::Zone;
use crate::measure::{Budget, RunRecord};

/// How well the rig is known, as standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationUncertainty {
    /// Of each of the two edges of the zone in which lobes are really shown, degrees.
    pub edge_deg: f64,
    /// Of the scale of each channel, relative: the gray card's albedo and its measurement.
    pub scale_rel: f64,
}

impl Default for CalibrationUncertainty {
    /// A rig aligned to a few hundredths of a degree and a card known to two in a thousand.
    fn default() -> Self {
        Self { edge_deg: 0.05, scale_rel: 0.002 }
    }
}

impl CalibrationUncertainty {
    /// What the budget of a run says; the default for runs of older versions, which have none.
    pub fn of(record: &RunRecord) -> Self {
        let of = |budget: &Budget| Self { edge_deg: budget.assumed.edge_deg, scale_rel: budget.scale_rel() };
        record.budget.as_ref().map_or_else(Self::default, of)
    }
}

/// Changes of the data, in 1/sqrt(sr) by channel after channel, that one standard deviation of each calibration error
/// makes.
pub(super) struct CalibrationErrors(pub Vec<DVector<f64>>);

impl CalibrationErrors {
    /// For the data that `columns` with the coefficients `x` predict.
    ///
    /// A lobe shown in a zone whose edge lies elsewhere is the lobe of that zone; the gray card, measured alike, takes
    /// the change of z_00 out again. Scales differ by channel, edges do not.
    pub fn new(
        observations: &Observations,
        family: &dyn Family,
        minimum: &Minimum,
        likelihood: &Likelihood<'_>,
        known: &CalibrationUncertainty,
    ) -> Result<Self, OrderError> {
        let n = likelihood.lambert.len();
        let mut errors = Vec::new();
        for c in 0..3 {
            let prediction = likelihood.predict(&minimum.columns, &minimum.solution.x, c);
            let mut change = DVector::zeros(3 * n);
            (0..n).for_each(|i| change[c * n + i] = known.scale_rel * prediction[i]);
            errors.push(change);
        }
        for edge in 0..2 {
            let shifted = |sign: f64| -> Result<DVector<f64>, OrderError> {
                let zone = moved(&observations.grid.zone(), edge, sign * EDGE_STEP_DEG);
                let (forward, gray) = shifted_forward(observations, zone)?;
                let lambert = lambert_column(&forward);
                let columns = family.columns(&forward, &minimum.theta);
                let there = Likelihood {
                    forward: &forward,
                    lambert: &lambert,
                    z: likelihood.z.clone(),
                    weight: likelihood.weight.clone(),
                };
                let all = (0..3).flat_map(|c| there.predict(&columns, &minimum.solution.x, c));
                Ok(DVector::from_iterator(3 * n, all) * gray)
            };
            let slope = (shifted(1.0)? - shifted(-1.0)?) / (2.0 * EDGE_STEP_DEG);
            errors.push(slope * known.edge_deg);
        }
        Ok(Self(errors))
    }
}

const EDGE_STEP_DEG: f64 = 0.02;

fn moved(zone: &Zone, edge: usize, by_deg: f64) -> Zone {
    let mut limits = [zone.theta_min(), zone.theta_max()];
    limits[edge] = (limits[edge] + by_deg.to_radians()).max(0.0);
    Zone::new(limits[0], limits[1]).expect("a small shift of a valid zone")
}

/// Integrals over the zone really lit, and the factor by which the gray card's calibration scales them.
pub(super) fn shifted_forward(observations: &Observations, zone: Zone) -> Result<(Forward, f64), OrderError> {
    let forward = Forward::over(observations, zone, fineness_of(observations))?;
    let gray = |zone: Zone| gray_card_coefficients(zone, 0, 1.0)[0];
    Ok((forward, gray(observations.grid.zone()) / gray(zone)))
}

/// The Lambert part of albedo 1.
pub(super) fn lambert_column(forward: &Forward) -> Vec<f64> {
    let [column] = forward.project(|_| [std::f64::consts::FRAC_1_PI]);
    column
}

/// Covariance of a fit's parameters: shape parameters first, then linear ones, `[column][channel]`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Covariance {
    /// Which parameters are free: not pushed against zero or a bound.
    pub free: Vec<bool>,
    /// Covariance of all; rows of parameters that are not free are 0.
    pub matrix: DMatrix<f64>,
}

/// The covariance at a minimum: noise by Gauss-Newton, scaled by the misfit where the family does not explain the data,
/// plus what each calibration error would have shifted the parameters by.
pub(super) fn covariance(
    family: &dyn Family,
    minimum: &Minimum,
    likelihood: &Likelihood<'_>,
    errors: &CalibrationErrors,
) -> Covariance {
    let n = likelihood.lambert.len();
    let (shapes, columns) = (minimum.theta.len(), minimum.solution.x.len());
    let count = shapes + 3 * columns;
    let mut jacobian = DMatrix::zeros(3 * n, count);
    let mut free = vec![false; count];
    let slopes = family.slopes(likelihood.forward, &minimum.theta);
    for (j, (p, slopes)) in family.shape().iter().zip(&slopes).enumerate() {
        let theta = minimum.theta[j];
        jacobian.set_column(j, &(derivative(likelihood, slopes, &minimum.solution.x) / (theta - p.origin)));
        let inside = theta > p.range[0] * 1.001 && theta < p.range[1] * 0.999;
        free[j] = inside && jacobian.column(j).norm_squared() > 0.0;
    }
    for (k, x) in minimum.solution.x.iter().enumerate() {
        let column = if k == 0 { likelihood.lambert } else { &minimum.columns[k - 1] };
        for c in 0..3 {
            let j = shapes + 3 * k + c;
            free[j] = x[c] > 0.0;
            for i in 0..n {
                jacobian[(c * n + i, j)] = -likelihood.weight[c][i] * column[i];
            }
        }
    }
    let used: Vec<usize> = (0..count).filter(|&j| free[j]).collect();
    let thin = jacobian.select_columns(&used);
    let scale = DVector::from_iterator(used.len(), thin.column_iter().map(|c| 1.0 / c.norm()));
    let scaled = DMatrix::from_fn(thin.nrows(), thin.ncols(), |i, j| thin[(i, j)] * scale[j]);
    let mut matrix = DMatrix::zeros(count, count);
    let Some(inverse) = (scaled.transpose() * &scaled).cholesky().map(|c| c.inverse()) else {
        // Parameters that trade against each other exactly have no errors of their own.
        return Covariance { free: vec![false; count], matrix };
    };
    let freedom = likelihood.len().saturating_sub(used.len()).max(1);
    // Chi squared of noise alone scatters by sqrt(2 / freedom): only more than that is misfit.
    let reduced = minimum.solution.chi2 / freedom as f64;
    let misfit = if reduced > 1.0 + 2.0 * (2.0 / freedom as f64).sqrt() { reduced } else { 1.0 };
    let mut covariance = &inverse * misfit;
    for error in &errors.0 {
        let weighted = DVector::from_fn(3 * n, |i, _| likelihood.weight[i / n][i % n] * error[i]);
        let shift = &inverse * scaled.tr_mul(&weighted);
        covariance += &shift * shift.transpose();
    }
    for (p, &i) in used.iter().enumerate() {
        for (q, &j) in used.iter().enumerate() {
            matrix[(i, j)] = covariance[(p, q)] * scale[p] * scale[q];
        }
    }
    Covariance { free, matrix }
}

impl Covariance {
    /// Standard error of one parameter; None if it is not free.
    pub fn standard_error(&self, j: usize) -> Option<f64> {
        self.free[j].then(|| self.matrix[(j, j)].sqrt())
    }

    /// Correlation of two parameters; 0 unless both are free.
    pub fn correlation(&self, i: usize, j: usize) -> f64 {
        let norm = (self.matrix[(i, i)] * self.matrix[(j, j)]).sqrt();
        if norm > 0.0 { self.matrix[(i, j)] / norm } else { 0.0 }
    }
}
