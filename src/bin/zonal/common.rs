//! What the commands share: loading with names in messages, progress, results, exit codes.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::Context;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use signal_hook::iterator::Signals;
use zonal::calibrate::{Acceptance, CalibrateError, CalibrationSet, Devices, Freshness, Origin};
use zonal::capture::{CaptureError, Control};
use zonal::devices::{DeviceBench, DevicesFile, Operator};
use zonal::export::{ShMaterial, TensorMaterial};
use zonal::fit::FitReport;
use zonal::geometry::Zone;
use zonal::measure::{Assumptions, MeasureError, RunRecord};
use zonal::optics::Rig;
use zonal::patterns::Plan;
use zonal::radiometry::ColourSpace;
use zonal::reduce::{Coefficients, ReduceError};
use zonal::reflectance::{Brdf, Model, Turned, open};
use zonal::store;
use zonal::twin::{TwinBench, TwinConfig};

/// What a command has to say, twice.
pub struct Report {
    /// For people.
    pub text: String,
    /// For programs.
    pub json: serde_json::Value,
}

/// Reads a rig file.
pub fn rig(path: &Path) -> anyhow::Result<Rig> {
    let text = store::read_text(path)?;
    Rig::from_toml(&text).with_context(|| path.display().to_string())
}

/// Reads a plan file.
pub fn plan(path: &Path) -> anyhow::Result<Plan> {
    let text = store::read_text(path)?;
    Plan::from_toml(&text).with_context(|| path.display().to_string())
}

/// A material as commands take it.
pub struct Material {
    /// Its values.
    pub brdf: Arc<dyn Brdf>,
    /// Its parameters, where it comes from a file that holds a closed form.
    pub model: Option<Model>,
    /// What it is and where it comes from.
    pub history: String,
    /// Measured zone of a fit.
    pub zone: Option<Zone>,
    /// Why a fit should not be used, if it should not.
    pub unsuccessful: Option<String>,
}

impl Material {
    fn new(brdf: Arc<dyn Brdf>, history: String) -> Self {
        Self { brdf, model: None, history, zone: None, unsuccessful: None }
    }
}

/// A parser of finite numbers in a range.
pub fn within(low: f64, high: f64) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| match text.parse::<f64>() {
        Ok(x) if (low..=high).contains(&x) => Ok(x),
        _ => Err(format!("{text} is not a number in {low}..={high}")),
    }
}

/// A material from any file or name that stands for one.
pub fn material(name: &str) -> anyhow::Result<Material> {
    if name.ends_with(".exr") {
        let path = Path::new(name);
        if TensorMaterial::is_in(path)? {
            let tensor = TensorMaterial::read(path)?;
            let [order, exitant] = tensor.zonal_orders;
            let history =
                format!("{name}: zonal orders {order} and {exitant}, method {}; {}", tensor.method, tensor.history);
            return Ok(Material::new(Arc::new(tensor), history));
        }
        let sh = ShMaterial::read(path)?;
        let history = format!("{name}: zonal order {}, method {}; {}", sh.zonal_order, sh.method, sh.history);
        return Ok(Material::new(Arc::new(sh), history));
    }
    if name.ends_with(".json") {
        let fit = FitReport::read(Path::new(name))?;
        let history = format!("{name}: fit {} of zonal order {}; {}", fit.model, fit.order, fit.history);
        return Ok(Material {
            zone: Some(fit.zone()),
            unsuccessful: (!fit.successful).then(|| format!("{name}: the search ended with {:?}", fit.termination)),
            model: Some(fit.brdf.clone()),
            ..Material::new(Arc::new(fit.brdf), history)
        });
    }
    Ok(Material::new(open(name)?, name.to_owned()))
}

/// The record and the coefficients of a run that has ended well.
pub fn run(folder: &Path) -> anyhow::Result<(RunRecord, Coefficients)> {
    let record = RunRecord::read_complete(folder)?;
    let coefficients = Coefficients::read(&folder.join("coefficients.exr"))
        .with_context(|| format!("no coefficients (`zonal reduce {}` makes them again)", folder.display()))?;
    Ok((record, coefficients))
}

/// The coefficients of a run as if only functions up to `order` had been shown; all of them without one.
pub fn coefficients(folder: &Path, order: Option<usize>) -> anyhow::Result<Coefficients> {
    let (_, measured) = run(folder)?;
    let order = order.unwrap_or(measured.order);
    if order > measured.order {
        let message = format!("--order {order} exceeds the run's order {}: choose a smaller one", measured.order);
        return Err(BadUsage(message).into());
    }
    Ok(measured.truncated(order))
}

/// A progress bar over frames on stderr; silent where nobody watches.
pub fn frames_bar(what: &str) -> impl FnMut(usize, usize) + use<> {
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr_with_hz(10));
    let style = ProgressStyle::with_template("{prefix:12} {bar:32} {pos}/{len} frames  {elapsed} gone, {eta} left");
    bar.set_style(style.expect("a valid template"));
    bar.set_prefix(what.to_owned());
    move |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
        if done == all {
            bar.finish_and_clear();
        }
    }
}

