//! The report of a measurement: one self-contained HTML page.
//!
//! [`RunReport`] is of any run and the models fitted to it, [`DemoReport`] of the demonstration, whose rig is at hand too.
//! What they show is computed in `measured` and `fits`; the rest is drawing.
//!
//! The page needs no script and no other file: images are base64 PNG, charts inline SVG. It is laid out for a phone of
//! 360 px as well as a desk, follows the reader's light or dark scheme, and tells series apart by colour (Okabe and Ito's
//! palette), dash and mark together.

mod axis;
mod chart;
mod control;
mod demo_page;
mod design_page;
mod drawing;
mod figures;
mod fit_sections;
mod fits;
mod front;
mod heat;
mod html;
mod label;
mod measured;
mod optics_chart;
mod paint;
mod pareto;
mod pareto_panels;
mod pareto_runs;
mod png;
mod polar;
mod run_page;
mod sheet;
mod stability;
mod text;

use thiserror::Error;

pub use axis::{Axis, Scale};
pub use chart::{Chart, Mark, Series};
pub use control::ControlReport;
pub use design_page::DesignReport;
pub use fits::{Fits, MethodFit};
pub use front::{front_csv, front_sheet};
pub use measured::{accuracy, conversions, converted, pictures, slices, spectrum};
pub use optics_chart::{HeightRow, OpticsReport, ProfileRow};
pub use pareto::{ComputePoint, ParetoReport, PlanPoint, SeedPoint, Stage};
pub use pareto_runs::{ParetoError, ParetoRuns, ParetoScan, pareto_plans};
pub use png::{pattern_png, plane_png};
pub use sheet::Sheet;
pub use stability::StabilityReport;

use crate::basis::{ConversionError, OrderError};
use crate::calibrate::GrayCardCheck;
use crate::fit::{CalibrationUncertainty, FitError, FitMethod};
use crate::measure::RunRecord;
use crate::reduce::Coefficients;
use crate::reflectance::{Brdf, MetricError};
use crate::render::Shape;

/// Why there is no report.
#[derive(Debug, Error)]
pub enum ReportError {
    /// No model could be fitted to the run.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// The truth given is none.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// The run could not be converted to spherical harmonics.
    #[error(transparent)]
    Conversion(#[from] ConversionError),
    /// The run's order is out of range.
    #[error(transparent)]
    Order(#[from] OrderError),
}

/// An image with its caption, which is its alternative text too.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// What it shows.
    pub caption: String,
    /// The PNG file.
    pub png: Vec<u8>,
}

/// The size of one zonal coefficient, 1/sqrt(sr).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpectrumPoint {
    /// Index k = l(l+1) + m.
    pub k: usize,
    /// RMS of z_k over exitant directions.
    pub rms: f64,
    /// RMS of its standard error.
    pub noise: f64,
    /// RMS of what a model predicts for it.
    pub predicted: f64,
}

/// f_cos in the plane of incidence of one exitant direction.
///
/// Curves are (theta_i in degrees, f_cos in 1/sr) with theta_i from -90 to 90: positive away from the camera, so that a
/// mirror peaks at theta_i = theta_o; the camera is at theta_i = -theta_o.
#[derive(Debug, Clone, PartialEq)]
pub struct Slice {
    /// Polar angle of the camera, degrees.
    pub theta_o_deg: f64,
    /// The truth, where it is known.
    pub truth: Option<Vec<(f64, f64)>>,
    /// Reconstructions by name.
    pub methods: Vec<(String, Vec<(f64, f64)>)>,
    /// Limits of the measured zone, degrees.
    pub zone_deg: [f64; 2],
}

/// What one zonal order costs and gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AccuracyPoint {
    /// Zonal order.
    pub order: usize,
    /// Predicted time on the physical rig, s.
    pub rig_s: f64,
    /// Relative error inside the zone.
    pub error_in: f64,
    /// Relative error outside the zone.
    pub error_out: f64,
}

/// One method of conversion to spherical harmonics and how it did.
#[derive(Debug, Clone, PartialEq)]
pub struct MethodRow {
    /// Its name.
    pub method: String,
    /// Zonal order.
    pub order: usize,
    /// Condition number of the worst block.
    pub condition: f64,
    /// Noise gain inside the zone.
    pub noise_gain_in: f64,
    /// Noise gain outside the zone.
    pub noise_gain_out: f64,
    /// Relative error inside the zone, where the truth is known.
    pub error_in: Option<f64>,
    /// Relative error outside the zone, where the truth is known.
    pub error_out: Option<f64>,
    /// Why the method was refused, if it was.
    pub refused: Option<String>,
}

/// All that the page of a demonstration shows. Texts are plain: the page escapes them.
#[derive(Debug, Clone, PartialEq)]
pub struct DemoReport {
    /// Heading of the page.
    pub title: String,
    /// Name of the material.
    pub material: String,
    /// The run's record: rig, plan, times, noise.
    pub record: RunRecord,
    /// How the rig did on the gray card.
    pub gray_card: GrayCardCheck,
    /// Some of the patterns shown.
    pub patterns: Vec<Picture>,
    /// A response of the camera.
    pub response: Picture,
    /// Every coefficient measured.
    pub spectrum: Vec<SpectrumPoint>,
    /// Slices in the plane of incidence.
    pub slices: Vec<Slice>,
    /// Rendered spheres: the measurement against the truth.
    pub spheres: Vec<Picture>,
    /// Error against time, one point for each order.
    pub accuracy: Vec<AccuracyPoint>,
    /// Plans on the plane of rig time against the error of a fit.
    pub pareto: Option<ParetoReport>,
    /// All methods of conversion tried.
    pub methods: Vec<MethodRow>,
    /// All models fitted.
    pub fits: Fits,
    /// Where the numbers come from: names and values.
    pub provenance: Vec<(String, String)>,
}

impl DemoReport {
    /// The page.
    pub fn to_html(&self) -> String {
        demo_page::page(self)
    }
}

/// All that the page of a run shows. Texts are plain: the page escapes them.
#[derive(Debug, Clone, PartialEq)]
pub struct RunReport {
    /// The run's record: sample, rig, plan, times, noise.
    pub record: RunRecord,
    /// What the models are compared with, where it is known.
    pub truth: Option<String>,
    /// All models fitted.
    pub fits: Fits,
    /// Every coefficient measured, and what the chosen model predicts.
    pub spectrum: Vec<SpectrumPoint>,
    /// Slices in the plane of incidence.
    pub slices: Vec<Slice>,
    /// The chosen model on a sphere and a cylinder.
    pub pictures: Vec<Picture>,
}

impl RunReport {
    /// Fits all methods to a run and computes what the page shows; `truth` is a name and a material.
    ///
    /// # Errors
    /// [`ReportError`].
    pub fn new(
        record: RunRecord,
        coefficients: &Coefficients,
        requested: FitMethod,
        truth: Option<(&str, &dyn Brdf)>,
    ) -> Result<Self, ReportError> {
        let (name, truth) = truth.unzip();
        let fits = Fits::new(coefficients, requested, truth, CalibrationUncertainty::of(&record))?;
        let model = &fits.chosen().brdf;
        let spectrum = spectrum(coefficients, model)?;
        let slices = slices(coefficients, truth, &fits.curves())?;
        let pictures = pictures(&[Shape::Sphere, Shape::Cylinder], "fit", model, truth);
        Ok(Self { record, truth: name.map(str::to_owned), fits, spectrum, slices, pictures })
    }

    /// The page.
    pub fn to_html(&self) -> String {
        run_page::page(self)
    }
}

#[cfg(test)]
mod tests;
