//! `zonal chart`.

use std::path::PathBuf;
use std::time::Instant;

use clap::ValueEnum;
use zonal::convert::{PriorTable, Scan, stability_csv};
use zonal::report::StabilityReport;
use zonal::store;

use crate::common::{self, Report};

#[derive(Clone, Copy, ValueEnum)]
enum Name {
    /// Where each method of conversion fails: order, zone, noise.
    Stability,
}

#[derive(clap::Args)]
pub struct Args {
    /// What to chart.
    name: Name,
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
        Name::Stability => stability(args),
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

fn at_least_one(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n) if n > 0 => Ok(n),
        _ => Err("give a whole number of at least 1".into()),
    }
}
