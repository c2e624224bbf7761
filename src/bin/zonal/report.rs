//! `zonal report`.

use std::path::PathBuf;

use serde_json::json;
use zonal::fit::FitMethod;
use zonal::report::{MethodFit, RunReport};
use zonal::store;

use crate::common::{self, Report};

#[derive(clap::Args)]
pub struct Args {
    /// Run folder.
    run: PathBuf,
    /// What was measured, where it is known: a measured file (.bsdf, .binary, .dat) or a name of `zonal materials`.
    #[arg(long, value_name = "FILE|NAME")]
    truth: Option<String>,
    /// HTML page to write; RUN/report.html if not given.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Model the page is about: auto, or one of its families or baselines.
    #[arg(long, default_value_t = FitMethod::Auto)]
    model: FitMethod,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let (record, coefficients) = common::run(&args.run)?;
    let out = common::writable(&args.out.clone().unwrap_or_else(|| args.run.join("report.html")))?;
    let truth = args.truth.as_deref().map(common::material).transpose()?;
    let truth = args.truth.as_deref().zip(truth.as_ref().map(|truth| truth.brdf.as_ref()));
    let page = RunReport::new(record, &coefficients, args.model, truth)?;
    store::write(&out, page.to_html().as_bytes())?;

    let chosen = page.fits.chosen();
    let mut text = format!("{}: chi {:.2}, misfit {:.2}% of z_00", chosen.model, chosen.chi, 100.0 * chosen.misfit_rel);
    if let Some(errors) = &page.fits.of(args.model).errors {
        let e = &errors.mean;
        text += &format!("; error of f_cos {:.1}% in the zone, {:.1}% outside", 100.0 * e.rel_in, 100.0 * e.rel_out);
    }
    for warning in &chosen.warnings {
        text += &format!("\nwarning: {warning}");
    }
    text += &format!("\npage: {}", out.display());
    let json = json!({
        "page": common::said(&out),
        "model": chosen.model,
        "requested": args.model,
        "warnings": chosen.warnings,
        "methods": page.fits.all.iter().map(method).collect::<Vec<_>>(),
    });
    Ok(Report { text, json })
}

/// One method for programs; errors are null where no truth is known.
fn method(f: &MethodFit) -> serde_json::Value {
    let r = &f.report;
    json!({
        "method": r.requested,
        "model": r.model,
        "errors": f.errors.map(|e| e.mean),
        "chi": r.chi,
        "misfit_rel": r.misfit_rel,
        "successful": r.successful,
        "fit_s": r.fit_s,
    })
}
