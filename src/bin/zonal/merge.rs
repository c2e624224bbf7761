//! `zonal merge`.

use std::path::PathBuf;

use zonal::measure::merge;

use crate::budget::{scatter, text};
use crate::common::{self, Report};

#[derive(clap::Args)]
pub struct Args {
    /// Run folders of one sample, each measured with the angle of its grain (`measure --grain-deg`).
    #[arg(required = true)]
    runs: Vec<PathBuf>,
    /// Run folder to create: the sample with its grain at 0.
    #[arg(long)]
    out: PathBuf,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    common::makeable(&args.out)?;
    let merged = merge(&args.runs, &args.out)?;
    let each = merged.run_chi2.iter().map(|x| format!("{x:.2}")).collect::<Vec<_>>().join(" ");
    let mut said = format!(
        "{} runs merged; chi squared over freedom {:.2} (by run: {each})\n{}\n",
        args.runs.len(),
        merged.reduced_chi2,
        scatter(&merged.remounts)
    );
    if let Some(budget) = &merged.record.budget {
        said += &text(budget);
    }
    said += &format!("\ncoefficients.exr and run.json in {}", args.out.display());
    let mut json = serde_json::to_value(&merged)?;
    json["out"] = common::said(&args.out).into();
    Ok(Report { text: said, json })
}
