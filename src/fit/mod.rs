//! Reflection models from measured coefficients, judged in the measured space.
//!
//! A model is asked what the rig would have measured: its f_cos is integrated against the very lobes that were shown, and
//! the differences to the measured coefficients, over their standard errors, are made small. The blur of the basis is then
//! part of the model, and sharp lobes survive low orders. Fits to the reconstruction exist as baselines only.
//!
//! Linear parameters (albedos, weights) are solved for, non-negative, at every step; only shape parameters are searched.

mod baselines;
mod dictionary;
mod family;
mod forward;
mod likelihood;
mod method;
mod observations;
mod report;
mod search;
mod select;
mod session;
mod uncertainty;

use std::time::Instant;

use thiserror::Error;

use crate::basis::OrderError;
use crate::reduce::Coefficients;
use crate::reflectance::Model;
use family::Family;
use search::Minimum;
use session::Session;
use uncertainty::{CalibrationErrors, covariance};

pub use crate::geometry::Fineness;
pub use forward::{Forward, Node};
pub use method::{FitMethod, UnknownMethod};
pub use observations::{ANISOTROPIC, Observations, Station};
pub use report::{FitReport, Plausibility, ResidualMap};
pub use search::Termination;
pub use select::{Candidate, PRICE, Selection};
pub use uncertainty::CalibrationUncertainty;

/// Why there is no fit.
#[derive(Debug, Error)]
pub enum FitError {
    /// The order is out of range.
    #[error(transparent)]
    Order(#[from] OrderError),
    /// No exitant direction has finite coefficients and standard errors.
    #[error("the coefficients hold no exitant direction with data: reduce the run again, with a finer exitant grid")]
    NoData,
    /// The sample is black.
    #[error("z_00 is not positive in any direction: was there a sample, and light?")]
    Black,
    /// A start does not name every shape parameter.
    #[error("`{model}` has {expected} shape parameters, {got} were given to start from")]
    Start {
        /// The family.
        model: FitMethod,
        /// Shape parameters it has.
        expected: usize,
        /// Values given.
        got: usize,
    },
}

/// What a fit is told beyond the data.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FitOptions {
    /// How well the rig is known.
    pub calibration: CalibrationUncertainty,
    /// Shape parameters to start from, instead of the family's own starts; `ggx`, `ggx2` and `abc` only.
    pub start: Option<Vec<f64>>,
}

/// One family fitted.
pub(crate) struct Fitted {
    method: FitMethod,
    family: Box<dyn Family>,
    minimum: Minimum,
    model: Model,
}

/// Fits a model to the coefficients of a run.
///
/// # Errors
/// [`FitError`]. A search that did not converge is no error: its report says so.
pub fn fit(coefficients: &Coefficients, method: FitMethod, options: &FitOptions) -> Result<FitReport, FitError> {
    let started = Instant::now();
    let observations = fittable(coefficients)?;
    let session = Session::new(&observations)?;
    let likelihood = session.likelihood();
    let (fitted, selection) = match method {
        FitMethod::Auto => {
            let ladder = session.auto(&likelihood)?;
            (ladder.chosen, Some(ladder.selection))
        }
        other => (session.fit_one(&likelihood, other, options.start.as_deref())?, None),
    };
    let errors = CalibrationErrors::new(
        &observations,
        fitted.family.as_ref(),
        &fitted.minimum,
        &likelihood,
        &options.calibration,
    )?;
    let covariance = covariance(fitted.family.as_ref(), &fitted.minimum, &likelihood, &errors);
    let predictions = [0, 1, 2].map(|c| likelihood.predict(&fitted.minimum.columns, &fitted.minimum.solution.x, c));
    Ok(FitReport::new(report::Parts {
        fitted: &fitted,
        requested: method,
        covariance: &covariance,
        observations: &observations,
        predictions,
        data: likelihood.len(),
        calibration: options.calibration,
        selection,
        fit_s: started.elapsed().as_secs_f64(),
        history: coefficients.history.clone(),
    }))
}

/// The model that [`FitMethod::Auto`] takes, and what else the data would have borne.
#[derive(Debug, Clone, PartialEq)]
pub struct Alternatives {
    /// The model chosen.
    pub model: Model,
    /// Its family.
    pub family: FitMethod,
    /// Why.
    pub selection: Selection,
    /// Other families fitted to the same data, from simple to rich, without Lambert.
    pub families: Vec<(FitMethod, Model)>,
    /// The chosen family fitted to what is left when every so many rings one is taken away, each share in turn.
    pub parts: Vec<Model>,
}

/// Fits all families, and the chosen one again without each of `parts` shares of the rings.
///
/// # Errors
/// [`FitError`].
pub fn alternatives(coefficients: &Coefficients, parts: usize) -> Result<Alternatives, FitError> {
    let observations = fittable(coefficients)?;
    let session = Session::new(&observations)?;
    let likelihood = session.likelihood();
    let ladder = session.auto(&likelihood)?;
    let parts = session.without_rings(&ladder.chosen, &likelihood, parts);
    let others = ladder.others.into_iter().filter(|other| other.method != FitMethod::Lambert);
    Ok(Alternatives {
        model: ladder.chosen.model,
        family: ladder.chosen.method,
        selection: ladder.selection,
        families: others.map(|other| (other.method, other.model)).collect(),
        parts,
    })
}

fn fittable(coefficients: &Coefficients) -> Result<Observations, FitError> {
    let observations = Observations::of(coefficients);
    if observations.is_empty() {
        return Err(FitError::NoData);
    }
    if observations.dc() <= 0.0 {
        return Err(FitError::Black);
    }
    Ok(observations)
}
