//! Separable least squares: linear parameters are solved for, only shape parameters are searched.

use std::f64::consts::FRAC_PI_2;

use argmin::core::{CostFunction, Executor, State};
use argmin::solver::neldermead::NelderMead;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt, TerminationReason};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn, U1};
use serde::{Deserialize, Serialize};

use super::Forward;
use super::family::{Family, ShapeParameter};
use super::likelihood::{Likelihood, Solution};
use crate::reflectance::Model;

/// Why a fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Termination {
    /// No step lowers the error any more, or the gradient vanishes.
    Converged,
    /// The problem has a closed solution: nothing was searched.
    Direct,
    /// The number of evaluations ran out.
    LostPatience,
    /// A residual was not finite.
    Numerical,
}

impl Termination {
    /// Whether the parameters are a minimum as far as can be told.
    pub fn was_successful(self) -> bool {
        matches!(self, Self::Converged | Self::Direct)
    }
}

/// Where a search ended.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Minimum {
    pub theta: Vec<f64>,
    pub columns: Vec<Vec<f64>>,
    pub solution: Solution,
    pub evaluations: usize,
    pub termination: Termination,
}

/// Searches from the best of the family's own starts.
pub(super) fn search(family: &dyn Family, likelihood: &Likelihood<'_>) -> Minimum {
    let starts = family.starts();
    let tried = starts.len();
    let costs = starts.into_iter().map(|theta| {
        let chi2 = likelihood.solve(&family.columns(likelihood.forward, &theta)).chi2;
        (theta, chi2)
    });
    let best = costs.min_by(|a, b| a.1.total_cmp(&b.1)).expect("a family has starts");
    let mut minimum = search_from(family, likelihood, &best.0);
    minimum.evaluations += tried;
    for start in family.rivals(&minimum.theta) {
        let rival = polish(family, likelihood, &start);
        let evaluations = minimum.evaluations + rival.evaluations;
        let explained = minimum.solution.chi2 - rival.solution.chi2;
        if explained > SIGNIFICANT * (minimum.solution.chi2 / likelihood.len().max(1) as f64).max(1.0) {
            minimum = rival;
        }
        minimum.evaluations = evaluations;
    }
    minimum
}

/// Searches from one start: a simplex finds the valley, Levenberg-Marquardt its floor.
pub(super) fn search_from(family: &dyn Family, likelihood: &Likelihood<'_>, start: &[f64]) -> Minimum {
    let scale = Scale(family.shape());
    if scale.0.is_empty() {
        let columns = family.columns(likelihood.forward, &[]);
        let solution = likelihood.solve(&columns);
        return Minimum { theta: Vec::new(), columns, solution, evaluations: 1, termination: Termination::Direct };
    }
    let (valley, evaluations) = simplex(family, likelihood, &scale, &scale.inward(start));
    let mut minimum = polish(family, likelihood, &scale.outward(&valley));
    minimum.evaluations += evaluations;
    minimum
}

/// Levenberg-Marquardt alone, for a start that lies in the right valley.
pub(super) fn polish(family: &dyn Family, likelihood: &Likelihood<'_>, start: &[f64]) -> Minimum {
    let scale = Scale(family.shape());
    if scale.0.is_empty() {
        return search_from(family, likelihood, start);
    }
    let mut problem = Problem { family, likelihood, inner: DVector::from_vec(scale.inward(start)), scale, state: None };
    problem.update();
    let solver = LevenbergMarquardt::new().with_patience(PATIENCE).with_ftol(CHI2_TOLERANCE).with_xtol(STEP_TOLERANCE);
    let (problem, report) = solver.minimize(problem);
    let termination = match report.termination {
        TerminationReason::Converged { .. }
        | TerminationReason::Orthogonal
        | TerminationReason::ResidualsZero
        | TerminationReason::NoImprovementPossible(_) => Termination::Converged,
        TerminationReason::LostPatience => Termination::LostPatience,
        _ => Termination::Numerical,
    };
    let theta = family.ordered(&problem.scale.outward(problem.inner.as_slice()));
    let columns = family.columns(likelihood.forward, &theta);
    let solution = likelihood.solve(&columns);
    Minimum { theta, columns, solution, evaluations: report.number_of_evaluations, termination }
}

