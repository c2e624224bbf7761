//! The table of fitting methods over the measured corpus: nine RGL files and the neural fits of MERL rows 0, 5, ..., 95,
//! on the built rig, orders 2 and 4, with the default noise and with noise_rel 1%.
//!
//! `ZONAL_CORPUS=... cargo bench --features corpus --bench fit_corpus`; `-- --exact` takes exact integrals with 1% noise
//! instead of the simulated rig, which is some ten times faster; `-- --each` lists every material.
#![allow(missing_docs)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use zonal::basis::{lm, size};
use zonal::fit::{Fineness, FitMethod, FitOptions, Forward, Observations, fit};
use zonal::geometry::{ExitantGrid, Zone};
use zonal::patterns::Plan;
use zonal::reduce::Coefficients;
use zonal::reflectance::{Brdf, Metric, NeuralBrdf, open};
use zonal::twin::TwinConfig;

const ORDERS: [usize; 2] = [2, 4];
const NOISE_REL: f64 = 0.01;

fn corpus() -> Vec<(String, Arc<dyn Brdf>)> {
    let root: PathBuf =
        std::env::var_os("ZONAL_CORPUS").expect("set ZONAL_CORPUS to the folder of measured data").into();
    let mut files: Vec<_> = std::fs::read_dir(root.join("rgl")).unwrap().map(|f| f.unwrap().path()).collect();
    files.sort();
    let rgl = files.iter().map(|f| {
        let name = f.file_stem().unwrap().to_string_lossy().into_owned();
        (name, open(f.to_str().unwrap()).unwrap())
    });
    let table = root.join("merl/nbrdf_merl_f32le.bin");
    let merl = (0..100).step_by(5).map(|row| {
        let brdf = NeuralBrdf::read(Path::new(&table), row).unwrap();
        (format!("merl-{row}"), Arc::new(brdf) as Arc<dyn Brdf>)
    });
    rgl.chain(merl).collect()
}

/// Exact coefficients of an isotropic material on the built rig's grid, sigma 0.
fn exact(brdf: &dyn Brdf, order: usize) -> Coefficients {
    let grid = ExitantGrid::new(Zone::from_degrees(9.0, 57.0).unwrap(), 32, 64);
    let n = size(order) * 3 * grid.len();
    let mut coefficients =
        Coefficients { grid, order, values: vec![0.0; n], sigma: vec![1.0; n], history: "exact".into() };
    let folded = Observations::folded(&coefficients);
    let predicted = Forward::new(&folded, Fineness { radial: 64, around: 160 }).unwrap().predict(brdf);
    for (c, predicted) in predicted.iter().enumerate() {
        for k in 0..size(order) {
            let (l, m) = lm(k);
            let term = folded.terms.iter().position(|&t| t == zonal::basis::index(l, m.abs())).unwrap();
            for cell in 0..grid.len() {
                let phi = f64::from(m) * grid.phi(cell % grid.sectors());
                let z = predicted[cell / grid.sectors() * folded.terms.len() + term];
                let turned = if m >= 0 { z * phi.cos() } else { -z * phi.sin() };
                coefficients.values[(k * 3 + c) * grid.len() + cell] = turned as f32;
            }
        }
    }
    coefficients.sigma.fill(0.0);
    coefficients
}

/// The same with noise added until its standard error is `noise_rel` of RMS z_00.
fn noisy(coefficients: &Coefficients, noise_rel: f64, seed: u64) -> Coefficients {
    let mut noisy = coefficients.clone();
    let dc = &coefficients.values[..3 * coefficients.grid.len()];
    let dc = (dc.iter().filter(|z| z.is_finite()).map(|z| f64::from(z * z)).sum::<f64>() / dc.len() as f64).sqrt();
    let mut rng = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(seed);
    for (z, sigma) in noisy.values.iter_mut().zip(&mut noisy.sigma) {
        let add = ((noise_rel * dc).powi(2) - f64::from(*sigma).powi(2)).max(0.0).sqrt();
        let e: f64 = StandardNormal.sample(&mut rng);
        *z += (add * e) as f32;
        *sigma = f64::from(*sigma).hypot(add) as f32;
    }
    noisy
}

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
    let rig = common::rig("ghosh-2007-built");
    let metric = Metric::new(rig.zone());
    let calibration = (!has("--exact")).then(|| common::calibrated(&rig, &TwinConfig::pinhole(1)));
    let mut rows = Vec::new();
    for (i, (name, truth)) in corpus().into_iter().enumerate() {
        let reference = metric.reference(truth.as_ref()).unwrap();
        let measured = match &calibration {
            Some(calibration) => {
                let config = TwinConfig::pinhole(100 + i as u64);
                common::run(&rig, &Plan::of_order(4), &config, calibration, truth.clone()).coefficients
            }
            None => exact(truth.as_ref(), 4),
        };
        let mut data = vec![("1%", noisy(&measured, NOISE_REL, i as u64))];
        if calibration.is_some() {
            data.push(("default", measured));
        }
        for (noise, coefficients) in &data {
            for order in ORDERS {
                let coefficients = coefficients.truncated(order);
                for method in FitMethod::ALL {
                    let report = fit(&coefficients, method, &FitOptions::default()).unwrap();
                    let errors = reference.errors(&report.brdf).unwrap().mean;
                    let albedo = errors.albedo_error.iter().map(|e| e.abs()).fold(0.0, f64::max);
                    let errors = [errors.rel_in, errors.rel_out, errors.log_in, errors.log_out, albedo];
                    if has("--each") {
                        let all = errors.map(|e| format!("{e:.3}")).join(" ");
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
    table(&rows);
}

/// Medians over materials.
fn table(rows: &[Row]) {
    for noise in ["1%", "default"] {
        for order in ORDERS {
            let here: Vec<&Row> = rows.iter().filter(|r| r.noise == noise && r.order == order).collect();
            if here.is_empty() {
                continue;
            }
            println!(
                "\norder {order}, noise {noise}: medians of rel_in, rel_out, log_in, log_out, worst albedo error; fit_s"
            );
            for method in FitMethod::ALL {
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
