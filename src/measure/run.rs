//! Running a plan, and going on where a run stopped.

use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use super::adapting::Adapting;
use super::record::CaptureRecord;
use super::{Adviser, AutomaticExposer, Budget, Decision, Evidence, MeasureError, Provenance, RunRecord};
use crate::basis::OrderError;
use crate::calibrate::CalibrationSet;
use crate::capture::{
    AllSteps, Bench, Bracket, CaptureError, Control, Crop, Director, Engine, Exposer, Placement, Progress, RUN_FORMAT,
    ResponseImage, Run, RunFolder, RunSummary, sensor,
};
use crate::geometry::ExitantGrid;
use crate::optics::{OpticalMap, Rig};
use crate::patterns::{LobePair, Lobes, Pattern, Plan, Step, Timing};
use crate::radiometry::ColourSpace;
use crate::reduce::{CellMap, Coefficients, ReduceError, Reduced, Reducer};
use crate::store::{self, StoreError};

/// What is to be measured, and with what.
#[derive(Clone, Copy)]
pub struct Request<'a> {
    /// The rig.
    pub rig: &'a Rig,
    /// The plan.
    pub plan: &'a Plan,
    /// The rig's calibrations.
    pub calibration: &'a CalibrationSet,
    /// What goes into the record.
    pub provenance: &'a Provenance,
    /// A way to pause and stop it.
    pub control: &'a Control,
    /// Says what adaptive plans take next; others ask nobody.
    pub adviser: Option<&'a dyn Adviser>,
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

/// Runs a plan on the sample. With `folder`, everything is recorded there.
///
/// # Errors
/// [`MeasureError`]. As long as the devices are not open, there is no folder then; later it says `stopped` or `failed` in its record,
/// and [`resume`] takes what is missing.
pub fn measure(
    request: &Request<'_>,
    bench: &mut dyn Bench,
    folder: Option<&RunFolder>,
    progress: &mut Progress<'_>,
) -> Result<Measurement, MeasureError> {
    let Request { rig, plan, calibration, .. } = request;
    if let Some(map) = &calibration.map {
        map.check_zone(rig)?;
    }
    // Found out before a folder is made.
    let prepared = Prepared::new(request)?;
    calibration.to_colours(plan.colour_space())?;
    let record = new_record(request, &prepared.pairs);
    let first = record.clone();
    let mut begin = || {
        let Some(folder) = folder else { return Ok(()) };
        folder.begin(|path| {
            store::write(&path.join("rig.toml"), rig.to_toml().as_bytes())?;
            store::write(&path.join("plan.toml"), plan.to_toml().as_bytes())?;
            calibration.write(&path.join("calibration"), rig)?;
            store::write_json(&path.join("run.json"), &first)
        })
    };
    perform(request, bench, prepared, record, Place { folder, begin: &mut begin }, progress)
}

/// Where a run is recorded, and what makes that ready.
struct Place<'a> {
    folder: Option<&'a RunFolder>,
    begin: &'a mut dyn FnMut() -> Result<(), StoreError>,
}

/// Goes on with a run that was stopped, failed or killed: takes the frames that are missing and reduces all.
///
/// The bench is that of the run's own `rig.toml`; `make_bench` gets that rig and the run's record. `adviser` must be the one that
/// an adaptive run was begun with.
///
/// # Errors
/// [`MeasureError::Complete`] if nothing is missing, [`MeasureError::OldRun`], and as [`measure`].
pub fn resume<E: From<MeasureError>>(
    path: &Path,
    control: &Control,
    adviser: Option<&dyn Adviser>,
    make_bench: impl FnOnce(&Rig, &RunRecord) -> Result<Box<dyn Bench>, E>,
    progress: &mut Progress<'_>,
) -> Result<Measurement, E> {
    let (folder, record) = open(path)?;
    let read = |name: &str| store::read_text(&folder.file(name)).map_err(MeasureError::from);
    let rig = Rig::from_toml(&read("rig.toml")?).map_err(MeasureError::from)?;
    let plan = Plan::from_toml(&read("plan.toml")?).map_err(MeasureError::from)?;
    let calibration = CalibrationSet::read(&folder.file("calibration"), &rig).map_err(MeasureError::from)?;
    let mut bench = make_bench(&rig, &record)?;
    let provenance = record.provenance.clone();
    let request =
        Request { rig: &rig, plan: &plan, calibration: &calibration, provenance: &provenance, control, adviser };
    let prepared = Prepared::new(&request)?;
    let mut begin = || Ok(());
    let place = Place { folder: Some(&folder), begin: &mut begin };
    Ok(perform(&request, bench.as_mut(), prepared, record, place, progress)?)
}