/// Colours of coefficients, as options name them.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub enum Colours {
    /// The camera's own, white-balanced on the gray card.
    Camera,
    /// The projector's primaries; needs `zonal calibrate colour`.
    Projector,
}

impl Colours {
    /// The colours meant.
    pub fn space(self) -> ColourSpace {
        match self {
            Colours::Camera => ColourSpace::Camera,
            Colours::Projector => ColourSpace::Projector,
        }
    }
}

/// The calibrations in a folder, of some age at most: those of real devices, or of the simulated rig `config`, on which they are
/// made now where there is no folder.
pub fn calibration(
    folder: Option<&Path>,
    rig: &Rig,
    config: Option<&TwinConfig>,
    max_age_days: Option<f64>,
) -> anyhow::Result<CalibrationSet> {
    let now = jiff::Timestamp::now();
    if let Some(folder) = folder {
        let freshness = max_age_days.map(|max_age_days| Freshness { now, max_age_days });
        let accept = Acceptance { simulated: Some(config.is_some()), freshness };
        return Ok(CalibrationSet::read_for(folder, rig, &accept)?);
    }
    let Some(config) = config else {
        let message = "real devices must be calibrated before: `zonal calibrate KIND RIG --devices FILE --out FOLDER` for \
                       response, align, map, flat-field and gray-card, then give --calibration FOLDER";
        return Err(BadUsage(message.into()).into());
    };
    let mut bench = TwinBench::new(rig, for_calibration(config), open("gray-card")?);
    let origin = Origin { date: now, devices: Devices::Simulated { seed: config.seed } };
    Ok(CalibrationSet::make(rig, &mut bench, None, &mut frames_bar("calibrate"))?.made(rig, &origin))
}

/// The simulated rig of a name, with what a file says is out of place.
pub fn twin(name: &str, seed: u64, misalign: Option<&Path>) -> anyhow::Result<TwinConfig> {
    let Some(mut config) = TwinConfig::named(name, seed) else {
        return Err(BadUsage(format!("--twin {name} is no simulated rig: choose pinhole or finite")).into());
    };
    if let Some(path) = misalign {
        config.perturbation = store::read_json(path)?;
    }
    Ok(config)
}

/// The same devices with other noise: calibrations and measurements of one seed must not share it.
pub fn for_calibration(config: &TwinConfig) -> TwinConfig {
    TwinConfig { seed: config.seed ^ 0xCA11_B8A7, ..config.clone() }
}

/// Real devices for a rig, as their file says. Somebody must be there to put things in place, unless they are (`yes`).
pub fn devices(file: &DevicesFile, rig: &Rig, yes: bool, control: &Control) -> anyhow::Result<DeviceBench> {
    let operator = match (yes, std::io::stdin().is_terminal()) {
        (true, _) => Operator::Gone,
        (false, true) => Operator::AtTerminal,
        (false, false) => {
            let message =
                "nobody is at the terminal to put things in place: with --yes, what is needed first is there already";
            return Err(BadUsage(message.into()).into());
        }
    };
    Ok(DeviceBench::steered(file, rig, operator, control)?)
}

/// Reads a devices file.
pub fn devices_file(path: &Path) -> anyhow::Result<DevicesFile> {
    DevicesFile::read(path).with_context(|| path.display().to_string())
}

/// A simulated rig for a sample.
pub fn bench(rig: &Rig, config: &TwinConfig, sample: Arc<dyn Brdf>) -> TwinBench {
    TwinBench::new(rig, config.clone(), sample)
}

/// The path of a file to write whose folder must exist: found out before anything is computed.
pub fn writable(path: &Path) -> anyhow::Result<PathBuf> {
    let folder = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    };
    let reason = if path.is_dir() {
        Some("it is a folder")
    } else if path.exists() && !path.is_file() {
        // Renamed over, a device would be gone.
        Some("it is a device")
    } else if !folder.is_dir() {
        Some("its parent is not a folder")
    } else {
        None
    };
    if let Some(reason) = reason {
        return Err(BadUsage(format!("cannot write {}: {reason}; choose another --out", path.display())).into());
    }
    Ok(path.to_owned())
}

/// A folder that can be made: found out before anything is computed.
pub fn makeable(path: &Path) -> anyhow::Result<()> {
    let blocked = path.ancestors().find(|p| p.exists() && !p.is_dir());
    if let Some(file) = blocked {
        let message = format!("cannot make {}: {} is a file; choose another --out", path.display(), file.display());
        return Err(BadUsage(message).into());
    }
    Ok(())
}

/// This moment, UTC, ISO 8601, whole seconds.
pub fn now() -> String {
    let now = jiff::Timestamp::now();
    now.round(jiff::Unit::Second).unwrap_or(now).to_string()
}