/// Chi squared by which a rival must be better, in units of what is left for each datum: three standard errors. What noise decides
/// would change the model from one run to the next.
const SIGNIFICANT: f64 = 9.0;
/// A relative change of chi squared below this ends the search: noise moves it by far more.
const CHI2_TOLERANCE: f64 = 1e-7;
/// The same of the search variables, which standard errors of the best data do not reach.
const STEP_TOLERANCE: f64 = 1e-6;
/// Evaluations of Levenberg-Marquardt for each shape parameter, and once more.
const PATIENCE: usize = 30;
/// Evaluations of the simplex for each shape parameter.
const SIMPLEX_PATIENCE: u64 = 16;

/// Maps shape parameters to search variables and back: logarithms, bounded by a sine as in MINUIT.
struct Scale(Vec<ShapeParameter>);

impl Scale {
    fn inward(&self, theta: &[f64]) -> Vec<f64> {
        let one = |p: &ShapeParameter, t: f64| {
            let [lo, hi] = p.range.map(|r| (r - p.origin).ln());
            let share = ((t - p.origin).max(f64::MIN_POSITIVE).ln() - lo) / (hi - lo);
            // On a bound the sine is flat and nothing would move.
            (2.0 * share.clamp(1e-3, 1.0 - 1e-3) - 1.0).asin()
        };
        self.0.iter().zip(theta).map(|(p, &t)| one(p, t)).collect()
    }

    fn outward(&self, inner: &[f64]) -> Vec<f64> {
        let one = |p: &ShapeParameter, v: f64| {
            let [lo, hi] = p.range.map(|r| (r - p.origin).ln());
            p.origin + (lo + (hi - lo) * 0.5 * (v.sin() + 1.0)).exp()
        };
        self.0.iter().zip(inner).map(|(p, &v)| one(p, v)).collect()
    }

    /// Derivatives of the logarithms of the shape parameters above their origins by the search variables.
    fn slopes(&self, inner: &[f64]) -> Vec<f64> {
        let one = |p: &ShapeParameter, v: f64| {
            let [lo, hi] = p.range.map(|r| (r - p.origin).ln());
            (hi - lo) * 0.5 * v.cos()
        };
        self.0.iter().zip(inner).map(|(p, &v)| one(p, v)).collect()
    }
}

struct Cost<'a> {
    family: &'a dyn Family,
    likelihood: &'a Likelihood<'a>,
    scale: &'a Scale,
}

impl CostFunction for Cost<'_> {
    type Param = DVector<f64>;
    type Output = f64;

    fn cost(&self, inner: &DVector<f64>) -> Result<f64, argmin::core::Error> {
        let columns = self.family.columns(self.likelihood.forward, &self.scale.outward(inner.as_slice()));
        Ok(self.likelihood.solve(&columns).chi2.max(f64::MIN_POSITIVE).ln())
    }
}

/// Nelder-Mead from a simplex that spans a tenth of the range.
fn simplex(family: &dyn Family, likelihood: &Likelihood<'_>, scale: &Scale, start: &[f64]) -> (Vec<f64>, usize) {
    let start = DVector::from_column_slice(start);
    let mut corners = vec![start.clone()];
    for j in 0..start.len() {
        let mut corner = start.clone();
        // Towards the middle of the range, where there is room.
        corner[j] -= 0.1 * FRAC_PI_2 * corner[j].signum();
        corners.push(corner);
    }
    let solver = NelderMead::new(corners).with_sd_tolerance(1e-4).expect("a positive tolerance");
    let patience = SIMPLEX_PATIENCE * start.len() as u64;
    let run = Executor::new(Cost { family, likelihood, scale }, solver)
        .configure(|state| state.max_iters(patience))
        .timer(false)
        .ctrlc(false)
        .run();
    match run {
        Ok(result) => {
            let evaluations = result.problem().counts.values().sum::<u64>() as usize;
            let best = result.state().get_best_param().unwrap_or(&start);
            (best.as_slice().to_vec(), evaluations)
        }
        Err(_) => (start.as_slice().to_vec(), 0),
    }
}

