//! The table of fitting methods over the measured corpus: nine RGL files and the neural fits of MERL rows 0, 5, ..., 95,
//! on the built rig, orders 2 and 4, with the default noise and with noise_rel 1%.
//!
//! `ZONAL_CORPUS=... cargo bench --features corpus --bench fit_corpus`; `-- --exact` takes exact integrals with 1% noise
//! instead of the simulated rig, which is some ten times faster; `-- --each` lists every material, `-- --only METHOD` fits
//! one method, `-- --every N` takes every N-th material. `-- --twin finite` measures on the rig with finite pupils as well
//! as on that of pinholes and prints the differences.
#![allow(missing_docs)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::sync::Arc;

use zonal::calibrate::CalibrationSet;
use zonal::fit::{FitMethod, FitOptions, FitReport, fit};
use zonal::geometry::ExitantGrid;
use zonal::optics::Rig;
use zonal::patterns::Plan;
use zonal::reduce::Coefficients;
use zonal::reflectance::{Brdf, Metric};
use zonal::twin::TwinConfig;

const ORDERS: [usize; 2] = [2, 4];
const NOISE_REL: f64 = 0.01;

struct Row {
    twin: &'static str,
    rgl: bool,
    order: usize,
    noise: &'static str,
    method: FitMethod,
    /// rel_in, rel_out, log_in, log_out, worst albedo error.
    errors: [f64; 5],
    fit_s: f64,
    chosen: FitMethod,
}

/// What a material is measured on.
enum Source {
    /// Integrals without error.
    Exact,
    /// A simulated rig, by its name, with its calibration.
    Twin(&'static str, Box<CalibrationSet>),
}

impl Source {
    fn name(&self) -> &'static str {
        match self {
            Source::Exact => "exact",
            Source::Twin(name, _) => name,
        }
    }

    /// A rig calibrated as it is meant to be: stray light taken off where there is some.
    fn twin(rig: &Rig, name: &'static str) -> Self {
        let config = TwinConfig::named(name, 1).expect("a simulated rig");
        let set = common::calibrated(rig, &config);
        let set =
            if config.stray_share > 0.0 { common::with_black_trap(rig, &config, set, &Plan::of_order(4)) } else { set };
        Self::Twin(name, Box::new(set))
    }

    fn measured(&self, rig: &Rig, truth: &Arc<dyn Brdf>, i: usize) -> Coefficients {
        match self {
            Source::Exact => {
                let grid = ExitantGrid::new(rig.zone(), 32, 64);
                common::exact_coefficients(truth.as_ref(), grid, 4, rig.zone())
            }
            Source::Twin(name, calibration) => {
                let config = TwinConfig::named(name, 100 + i as u64).expect("a simulated rig");
                common::run(rig, &Plan::of_order(4), &config, calibration, truth.clone()).coefficients
            }
        }
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let has = |flag: &str| arguments.iter().any(|a| a == flag);
    let value = |flag: &str| arguments.iter().position(|a| a == flag).map(|i| arguments[i + 1].as_str());
    let only = value("--only").map(|name| name.parse::<FitMethod>().unwrap());
    let every = value("--every").map_or(1, |n| n.parse::<usize>().unwrap());
    let methods: Vec<FitMethod> = FitMethod::ALL.into_iter().filter(|m| only.is_none_or(|o| o == *m)).collect();
    let rig = common::rig("ghosh-2007-built");
    let metric = Metric::new(rig.zone());
    let sources = match (has("--exact"), value("--twin")) {
        (true, _) => vec![Source::Exact],
        (_, Some("finite")) => ["pinhole", "finite"].map(|name| Source::twin(&rig, name)).into(),
        (_, None | Some("pinhole")) => vec![Source::twin(&rig, "pinhole")],
        (_, Some(other)) => panic!("--twin {other} is no simulated rig: choose pinhole or finite"),
    };
    let mut rows = Vec::new();
    for (i, (name, truth)) in common::measured_materials().into_iter().enumerate().step_by(every) {
        let reference = metric.reference(truth.as_ref()).unwrap();
        for source in &sources {
            let measured = source.measured(&rig, &truth, i);
            let mut data = vec![("1%", common::noisy(&measured, NOISE_REL, i as u64))];
            if matches!(source, Source::Twin(..)) {
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
                        let row = Row {
                            twin: source.name(),
                            rgl: !name.starts_with("merl"),
                            order,
                            noise,
                            method,
                            errors,
                            fit_s: report.fit_s,
                            chosen: report.model,
                        };
                        if has("--each") {
                            each(&name, &row, &report);
                        }
                        rows.push(row);
                    }
                }
            }
        }
    }
    for source in &sources {
        println!("\n{}", source.name());
        table(&rows.iter().filter(|r| r.twin == source.name()).collect::<Vec<_>>(), &methods);
    }
    if let [pinhole, finite] = &sources[..] {
        differences(&rows, [pinhole.name(), finite.name()], &methods);
    }
}

/// What one fit came to.
fn each(name: &str, row: &Row, report: &FitReport) {
    let Row { twin, order, noise, method, errors, .. } = row;
    let all = errors.map(|e| format!("{e:.3}")).join(" ");
    if let Some(selection) = &report.selection {
        let ladder = selection
            .candidates
            .iter()
            .map(|c| format!("{} {:.4} ({:.4})", c.model, c.predicted_error, c.fitted_error));
        println!("{name:24} {order} {noise:7} {}", ladder.collect::<Vec<_>>().join(", "));
    }
    println!(
        "{name:24} {twin:7} {order} {noise:7} {method:22} {all} chi {:6.2} misfit {:.4} {:.3} s {}",
        report.chi, report.misfit_rel, report.fit_s, report.model
    );
}

/// Columns of one twin less those of another, material by material: medians, and the largest either way.
fn differences(rows: &[Row], [from, to]: [&str; 2], methods: &[FitMethod]) {
    let of = |twin: &str| rows.iter().filter(|r| r.twin == twin).collect::<Vec<_>>();
    // Both were measured in the same order.
    let pairs: Vec<(&Row, &Row)> = of(from).into_iter().zip(of(to)).collect();
    for noise in ["1%", "default"] {
        for order in ORDERS {
            println!(
                "\norder {order}, noise {noise}: {to} less {from}, median (largest) of rel_in, rel_out, log_in, log_out, \
                 worst albedo error"
            );
            for &method in methods {
                let here = |r: &Row| r.noise == noise && r.order == order && r.method == method;
                let column = |e: usize| {
                    let all = pairs.iter().filter(|(a, _)| here(a)).map(|(a, b)| b.errors[e] - a.errors[e]);
                    let all: Vec<f64> = all.collect();
                    let most = all.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(f64::NAN);
                    format!("{:+7.4} ({most:+.4})", common::median(all))
                };
                println!("{:22} {}", method.name(), (0..5).map(column).collect::<Vec<_>>().join(" "));
            }
        }
    }
}

/// Medians over materials.
fn table(rows: &[&Row], methods: &[FitMethod]) {
    for noise in ["1%", "default"] {
        for order in ORDERS {
            let here: Vec<&&Row> = rows.iter().filter(|r| r.noise == noise && r.order == order).collect();
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
