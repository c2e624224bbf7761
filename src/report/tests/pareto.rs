//! The chart of time and error, from made-up numbers.

use super::{HOSTILE, check_markup};
use crate::report::{ComputePoint, ParetoReport, PlanPoint, SeedPoint, Stage};

/// Median errors fall from 0.4 at order 0 to about 0.14.
fn error(order: usize) -> f64 {
    0.14 + 0.26 * (-0.45 * order as f64).exp()
}

fn plan(scheme: &str, order: usize, frames: usize, error: f64, measured: bool) -> PlanPoint {
    PlanPoint {
        scheme: scheme.into(),
        order,
        exposures: 1,
        frames,
        rig_s: 0.4 * frames as f64,
        method: "auto".into(),
        predicted: Some(error),
        measured: measured.then_some(error * (1.0 + 0.03 * (order % 5) as f64)),
    }
}

fn report() -> ParetoReport {
    let mut plans = Vec::new();
    for order in 0..=10 {
        let size = (order + 1) * (order + 1);
        plans.push(plan("pairs", order, 2 * size, error(order), order % 2 == 0));
        plans.push(plan("offset", order, size + 1, 1.05 * error(order), order % 4 == 0));
        plans.push(plan("multiplexed", order, size + 3, 1.01 * error(order), order == 6));
    }
    plans.extend((2..=20).step_by(2).map(|order| plan("isotropic", order, 2 * order, error(order), order % 4 == 0)));
    plans.extend([3, 5, 7].map(|order| plan("adaptive", order, 5 * order, 0.97 * error(order), true)));
    let thesis = |order: usize, measured| PlanPoint {
        method: "thesis".into(),
        predicted: None,
        measured: Some(measured),
        ..plan("pairs", order, 2 * (order + 1) * (order + 1), 0.0, false)
    };
    plans.extend([thesis(4, 0.61), thesis(10, 0.57)]);
    let way = |stage, method: &str, seconds, error, baseline| ComputePoint {
        stage,
        method: method.into(),
        seconds,
        error,
        baseline,
    };
    let seed = |order, rig_s, error| SeedPoint { order, rig_s, error };
    ParetoReport {
        materials: (0..10).map(|i| format!("material-{i}")).collect(),
        plans,
        computing: vec![
            way(Stage::Conversion, "thesis", 0.03, 2.1, true),
            way(Stage::Conversion, "hsh", 0.025, 0.9, true),
            way(Stage::Conversion, "truncated", 0.05, 0.6, false),
            way(Stage::Conversion, "slepian", 0.045, 0.35, false),
            way(Stage::Conversion, "parity", 0.02, 0.3, false),
            way(Stage::Conversion, "tikhonov", 0.06, 0.26, false),
            way(Stage::Conversion, "prior", 0.4, 0.06, false),
            way(Stage::Fit, "thesis", 40.0, 0.6, true),
            way(Stage::Fit, "ggx-to-reconstruction", 0.3, 0.5, true),
            way(Stage::Fit, "lambert", 0.002, 0.7, false),
            way(Stage::Fit, "ggx", 0.2, 0.22, false),
            way(Stage::Fit, "ggx2", 0.9, 0.17, false),
            way(Stage::Fit, "dbrdf", 1.3, 0.18, false),
            way(Stage::Fit, "auto", 2.5, 0.14, false),
            way(Stage::Simulation, "quadrature 64", 12.0, 1e-3, true),
            way(Stage::Simulation, "quadrature 256", 190.0, 6e-5, true),
            way(Stage::Simulation, "table", 0.5, 2e-3, false),
            way(Stage::Simulation, "zonal series", 1.5, 3e-5, false),
        ],
        seed: vec![seed(4, [60.0, 60.0], 0.61), seed(10, [300.0, 420.0], 0.57)],
        provenance: vec![("Predictions".into(), "over 100 published materials".into())],
    }
}

#[test]
fn the_front_is_sorted_and_nothing_beats_it() {
    let report = report();
    let front = report.front();
    assert!(front.len() > 5);
    for pair in front.windows(2) {
        assert!(pair[0].rig_s < pair[1].rig_s && pair[0].error() > pair[1].error());
    }
    for plan in report.plans.iter().filter(|p| p.measured.is_some()) {
        let beaten = |f: &&&PlanPoint| f.rig_s <= plan.rig_s && f.error() <= plan.error();
        assert!(front.iter().any(|f| beaten(&f)), "{plan:?}");
    }
    // What was measured counts, not what was predicted.
    assert_eq!(front.iter().filter(|p| p.method == "thesis").count(), 0);
}

#[test]
fn the_table_has_all_rows() {
    let report = report();
    let table = report.to_csv();
    let mut csv = csv::Reader::from_reader(table.as_slice());
    let kind = |r: csv::StringRecord| r[0].to_owned();
    let kinds: Vec<String> = csv.records().map(|r| kind(r.unwrap())).collect();
    let count = |kind: &str| kinds.iter().filter(|k| *k == kind).count();
    assert_eq!((count("plan"), count("seed"), count("conversion")), (report.plans.len(), 2, 7));
    assert_eq!((count("fit"), count("simulation"), kinds.len()), (7, 4, report.plans.len() + 20));
    let fronts = String::from_utf8(table).unwrap().lines().filter(|l| l.contains(",true,false")).count();
    assert_eq!(fronts, report.front().len());
}

#[test]
fn the_picture_and_the_page_tell_all() {
    let report = report();
    let svg = report.sheet().to_svg();
    check_markup(&svg);
    for name in [
        "pairs",
        "offset",
        "multiplexed",
        "isotropic",
        "adaptive",
        "order 10, 5–7 min",
        "75 times faster",
        "4.4 times less error",
        "Ghosh 2007: order 4, 1 min",
    ] {
        assert!(svg.contains(name), "{name}");
    }
    assert!(report.computing.iter().all(|c| svg.contains(&format!(">{}<", c.method))));
    let png = image::load_from_memory(&report.sheet().to_png()).unwrap();
    assert_eq!((png.width(), png.height()), (1620, 1266), "three cells by three");
    let page = report.to_html();
    check_markup(&page);
    assert!(page.contains("times faster") && page.contains("pareto.csv") && page.contains("material-9"));
}

#[test]
fn missing_and_impossible_numbers_are_left_out() {
    let mut report = report();
    for (i, p) in report.plans.iter_mut().enumerate() {
        let bad = [f64::NAN, f64::INFINITY, 0.0, -1.0][i % 4];
        (p.predicted, p.measured, p.scheme) = (Some(bad), (i % 3 == 0).then_some(bad), HOSTILE.into());
        p.rig_s = if i % 5 == 0 { bad } else { p.rig_s };
    }
    for (i, c) in report.computing.iter_mut().enumerate() {
        (c.method, c.error) = (HOSTILE.into(), [f64::NAN, 0.0, 0.1][i % 3]);
    }
    report.seed[0].error = f64::NAN;
    assert!(report.front().is_empty());
    let empty = ParetoReport { plans: vec![], computing: vec![], seed: vec![], ..report.clone() };
    for report in [report, empty] {
        let (page, svg) = (report.to_html(), report.sheet().to_svg());
        check_markup(&page);
        check_markup(&svg);
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert!(!String::from_utf8(report.to_csv()).unwrap().contains("NaN"));
    }
}
