//! `zonal chart`.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use clap::ValueEnum;
use zonal::convert::{PriorTable, Scan, stability_csv};
use zonal::measure::{ControlRun, MeasureError};
use zonal::optics::Rig;
use zonal::reflectance::{Brdf, sgd_materials};
use zonal::report::{ControlReport, ParetoScan, StabilityReport, pareto_plans};
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
        Name::Stability | Name::Pareto if !args.runs.is_empty() => {
            let name = args.name.to_possible_value().expect("none is hidden");
            Err(BadUsage(format!("`chart {}` takes no runs: leave them out", name.get_name())).into())
        }
        Name::Pareto => pareto(args),
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
    let calibration = common::calibration(None, &rig, &config, None)?;
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
