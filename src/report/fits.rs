//! All fits of a run, side by side.

use super::ReportError;
use crate::fit::{CalibrationUncertainty, FitMethod, FitOptions, FitReport, Selection, fit};
use crate::reduce::Coefficients;
use crate::reflectance::{Brdf, Metric, MetricErrors};

/// The fit of one method.
#[derive(Debug, Clone, PartialEq)]
pub struct MethodFit {
    /// What it found; `requested` is the method, `model` the family.
    pub report: FitReport,
    /// How far it is from the truth; None where that is not known, or the model is infinite somewhere.
    pub errors: Option<MetricErrors>,
}

/// Every method of [`FitMethod::ALL`] fitted to one run, and the one that was asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct Fits {
    /// In the order of [`FitMethod::ALL`].
    pub all: Vec<MethodFit>,
    /// The method asked for.
    pub requested: FitMethod,
}

impl Fits {
    /// Fits all methods to a run and compares them with the truth, where it is known.
    ///
    /// # Errors
    /// [`ReportError::Metric`] if the truth cannot be one, found out before anything is fitted; [`ReportError::Fit`].
    pub fn new(
        coefficients: &Coefficients,
        requested: FitMethod,
        truth: Option<&dyn Brdf>,
        calibration: CalibrationUncertainty,
    ) -> Result<Self, ReportError> {
        let metric = Metric::new(coefficients.grid.zone());
        let reference = truth.map(|truth| metric.reference(truth)).transpose()?;
        let one = |method: FitMethod| -> Result<MethodFit, ReportError> {
            let report = fit(coefficients, method, &FitOptions { calibration, start: None })?;
            let errors = reference.as_ref().and_then(|reference| reference.errors(&report.brdf).ok());
            Ok(MethodFit { report, errors })
        };
        Ok(Self { all: FitMethod::ALL.into_iter().map(one).collect::<Result<_, _>>()?, requested })
    }

    /// The fit of a method.
    ///
    /// # Panics
    /// If `all` does not hold it: [`Fits::new`] fits all methods.
    pub fn of(&self, method: FitMethod) -> &MethodFit {
        self.all.iter().find(|f| f.report.requested == method).expect("all methods are fitted")
    }

    /// The fit that was asked for.
    pub fn chosen(&self) -> &FitReport {
        &self.of(self.requested).report
    }

    /// The chosen model and the thesis's, by the names that curves of them have.
    pub fn curves(&self) -> Vec<(String, &dyn Brdf)> {
        let thesis = &self.of(FitMethod::Thesis).report;
        let chosen = self.chosen();
        let mut curves: Vec<(String, &dyn Brdf)> = vec![(format!("fit, {}", chosen.model), &chosen.brdf)];
        if chosen.model != FitMethod::Thesis {
            curves.push(("fit, thesis".into(), &thesis.brdf));
        }
        curves
    }

    /// How `auto` compared the families.
    pub fn selection(&self) -> Option<&Selection> {
        self.of(FitMethod::Auto).report.selection.as_ref()
    }
}