fn open(path: &Path) -> Result<(RunFolder, RunRecord), MeasureError> {
    let folder = RunFolder::open(path)?;
    let record = RunRecord::read(path)?;
    let manifest = path.join("run.json");
    if record.status == "complete" {
        return Err(MeasureError::Complete { path: manifest });
    }
    if record.format < RUN_FORMAT {
        return Err(MeasureError::OldRun { path: manifest, found: record.format });
    }
    Ok((folder, record))
}

fn new_record(request: &Request<'_>, pairs: &[LobePair]) -> RunRecord {
    let Request { rig, plan, .. } = request;
    let items = plan.rig_time(&Timing::of(rig));
    RunRecord {
        format: RUN_FORMAT,
        software: concat!("zonal ", env!("CARGO_PKG_VERSION")).into(),
        status: "running".into(),
        rig: rig.name.clone(),
        plan: plan.name.clone(),
        provenance: request.provenance.clone(),
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
        gains: stored_gains(pairs),
        steps: (0..plan.step_count()).collect(),
        isotropic: plan.scheme.is_isotropic(),
        anisotropy: 0.0,
        decisions: Vec::new(),
        colour_space: plan.colour_space(),
        capture: CaptureRecord::default(),
        budget: None,
    }
}

/// Takes what the folder does not hold yet, reduces all, and keeps the record true.
fn perform(
    request: &Request<'_>,
    bench: &mut dyn Bench,
    prepared: Prepared,
    mut record: RunRecord,
    place: Place<'_>,
    progress: &mut Progress<'_>,
) -> Result<Measurement, MeasureError> {
    let (started, folder) = (Instant::now(), place.folder);
    record.capture.sessions += 1;
    record.status = "running".into();
    let mut begun = false;
    let mut begin = || {
        (place.begin)()?;
        begun = true;
        folder.map_or(Ok(()), |folder| store::write_json(&folder.file("run.json"), &record))
    };
    let captured = capture(request, bench, prepared, Place { folder, begin: &mut begin }, progress);
    let outcome = captured.and_then(|captured| finish(request, captured, &mut record, started, folder));
    if let (Err(error), Some(folder), true) = (&outcome, folder, begun) {
        let stopped = matches!(error, MeasureError::Capture(CaptureError::Stopped { .. }));
        record.status = if stopped { "stopped" } else { "failed" }.into();
        record.compute_s += started.elapsed().as_secs_f64();
        // The error that ended the run is the one to report.
        let _ = store::write_json(&folder.file("run.json"), &record);
    }
    outcome
}

/// The frames of a plan on a calibrated rig; of an adaptive plan all that it may come to.
///
/// # Errors
/// [`OrderError`].
pub fn lobe_pairs(rig: &Rig, plan: &Plan, calibration: &CalibrationSet) -> Result<Vec<LobePair>, OrderError> {
    let p = &rig.projector;
    let steps = plan.steps(rig.zone());
    let lobes = Lobes::new(&calibration.maps(rig).projector, rig.zone(), steps, p.width_px, p.height_px)?;
    Ok(lobes.encode_all(&calibration.response, &calibration.flat))
}

/// Gains as a record holds them: one for each step, or for each frame where they differ.
fn stored_gains(pairs: &[LobePair]) -> Vec<f64> {
    if pairs.iter().all(|p| p.gains[0] == p.gains[1]) {
        return pairs.iter().map(|p| p.gains[0]).collect();
    }
    pairs.iter().flat_map(|p| p.gains).collect()
}