/// The least-squares problem in the search variables; linear parameters follow (Golub & Pereyra 1973, with the Jacobian
/// of Kaufman 1975).
struct Problem<'a> {
    family: &'a dyn Family,
    likelihood: &'a Likelihood<'a>,
    scale: Scale,
    inner: DVector<f64>,
    state: Option<(Vec<Vec<f64>>, Solution)>,
}

impl Problem<'_> {
    fn update(&mut self) {
        let columns = self.family.columns(self.likelihood.forward, &self.scale.outward(self.inner.as_slice()));
        let solution = self.likelihood.solve(&columns);
        self.state = Some((columns, solution));
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
    type ResidualStorage = Owned<f64, Dyn, U1>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn, U1>;

    fn set_params(&mut self, inner: &DVector<f64>) {
        self.inner.copy_from(inner);
        self.update();
    }

    fn params(&self) -> DVector<f64> {
        self.inner.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let (columns, solution) = self.state.as_ref()?;
        Some(self.likelihood.residuals(columns, &solution.x))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let (columns, solution) = self.state.as_ref()?;
        let n = self.likelihood.lambert.len();
        let mut jacobian = DMatrix::zeros(3 * n, self.inner.len());
        let theta = self.scale.outward(self.inner.as_slice());
        let slopes = self.family.slopes(self.likelihood.forward, &theta);
        for (j, (slopes, by_inner)) in slopes.iter().zip(self.scale.slopes(self.inner.as_slice())).enumerate() {
            jacobian.set_column(j, &(derivative(self.likelihood, slopes, &solution.x) * by_inner));
        }
        self.likelihood.project_out(columns, &solution.x, &mut jacobian);
        Some(jacobian)
    }
}

/// A family near a minimum, its columns linear in the logarithms of the shape parameters: to refit parts of the data,
/// which hardly moves them, without integrating anew.
pub(super) struct Linearised<'a> {
    family: &'a dyn Family,
    theta: &'a [f64],
    columns: &'a [Vec<f64>],
    /// By shape parameter and column.
    slopes: Vec<Vec<Vec<f64>>>,
}

impl<'a> Linearised<'a> {
    pub fn new(family: &'a dyn Family, forward: &Forward, minimum: &'a Minimum) -> Self {
        let slopes = family.slopes(forward, &minimum.theta);
        Self { family, theta: &minimum.theta, columns: &minimum.columns, slopes }
    }
}

impl Family for Linearised<'_> {
    fn shape(&self) -> Vec<ShapeParameter> {
        self.family.shape()
    }

    fn linear(&self) -> Vec<String> {
        self.family.linear()
    }

    fn columns(&self, _forward: &Forward, theta: &[f64]) -> Vec<Vec<f64>> {
        let mut columns = self.columns.to_vec();
        for (j, p) in self.shape().iter().enumerate() {
            let step = ((theta[j] - p.origin) / (self.theta[j] - p.origin)).ln();
            for (column, slope) in columns.iter_mut().zip(&self.slopes[j]) {
                column.iter_mut().zip(slope).for_each(|(a, s)| *a += step * s);
            }
        }
        columns
    }

    fn model(&self, theta: &[f64], x: &[[f64; 3]]) -> Model {
        self.family.model(theta, x)
    }

    fn starts(&self) -> Vec<Vec<f64>> {
        vec![self.theta.to_vec()]
    }
}

/// d residual / d parameter where the columns change by `slopes`, linear parameters held.
pub(super) fn derivative(likelihood: &Likelihood<'_>, slopes: &[Vec<f64>], x: &[[f64; 3]]) -> DVector<f64> {
    let n = likelihood.lambert.len();
    let mut change = DVector::zeros(3 * n);
    for c in 0..3 {
        for (slope, x) in slopes.iter().zip(&x[1..]).filter(|(_, x)| x[c] != 0.0) {
            for i in 0..n {
                change[c * n + i] -= likelihood.weight[c][i] * x[c] * slope[i];
            }
        }
    }
    change
}
