//! Reducing a stored run again.

use std::path::Path;
use std::time::Instant;

use super::run::{in_colours, recorded_gains, reducer};
use super::{Budget, Evidence, MeasureError, RunRecord};
use crate::calibrate::{Acceptance, CalibrationSet, Folder, Kind, Maps};
use crate::capture::{Crop, ResponseImage, RunFolder};
use crate::optics::Rig;
use crate::patterns::Plan;
use crate::radiometry::ColourSpace;
use crate::reduce::Coefficients;
use crate::store::{self, StoreError};

/// Reduces a stored run again, with the scale, stray light and colours of another calibration if one is given, and in other
/// colours than its plan's if they are. A calibration of any age will do, of the same kind of devices.
///
/// # Errors
/// [`MeasureError`].
pub fn reduce_run(
    run: &Path,
    calibration: Option<&Path>,
    colours: Option<ColourSpace>,
) -> Result<(Coefficients, RunRecord), MeasureError> {
    let started = Instant::now();
    let folder = RunFolder::open(run)?;
    let mut record = RunRecord::read_complete(run)?;
    if !record.provenance.merged.is_empty() {
        return Err(MeasureError::Merged { path: folder.file("run.json") });
    }
    let rig = Rig::from_toml(&store::read_text(&folder.file("rig.toml"))?)?;
    let plan = Plan::from_toml(&store::read_text(&folder.file("plan.toml"))?)?;
    let own = folder.file("calibration");
    let accept = Acceptance { simulated: Some(record.provenance.simulation.is_some()), freshness: None };
    let mut set = CalibrationSet::read_for(calibration.unwrap_or(&own), &rig, &accept)?;
    let count = plan.steps(rig.zone()).len();
    let Some(gains) = recorded_gains(&record.gains, count) else {
        let reason = format!("`gains` are not {count} divisors, as the plan asks for: measure again");
        return Err(StoreError::invalid(&folder.file("run.json"), reason).into());
    };
    if record.steps.is_empty() {
        record.steps = (0..count).collect();
    }
    if record.steps.iter().any(|&s| s >= count) {
        let reason = format!("`steps` names one beyond the plan's {count}: measure again");
        return Err(StoreError::invalid(&folder.file("run.json"), reason).into());
    }
    // The run's own map: it is how the frames were made and cut.
    let files = Folder { path: &own, rig: &rig, accept };
    set.map = files.if_there(Kind::Map, Folder::read_map).transpose()?.map(|(_, map)| map);
    let camera = Maps::of(&rig, set.map.as_ref()).camera;
    let mut reducer = reducer(&rig, &plan, &camera, gains, &set, &record.provenance)?;
    record.colour_space = colours.unwrap_or_else(|| plan.colour_space());
    set.to_colours(record.colour_space)?;
    let crop = Crop::of_map(&rig, &camera);
    // Runs of the first format hold the mean of all repeats.
    let repeats = if record.format < 2 { 1 } else { plan.repeats };
    for lobe in plan.lobes(record.steps.clone()) {
        let response = |repeat| ResponseImage::read_of(&folder.response_path(&lobe, repeat), crop);
        if repeats == 1 {
            reducer.add(lobe, &response(0)?);
        } else {
            let all = (0..repeats).map(response).collect::<Result<Vec<_>, _>>()?;
            reducer.add(lobe, &ResponseImage::mean(&all));
        }
    }
    record.saturated_fraction = reducer.saturated_fraction();
    let reduced = reducer.finish(&record.steps, record.isotropic)?;
    record.anisotropy = reduced.anisotropy;
    let coefficients = in_colours(reduced.coefficients, &set, record.colour_space)?;
    record.noise_rel = coefficients.noise_rel();
    let evidence = Evidence::new(&rig, &set.check, &record.capture);
    record.budget = Some(Budget::new(&coefficients, &evidence, &record.provenance.assumed));
    record.post_s = started.elapsed().as_secs_f64();
    coefficients.write(&folder.file("coefficients.exr"))?;
    if calibration.is_some() {
        // Response, flat field and camera stay: the frames were encoded and merged with the run's own.
        for kind in [Kind::GrayCard, Kind::BlackTrap, Kind::Colour] {
            set.replace_part(kind, &own, &rig)?;
        }
    }
    store::write_json(&folder.file("run.json"), &record)?;
    Ok((coefficients, record))
}
