//! `zonal chart`.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use clap::ValueEnum;
use zonal::convert::{PriorTable, Scan, stability_csv};
use zonal::design::height_errors;
use zonal::measure::{ControlRun, MeasureError};
use zonal::optics::{ProfileError, ProfileMethod, Rig};
use zonal::reflectance::{Brdf, sgd_materials};
use zonal::report::{ControlReport, HeightRow, OpticsReport, ParetoScan, ProfileRow, StabilityReport, pareto_plans};
use zonal::store;
use zonal::twin::TwinConfig;

use crate::common::{self, BadUsage, Report};

#[derive(Clone, Copy, ValueEnum)]
enum Name {
    /// Where each method of conversion fails: order, zone, noise.
    Stability,
    /// Gray-card runs over time, with control limits.
    Control,
    /// Seconds against error: plans on the rig, and ways of computing.
    Pareto,
    /// Ways to compute a dome's profile, and what a sample at the wrong height costs.
    Optics,
}

#[derive(clap::Args)]
pub struct Args {
    /// What to chart.
    name: Name,
    /// Gray-card runs (control).
    runs: Vec<PathBuf>,
    /// How many of the first runs set mean and limits (control).
    #[arg(long, default_value_t = 20, value_parser = at_least_two)]
    baseline: usize,
    /// New or empty folder for the table, the picture (.svg and .png) and the page.
    #[arg(long)]
    out: PathBuf,
    /// Test materials, at most; each by its two published fits.
    #[arg(long, default_value_t = usize::MAX, hide_default_value = true, value_parser = at_least_one)]
    materials: usize,
    /// Highest zonal order.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u16).range(4..=20))]
    max_order: u16,
    /// Seed of the noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    match args.name {
        Name::Stability | Name::Pareto | Name::Optics if !args.runs.is_empty() => {
            let name = args.name.to_possible_value().expect("none is hidden");
            Err(BadUsage(format!("`chart {}` takes no runs: leave them out", name.get_name())).into())
        }
        Name::Pareto => pareto(args),
        Name::Optics => optics(args),
        Name::Stability => stability(args),
        Name::Control => control(args),
    }
}

fn stability(args: &Args) -> anyhow::Result<Report> {
    let started = Instant::now();
    common::makeable(&args.out)?;
    store::vacant(&args.out)?;
    let scan =
        Scan { materials: args.materials, max_order: usize::from(args.max_order), seed: args.seed, ..Scan::default() };
    let table = PriorTable::built_in();
    let report = StabilityReport { materials: scan.test_materials(&table).len(), rows: scan.run(&table)?, scan };
    let sheet = report.sheet();
    store::write_dir(&args.out, |folder| {
        store::write(&folder.join("stability.csv"), &stability_csv(&report.rows))?;
        store::write(&folder.join("stability.svg"), sheet.to_svg().as_bytes())?;
        store::write(&folder.join("stability.png"), &sheet.to_png())?;
        store::write(&folder.join("index.html"), report.to_html().as_bytes())
    })?;
    let seconds = started.elapsed().as_secs_f64();
    let [page, png, svg, csv] = ["index.html", "stability.png", "stability.svg", "stability.csv"]
        .map(|name| common::said(&args.out.join(name)));
    let text = format!(
        "{} materials, {} points in {seconds:.0} s\npage: {page}\npicture: {png}\n         {svg}\ntable: {csv}",
        report.materials,
        report.rows.len()
    );
    let json = serde_json::json!({
        "page": page, "png": png, "svg": svg, "csv": csv,
        "materials": report.materials, "rows": report.rows.len(), "seconds": seconds,
    });
    Ok(Report { text, json })
}

/// Steps of profiles.
const STEPS: [usize; 5] = [30, 100, 1000, 10_000, 100_000];
/// Heights of samples, mm.
const HEIGHTS_MM: [f64; 5] = [0.05, 0.1, 0.2, 1.0, 2.0];
/// The gray card and a glossy material.
const RAISED: [&str; 2] = ["gray-card", "ggx-0.1"];
const SMALL_PUPIL: &str = include_str!("../../../optics/ghosh-2007-seed-projector.toml");

