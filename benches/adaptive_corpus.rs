//! Speed against accuracy on measured materials, on the simulated rig: fixed plans (positive and negative lobes, three exposures),
//! adaptive runs, free and as `zonal plan --budget --adaptive` limits them, and the plans that `zonal plan --budget` takes; nine RGL
//! files, neural fits of MERL rows 0, 5, ..., 95 and every fifth ABC material.
//!
//! `ZONAL_CORPUS=... cargo bench --features corpus --bench adaptive_corpus`; `-- --each` lists every run, `-- --every N` takes every
//! N-th material, `-- --from K` begins with the K-th, `-- --no-fixed` leaves out the fixed plans of pairs and what is compared with
//! them. `-- --seeds N` repeats the plan of 20 s alone, on N rigs that are out of place by as much as the simulated one but otherwise,
//! each with its calibration, and tells how well its error could be foretold by somebody who knew how such errors are distributed.
#![allow(missing_docs)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::sync::Arc;

use zonal::fit::{FitMethod, FitOptions, fit};
use zonal::forecast::{Class, Expected, NoiseModel, adaptive_plan, best_plan, candidates};
use zonal::measure::RunRecord;
use zonal::patterns::{Adaptive, Plan, Timing};
use zonal::reduce::Coefficients;
use zonal::reflectance::{Brdf, Metric, built_in, open};
use zonal::twin::TwinConfig;

const BUDGETS_S: [f64; 4] = [5.0, 10.0, 20.0, 60.0];
/// The one of them whose plan is repeated.
const REPEATED_S: f64 = 20.0;
/// Order of the longest fixed plan that 60 s allow.
const FIXED: usize = 7;

