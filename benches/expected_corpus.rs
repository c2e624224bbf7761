//! What the signs of a fit say of its error, learnt from runs of materials and rigs that the forecast is not tested with: neural fits
//! of the 80 MERL rows that are not multiples of 5 and as many ABC materials, each on one of eight simulated rigs that are out of
//! place in different ways, once by the plan for 20 s and once adaptively. Prints the powers of `forecast::expected` by ridge
//! regression of logarithms, its constants of materials that a family describes, and how many errors lie near what is expected.
//!
//! `ZONAL_CORPUS=... cargo bench --features corpus --bench expected_corpus`; `-- --every N` takes every N-th material, `-- --from K`
//! begins with the K-th. `-- --chance` tells instead how well the error of a material that its family describes could be foretold by
//! somebody who knew how it is distributed: exact integrals of every fifth ABC material, eight draws of noise each.
#![allow(missing_docs)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::sync::Arc;

use argmin::core::{CostFunction, Executor};
use argmin::solver::neldermead::NelderMead;
use nalgebra::{DVector, Matrix5, Vector5};
use zonal::fit::{FitMethod, FitOptions, alternatives, fit};
use zonal::forecast::{Class, NoiseModel, Signs, best_plan, candidates, ideal_coefficients};
use zonal::geometry::Zone;
use zonal::patterns::{Adaptive, Plan, Timing};
use zonal::reflectance::{Brdf, Metric, NeuralBrdf, abc_materials};
use zonal::twin::TwinConfig;

const SECONDS: f64 = 20.0;
/// Seeds of the rigs; those of the tests are below.
const RIGS: std::ops::RangeInclusive<u64> = 31..=38;
/// How names of measured materials begin.
const MEASURED: &str = "merl-";
/// For [`chance`]: noise of a direction over z_00, and draws for each material.
const NOISE_REL: f64 = 0.03;
const DRAWS: u64 = 8;
/// Weight of the prior that signs tell nothing, in runs.
const RIDGE: f64 = 1.0;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let number = |flag: &str| {
        arguments.iter().position(|a| a == flag).map(|i| arguments[i + 1].parse::<usize>().expect("a number"))
    };
    let (every, from) = (number("--every").unwrap_or(1), number("--from").unwrap_or(0));
    let rig = common::rig("ghosh-2007-built");
    let metric = Metric::new(rig.zone());
    if arguments.iter().any(|a| a == "--chance") {
        return chance(&metric, rig.zone());
    }
    let noise = NoiseModel::new(&rig, &Plan::of_order(2)).unwrap();
    let fixed = candidates(&Plan::of_order(2), false);
    let (best, _) = best_plan(&noise, &Timing::of(&rig), fixed, SECONDS, Class::Any).unwrap();
    let plans = [best, Plan::of_order(10).adapted(Adaptive::default())];
    let rigs: Vec<_> = RIGS.map(common::rig_out_of_place).collect();
    let rigs: Vec<_> = rigs.into_iter().map(|config| (common::calibrated(&rig, &config), config)).collect();
    let mut runs: Vec<(Signs, f64, bool)> = Vec::new();
    for (i, (name, truth)) in materials().into_iter().enumerate().skip(from).step_by(every) {
        let reference = metric.reference(truth.as_ref()).unwrap();
        let (calibration, config) = &rigs[i / 2 % rigs.len()];
        let config = TwinConfig { seed: config.seed + 100 * (i as u64 + 1), ..config.clone() };
        for plan in &plans {
            let run = common::run(&rig, plan, &config, calibration, truth.clone());
            let found = alternatives(&run.coefficients, Signs::PARTS).unwrap();
            let signs = Signs::of(&found, &metric);
            let error = reference.errors(&found.model).unwrap().mean.overall();
            println!("{name}\t{}\t{error:.5}\t{:.5}\t{signs:?}", run.record.order, signs.error());
            runs.push((signs, error, name.starts_with(MEASURED)));
        }
    }
    let learnt: Vec<_> = runs.iter().filter(|(signs, _, measured)| *measured && signs.misses()).collect();
    let [scale, powers @ ..] = regression(&learnt);
    println!("{} runs of measured materials whose models miss something: SCALE {:.2}", learnt.len(), scale.exp());
    println!("powers of disagreement, misfit, sharpness, contrast: {powers:.3?}");
    let described = runs.iter().filter(|(signs, _, measured)| !measured && !signs.misses()).collect();
    let [rig, calibrated, direction] = described_by_a_family(described);
    println!("of a family: RIG {rig:.2}, CALIBRATED {calibrated:.1e}, {direction:.2} times DIRECTION");
    for (kind, measured) in [("measured", true), ("of a family", false)] {
        let of: Vec<_> = runs.iter().filter(|run| run.2 == measured).collect();
        let within = of.iter().filter(|(signs, error, _)| (error / signs.error()).ln().abs() < 1.5f64.ln()).count();
        println!("{kind}: {within} of {} errors within a factor 1.5 of what is expected", of.len());
    }
}