fn optics(args: &Args) -> anyhow::Result<Report> {
    let started = Instant::now();
    common::makeable(&args.out)?;
    store::vacant(&args.out)?;
    let rig = Rig::from_toml(RIG)?;
    let mirrors = rig.mirrors();
    let mut profiles = Vec::new();
    for method in ProfileMethod::ALL {
        for steps in STEPS {
            let timed = |_| {
                let begun = Instant::now();
                std::hint::black_box(method.points(&mirrors, steps));
                begun.elapsed().as_secs_f64()
            };
            let seconds = (0..5).map(timed).fold(f64::INFINITY, f64::min);
            let error = ProfileError::of(method, &mirrors, steps);
            let closed = method == ProfileMethod::ClosedForm;
            let distance_mm = if closed { mirrors.path_variation(steps) } else { error.distance_mm };
            profiles.push(ProfileRow {
                method: method.name(),
                steps,
                distance_mm,
                slope_arcsec: error.slope_arcsec,
                seconds,
            });
        }
    }
    let mut heights = Vec::new();
    for text in [RIG, SMALL_PUPIL] {
        let rig = Rig::from_toml(text)?;
        for name in RAISED {
            let material = common::material(name)?;
            let errors = height_errors(&rig, material.brdf.as_ref(), 2, &HEIGHTS_MM)?;
            let errors = errors.context("a ray of a pupil misses a mirror of a built-in rig")?;
            heights.push(HeightRow { rig: rig.name.clone(), material: name.into(), errors });
        }
    }
    let report = OpticsReport { profiles, heights };
    let sheet = report.sheet();
    store::write_dir(&args.out, |folder| {
        store::write(&folder.join("optics.csv"), &report.to_csv())?;
        store::write(&folder.join("optics.svg"), sheet.to_svg().as_bytes())?;
        store::write(&folder.join("optics.png"), &sheet.to_png())?;
        store::write(&folder.join("index.html"), report.to_html().as_bytes())
    })?;
    let seconds = started.elapsed().as_secs_f64();
    let mut json = serde_json::to_value(&report)?;
    let [page, png, svg, csv] =
        ["index.html", "optics.png", "optics.svg", "optics.csv"].map(|name| common::said(&args.out.join(name)));
    let mut text: Vec<String> = report
        .profiles
        .iter()
        .map(|p| {
            let (name, steps, mm, arcsec, ms) = (p.method, p.steps, p.distance_mm, p.slope_arcsec, 1e3 * p.seconds);
            format!("{name:12} {steps:6} steps: {mm:.2e} mm, {arcsec:.2e} arc seconds, {ms:.3} ms")
        })
        .collect();
    for h in &report.heights {
        for e in &h.errors {
            let (mm, of_one, of_all, lit) = (e.height_mm, 100.0 * e.largest_rel, 100.0 * e.total_rel, e.lit_share);
            text.push(format!(
                "{} on {}, {mm} mm too high: {of_one:.3}% of z_00 in one coefficient, {of_all:.3}% in all; {lit:.2} lit",
                h.material, h.rig
            ));
        }
    }
    text.push(format!("page: {page}\npicture: {png}\n         {svg}\ntable: {csv}"));
    for (key, value) in [("page", page), ("png", png), ("svg", svg), ("csv", csv)] {
        json[key] = value.into();
    }
    json["seconds"] = seconds.into();
    Ok(Report { text: text.join("\n"), json })
}

/// Published SGD materials, of all classes, that are none of the families fitted.
const PARETO_MATERIALS: [&str; 5] =
    ["red-fabric2", "yellow-matte-plastic", "blue-metallic-paint", "violet-acrylic", "chrome-steel"];
const RIG: &str = include_str!("../../../optics/ghosh-2007-built.toml");

