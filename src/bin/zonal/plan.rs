//! `zonal plan`.

use std::path::PathBuf;

use anyhow::Context;
use clap::ValueEnum;
use zonal::forecast::{Class, Forecast, NoiseModel, Outlook, adaptive_plan, best_plan, candidates};
use zonal::optics::Rig;
use zonal::patterns::{Plan, Timing};
use zonal::store;

use crate::common::{self, BadUsage, Report};

#[derive(clap::Args)]
pub struct Args {
    /// Rig file.
    rig: PathBuf,
    /// Plan file.
    plan: PathBuf,
    /// Find the plan that makes the most of so many seconds on the rig; exitant directions and colours are those of PLAN.
    #[arg(long, value_name = "SECONDS")]
    budget: Option<f64>,
    /// With --budget, plans for any sample; otherwise those for isotropic ones are tried too.
    #[arg(long, requires = "budget")]
    any_sample: bool,
    /// With --budget, a plan that takes what the sample needs, of so many seconds at most: from 20 s on it does better on
    /// measured materials than any that is fixed before, with 5 s worse.
    #[arg(long, requires = "budget", conflicts_with = "any_sample")]
    adaptive: bool,
    /// Class of materials that the error is forecast for.
    #[arg(long, value_enum, default_value_t = ClassName::Any)]
    class: ClassName,
    /// Plan file to write, with --budget.
    #[arg(long, requires = "budget")]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum ClassName {
    /// All of them.
    Any,
    /// No lobe to speak of.
    Matte,
    /// A wide lobe.
    Satin,
    /// A narrow lobe on a diffuse ground.
    Glossy,
    /// A lobe that outshines the rest.
    Specular,
}

impl ClassName {
    fn class(self) -> Class {
        match self {
            Self::Any => Class::Any,
            Self::Matte => Class::Matte,
            Self::Satin => Class::Satin,
            Self::Glossy => Class::Glossy,
            Self::Specular => Class::Specular,
        }
    }
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let rig = common::rig(&args.rig)?;
    let given = common::plan(&args.plan)?;
    let timing = Timing::of(&rig);
    let noise = NoiseModel::new(&rig, &given)?;
    let class = args.class.class();
    let (plan, forecast) = match args.budget {
        Some(budget_s) if !(budget_s > 0.0 && budget_s.is_finite()) => {
            return Err(BadUsage(format!("--budget {budget_s}: choose a number of seconds above 0")).into());
        }
        Some(budget_s) if args.adaptive => {
            let plan = adaptive_plan(&given, &timing, budget_s)?;
            plan.check().context("--budget")?;
            let forecast = Outlook::built_in().forecast(&noise, &timing, &plan, class)?;
            (plan, forecast)
        }
        Some(budget_s) => best_plan(&noise, &timing, candidates(&given, args.any_sample), budget_s, class)?,
        None => {
            let forecast = Outlook::built_in().forecast(&noise, &timing, &given, class)?;
            (given, forecast)
        }
    };
    if let Some(out) = &args.out {
        store::write(&common::writable(out)?, plan.to_toml().as_bytes())?;
    }
    Ok(report(&rig, &plan, &forecast, class, args))
}

fn report(rig: &Rig, plan: &Plan, forecast: &Forecast, class: Class, args: &Args) -> Report {
    let timing = Timing::of(rig);
    let items = &forecast.rig_s_items;
    let exposures: Vec<String> = plan.exposures_s(&timing).iter().map(|e| format!("{:.1}", e * 1e3)).collect();
    let mut text = format!(
        "{} on {}: {} images x {} exposures ({} ms) x {} = {} frames\n{:.1} s on the rig: {:.1} s exposure, {:.1} s readout wait, {:.1} s pattern change\n\
         scheme {}, noise {:.2}% of z_00; error expected for {} materials: {:.1}%",
        plan.name,
        rig.name,
        plan.images(),
        exposures.len(),
        exposures.join(", "),
        plan.repeats,
        plan.frames(),
        items.total_s(),
        items.exposure_s,
        items.readout_wait_s,
        items.pattern_change_s,
        plan.scheme,
        100.0 * forecast.noise_rel,
        class.name(),
        100.0 * forecast.error,
    );
    if let Some(target) = &plan.automatic {
        text += &format!(
            "\nas many exposures of {} to {} refresh periods are taken as noise of {}% needs: this is the time of two for each lobe",
            target.shortest_refreshes,
            target.longest_refreshes,
            100.0 * target.noise_rel
        );
    }
    if let Some(adaptive) = &plan.adaptive {
        text += &format!(
            "\nadaptive: this is the least, order 2; it goes on up to order {} while a step saves {}% of the error",
            plan.order,
            100.0 * adaptive.gain_rel
        );
        if let Some(limit_s) = adaptive.limit_s {
            text += &format!(" and no longer than {limit_s} s");
        }
    }
    if let Some(out) = &args.out {
        text += &format!("\nplan: {}", out.display());
    }
    let json = serde_json::json!({
        "name": plan.name,
        "order": plan.order,
        "scheme": plan.scheme,
        "images": plan.images(),
        "frames": plan.frames(),
        "repeats": plan.repeats,
        "rig_s": forecast.rig_s,
        "rig_s_items": items,
        "noise_rel": forecast.noise_rel,
        "class": class,
        "predicted_error": forecast.error,
        "out": args.out.as_deref().map(common::said),
    });
    Report { text, json }
}