/// What a sample is as it is mounted.
pub fn mounted(sample: Arc<dyn Brdf>, grain_deg: f64) -> Arc<dyn Brdf> {
    if grain_deg == 0.0 { sample } else { Arc::new(Turned::new(sample, grain_deg.to_radians())) }
}

/// Assumptions of budgets from a file, or the usual ones.
pub fn assumptions(path: Option<&Path>) -> anyhow::Result<Assumptions> {
    let Some(path) = path else { return Ok(Assumptions::default()) };
    Assumptions::from_toml(&store::read_text(path)?).with_context(|| path.display().to_string())
}

/// A path for programs; letters that are no Unicode are replaced.
pub fn said(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

/// A request that cannot be met as it stands.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct BadUsage(pub String);

/// A batch of which some samples could not be measured.
#[derive(Debug, thiserror::Error)]
#[error("{failed} of {all} samples failed; the others are measured, `--resume` tries these again\n{table}")]
pub struct SamplesFailed {
    /// How many failed.
    pub failed: usize,
    /// Of how many.
    pub all: usize,
    /// What became of each.
    pub table: String,
    /// The same for `--json`.
    pub json: serde_json::Value,
}

/// Devices that cannot do what a measurement needs.
#[derive(Debug, thiserror::Error)]
#[error("{failed} of {all} things fail\n{table}")]
pub struct DevicesFail {
    /// How many.
    pub failed: usize,
    /// Of how many.
    pub all: usize,
    /// What was found out.
    pub table: String,
    /// The same for `--json`.
    pub json: serde_json::Value,
}

/// What was found out all the same, for `--json`.
pub fn found(error: &anyhow::Error) -> Option<&serde_json::Value> {
    let of_devices = error.downcast_ref::<DevicesFail>().map(|e| &e.json);
    of_devices.or_else(|| error.downcast_ref::<SamplesFailed>().map(|e| &e.json))
}

/// An error and its causes, each said once.
pub fn message(error: &anyhow::Error) -> String {
    error.chain().map(|cause| cause.to_string()).fold(String::new(), |said, cause| match said {
        said if said.contains(&cause) => said,
        said if said.is_empty() => cause,
        said => format!("{said}: {cause}"),
    })
}

/// 1 where a device failed or a computation broke down, 2 where the request or its files must change.
pub fn exit_code(error: &anyhow::Error) -> ExitCode {
    let device = |e: &CaptureError| {
        use CaptureError::{Declined, Device, Frozen, NoTag, Rejected, Stopped};
        let stopped = matches!(e.cause(), Stopped { .. } | Declined { .. });
        stopped || matches!(e.cause(), Device { .. } | Frozen { .. } | NoTag { .. } | Rejected { .. })
    };
    let failed = error.chain().any(|cause| {
        cause.downcast_ref::<CaptureError>().is_some_and(device)
            || matches!(cause.downcast_ref(), Some(MeasureError::Capture(e)) if device(e))
            || matches!(cause.downcast_ref(), Some(CalibrateError::Capture(e)) if device(e))
            || matches!(cause.downcast_ref(), Some(CalibrateError::DarkFlatField | CalibrateError::DarkGrayCard))
            || matches!(cause.downcast_ref(), Some(CalibrateError::NoCross { .. } | CalibrateError::NoFringes { .. }))
            || matches!(cause.downcast_ref(), Some(CalibrateError::Transfer(_) | CalibrateError::Linearity(_)))
            || matches!(cause.downcast_ref(), Some(ReduceError::Incomplete { .. }))
            || cause.is::<SamplesFailed>()
            || cause.is::<DevicesFail>()
    });
    if failed { ExitCode::from(1) } else { ExitCode::from(2) }
}

/// Why a command that needs a rig cannot go on without one.
pub fn no_devices() -> anyhow::Error {
    let message = "on which rig? Add --devices FILE for a real one (`zonal devices` says what there is), or --simulate";
    BadUsage(message.into()).into()
}

/// A run's control in the hands of signals: Ctrl-C or a termination stops it after the frame under way, a second one ends
/// the program at once; SIGUSR1 pauses and resumes.
pub fn steered() -> Control {
    let control = Control::default();
    let steered = control.clone();
    let (stops, toggle) = ([libc::SIGINT, libc::SIGTERM], libc::SIGUSR1);
    match Signals::new([stops[0], stops[1], toggle]) {
        Ok(mut signals) => {
            std::thread::spawn(move || {
                for signal in signals.forever() {
                    match signal {
                        signal if signal == toggle && steered.paused() => steered.resume(),
                        signal if signal == toggle => steered.pause(),
                        _ if steered.aborted() => std::process::exit(1),
                        _ => {
                            eprintln!("stopping after this frame; once more to stop at once");
                            steered.abort();
                        }
                    }
                }
            });
        }
        Err(error) => eprintln!("warning: signals cannot be caught, Ctrl-C will end the program at once: {error}"),
    }
    control
}
