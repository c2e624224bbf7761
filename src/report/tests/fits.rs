//! Pages of fitted runs, from coefficients that a known material would give.

use std::sync::LazyLock;

use super::{HOSTILE, check_markup, record};
use crate::basis::{index, lm, size};
use crate::fit::{Fineness, FitMethod, Forward, Observations, ResidualMap};
use crate::geometry::{ExitantGrid, Zone};
use crate::reduce::Coefficients;
use crate::reflectance::{Brdf, Ggx, MetricError};
use crate::report::figures::fits_chart;
use crate::report::heat::heat_svg;
use crate::report::{Fits, ReportError, RunReport, spectrum};

/// Coefficients of order 2 that an isotropic material gives without noise; their standard error is 0.1% of z_00 or so.
pub fn measured(brdf: &dyn Brdf) -> Coefficients {
    let (order, grid) = (2, ExitantGrid::new(Zone::from_degrees(9.0, 57.0).unwrap(), 6, 8));
    let n = size(order) * 3 * grid.len();
    let mut coefficients =
        Coefficients { grid, order, values: vec![0.0; n], sigma: vec![1e-4; n], history: "made up".into() };
    let observations = Observations::folded(&coefficients);
    let predicted = Forward::new(&observations, Fineness::default()).unwrap().predict(brdf);
    let terms = observations.terms.len();
    for (channel, predicted) in predicted.iter().enumerate() {
        for (i, &z) in predicted.iter().enumerate() {
            let (ring, (l, m)) = (observations.stations[i / terms].ring, lm(observations.terms[i % terms]));
            for sector in 0..grid.sectors() {
                let (sin, cos) = (f64::from(m) * grid.phi(sector)).sin_cos();
                let mut set = |m: i32, z: f64| {
                    let cell = ring * grid.sectors() + sector;
                    coefficients.values[(index(l, m) * 3 + channel) * grid.len() + cell] = z as f32;
                };
                set(-m, sin * z);
                set(m, cos * z);
            }
        }
    }
    coefficients
}

fn material() -> Ggx {
    Ggx::isotropic(0.3, [0.5; 3]).on_lambert(0.8, [0.3, 0.2, 0.1])
}

/// All methods fitted to [`material`], once for all tests.
pub static FITS: LazyLock<Fits> = LazyLock::new(|| {
    Fits::new(&measured(&material()), FitMethod::Auto, Some(&material()), Default::default()).unwrap()
});

/// Coefficients are stored as f32.
const SINGLE: f64 = 1e-5;

#[test]
fn the_chosen_model_is_the_material() {
    let fits = &*FITS;
    assert_eq!(fits.all.len(), FitMethod::ALL.len());
    assert_eq!(fits.chosen().model, FitMethod::Ggx, "{:?}", fits.selection());
    // The data hold no noise: this is where the search stops.
    const FOUND: f64 = 1e-3;
    assert!(fits.of(FitMethod::Auto).errors.unwrap().mean.rel_in < FOUND);
    assert!(fits.of(FitMethod::Thesis).errors.unwrap().mean.rel_in > 0.1);
    let names: Vec<String> = fits.curves().into_iter().map(|c| c.0).collect();
    assert_eq!(names, ["fit, ggx", "fit, thesis"]);
}

#[test]
fn a_material_predicts_its_own_spectrum() {
    let points = spectrum(&measured(&material()), &material()).unwrap();
    assert_eq!(points.iter().map(|p| lm(p.k)).collect::<Vec<_>>(), [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)]);
    for p in &points {
        assert!((p.predicted - p.rms).abs() < SINGLE * points[0].rms, "{p:?}");
        // Eight sectors say the same, and sectors share m > 0 with their sine terms.
        assert!(p.noise < 1e-4 && p.noise > 1e-5, "{p:?}");
    }
}

