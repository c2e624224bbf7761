//! A small nonlinear least-squares problem with numerical derivatives, and what its solution is worth.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn, U1};
use rayon::prelude::*;

/// Step of the numerical derivative, in units of the parameters.
const STEP: f64 = 1e-3;

/// Where residuals are least.
#[derive(Debug, Clone)]
pub(super) struct Minimum {
    /// The parameters.
    pub x: DVector<f64>,
    /// Their covariance if every residual has the variance 1.
    pub covariance: DMatrix<f64>,
    /// The residuals there.
    pub residuals: DVector<f64>,
}

/// Least squares from `start`; parameters should be of order 1, residuals in units of their standard errors.
///
/// `None` if the search fails or a combination of parameters changes no residual.
pub(super) fn minimise(start: Vec<f64>, residuals: &(dyn Fn(&[f64]) -> Vec<f64> + Sync)) -> Option<Minimum> {
    let problem = Problem { x: DVector::from_vec(start), residuals };
    let (problem, report) = LevenbergMarquardt::new().with_patience(30).minimize(problem);
    if !report.objective_function.is_finite() {
        return None;
    }
    let jacobian = problem.jacobian()?;
    let covariance = (jacobian.transpose() * &jacobian).cholesky()?.inverse();
    Some(Minimum { covariance, residuals: problem.residuals()?, x: problem.x })
}

struct Problem<'a> {
    x: DVector<f64>,
    residuals: &'a (dyn Fn(&[f64]) -> Vec<f64> + Sync),
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
    type ResidualStorage = Owned<f64, Dyn, U1>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn, U1>;

    fn set_params(&mut self, x: &DVector<f64>) {
        self.x.copy_from(x);
    }

    fn params(&self) -> DVector<f64> {
        self.x.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let r = (self.residuals)(self.x.as_slice());
        r.iter().all(|x| x.is_finite()).then(|| DVector::from_vec(r))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let columns: Vec<DVector<f64>> = (0..self.x.len())
            .into_par_iter()
            .map(|j| {
                let at = |step: f64| {
                    let mut x = self.x.as_slice().to_vec();
                    x[j] += step;
                    DVector::from_vec((self.residuals)(&x))
                };
                (at(STEP) - at(-STEP)) / (2.0 * STEP)
            })
            .collect();
        Some(DMatrix::from_columns(&columns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_is_found_with_its_covariance() {
        // y = a + b x at x = 0..9, unit variance: the textbook's covariance.
        let data: Vec<(f64, f64)> = (0..10).map(|i| (f64::from(i), 2.0 - 0.5 * f64::from(i))).collect();
        let residuals = |p: &[f64]| data.iter().map(|(x, y)| p[0] + p[1] * x - y).collect();
        let found = minimise(vec![0.0, 0.0], &residuals).unwrap();
        assert!((found.x[0] - 2.0).abs() < 1e-9 && (found.x[1] + 0.5).abs() < 1e-9);
        assert!((found.covariance[(1, 1)] - 1.0 / 82.5).abs() < 1e-6);
        assert!(minimise(vec![0.0, 0.0], &|p: &[f64]| vec![p[0] + p[1]; 3]).is_none(), "only a sum is determined");
    }
}
