//! Remounts of one sample, turned to a common frame and averaged.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Assumptions, Budget, Evidence, MeasureError, Remounts, RunRecord, remounts};
use crate::calibrate::CalibrationSet;
use crate::optics::Rig;
use crate::patterns::Plan;
use crate::reduce::Coefficients;
use crate::store::{self, StoreError};

/// What merging runs has shown.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Merged {
    /// The record of the run made.
    pub record: RunRecord,
    /// How the zone's mean albedo scatters.
    pub remounts: Remounts,
    /// Chi squared of all coefficients against their mean over its degrees of freedom: 1 where noise explains the scatter.
    pub reduced_chi2: f64,
    /// The same of each run.
    pub run_chi2: Vec<f64>,
}

/// Merges rotated remounts of one sample into a run folder that holds what later commands read: each turned until its grain
/// lies at 0, then the mean by inverse variance. The scatter beyond noise is recorded as the remounts' uncertainty.
///
/// # Errors
/// [`MeasureError::TooFew`], [`MeasureError::Unlike`] for runs of another sample, rig, order or grid, and what reading and
/// writing meet.
pub fn merge(runs: &[PathBuf], out: &Path) -> Result<Merged, MeasureError> {
    if runs.len() < 2 {
        return Err(MeasureError::TooFew { found: runs.len(), least: 2, purpose: "merge" });
    }
    store::vacant(out)?;
    let read = |run: &PathBuf| -> Result<(RunRecord, Coefficients), MeasureError> {
        Ok((RunRecord::read_complete(run)?, Coefficients::read(&run.join("coefficients.exr"))?))
    };
    let all = runs.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    for (run, (record, coefficients)) in runs.iter().zip(&all) {
        if let Some(what) = difference(&all[0], record, coefficients) {
            return Err(MeasureError::Unlike { path: run.clone(), what });
        }
    }
    let first = &runs[0];
    let rig = Rig::from_toml(&store::read_text(&first.join("rig.toml"))?)?;
    let plan = Plan::from_toml(&store::read_text(&first.join("plan.toml"))?)?;
    let calibration = CalibrationSet::read(&first.join("calibration"), &rig)?;
    let turned: Vec<Coefficients> =
        all.iter().map(|(record, c)| c.turned_to_grain(record.provenance.grain_deg.to_radians())).collect();
    let (mut mean, run_chi2, reduced_chi2) = average(&turned);

    let mut record = all[0].0.clone();
    let each = |value: &dyn Fn(&RunRecord) -> f64| all.iter().map(|(r, _)| value(r)).sum::<f64>();
    record.frames = all.iter().map(|(r, _)| r.frames).sum();
    record.rig_s = each(&|r| r.rig_s);
    record.compute_s = each(&|r| r.compute_s);
    record.saturated_fraction = each(&|r| r.saturated_fraction) / all.len() as f64;
    record.capture.tagged = all.iter().all(|(r, _)| r.capture.tagged);
    let independent = |r: &RunRecord| r.capture.lamp_sigma.powi(2);
    record.capture.lamp_sigma = each(&independent).sqrt() / all.len() as f64;
    let evidence = Evidence::new(&rig, &calibration.check, &record.capture);
    let budgets: Vec<Budget> = turned.iter().map(|c| Budget::new(c, &evidence, &record.provenance.assumed)).collect();
    let remounts = remounts(&budgets)?;
    let provenance = &mut record.provenance;
    provenance.grain_deg = 0.0;
    provenance.merged = runs.iter().map(|r| r.display().to_string()).collect();
    provenance.assumed = Assumptions {
        remount_rel: Some(remounts.remount_rel / (all.len() as f64).sqrt()),
        ..provenance.assumed.clone()
    };
    mean.history = format!("merged from {} runs; {}", all.len(), provenance.history(&rig, &plan));
    record.noise_rel = mean.noise_rel();
    record.budget = Some(Budget::new(&mean, &evidence, &record.provenance.assumed));
    store::write_dir(out, |part| -> Result<(), StoreError> {
        store::write(&part.join("rig.toml"), rig.to_toml().as_bytes())?;
        store::write(&part.join("plan.toml"), plan.to_toml().as_bytes())?;
        calibration.write(&part.join("calibration"), &rig)?;
        mean.write(&part.join("coefficients.exr"))?;
        store::write_json(&part.join("run.json"), &record)
    })?;
    Ok(Merged { record, remounts, reduced_chi2, run_chi2 })
}

/// In what a run differs from the first so that their coefficients do not describe the same.
fn difference(first: &(RunRecord, Coefficients), record: &RunRecord, c: &Coefficients) -> Option<&'static str> {
    let (of_first, coefficients) = first;
    let (a, b) = (&of_first.provenance, &record.provenance);
    [
        (a.sample_name() != b.sample_name() || a.sample != b.sample, "sample"),
        (of_first.rig != record.rig, "rig"),
        (coefficients.order != c.order, "order"),
        (coefficients.grid != c.grid, "exitant grid"),
    ]
    .into_iter()
    .find_map(|(differs, what)| differs.then_some(what))
}

/// Mean by inverse variance, chi squared over degrees of freedom of each run, and of all.
fn average(runs: &[Coefficients]) -> (Coefficients, Vec<f64>, f64) {
    let mut mean = runs[0].clone();
    let mut chi2 = vec![(0.0, 0.0); runs.len()];
    for i in 0..mean.values.len() {
        let known: Vec<(usize, f64, f64)> = runs
            .iter()
            .enumerate()
            .map(|(run, c)| (run, f64::from(c.values[i]), f64::from(c.sigma[i])))
            .filter(|(_, z, s)| z.is_finite() && *s > 0.0)
            .collect();
        let weight: f64 = known.iter().map(|(_, _, s)| s.powi(-2)).sum();
        let value = known.iter().map(|(_, z, s)| z * s.powi(-2)).sum::<f64>() / weight;
        (mean.values[i], mean.sigma[i]) = (value as f32, weight.powf(-0.5) as f32);
        if known.len() > 1 {
            for &(run, z, s) in &known {
                chi2[run].0 += ((z - value) / s).powi(2);
                // The share of freedom that the mean leaves this run.
                chi2[run].1 += 1.0 - s.powi(-2) / weight;
            }
        }
    }
    if mean.sigma.iter().any(|s| s.is_infinite()) {
        mean.sigma.iter_mut().zip(&mean.values).filter(|(_, z)| z.is_nan()).for_each(|(s, _)| *s = f32::NAN);
    }
    let over = |(sum, freedom): (f64, f64)| sum / freedom;
    let all = chi2.iter().fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
    (mean, chi2.into_iter().map(over).collect(), over(all))
}