#[test]
fn the_chart_shows_every_method_by_time_and_error() {
    let chart = fits_chart(&FITS);
    check_markup(&chart.to_svg());
    let labels: Vec<&str> = chart.series.iter().flat_map(|s| s.labels.iter().map(String::as_str)).collect();
    assert_eq!(labels.len(), FitMethod::ALL.len());
    assert!(chart.y.label.starts_with("error"), "{}", chart.y.label);
    assert!(chart.series.iter().flat_map(|s| &s.points).all(|p| p.0 > 0.0 && p.1 > 0.0));
    let mut blind = FITS.clone();
    blind.all.iter_mut().for_each(|f| f.errors = None);
    assert!(fits_chart(&blind).y.label.starts_with("misfit"));
}

#[test]
fn residuals_are_shaded_to_a_round_number() {
    let map = |by: Vec<Vec<f64>>| ResidualMap {
        theta_o_deg: (0..by.len()).map(|i| 10.0 + i as f64).collect(),
        by_ring_and_degree: by,
    };
    let svg = heat_svg(&map(vec![vec![0.0, 0.013], vec![0.02, f64::NAN]]));
    check_markup(&svg);
    assert!(svg.contains("largest 2.0 %") && svg.contains("fill-opacity=\"0.650\""), "{svg}");
    for odd in [vec![], vec![vec![]], vec![vec![0.0]], vec![vec![f64::INFINITY, 1.0]; 30]] {
        let svg = heat_svg(&map(odd));
        check_markup(&svg);
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }
}

fn run_report() -> RunReport {
    let coefficients = measured(&material());
    RunReport::new(record("paint"), &coefficients, FitMethod::Auto, Some(("a paint", &material()))).unwrap()
}

#[test]
fn the_page_of_a_run_holds_all_sections() {
    let report = run_report();
    let page = report.to_html();
    check_markup(&page);
    for outside in ["http:", "https:", "<script", "url(", "@import", "href"] {
        assert!(!page.contains(outside), "{outside}");
    }
    for words in [
        "paint measured by",
        "off a paint inside",
        "The fit, against the truth",
        "Cylinder in a studio light probe",
        "Fitted model: ggx, chosen by auto",
        "Why auto chooses ggx",
        "Methods of fitting",
        "Albedo 70°",
        "Slices in the plane of incidence",
        "predicted by the model",
        "Where the model misses",
        "Reciprocity: exact",
        "Provenance",
        "edges of the zone known to",
    ] {
        assert!(page.contains(words), "{words}");
    }
    assert!(!page.contains("class=\"warnings\""));
    assert_eq!(page.matches("<img ").count(), 4);
}

#[test]
fn warnings_come_first_and_text_is_escaped() {
    let mut report = run_report();
    report.truth = Some(HOSTILE.into());
    report.record = record(HOSTILE);
    for f in &mut report.fits.all {
        f.report.warnings = vec![format!("families fail, {HOSTILE}")];
        f.report.history = HOSTILE.into();
    }
    let page = report.to_html();
    check_markup(&page);
    assert!(!page.contains("<script") && !page.contains("\" onload") && !page.contains('\u{1}'));
    let at = |words: &str| page.find(words).unwrap();
    assert!(at("Families fail") < at("<h2>"));
}

#[test]
fn a_page_without_truth_says_so() {
    let mut report = run_report();
    report.truth = None;
    report.fits.all.iter_mut().for_each(|f| f.errors = None);
    report.slices.iter_mut().for_each(|s| s.truth = None);
    let page = report.to_html();
    check_markup(&page);
    assert!(page.contains("--truth") && !page.contains("Error in zone"));
}

/// Negative towards grazing light.
struct Ringing;

impl Brdf for Ringing {
    fn eval(&self, wi: &crate::geometry::Direction, _wo: &crate::geometry::Direction) -> [f64; 3] {
        [0.1 - f64::from(u8::from(wi.theta() > 1.2)); 3]
    }

    fn is_isotropic(&self) -> bool {
        true
    }
}

#[test]
fn a_truth_that_is_none_is_refused() {
    let refused = Fits::new(&measured(&material()), FitMethod::Auto, Some(&Ringing), Default::default()).unwrap_err();
    assert!(matches!(refused, ReportError::Metric(MetricError::Negative { .. })), "{refused}");
}
