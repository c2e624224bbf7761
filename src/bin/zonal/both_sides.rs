//! `zonal convert --both-sides`.

use std::path::Path;

use clap::ValueEnum;
use serde_json::json;
use zonal::basis::{Conversion, Method, reciprocity};
use zonal::export::{TensorMaterial, both_sides};
use zonal::fit::{CalibrationUncertainty, Observations};
use zonal::reduce::Coefficients;

use crate::common::{self, Report};

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum ReciprocityArg {
    /// Impose it where the data pass the test.
    Auto,
    /// Impose it; refused where the data fail the test.
    Impose,
    /// Leave the data as they are.
    Ignore,
}

#[derive(clap::Args)]
pub struct Args {
    /// Expand exitant directions too, which extrapolates them beyond the zone.
    #[arg(long)]
    pub both_sides: bool,
    /// What to make of f(wi, wo) = f(wo, wi).
    #[arg(long, default_value = "auto", requires = "both_sides")]
    reciprocity: ReciprocityArg,
    /// Zonal order of exitant directions; that of incident ones unless told otherwise.
    #[arg(long, requires = "both_sides", allow_negative_numbers = true)]
    exitant_order: Option<usize>,
}

pub fn run(
    args: &Args,
    coefficients: &Coefficients,
    method: Method,
    force: bool,
    out: &Path,
) -> anyhow::Result<Report> {
    let (zone, order) = (coefficients.grid.zone(), coefficients.order);
    let exitant_order = args.exitant_order.unwrap_or(order);
    let (incident, exitant) = (Conversion::new(method, zone, order)?, Conversion::new(method, zone, exitant_order)?);
    let seen = Observations::of(coefficients);
    let mut tensors = both_sides(coefficients, exitant_order, seen.folded, &CalibrationUncertainty::default())?;
    let test = reciprocity(&tensors)?;
    let impose = match args.reciprocity {
        ReciprocityArg::Auto => test.holds(),
        ReciprocityArg::Impose if force => true,
        ReciprocityArg::Impose => test.check().map(|()| true)?,
        ReciprocityArg::Ignore => false,
    };
    let gains: Vec<f64> = tensors.iter_mut().map(|t| if impose { t.impose_reciprocity() } else { 1.0 }).collect();
    let gain = gains.iter().sum::<f64>() / gains.len() as f64;
    let noise_rel = tensors.iter().map(|t| t.noise_rel()).fold(0.0, f64::max);
    if !force {
        // Noise is amplified once on each side.
        incident.check(noise_rel * exitant.noise_gain_out.max(1.0))?;
    }
    let material = TensorMaterial::new(&tensors, &incident, &exitant, zone, coefficients.history.clone())?;
    material.write(out)?;
    let text = format!(
        "{} at orders {order} and {exitant_order} on both sides: condition {:.2e}, noise gain {:.3} in and {:.3} out of the \
         zone, for each side\n{}; antisymmetric {:.2}%, expected {:.2}% (p = {:.2}): {}\n{}",
        method.name(),
        incident.condition,
        incident.noise_gain_in,
        incident.noise_gain_out,
        if seen.folded { "isotropic" } else { "anisotropic" },
        100.0 * test.violation,
        100.0 * test.expected,
        test.p,
        if impose {
            format!("reciprocity imposed, variance {gain:.2} times smaller")
        } else {
            "reciprocity not imposed".into()
        },
        out.display()
    );
    let json = json!({
        "method": method.name(),
        "order": order,
        "exitant_order": exitant_order,
        "sh_order": incident.sh_order,
        "exitant_sh_order": exitant.sh_order,
        "condition": incident.condition,
        "noise_gain_in": incident.noise_gain_in,
        "noise_gain_out": incident.noise_gain_out,
        "noise_rel": noise_rel,
        "isotropic": seen.folded,
        "anisotropy": seen.anisotropy,
        "reciprocity": {
            "violation": test.violation,
            "expected": test.expected,
            "chi2": test.chi2,
            "freedom": test.freedom,
            "p": test.p,
            "holds": test.holds(),
            "imposed": impose,
            "variance_gain": gain,
        },
        "out": common::said(out),
    });
    Ok(Report { text, json })
}
