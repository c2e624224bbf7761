//! The plan that makes the most of some seconds.

use rayon::prelude::*;

use super::NoiseModel;
use super::outlook::{Class, Forecast, NoPlan, Outlook};
use crate::patterns::{Adaptive, ExposureBracket, Plan, Scheme, Timing};

/// Highest order of plans that are tried.
const HIGHEST: usize = 10;
/// Brackets that are tried: refresh periods of the shortest exposure, ratio, number. The shortest holds the brightest lobes.
const BRACKETS: [(u32, u32, u32); 4] = [(1, 4, 1), (1, 4, 2), (1, 16, 2), (1, 4, 3)];
/// Repeats that are tried.
const REPEATS: [usize; 6] = [1, 2, 3, 4, 6, 8];

/// All plans worth a thought for samples that are isotropic, or for any; exitant directions and colours are those of `like`.
pub fn candidates(like: &Plan, any_sample: bool) -> Vec<Plan> {
    let schemes = Scheme::ALL.into_iter().filter(|s| !(any_sample && s.is_isotropic()));
    let mut plans = Vec::new();
    for scheme in schemes {
        for order in (0..=HIGHEST).filter(|&order| scheme.step_count(order).is_ok()) {
            for (shortest_refreshes, spacing, count) in BRACKETS {
                for repeats in REPEATS {
                    let exposure = Some(ExposureBracket { count, shortest_refreshes, spacing });
                    let plan = Plan::of_order(order).by(scheme);
                    let name = format!("{}-{count}x{repeats}", plan.name);
                    plans.push(Plan { name, repeats, exposure, exitant: like.exitant, colour: like.colour, ..plan });
                }
            }
        }
    }
    plans
}

/// An adaptive plan that stays within `budget_s` seconds on the rig, decisions among them; exitant directions and colours are those
/// of `like`.
///
/// # Errors
/// [`NoPlan`] if its first step alone takes longer.
pub fn adaptive_plan(like: &Plan, timing: &Timing, budget_s: f64) -> Result<Plan, NoPlan> {
    let adaptive = Adaptive { limit_s: Some(budget_s), ..Adaptive::default() };
    let plan = Plan { exitant: like.exitant, colour: like.colour, ..Plan::of_order(HIGHEST) }.adapted(adaptive);
    let least_s = plan.rig_time(timing).total_s();
    if least_s > budget_s { Err(NoPlan { budget_s, least_s }) } else { Ok(plan) }
}

/// The plan of at most `budget_s` seconds that is expected to leave the least error for a class; of equals the fastest.
///
/// # Errors
/// [`NoPlan`].
pub fn best_plan(
    noise: &NoiseModel,
    timing: &Timing,
    plans: Vec<Plan>,
    budget_s: f64,
    class: Class,
) -> Result<(Plan, Forecast), NoPlan> {
    let times: Vec<f64> = plans.iter().map(|p| p.rig_time(timing).total_s()).collect();
    let least_s = times.iter().copied().fold(f64::INFINITY, f64::min);
    let within: Vec<Plan> = plans.into_iter().zip(&times).filter(|(_, t)| **t <= budget_s).map(|(p, _)| p).collect();
    let outlook = Outlook::built_in();
    let forecast = |plan: Plan| outlook.forecast(noise, timing, &plan, class).ok().map(|f| (plan, f));
    let known: Vec<(Plan, Forecast)> = within.into_par_iter().filter_map(forecast).collect();
    let order = |(_, a): &(Plan, Forecast), (_, b): &(Plan, Forecast)| {
        a.error.total_cmp(&b.error).then(a.rig_s.total_cmp(&b.rig_s))
    };
    known.into_iter().min_by(order).ok_or(NoPlan { budget_s, least_s })
}