/// One run of one material.
struct Row {
    material: String,
    what: String,
    frames: usize,
    rig_s: f64,
    elapsed_s: f64,
    error: f64,
    expected: f64,
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let has = |flag: &str| arguments.iter().position(|a| a == flag);
    let number = |flag: &str| has(flag).map(|i| arguments[i + 1].parse::<usize>().expect("a number"));
    let (every, from) = (number("--every").unwrap_or(1), number("--from").unwrap_or(0));
    let rig = common::rig("ghosh-2007-built");
    let timing = Timing::of(&rig);
    let metric = Metric::new(rig.zone());
    let calibration = common::calibrated(&rig, &TwinConfig::pinhole(1));
    let noise = NoiseModel::new(&rig, &Plan::of_order(2)).unwrap();
    let best = BUDGETS_S.map(|seconds| {
        let plans = candidates(&Plan::of_order(2), false);
        let (plan, forecast) = best_plan(&noise, &timing, plans, seconds, Class::Any).unwrap();
        println!("{seconds} s: {} ({} frames, {:.1} s)", plan.name, plan.frames(), forecast.rig_s);
        (seconds, plan, forecast)
    });
    let chosen = materials().into_iter().enumerate().skip(from).step_by(every);
    if let Some(seeds) = number("--seeds") {
        let (_, repeated_plan, _) =
            best.iter().find(|(seconds, ..)| *seconds == REPEATED_S).expect("one of the budgets");
        let rigs: Vec<_> = (1..=seeds as u64).map(common::rig_out_of_place).collect();
        let rigs: Vec<_> = rigs.into_iter().map(|config| (common::calibrated(&rig, &config), config)).collect();
        let repeated = chosen.map(|(i, (name, truth))| {
            let reference = metric.reference(truth.as_ref()).unwrap();
            let runs = rigs.iter().map(|(calibration, config)| {
                let config = TwinConfig { seed: config.seed + 100 * (i as u64 + 1), ..config.clone() };
                let run = common::run(&rig, repeated_plan, &config, calibration, truth.clone());
                let expected = Expected::of(&run.coefficients).unwrap();
                (reference.errors(&expected.model).unwrap().mean.overall(), expected.error)
            });
            (name, runs.collect())
        });
        return foretellable(repeated);
    }
    let mut rows: Vec<Row> = Vec::new();
    for (i, (name, truth)) in chosen {
        let reference = metric.reference(truth.as_ref()).unwrap();
        let config = TwinConfig::pinhole(100 + i as u64);
        let error = |c: &Coefficients, method| {
            let model = fit(c, method, &FitOptions::default()).unwrap().brdf;
            reference.errors(&model).unwrap().mean.overall()
        };
        let mut add = |what: String, frames, rig_s, elapsed_s, error, expected| {
            if has("--each").is_some() {
                println!("{name}\t{what}\t{frames}\t{rig_s:.3}\t{elapsed_s:.3}\t{error:.5}\t{expected:.5}");
            }
            rows.push(Row { material: name.clone(), what, frames, rig_s, elapsed_s, error, expected });
        };
        if has("--no-fixed").is_none() {
            let fixed = common::run(&rig, &Plan::of_order(FIXED), &config, &calibration, truth.clone());
            for order in 0..=FIXED {
                let plan = Plan::of_order(order);
                let rig_s = plan.rig_time(&timing).total_s();
                let known = fixed.coefficients.truncated(order);
                add(format!("fixed {order}"), plan.frames(), rig_s, f64::NAN, error(&known, FitMethod::Auto), f64::NAN);
            }
            add("thesis".into(), 0, 0.0, f64::NAN, error(&fixed.coefficients, FitMethod::Thesis), f64::NAN);
        }
        let adapted = |plan: &Plan| {
            let run = common::run(&rig, plan, &config, &calibration, truth.clone());
            let model = Expected::of(&run.coefficients).unwrap().model;
            (run.record, reference.errors(&model).unwrap().mean.overall())
        };
        let free = adapted(&Plan::of_order(10).adapted(Adaptive::default()));
        let mut adaptive = |what: String, (record, found): &(RunRecord, f64)| {
            let elapsed_s = record.capture.elapsed_s + record.rig_s_items.decision_s;
            let last = record.decisions.last().expect("one at least");
            add(format!("{what} {}", record.order), record.frames, record.rig_s, elapsed_s, *found, last.error);
        };
        adaptive("adaptive".into(), &free);
        for seconds in BUDGETS_S {
            let what = format!("budget {seconds},");
            // Within the limit it is the same run, unless a step was foreseen to take longer than it did.
            if free.0.rig_s <= seconds {
                adaptive(what, &free);
            } else {
                adaptive(what, &adapted(&adaptive_plan(&Plan::of_order(2), &timing, seconds).unwrap()));
            }
        }
        for (seconds, plan, forecast) in &best {
            let run = common::run(&rig, plan, &config, &calibration, truth.clone());
            let expected = Expected::of(&run.coefficients).unwrap();
            let found = reference.errors(&expected.model).unwrap().mean.overall();
            let elapsed_s = run.record.capture.elapsed_s;
            add(format!("plan {seconds},"), plan.frames(), forecast.rig_s, elapsed_s, found, expected.error);
        }
    }
    summary(&rows);
}

fn materials() -> Vec<(String, Arc<dyn Brdf>)> {
    let abc = built_in().into_iter().filter(|m| m.family == "abc").step_by(5);
    let abc = abc.map(|m| (format!("abc-{}", m.name), open(&m.name).unwrap()));
    common::measured_materials().into_iter().chain(abc).collect()
}