fn pareto(args: &Args) -> anyhow::Result<Report> {
    let started = Instant::now();
    common::makeable(&args.out)?;
    store::vacant(&args.out)?;
    let rig = Rig::from_toml(RIG)?;
    let config = TwinConfig::pinhole(args.seed);
    let calibration = common::calibration(None, &rig, Some(&config), None)?;
    let known = sgd_materials();
    let materials: Vec<(String, Arc<dyn Brdf>)> = PARETO_MATERIALS
        .into_iter()
        .take(args.materials)
        .filter_map(|name| known.iter().find(|m| m.name == name))
        .map(|m| (m.name.clone(), Arc::new(m.brdf) as Arc<dyn Brdf>))
        .collect();
    let scan = ParetoScan {
        rig: &rig,
        calibration: &calibration,
        config: &config,
        materials: &materials,
        pairs: usize::from(args.max_order.min(6)),
        plans: pareto_plans(),
        computing: true,
    };
    let report = scan.run(&mut common::frames_bar("pareto"))?.report;
    let sheet = report.sheet();
    store::write_dir(&args.out, |folder| {
        store::write(&folder.join("pareto.csv"), &report.to_csv())?;
        store::write(&folder.join("pareto.svg"), sheet.to_svg().as_bytes())?;
        store::write(&folder.join("pareto.png"), &sheet.to_png())?;
        store::write(&folder.join("index.html"), report.to_html().as_bytes())
    })?;
    let seconds = started.elapsed().as_secs_f64();
    let [page, png, svg, csv] =
        ["index.html", "pareto.png", "pareto.svg", "pareto.csv"].map(|name| common::said(&args.out.join(name)));
    let run = report.plans.iter().filter(|p| p.measured.is_some()).count();
    let text = format!(
        "{} plans, {run} of them run on {} materials, in {seconds:.0} s\npage: {page}\npicture: {png}\n         {svg}\ntable: {csv}",
        report.plans.len(),
        materials.len()
    );
    let json = serde_json::json!({
        "page": page, "png": png, "svg": svg, "csv": csv, "materials": report.materials,
        "plans": report.plans, "seed": report.seed, "computing": report.computing, "seconds": seconds,
    });
    Ok(Report { text, json })
}

fn control(args: &Args) -> anyhow::Result<Report> {
    common::makeable(&args.out)?;
    store::vacant(&args.out)?;
    let least = 3;
    if args.runs.len() < least {
        return Err(MeasureError::TooFew { found: args.runs.len(), least, purpose: "draw a control chart" }.into());
    }
    let read = |run: &PathBuf| -> anyhow::Result<ControlRun> {
        let (record, coefficients) = common::run(run)?;
        if let Some(began) = &record.provenance.started {
            let date: Result<jiff::Timestamp, _> = began.parse();
            date.with_context(|| format!("{}: `started`", run.join("run.json").display()))?;
        }
        Ok(ControlRun::new(common::said(run), record.provenance.started, &coefficients))
    };
    let runs = args.runs.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    let report = ControlReport::new(runs, args.baseline.min(args.runs.len()));
    let sheet = report.sheet();
    store::write_dir(&args.out, |folder| {
        store::write(&folder.join("control.csv"), &report.to_csv())?;
        store::write(&folder.join("control.svg"), sheet.to_svg().as_bytes())?;
        store::write(&folder.join("control.png"), &sheet.to_png())?;
        store::write(&folder.join("index.html"), report.to_html().as_bytes())
    })?;
    let [page, png, svg, csv] =
        ["index.html", "control.png", "control.svg", "control.csv"].map(|name| common::said(&args.out.join(name)));
    let flagged = report.flagged();
    let mut text = format!("{} runs, {} out of control", report.runs.len(), flagged.len());
    for (i, said) in &flagged {
        text += &format!("\n  {}: {said}", report.runs[*i].run);
    }
    text += &format!("\npage: {page}\npicture: {png}\n         {svg}\ntable: {csv}");
    let flagged: Vec<_> = flagged
        .iter()
        .map(|(i, said)| serde_json::json!({ "run": report.runs[*i].run, "number": i + 1, "signals": said }))
        .collect();
    let json = serde_json::json!({
        "page": page, "png": png, "svg": svg, "csv": csv,
        "runs": report.runs, "series": report.series, "baseline": report.baseline, "flagged": flagged,
    });
    Ok(Report { text, json })
}

fn at_least_two(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n) if n > 1 => Ok(n),
        _ => Err("give a whole number of at least 2".into()),
    }
}

fn at_least_one(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n) if n > 0 => Ok(n),
        _ => Err("give a whole number of at least 1".into()),
    }
}