/// What [`stored_gains`] stored for so many steps; none if it is something else.
pub(super) fn recorded_gains(stored: &[f64], steps: usize) -> Option<Vec<[f64; 2]>> {
    let usable = stored.iter().all(|g| g.is_finite() && *g != 0.0);
    match stored.len() {
        n if n == steps && usable => Some(stored.iter().map(|&g| [g, g]).collect()),
        n if n == 2 * steps && usable => Some(stored.chunks(2).map(|g| [g[0], g[1]]).collect()),
        _ => None,
    }
}

/// What a run shows and how it is reduced, computed before anything moves.
struct Prepared {
    pairs: Vec<LobePair>,
    steps: Vec<Step>,
    camera: OpticalMap,
    reducer: Reducer,
}

impl Prepared {
    fn new(request: &Request<'_>) -> Result<Self, MeasureError> {
        let Request { rig, plan, calibration, provenance, .. } = *request;
        plan.check()?;
        if plan.adaptive.is_some() && request.adviser.is_none() {
            return Err(MeasureError::NoAdviser);
        }
        let pairs = lobe_pairs(rig, plan, calibration)?;
        let gains = pairs.iter().map(|p| p.gains).collect();
        let camera = calibration.maps(rig).camera;
        let reducer = reducer(rig, plan, &camera, gains, calibration, provenance)?;
        Ok(Self { pairs, steps: plan.steps(rig.zone()), camera, reducer })
    }
}

struct Captured {
    reducer: Reducer,
    /// What the coefficients are made from.
    steps: Vec<usize>,
    isotropic: bool,
    decisions: Vec<Decision>,
    first_response: ResponseImage,
    last_frame: Instant,
    summary: RunSummary,
}

fn capture(
    request: &Request<'_>,
    bench: &mut dyn Bench,
    prepared: Prepared,
    place: Place<'_>,
    progress: &mut Progress<'_>,
) -> Result<Captured, MeasureError> {
    let Request { rig, plan, calibration, control, .. } = *request;
    let Prepared { pairs, steps, camera, reducer } = prepared;
    let rig = &calibration.rig(rig);
    let patterns: Vec<Pattern> = pairs.iter().flat_map(|p| p.patterns.clone()).collect();
    let timing = Timing::of(rig);
    let exposures_s = plan.exposures_s(&timing);
    let longest_s = exposures_s.iter().copied().fold(0.0, f64::max);
    let crop = Crop::of_map(rig, &camera);
    let mut automatic;
    let mut bracket;
    let exposer: &mut dyn Exposer = match &plan.automatic {
        Some(target) => {
            let cells = CellMap::new(rig, &camera, crop, exitant_grid(rig, plan))?;
            let scale = calibration.scale.clone();
            let exposer = AutomaticExposer::new(target, &timing, sensor(rig), cells, scale, &pairs, &steps);
            automatic = if plan.adaptive.is_some() { exposer.carrying() } else { exposer };
            &mut automatic
        }
        None => {
            bracket = Bracket(exposures_s);
            &mut bracket
        }
    };
    bench.place(Placement::Sample)?;
    let mut last_frame = Instant::now();
    let mut timed = |done: usize, all: usize| {
        last_frame = Instant::now();
        progress(done, all);
    };
    let mut first_response = None;
    let stages = plan.stages(rig.zone());
    let reducer = Mutex::new(reducer);
    let mut all = AllSteps::new(pairs.len());
    let mut adapting = None;
    let director: &mut dyn Director = match (plan.adaptive, request.adviser) {
        (Some(target), Some(adviser)) => adapting.insert(Adapting::new(&stages, &reducer, adviser, target)),
        _ => &mut all,
    };
    let run = Run {
        patterns: &patterns,
        mixed: plan.is_mixed(),
        director,
        repeats: plan.repeats,
        exposer,
        longest_s,
        crop,
        maps: calibration.sensor.as_ref(),
        folder: place.folder,
        begin: place.begin,
    };
    let summary = Engine::new(rig, bench, control.clone()).run(run, &mut timed, |lobe, response| {
        reducer.lock().unwrap_or_else(PoisonError::into_inner).add(lobe, &response);
        first_response.get_or_insert(response);
    })?;
    let (steps, isotropic, decisions) = match adapting {
        Some(Adapting { failure: Some(failure), .. }) => return Err(failure.into()),
        Some(a) => (a.steps.clone(), a.isotropic(), a.decisions),
        None => ((0..pairs.len()).collect(), plan.scheme.is_isotropic(), Vec::new()),
    };
    let reducer = reducer.into_inner().unwrap_or_else(PoisonError::into_inner);
    let first_response = first_response.expect("a plan has lobes");
    Ok(Captured { reducer, steps, isotropic, decisions, first_response, last_frame, summary })
}

