//! Reducing a stored run again.

use std::path::Path;
use std::time::Instant;

use super::run::reducer;
use super::{Budget, Evidence, MeasureError, RunRecord};
use crate::basis::size;
use crate::calibrate::CalibrationSet;
use crate::capture::{Crop, ResponseImage, RunFolder};
use crate::optics::Rig;
use crate::patterns::Plan;
use crate::reduce::Coefficients;
use crate::store::{self, StoreError};

/// Reduces a stored run again, with another calibration's scale if one is given.
///
/// # Errors
/// [`MeasureError`].
pub fn reduce_run(run: &Path, calibration: Option<&Path>) -> Result<(Coefficients, RunRecord), MeasureError> {
    let started = Instant::now();
    let folder = RunFolder::open(run)?;
    let mut record = RunRecord::read_complete(run)?;
    if !record.provenance.merged.is_empty() {
        return Err(MeasureError::Merged { path: folder.file("run.json") });
    }
    let rig = Rig::from_toml(&store::read_text(&folder.file("rig.toml"))?)?;
    let plan = Plan::from_toml(&store::read_text(&folder.file("plan.toml"))?)?;
    let own = folder.file("calibration");
    let set = CalibrationSet::read(calibration.unwrap_or(&own), &rig)?;
    if record.gains.len() != size(plan.order) || record.gains.contains(&0.0) {
        let reason = format!("`gains` are not {} divisors, as the plan asks for: measure again", size(plan.order));
        return Err(StoreError::invalid(&folder.file("run.json"), reason).into());
    }
    let mut reducer = reducer(&rig, &plan, &record.gains, &set.scale, &record.provenance)?;
    let crop = Crop::of_zone(&rig);
    // Runs of the first format hold the mean of all repeats.
    let repeats = if record.format < 2 { 1 } else { plan.repeats };
    for lobe in plan.lobes() {
        let response = |repeat| ResponseImage::read_of(&folder.response_path(&lobe, repeat), crop);
        if repeats == 1 {
            reducer.add(lobe, &response(0)?);
        } else {
            let all = (0..repeats).map(response).collect::<Result<Vec<_>, _>>()?;
            reducer.add(lobe, &ResponseImage::mean(&all));
        }
    }
    record.saturated_fraction = reducer.saturated_fraction();
    let coefficients = reducer.finish()?;
    record.noise_rel = coefficients.noise_rel();
    let evidence = Evidence::new(&rig, &set.check, &record.capture);
    record.budget = Some(Budget::new(&coefficients, &evidence, &record.provenance.assumed));
    record.post_s = started.elapsed().as_secs_f64();
    coefficients.write(&folder.file("coefficients.exr"))?;
    if calibration.is_some() {
        // Response and flat field stay: the frames were encoded with the run's own.
        CalibrationSet::write_gray_card(&set.scale, &set.check, &own, &rig)?;
    }
    store::write_json(&folder.file("run.json"), &record)?;
    Ok((coefficients, record))
}