fn materials() -> Vec<(String, Arc<dyn Brdf>)> {
    let others = |i: &usize| !i.is_multiple_of(5);
    let file = common::corpus().join("merl/nbrdf_merl_f32le.bin");
    let merl = (0..100).filter(others).map(|row| {
        let brdf: Arc<dyn Brdf> = Arc::new(NeuralBrdf::read(&file, row).unwrap());
        (format!("{MEASURED}{row}"), brdf)
    });
    let abc = abc_materials().iter().enumerate().filter(|(i, _)| others(i));
    let abc = abc.map(|(_, m)| (format!("abc-{}", m.name), Arc::new(m.brdf) as Arc<dyn Brdf>));
    // In turn, so that a few are of both kinds.
    abc.zip(merl).flat_map(<[_; 2]>::from).collect()
}

/// Errors by noise alone, against their own geometric mean.
fn chance(metric: &Metric, zone: Zone) {
    for order in [2, 6] {
        let within = abc_materials().iter().step_by(5).flat_map(|material| {
            let reference = metric.reference(&material.brdf).unwrap();
            let error = |seed| {
                let data = ideal_coefficients(&material.brdf, zone, order, NOISE_REL, seed).unwrap();
                let model = fit(&data, FitMethod::Abc, &FitOptions::default()).unwrap().brdf;
                reference.errors(&model).unwrap().mean.overall().ln()
            };
            let errors: Vec<f64> = (0..DRAWS).map(error).collect();
            let mean = errors.iter().sum::<f64>() / DRAWS as f64;
            errors.into_iter().map(move |e| (e - mean).abs() < 1.5f64.ln())
        });
        let within: Vec<bool> = within.collect();
        let near = within.iter().filter(|near| **near).count();
        println!("order {order}: {near} of {} errors within a factor 1.5 of their geometric mean", within.len());
    }
}

/// ln error = first + powers . signs, standardised signs with a ridge.
fn regression(runs: &[&(Signs, f64, bool)]) -> [f64; 5] {
    let n = runs.len() as f64;
    let signs: Vec<[f64; 4]> = runs.iter().map(|(signs, ..)| signs.of_misfit()).collect();
    let mean: [f64; 4] = std::array::from_fn(|j| signs.iter().map(|s| s[j]).sum::<f64>() / n);
    let spread: [f64; 4] =
        std::array::from_fn(|j| (signs.iter().map(|s| (s[j] - mean[j]).powi(2)).sum::<f64>() / n).sqrt());
    let (mut normal, mut right) = (Matrix5::zeros(), Vector5::zeros());
    for (s, (_, error, _)) in signs.iter().zip(runs.iter().map(|r| &**r)) {
        let row = Vector5::from_fn(|j, _| if j == 0 { 1.0 } else { (s[j - 1] - mean[j - 1]) / spread[j - 1] });
        normal += row * row.transpose();
        right += row * error.ln();
    }
    for j in 1..5 {
        normal[(j, j)] += RIDGE;
    }
    let x = normal.cholesky().expect("positive definite by the ridge").solve(&right);
    let powers: [f64; 4] = std::array::from_fn(|j| x[j + 1] / spread[j]);
    let scale = x[0] - powers.iter().zip(mean).map(|(p, m)| p * m).sum::<f64>();
    [scale, powers[0], powers[1], powers[2], powers[3]]
}

/// What of the logarithms of RIG, CALIBRATED and a factor of DIRECTION brings the most errors near what is expected: least squares
/// would follow the few that are far off by chance.
struct Far<'a>(Vec<&'a (Signs, f64, bool)>);

impl CostFunction for Far<'_> {
    type Param = DVector<f64>;
    type Output = f64;

    fn cost(&self, logarithms: &DVector<f64>) -> Result<f64, argmin::core::Error> {
        let [rig, calibrated, direction] = std::array::from_fn(|i| logarithms[i].exp());
        let far = |(signs, error, _): &(Signs, f64, bool)| {
            let beyond = signs.of_misfit()[1].exp();
            let expected = [signs.noise, signs.as_likely, rig * beyond, direction * signs.sharpness, calibrated];
            let off = (error / expected.into_iter().fold(0.0, f64::hypot)).ln() / 1.5f64.ln();
            1.0 - (-off * off / 1.5).exp()
        };
        Ok(self.0.iter().map(|run| far(run)).sum::<f64>() / self.0.len() as f64)
    }
}

/// RIG, CALIBRATED and the factor of DIRECTION.
fn described_by_a_family(runs: Vec<&(Signs, f64, bool)>) -> [f64; 3] {
    let start = DVector::from_column_slice(&[2f64, 4e-4, 1.0].map(f64::ln));
    let mut corners = vec![start.clone(); 4];
    (0..3).for_each(|j| corners[j + 1][j] += 0.5);
    let solver = NelderMead::new(corners).with_sd_tolerance(1e-6).expect("a positive tolerance");
    let run =
        Executor::new(Far(runs), solver).configure(|state| state.max_iters(2000)).run().expect("costs are finite");
    let best = run.state.best_param.expect("some corner is best");
    std::array::from_fn(|i| best[i].exp())
}
