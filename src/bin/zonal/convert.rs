//! `zonal convert`.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::ValueEnum;
use zonal::basis::{Method, Rule};
use zonal::convert::{self, PriorTable};
use zonal::export::ShMaterial;
use zonal::reduce::Coefficients;
use zonal::store;

use crate::both_sides;
use crate::common::{self, BadUsage, Report};

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum MethodArg {
    /// The literal dual basis of the thesis; refused where its noise explodes.
    Thesis,
    /// The dual with the small eigenvalues cut.
    Truncated,
    /// Combinations of harmonics that lie in the zone.
    Slepian,
    /// Harmonics that vanish at the horizon, up to the next order.
    Parity,
    /// The same up to a higher order, smooth.
    Tikhonov,
    /// The dual basis of hemispherical harmonics.
    Hsh,
    /// What other materials show outside the zone that look alike in it; isotropic samples.
    Prior,
}

#[derive(Clone, Copy, ValueEnum)]
enum RuleArg {
    /// Nothing is held back where the zone says enough, elsewhere as by `gcv`.
    Auto,
    /// Discrepancy principle: what is left out equals the noise.
    Discrepancy,
    /// Generalised cross-validation.
    Gcv,
}

impl From<RuleArg> for Rule {
    fn from(arg: RuleArg) -> Self {
        match arg {
            RuleArg::Auto => Rule::Auto,
            RuleArg::Discrepancy => Rule::Discrepancy,
            RuleArg::Gcv => Rule::Gcv,
        }
    }
}

impl MethodArg {
    /// The linear method, or none for the prior.
    fn linear(self) -> Option<Method> {
        match self {
            MethodArg::Thesis => Some(Method::Thesis),
            MethodArg::Truncated => Some(Method::Truncated),
            MethodArg::Slepian => Some(Method::Slepian),
            MethodArg::Parity => Some(Method::Parity),
            MethodArg::Tikhonov => Some(Method::Tikhonov),
            MethodArg::Hsh => Some(Method::Hsh),
            MethodArg::Prior => None,
        }
    }
}

#[derive(clap::Args)]
pub struct Args {
    /// Run folder.
    run: PathBuf,
    /// How values outside the zone are found.
    #[arg(long, default_value = "parity")]
    method: MethodArg,
    /// Zonal order to use, at most the run's.
    #[arg(long, allow_negative_numbers = true)]
    order: Option<usize>,
    /// How `truncated` and `tikhonov` choose how much to hold back.
    #[arg(long, default_value = "auto")]
    rule: RuleArg,
    /// Table of `--method prior`, from `zonal prior`; the built-in one unless given.
    #[arg(long, value_name = "FILE")]
    prior: Option<PathBuf>,
    /// OpenEXR file to write.
    #[arg(long)]
    out: PathBuf,
    /// Convert even where noise exceeds the signal.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    both: both_sides::Args,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let out = common::writable(&args.out)?;
    let coefficients = common::coefficients(&args.run, args.order)?;
    // Of an adaptive run the last degree may hold some functions only.
    let coefficients = coefficients.truncated(coefficients.complete_order());
    let order = coefficients.order;
    let Some(method) = args.method.linear() else {
        if args.both.both_sides {
            return Err(BadUsage("--both-sides takes a linear method: use `--method parity`".into()).into());
        }
        return by_prior(args, &coefficients, &out);
    };
    if args.both.both_sides {
        if method == Method::Hsh {
            return Err(BadUsage("--both-sides is written in spherical harmonics: use `--method parity`".into()).into());
        }
        return both_sides::run(&args.both, &coefficients, method, args.force, &out);
    }
    let conversion = convert::tuned(&coefficients, method, args.rule.into())?;
    if !args.force {
        conversion.check(coefficients.noise_rel())?;
    }
    let material = ShMaterial::new(&coefficients, &conversion);
    material.write(&out)?;
    let said = Said {
        condition: conversion.condition,
        noise_gains: [conversion.noise_gain_in, conversion.noise_gain_out],
        detail: convert::strength_text(conversion.strength),
        surprise: None,
    };
    Ok(said.report(&material, coefficients.noise_rel(), order, &out))
}

fn by_prior(args: &Args, coefficients: &Coefficients, out: &Path) -> anyhow::Result<Report> {
    let table = match &args.prior {
        None => PriorTable::built_in(),
        Some(path) => PriorTable::from_toml(&store::read_text(path)?).with_context(|| path.display().to_string())?,
    };
    let (converted, findings) = convert::prior(coefficients, &table)?;
    let material = ShMaterial::from(converted);
    material.write(out)?;
    let unlike = if findings.surprise > UNLIKE {
        ": unlike all of them, so do not trust what lies outside the zone"
    } else {
        ""
    };
    let said = Said {
        condition: findings.condition,
        noise_gains: [findings.noise_gain_in, findings.noise_gain_out],
        detail: format!(
            "differs from {} known materials by {:.1} times their own spread{unlike}",
            table.materials.len(),
            findings.surprise.sqrt()
        ),
        surprise: Some(findings.surprise),
    };
    Ok(said.report(&material, coefficients.noise_rel(), coefficients.order, out))
}

/// Variance over the population's from which on a sample is like none of its members.
const UNLIKE: f64 = 30.0;

/// What every method has to say.
struct Said {
    condition: f64,
    noise_gains: [f64; 2],
    detail: String,
    surprise: Option<f64>,
}

impl Said {
    fn report(&self, material: &ShMaterial, noise_rel: f64, order: usize, out: &Path) -> Report {
        let [noise_gain_in, noise_gain_out] = self.noise_gains;
        let share = material.mean_data_share();
        let text = format!(
            "{} at order {order}: condition {:.2e}, noise gain {noise_gain_in:.3} in and {noise_gain_out:.3} out of the zone; \
             {:.0}% data; {}; {}",
            material.method,
            self.condition,
            100.0 * share,
            self.detail,
            out.display()
        );
        let json = serde_json::json!({
            "method": material.method,
            "order": order,
            "sh_order": material.order(),
            "condition": self.condition,
            "noise_gain_in": noise_gain_in,
            "noise_gain_out": noise_gain_out,
            "noise_rel": noise_rel,
            "data_share": share,
            "detail": self.detail,
            "surprise": self.surprise,
            "out": common::said(out),
        });
        Report { text, json }
    }
}