/// Prints how many of the errors found lie within a factor 1.5 of what was expected, of the geometric mean of the material's other
/// runs, and of the number that covers most of them: what nobody can do better who does not know how this rig is out of place.
fn foretellable(repeated: impl Iterator<Item = (String, Vec<(f64, f64)>)>) {
    let within = |found: f64, expected: f64| usize::from((found / expected).ln().abs() < 1.5f64.ln());
    let mut sums = [("abc", [0; 4]), ("others", [0; 4])];
    for (name, runs) in repeated {
        let found: Vec<f64> = runs.iter().map(|r| r.0).collect();
        let mean = found.iter().map(|f| f.ln()).sum::<f64>() / found.len() as f64;
        let others = |f: f64| ((mean * found.len() as f64 - f.ln()) / (found.len() - 1) as f64).exp();
        let covered = |low: &f64| found.iter().filter(|&f| f >= low && *f < 1.5f64.powi(2) * low).count();
        let counts = [
            runs.iter().map(|&(f, e)| within(f, e)).sum(),
            found.iter().map(|&f| within(f, others(f))).sum(),
            found.iter().map(covered).max().unwrap_or(0),
            found.len(),
        ];
        let expected: Vec<String> = runs.iter().map(|r| format!("{:.5}:{:.5}", r.0, r.1)).collect();
        println!("{name}\t{}\t{counts:?}", expected.join(" "));
        let sum = &mut sums[usize::from(!name.starts_with("abc"))].1;
        sum.iter_mut().zip(counts).for_each(|(s, c)| *s += c);
    }
    for (what, [expected, others, covered, runs]) in sums {
        println!(
            "{what}: within a factor 1.5 of what was expected {expected} of {runs} runs, of the geometric mean of the material's \
             other runs {others}, of the best number for each material {covered}"
        );
    }
}

fn summary(rows: &[Row]) {
    let named = |what: &str| -> Vec<&Row> { rows.iter().filter(|r| r.what.starts_with(what)).collect() };
    let errors = |rows: &[&Row]| common::median(rows.iter().map(|r| r.error).collect());
    println!("\nmedian errors");
    let mut best = f64::INFINITY;
    for order in 0..=FIXED {
        let of = named(&format!("fixed {order}"));
        let Some(first) = of.first() else { continue };
        best = best.min(errors(&of));
        println!("fixed, order {order}: {:.4}, {} frames, {:.1} s", errors(&of), first.frames, first.rig_s);
    }
    let thesis = named("thesis");
    if !thesis.is_empty() {
        println!("thesis: {:.4}", errors(&thesis));
    }
    let adaptive = named("adaptive");
    let frames = common::median(adaptive.iter().map(|r| r.frames as f64).collect());
    let most = adaptive.iter().map(|r| r.frames).max().unwrap_or(0);
    println!("adaptive: {:.4}, {frames} frames (at most {most})", errors(&adaptive));
    if best.is_finite() {
        println!("adaptive over the best fixed: {:.3}", errors(&adaptive) / best);
        let no_worse = adaptive.iter().filter(|a| {
            let fixed =
                rows.iter().filter(|r| r.material == a.material && r.what.starts_with("fixed") && r.frames <= a.frames);
            fixed.map(|r| r.error).fold(f64::INFINITY, f64::min) >= a.error
        });
        println!("no worse than any fixed plan of as many frames: {} of {}", no_worse.count(), adaptive.len());
    }
    for seconds in BUDGETS_S {
        let of = named(&format!("budget {seconds},"));
        let rivals: Vec<String> = (0..=FIXED)
            .map(|order| named(&format!("fixed {order}")))
            .filter(|f| f.first().is_some_and(|f| f.rig_s <= seconds))
            .map(|f| format!("{:.4}", errors(&f)))
            .collect();
        let longest_s = of.iter().map(|r| r.elapsed_s).fold(0.0, f64::max);
        println!(
            "budget {seconds} s: adaptive {:.4} (at most {longest_s:.1} s), plan {:.4}, fixed plans of that length {}",
            errors(&of),
            errors(&named(&format!("plan {seconds},"))),
            rivals.join(" ")
        );
    }
    for kind in ["adaptive".into()].into_iter().chain(BUDGETS_S.map(|seconds| format!("plan {seconds},"))) {
        let foretold = named(&kind);
        let within = |factor: f64| foretold.iter().filter(|r| (r.error / r.expected).ln().abs() < factor.ln()).count();
        let on_time = foretold.iter().filter(|r| (r.elapsed_s / r.rig_s - 1.0).abs() < 0.05).count();
        println!(
            "{kind}: errors within a factor 1.5 of what was expected {} of {}, within 2 {}; seconds within 5% {on_time}",
            within(1.5),
            foretold.len(),
            within(2.0)
        );
    }
}
