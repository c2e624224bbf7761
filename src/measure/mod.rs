//! A measurement: a plan run on a bench with a calibration, into a run folder that tells all.

use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::basis::{OrderError, size};
use crate::calibrate::{CalibrateError, CalibrationSet, Maps};
use crate::capture::{Bench, CaptureError, Crop, Engine, Placement, Progress, RUN_FORMAT, ResponseImage, RunFolder};
use crate::geometry::ExitantGrid;
use crate::optics::{OpticalMap, Rig, RigError};
use crate::patterns::{LobePair, Lobes, Pattern, Plan, PlanError, RigTime, Timing};
use crate::reduce::{CellMap, ChannelScale, Coefficients, ReduceError, Reducer};
use crate::store::{self, StoreError};

/// Why a measurement failed.
#[derive(Debug, Error)]
pub enum MeasureError {
    /// A calibration could not be used or made.
    #[error(transparent)]
    Calibrate(#[from] CalibrateError),
    /// Capturing failed.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// Reduction failed.
    #[error(transparent)]
    Reduce(#[from] ReduceError),
    /// The order is out of range.
    #[error(transparent)]
    Order(#[from] OrderError),
    /// The run's rig file is damaged.
    #[error("the run's rig.toml: {0}")]
    Rig(#[from] RigError),
    /// The run's plan file is damaged.
    #[error("the run's plan.toml: {0}")]
    Plan(#[from] PlanError),
    /// The run did not end.
    #[error("{path} says `{status}`, not `complete`: measure again", path = path.display())]
    NotComplete {
        /// The run's record.
        path: PathBuf,
        /// Its status.
        status: String,
    },
    /// A file could not be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// What is measured and by what: goes into the record as it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Name or file of the sample.
    pub sample: String,
    /// The simulated rig, if it is one.
    pub simulation: Option<serde_json::Value>,
}

impl Provenance {
    /// One line for the headers of files: sample, rig, plan and the simulated rig with its seed.
    fn history(&self, rig: &Rig, plan: &Plan) -> String {
        let simulation = self.simulation.as_ref().map_or_else(String::new, |s| format!("; simulated rig {s}"));
        format!("sample {}; rig {}; plan {}{simulation}", self.sample, rig.name, plan.name)
    }
}

/// `run.json`: the record of a run. Times in seconds, angles in degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// Version of the run folder.
    pub format: u32,
    /// Program and version.
    pub software: String,
    /// `running`, `failed` or `complete`.
    pub status: String,
    /// Name of the rig.
    pub rig: String,
    /// Name of the plan.
    pub plan: String,
    /// What was measured and by what.
    pub provenance: Provenance,
    /// Zonal order.
    pub order: usize,
    /// Patterns shown.
    pub images: usize,
    /// Camera frames.
    pub frames: usize,
    /// Predicted wall time on the physical rig.
    pub rig_s: f64,
    /// What it is spent on.
    pub rig_s_items: RigTime,
    /// Time this program took from the first pattern to the coefficients.
    pub compute_s: f64,
    /// Time from the last frame to the coefficients.
    pub post_s: f64,
    /// Limits of the measured zone.
    pub zone_deg: [f64; 2],
    /// RMS sigma over RMS DC.
    pub noise_rel: f64,
    /// Share of zone pixels saturated in every exposure.
    pub saturated_fraction: f64,
    /// Divisor of each lobe difference.
    pub gains: Vec<f64>,
}

impl RunRecord {
    /// Reads the record of a run folder.
    ///
    /// # Errors
    /// [`StoreError`]; a record of a newer program is [`StoreError::Invalid`].
    pub fn read(run: &Path) -> Result<Self, StoreError> {
        store::read_versioned(&run.join("run.json"), RUN_FORMAT)
    }

    /// Reads the record of a run that has ended well.
    ///
    /// # Errors
    /// As [`RunRecord::read`], and [`MeasureError::NotComplete`].
    pub fn read_complete(run: &Path) -> Result<Self, MeasureError> {
        let record = Self::read(run)?;
        if record.status == "complete" {
            return Ok(record);
        }
        Err(MeasureError::NotComplete { path: run.join("run.json"), status: record.status })
    }
}

/// A finished measurement.
pub struct Measurement {
    /// The coefficients.
    pub coefficients: Coefficients,
    /// The record, as in `run.json`.
    pub record: RunRecord,
    /// The response to the first pattern (the constant function), for pictures.
    pub first_response: ResponseImage,
}

/// Runs `plan` on the sample. With `folder`, everything is recorded there.
///
/// # Errors
/// [`MeasureError`]. Before the first frame, there is no folder then; later it says `failed` in its record and keeps
/// what was stored.
pub fn measure(
    rig: &Rig,
    plan: &Plan,
    bench: &mut dyn Bench,
    calibration: &CalibrationSet,
    provenance: Provenance,
    mut folder: Option<&mut RunFolder>,
    progress: &mut Progress<'_>,
) -> Result<Measurement, MeasureError> {
    let started = Instant::now();
    if let Some(map) = &calibration.map {
        map.check_zone(rig)?;
    }
    let timing = Timing::of(rig);
    let maps = calibration.maps(rig);
    let pairs = lobe_pairs(rig, plan, calibration)?;
    let gains: Vec<f64> = pairs.iter().map(|p| p.gain).collect();
    let crop = Crop::of_map(rig, &maps.camera);
    let reducer = reducer(rig, plan, &maps.camera, &gains, &calibration.scale, &provenance)?;
    let items = plan.rig_time(&timing);
    let mut record = RunRecord {
        format: RUN_FORMAT,
        software: concat!("zonal ", env!("CARGO_PKG_VERSION")).into(),
        status: "running".into(),
        rig: rig.name.clone(),
        plan: plan.name.clone(),
        provenance,
        order: plan.order,
        images: plan.images(),
        frames: plan.frames(),
        rig_s: items.total_s(),
        rig_s_items: items,
        compute_s: 0.0,
        post_s: 0.0,
        zone_deg: [rig.zone.theta_min_deg, rig.zone.theta_max_deg],
        noise_rel: 0.0,
        saturated_fraction: 0.0,
        gains,
    };
    if let Some(folder) = folder.as_deref_mut() {
        folder.begin(|path| {
            store::write(&path.join("rig.toml"), rig.to_toml().as_bytes())?;
            store::write(&path.join("plan.toml"), plan.to_toml().as_bytes())?;
            calibration.write(&path.join("calibration"), rig)?;
            store::write_json(&path.join("run.json"), &record)
        })?;
    }
    let result = capture(rig, plan, bench, crop, &pairs, reducer, folder.as_deref_mut(), progress);
    let outcome = result.and_then(|captured| finish(captured, &mut record, started, folder.as_deref()));
    if outcome.is_err()
        && let Some(folder) = folder
    {
        record.status = "failed".into();
        // The error that ended the run is the one to report.
        let _ = store::write_json(&folder.file("run.json"), &record);
    }
    outcome
}

/// Reduces a stored run again, with another calibration's scale if one is given.
///
/// # Errors
/// [`MeasureError`].
pub fn reduce_run(run: &Path, calibration: Option<&Path>) -> Result<(Coefficients, RunRecord), MeasureError> {
    let started = Instant::now();
    let folder = RunFolder::open(run)?;
    let mut record = RunRecord::read_complete(run)?;
    let rig = Rig::from_toml(&store::read_text(&folder.file("rig.toml"))?)?;
    let plan = Plan::from_toml(&store::read_text(&folder.file("plan.toml"))?)?;
    let own = folder.file("calibration");
    let set = CalibrationSet::read(calibration.unwrap_or(&own), &rig)?;
    if record.gains.len() != size(plan.order) || record.gains.contains(&0.0) {
        let reason = format!("`gains` are not {} divisors, as the plan asks for: measure again", size(plan.order));
        return Err(StoreError::invalid(&folder.file("run.json"), reason).into());
    }
    // The run's own map: it is how the frames were made and cut.
    let map = CalibrationSet::read_map(&own, &rig)?;
    let camera = Maps::of(&rig, map.as_ref()).camera;
    let mut reducer = reducer(&rig, &plan, &camera, &record.gains, &set.scale, &record.provenance)?;
    let crop = Crop::of_map(&rig, &camera);
    for lobe in plan.lobes() {
        let path = folder.response_path(&lobe);
        let response = ResponseImage::read(&path)?;
        if response.crop != crop {
            return Err(StoreError::invalid(&path, "it shows another part of the sensor: measure again").into());
        }
        reducer.add(lobe, &response);
    }
    record.saturated_fraction = reducer.saturated_fraction();
    let coefficients = reducer.finish()?;
    record.noise_rel = coefficients.noise_rel();
    record.post_s = started.elapsed().as_secs_f64();
    coefficients.write(&folder.file("coefficients.exr"))?;
    if calibration.is_some() {
        // Response and flat field stay: the frames were encoded with the run's own.
        CalibrationSet::write_gray_card(&set.scale, &set.check, &own, &rig)?;
    }
    store::write_json(&folder.file("run.json"), &record)?;
    Ok((coefficients, record))
}

/// The frames of a plan on a calibrated rig.
///
/// # Errors
/// [`OrderError`].
pub fn lobe_pairs(rig: &Rig, plan: &Plan, calibration: &CalibrationSet) -> Result<Vec<LobePair>, OrderError> {
    let p = &rig.projector;
    let lobes = Lobes::new(&calibration.maps(rig).projector, rig.zone(), plan.order, p.width_px, p.height_px)?;
    Ok((0..size(plan.order)).map(|k| lobes.encode(k, &calibration.response, &calibration.flat)).collect())
}

struct Captured {
    reducer: Reducer,
    first_response: ResponseImage,
    last_frame: Instant,
}

#[expect(clippy::too_many_arguments, reason = "one call")]
fn capture(
    rig: &Rig,
    plan: &Plan,
    bench: &mut dyn Bench,
    crop: Crop,
    pairs: &[LobePair],
    mut reducer: Reducer,
    folder: Option<&mut RunFolder>,
    progress: &mut Progress<'_>,
) -> Result<Captured, MeasureError> {
    let patterns: Vec<Pattern> = pairs.iter().flat_map(|p| p.patterns.clone()).collect();
    bench.place(Placement::Sample)?;
    let mut last_frame = Instant::now();
    let mut timed = |done: usize, all: usize, left_s: f64| {
        last_frame = Instant::now();
        progress(done, all, left_s);
    };
    let mut first_response = None;
    Engine::new(rig, bench).with_crop(crop).run(plan, &patterns, folder, &mut timed, |lobe, response| {
        reducer.add(lobe, &response);
        first_response.get_or_insert(response);
    })?;
    let first_response = first_response.expect("a plan has lobes");
    Ok(Captured { reducer, first_response, last_frame })
}

fn reducer(
    rig: &Rig,
    plan: &Plan,
    camera: &OpticalMap,
    gains: &[f64],
    scale: &ChannelScale,
    provenance: &Provenance,
) -> Result<Reducer, ReduceError> {
    let grid = ExitantGrid::new(rig.zone(), plan.exitant.rings, plan.exitant.sectors);
    let cells = CellMap::new(rig, camera, Crop::of_map(rig, camera), grid)?;
    Ok(Reducer::new(cells, plan.order, gains.to_vec(), scale.clone(), provenance.history(rig, plan)))
}

fn finish(
    captured: Captured,
    record: &mut RunRecord,
    started: Instant,
    folder: Option<&RunFolder>,
) -> Result<Measurement, MeasureError> {
    record.saturated_fraction = captured.reducer.saturated_fraction();
    let coefficients = captured.reducer.finish()?;
    record.noise_rel = coefficients.noise_rel();
    if let Some(folder) = folder {
        coefficients.write(&folder.file("coefficients.exr"))?;
    }
    record.post_s = captured.last_frame.elapsed().as_secs_f64();
    record.compute_s = started.elapsed().as_secs_f64();
    record.status = "complete".into();
    if let Some(folder) = folder {
        store::write_json(&folder.file("run.json"), &record)?;
    }
    Ok(Measurement { coefficients, record: record.clone(), first_response: captured.first_response })
}
