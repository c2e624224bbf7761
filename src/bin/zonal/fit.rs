//! `zonal fit`.

use std::path::PathBuf;

use zonal::fit::{CalibrationUncertainty, FitMethod, FitOptions, FitReport, fit};
use zonal::measure::RunRecord;

use crate::common::{self, BadUsage, Report};

#[derive(clap::Args)]
pub struct Args {
    /// Run folder.
    run: PathBuf,
    /// thesis | ggx-to-reconstruction | lambert | ggx | abc | ggx2 | dbrdf | mixture | auto
    #[arg(long, default_value = "auto")]
    model: String,
    /// Zonal order to use, at most the run's.
    #[arg(long, allow_negative_numbers = true)]
    order: Option<usize>,
    /// Standard error of the zone's edges, degrees; by default that of the run's budget.
    #[arg(long, allow_negative_numbers = true)]
    edge_deg: Option<f64>,
    /// Relative standard error of the channels' scale; by default that of the run's budget.
    #[arg(long, allow_negative_numbers = true)]
    scale_rel: Option<f64>,
    /// JSON file to write.
    #[arg(long)]
    out: PathBuf,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let method: FitMethod = args.model.parse()?;
    let out = common::writable(&args.out)?;
    if out.extension().and_then(|e| e.to_str()) != Some("json") {
        return Err(BadUsage(format!("{}: fits are .json files: name one", out.display())).into());
    }
    for (flag, value, most) in [("--edge-deg", args.edge_deg, 2.0), ("--scale-rel", args.scale_rel, 0.5)] {
        let Some(value) = value else { continue };
        if !(0.0..=most).contains(&value) {
            return Err(BadUsage(format!("{flag} {value} is out of range: choose 0..={most}")).into());
        }
    }
    let coefficients = common::coefficients(&args.run, args.order)?;
    let known = CalibrationUncertainty::of(&RunRecord::read(&args.run)?);
    let calibration = CalibrationUncertainty {
        edge_deg: args.edge_deg.unwrap_or(known.edge_deg),
        scale_rel: args.scale_rel.unwrap_or(known.scale_rel),
    };
    let report = fit(&coefficients, method, &FitOptions { calibration, start: None })?;
    report.write(&out)?;
    for warning in &report.warnings {
        eprintln!("warning: {warning}");
    }
    let mut json = serde_json::to_value(&report)?;
    json["out"] = common::said(&out).into();
    Ok(Report { text: text(&report, &out.display().to_string()), json })
}

fn text(report: &FitReport, out: &str) -> String {
    let mut text = format!(
        "{} of order {}: chi {:.2}, misses by {:.2}% of z_00 (noise {:.2}%); {:.2} s",
        report.model,
        report.order,
        report.chi,
        100.0 * report.misfit_rel,
        100.0 * report.noise_rel,
        report.fit_s
    );
    if let Some(selection) = &report.selection {
        text += &format!("\n{}", selection.reason);
    }
    for (name, value) in &report.parameters {
        text += &match report.standard_errors.get(name).copied().flatten() {
            Some(error) => format!("\n  {name:16} {value:12.5} +- {error:.5}"),
            None => format!("\n  {name:16} {value:12.5}"),
        };
    }
    text + &format!("\n{out}")
}