fn exitant_grid(rig: &Rig, plan: &Plan) -> ExitantGrid {
    ExitantGrid::new(rig.zone(), plan.exitant.rings, plan.exitant.sectors)
}

pub(super) fn reducer(
    rig: &Rig,
    plan: &Plan,
    camera: &OpticalMap,
    gains: Vec<[f64; 2]>,
    calibration: &CalibrationSet,
    provenance: &Provenance,
) -> Result<Reducer, ReduceError> {
    let cells = CellMap::new(rig, camera, Crop::of_map(rig, camera), exitant_grid(rig, plan))?;
    let history = provenance.history(rig, plan);
    let reducer = Reducer::new(cells, plan.steps(rig.zone()), gains, calibration.scale.clone(), history);
    match &calibration.black_trap {
        Some(trap) => reducer.less_stray(trap),
        None => Ok(reducer),
    }
}

/// Coefficients as the camera sees them in the colours wanted.
pub(super) fn in_colours(
    coefficients: Coefficients,
    calibration: &CalibrationSet,
    space: ColourSpace,
) -> Result<Coefficients, MeasureError> {
    let inverse = calibration.to_colours(space)?;
    Ok(inverse.map_or_else(|| coefficients.clone(), |inverse| coefficients.in_primaries(&inverse)))
}

fn finish(
    request: &Request<'_>,
    captured: Captured,
    record: &mut RunRecord,
    started: Instant,
    folder: Option<&RunFolder>,
) -> Result<Measurement, MeasureError> {
    let RunSummary { effort, frames, images, rig_time, elapsed_s, preparation_s, .. } = captured.summary;
    let RunSummary { rejected, latency_s, tagged, light, light_sigma, .. } = captured.summary;
    record.saturated_fraction = captured.reducer.saturated_fraction();
    record.frames = frames;
    record.images = images / request.plan.repeats;
    // What was really taken, where that was not known beforehand.
    if request.plan.automatic.is_some() || request.plan.adaptive.is_some() {
        (record.rig_s, record.rig_s_items) = (rig_time.total_s(), rig_time);
    }
    let Captured { steps, isotropic, decisions, .. } = &captured;
    (record.steps, record.isotropic, record.decisions) = (steps.clone(), *isotropic, decisions.clone());
    record.capture = CaptureRecord {
        rejected,
        skipped: effort.skipped,
        engine_s_per_frame: effort.own_s / effort.frames.max(1) as f64,
        latency_s,
        tagged,
        lamp: light,
        lamp_sigma: light_sigma,
        elapsed_s,
        preparation_s,
        ..record.capture
    };
    let Reduced { coefficients, anisotropy } = captured.reducer.finish(steps, *isotropic)?;
    record.anisotropy = anisotropy;
    record.order = coefficients.order;
    let coefficients = in_colours(coefficients, request.calibration, request.plan.colour_space())?;
    record.noise_rel = coefficients.noise_rel();
    let evidence = Evidence::new(request.rig, &request.calibration.check, &record.capture);
    record.budget = Some(Budget::new(&coefficients, &evidence, &record.provenance.assumed));
    if let Some(folder) = folder {
        coefficients.write(&folder.file("coefficients.exr"))?;
    }
    record.post_s = captured.last_frame.elapsed().as_secs_f64();
    record.compute_s += started.elapsed().as_secs_f64();
    record.status = "complete".into();
    if let Some(folder) = folder {
        // A run that says it is complete is left as it is, so this comes first.
        folder.tidy();
        store::write_json(&folder.file("run.json"), &record)?;
    }
    Ok(Measurement { coefficients, record: record.clone(), first_response: captured.first_response })
}
