//! `zonal budget`.

use std::path::PathBuf;

use serde_json::json;
use zonal::measure::{Budget, Kind, MeasureError, Remounts, budget_of, remounts};

use crate::common::{self, Report};

#[derive(clap::Args)]
pub struct Args {
    /// Run folder; several runs of one sample, each mounted anew, show how remounts scatter.
    #[arg(required = true)]
    runs: Vec<PathBuf>,
    /// TOML file whose section [budget] states what rig, card and mount are known to, instead of the run's own.
    #[arg(long, value_name = "FILE")]
    budget: Option<PathBuf>,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let given = args.budget.as_deref().map(|path| common::assumptions(Some(path))).transpose()?;
    let all = args.runs.iter().map(|run| budget_of(run, given.as_ref())).collect::<Result<Vec<_>, _>>()?;
    let of = |i: usize| (all[i].0.provenance.sample_name(), &all[i].0.rig);
    if let Some(i) = (1..all.len()).find(|&i| of(i) != of(0)) {
        return Err(MeasureError::Unlike { path: args.runs[i].clone(), what: "sample or rig" }.into());
    }
    let (record, first) = &all[0];
    if all.len() == 1 {
        let json = json!({ "run": common::said(&args.runs[0]), "sample": of(0).0, "budget": first });
        return Ok(Report { text: text(first), json });
    }
    let budgets: Vec<Budget> = all.iter().map(|(_, budget)| budget.clone()).collect();
    let seen = remounts(&budgets)?;
    let assumed = zonal::measure::Assumptions { remount_rel: Some(seen.remount_rel), ..first.assumed.clone() };
    let (_, budget) = budget_of(&args.runs[0], Some(&assumed))?;
    let runs: Vec<_> = args.runs.iter().map(|run| common::said(run)).collect();
    let text = format!("{}\n{} with this scatter:\n{}", scatter(&seen), args.runs[0].display(), self::text(&budget));
    let json = json!({ "runs": runs, "sample": record.provenance.sample_name(), "remounts": seen, "budget": budget });
    Ok(Report { text, json })
}

/// How remounts scatter, in a line.
pub fn scatter(seen: &Remounts) -> String {
    let percent = |rel: [f64; 3]| rel.map(|r| format!("{:.3}%", 100.0 * r)).join(" ");
    format!(
        "{} remounts scatter by {} (R G B), of which noise {}; remounting {:.3}% (+-{:.0}% of itself)",
        seen.runs,
        percent(seen.scatter_rel),
        percent(seen.noise_rel),
        100.0 * seen.remount_rel,
        100.0 / (2.0 * (seen.runs - 1) as f64).sqrt()
    )
}

/// A budget as a table.
pub fn text(budget: &Budget) -> String {
    let a = &budget.albedo;
    let channel = |c: usize| {
        let [low, high] = a.interval_95[c];
        format!("{:.5} ({low:.5}..{high:.5})", a.value[c])
    };
    let mut text = format!("albedo of the zone, R G B with 95% intervals: {}", [0, 1, 2].map(channel).join("  "));
    for c in &budget.components {
        let kind = match c.kind {
            Kind::Random => "random",
            Kind::Azimuthal => "azimuthal",
            Kind::Channel => "channel",
            Kind::Common => "common",
        };
        let relative = c.relative.map(|r| format!("{:7.3}", 100.0 * r)).join("");
        text += &format!("\n  {:24} {kind:10}{relative} %  {}", c.name, c.source);
    }
    let systematic = budget.systematic_rel.map(|r| format!("{:7.3}", 100.0 * r)).join("");
    text + &format!("\n  {:35}{systematic} %  common to all coefficients of a channel", "systematic")
}
