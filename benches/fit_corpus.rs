//! The table of fitting methods over the measured corpus: nine RGL files and the neural fits of MERL rows 0, 5, ..., 95,
//! on the built rig, orders 2 and 4, with the default noise and with noise_rel 1%.
//!
//! `ZONAL_CORPUS=... cargo bench --features corpus --bench fit_corpus`; `-- --exact` takes exact integrals with 1% noise
//! instead of the simulated rig, which is some ten times faster; `-- --each` lists every material, `-- --only METHOD` fits
//! one method.
#![allow(missing_docs)]

#[path = "../tests/common/mod.rs"]
mod common;

use zonal::fit::{FitMethod, FitOptions, fit};
use zonal::geometry::ExitantGrid;
use zonal::patterns::Plan;
use zonal::reflectance::Metric;
use zonal::twin::TwinConfig;

const ORDERS: [usize; 2] = [2, 4];
const NOISE_REL: f64 = 0.01;

struct Row {
    rgl: bool,
    order: usize,
    noise: &'static str,
    method: FitMethod,
    /// rel_in, rel_out, log_in, log_out, worst albedo error.
    errors: [f64; 5],
    fit_s: f64,
    chosen: FitMethod,
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let has = |flag: &str| arguments.iter().any(|a| a == flag);
    let only = arguments.iter().position(|a| a == "--only").map(|i| arguments[i + 1].parse::<FitMethod>().unwrap());
    let methods: Vec<FitMethod> = FitMethod::ALL.into_iter().filter(|m| only.is_none_or(|o| o == *m)).collect();
    let rig = common::rig("ghosh-2007-built");
    let grid = ExitantGrid::new(rig.zone(), 32, 64);
    let metric = Metric::new(rig.zone());
    let calibration = (!has("--exact")).then(|| common::calibrated(&rig, &TwinConfig::pinhole(1)));
    let mut rows = Vec::new();
    for (i, (name, truth)) in common::measured_materials().into_iter().enumerate() {
        let reference = metric.reference(truth.as_ref()).unwrap();
        let measured = match &calibration {
            Some(calibration) => {
                let config = TwinConfig::pinhole(100 + i as u64);
                common::run(&rig, &Plan::of_order(4), &config, calibration, truth.clone()).coefficients
            }
            None => common::exact_coefficients(truth.as_ref(), grid, 4, rig.zone()),
        };
        let mut data = vec![("1%", common::noisy(&measured, NOISE_REL, i as u64))];
        if calibration.is_some() {
            data.push(("default", measured));
        }
        for (noise, coefficients) in &data {
            for order in ORDERS {
                let coefficients = coefficients.truncated(order);
                for &method in &methods {
                    let report = fit(&coefficients, method, &FitOptions::default()).unwrap();
                    let errors = reference.errors(&report.brdf).unwrap().mean;
                    let albedo = errors.albedo_error.iter().map(|e| e.abs()).fold(0.0, f64::max);
                    let errors = [errors.rel_in, errors.rel_out, errors.log_in, errors.log_out, albedo];
                    if has("--each") {
                        let all = errors.map(|e| format!("{e:.3}")).join(" ");
                        if let Some(selection) = &report.selection {
                            let ladder = selection
                                .candidates
                                .iter()
                                .map(|c| format!("{} {:.4} ({:.4})", c.model, c.predicted_error, c.fitted_error));
                            println!("{name:24} {order} {noise:7} {}", ladder.collect::<Vec<_>>().join(", "));
                        }
                        println!(
                            "{name:24} {order} {noise:7} {method:22} {all} chi {:6.2} misfit {:.4} {:.3} s {}",
                            report.chi, report.misfit_rel, report.fit_s, report.model
                        );
                    }
                    rows.push(Row {
                        rgl: !name.starts_with("merl"),
                        order,
                        noise,
                        method,
                        errors,
                        fit_s: report.fit_s,
                        chosen: report.model,
                    });
                }
            }
        }
    }
    table(&rows, &methods);
}

/// Medians over materials.
fn table(rows: &[Row], methods: &[FitMethod]) {
    for noise in ["1%", "default"] {
        for order in ORDERS {
            let here: Vec<&Row> = rows.iter().filter(|r| r.noise == noise && r.order == order).collect();
            if here.is_empty() {
                continue;
            }
            println!(
                "\norder {order}, noise {noise}: medians of rel_in, rel_out, log_in, log_out, worst albedo error; fit_s"
            );
            for &method in methods {
                let column = |rgl: bool, e: usize| {
                    let values = here.iter().filter(|r| r.rgl == rgl && r.method == method);
                    format!("{:6.3}", common::median(values.map(|r| r.errors[e]).collect()))
                };
                let all = |rgl: bool| (0..5).map(|e| column(rgl, e)).collect::<Vec<_>>().join(" ");
                let times = here.iter().filter(|r| r.method == method).map(|r| r.fit_s).collect();
                let seconds = common::median(times);
                println!("{:22} RGL {}   MERL {}   {seconds:.3} s", method.name(), all(true), all(false));
            }
            let mut chosen: Vec<_> =
                here.iter().filter(|r| r.method == FitMethod::Auto).map(|r| r.chosen.name()).collect();
            chosen.sort_unstable();
            let counts = chosen.chunk_by(|a, b| a == b).map(|c| format!("{} x {}", c.len(), c[0]));
            println!("auto chose {}", counts.collect::<Vec<_>>().join(", "));
        }
    }
}
