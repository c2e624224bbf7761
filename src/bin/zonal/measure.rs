//! `zonal measure`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context;
use zonal::calibrate::CalibrationSet;
use zonal::capture::{Bench, Control, RunFolder, check_devices};
use zonal::devices::DevicesFile;
use zonal::forecast::FitAdviser;
use zonal::measure::{Assumptions, Measurement, Provenance, Request, RunRecord, measure, resume};
use zonal::optics::Rig;
use zonal::patterns::{Plan, Timing};
use zonal::reflectance::{Brdf, open};
use zonal::store;
use zonal::twin::{Faults, TwinBench, TwinConfig};

use crate::batch;
use crate::common::{self, BadUsage, Report};

/// The devices file in a run folder.
const DEVICES: &str = "devices.toml";

#[derive(clap::Args)]
pub struct Args {
    /// Rig file.
    pub rig: PathBuf,
    /// Plan file.
    pub plan: PathBuf,
    /// Run folder to create, or with --resume to go on with; with --batch the folder of all runs.
    #[arg(long)]
    pub out: PathBuf,
    /// Go on with a run that was stopped, failed or killed; rig, plan, calibration and sample are the run's own.
    #[arg(long)]
    pub resume: bool,
    /// Measure this material on the simulated rig: a .bsdf, .binary or .dat file, or a name of `zonal materials`.
    #[arg(long, value_name = "MATERIAL")]
    pub simulate: Option<String>,
    /// Measure with the real devices of this file; with --resume, instead of those the run was begun with.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["simulate", "twin", "noiseless", "paced", "free_running", "fault", "misalign"])]
    pub devices: Option<PathBuf>,
    /// The sample is in place: do not ask.
    #[arg(long, conflicts_with = "batch")]
    yes: bool,
    /// Simulated rig: pinhole (chief rays), or finite (pupils with footprints, blur and vignetting, stray light, a sample
    /// 0.05 mm too high).
    #[arg(long, value_name = "NAME", default_value = "pinhole")]
    twin: String,
    /// Seed of the simulated noise.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    pub seed: u64,
    /// Simulate a camera without shot and dark noise.
    #[arg(long)]
    noiseless: bool,
    /// Simulate in real time.
    #[arg(long)]
    paced: bool,
    /// Simulate a camera that cannot be triggered.
    #[arg(long)]
    free_running: bool,
    /// Simulate faults, e.g. drop=0.01: drop, duplicate, repeat, reorder, flag, late (shares), late_s, stuck_after, lost_after, seed.
    #[arg(long, value_name = "NAME=VALUE")]
    fault: Vec<String>,
    /// What is out of place in the simulated rig: a JSON file with any of the keys of `perturbation` in run.json.
    #[arg(long, value_name = "FILE.json")]
    misalign: Option<PathBuf>,
    /// Folder with the rig's calibrations; without it a simulated rig is calibrated first.
    #[arg(long)]
    pub calibration: Option<PathBuf>,
    /// Days after which a calibration is too old.
    #[arg(long, value_name = "DAYS", default_value_t = 30.0)]
    pub max_age_days: f64,
    /// Colours of the coefficients instead of the plan's.
    #[arg(long, value_enum)]
    colour: Option<common::Colours>,
    /// What the sample is called.
    #[arg(long, value_name = "NAME")]
    pub sample: Option<String>,
    /// Angle from the rig's +x to the sample's grain as it is mounted, counter-clockwise, degrees.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub grain_deg: f64,
    /// TOML file whose section [budget] states what rig, card and mount are known to.
    #[arg(long, value_name = "FILE")]
    pub budget: Option<PathBuf>,
    /// Measure the samples of this TOML file one after the other, with one calibration.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["simulate", "sample", "grain_deg"])]
    pub batch: Option<PathBuf>,
    /// Take what the sample needs and no more: begin at order 2 as if it were isotropic, and go on up to the plan's order while
    /// a further step is expected to save enough of the error.
    #[arg(long)]
    pub adaptive: bool,
    /// Share of the error that a further step must be expected to save, with --adaptive [default: 0.05, or the plan's].
    #[arg(long, value_name = "SHARE", requires = "adaptive")]
    pub gain: Option<f64>,
    /// Seconds on the rig not to be exceeded, with --adaptive, decisions included; what is always taken is order 2.
    #[arg(long, value_name = "SECONDS", requires = "adaptive")]
    pub limit: Option<f64>,
    /// Keep every camera frame as a 16-bit PNG.
    #[arg(long)]
    pub keep_frames: bool,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let rig = common::rig(&args.rig)?;
    let mut plan = common::plan(&args.plan)?;
    if let Some(colours) = args.colour {
        plan = plan.in_colours(colours.space());
    }
    if args.adaptive {
        let mut adaptive = plan.adaptive.unwrap_or_default();
        adaptive.gain_rel = args.gain.unwrap_or(adaptive.gain_rel);
        adaptive.limit_s = args.limit.or(adaptive.limit_s);
        plan = plan.adapted(adaptive);
        plan.check().context("--adaptive")?;
    }
    if args.max_age_days.is_nan() || args.max_age_days <= 0.0 {
        return Err(BadUsage(format!("--max-age-days {}: choose a number above 0", args.max_age_days)).into());
    }
    let session = Session {
        args,
        rig: &rig,
        plan: &plan,
        faults: faults(&args.fault)?,
        control: common::steered(),
        assumed: common::assumptions(args.budget.as_deref())?,
    };
    if let Some(batch) = &args.batch {
        return batch::run(&session, batch);
    }
    if args.resume {
        return Ok(report(&session.resumed(&args.out)?.record, &args.out));
    }
    common::makeable(&args.out)?;
    let sample = Mounted {
        name: args.sample.clone(),
        simulate: args.simulate.clone(),
        grain_deg: args.grain_deg,
        seed: args.seed,
    };
    let apparatus = session.checked(&sample)?;
    // Found out before a calibration is made; the folder itself appears with the first frame.
    let folder = RunFolder::create(&args.out, args.keep_frames)?;
    let calibration =
        common::calibration(args.calibration.as_deref(), &rig, apparatus.config(), Some(args.max_age_days))?;
    let measured = session.measured(&sample, apparatus, &calibration, folder)?;
    Ok(report(&measured.record, &args.out))
}

/// A sample as it lies in the rig.
pub struct Mounted {
    /// What it is called.
    pub name: Option<String>,
    /// The material it is simulated by.
    pub simulate: Option<String>,
    /// See [`Provenance::grain_deg`].
    pub grain_deg: f64,
    /// Seed of the simulated noise.
    pub seed: u64,
}

/// What a sample is measured on.
pub enum Apparatus {
    /// The simulated rig, with the sample in it.
    Simulated(Arc<dyn Brdf>, Box<TwinConfig>),
    /// Real devices.
    Real(Box<DevicesFile>),
}

impl Apparatus {
    /// The simulated rig, if it is one.
    pub fn config(&self) -> Option<&TwinConfig> {
        match self {
            Apparatus::Simulated(_, config) => Some(config),
            Apparatus::Real(_) => None,
        }
    }
}

/// What all measurements of one call share.
pub struct Session<'a> {
    pub args: &'a Args,
    pub rig: &'a Rig,
    pub plan: &'a Plan,
    faults: Faults,
    control: Control,
    assumed: Assumptions,
}

impl Session<'_> {
    /// The simulated devices of a seed.
    pub fn config(&self, seed: u64) -> anyhow::Result<TwinConfig> {
        let config = common::twin(&self.args.twin, seed, self.args.misalign.as_deref())?;
        Ok(if self.args.noiseless { config.noiseless() } else { config })
    }

    /// Opens a sample, or checks that real devices can do what rig and plan ask for.
    pub fn checked(&self, sample: &Mounted) -> anyhow::Result<Apparatus> {
        if !(-360.0..=360.0).contains(&sample.grain_deg) {
            let message = format!("a grain at {} deg is out of range: choose -360..=360", sample.grain_deg);
            return Err(BadUsage(message).into());
        }
        match (&self.args.devices, &sample.simulate) {
            (Some(_), Some(material)) => {
                let message = format!("`simulate = {material}` with --devices: leave one of them out");
                Err(BadUsage(message).into())
            }
            (Some(path), None) => {
                let file = common::devices_file(path)?;
                self.check(&common::devices(&file, self.rig, self.args.yes, &self.control)?)?;
                Ok(Apparatus::Real(Box::new(file)))
            }
            (None, Some(material)) => {
                let brdf = common::mounted(open(material)?, sample.grain_deg);
                Ok(Apparatus::Simulated(brdf, Box::new(self.config(sample.seed)?)))
            }
            (None, None) => Err(common::no_devices()),
        }
    }

    /// Compares devices with rig and plan.
    fn check(&self, bench: &dyn Bench) -> anyhow::Result<()> {
        check_devices(self.rig, bench, &self.plan.exposures_s(&Timing::of(self.rig)))?;
        Ok(())
    }

    /// Measures a sample into a folder.
    pub fn measured(
        &self,
        sample: &Mounted,
        apparatus: Apparatus,
        calibration: &CalibrationSet,
        folder: RunFolder,
    ) -> anyhow::Result<Measurement> {
        let unnamed = || "a sample without a name".to_owned();
        let simulation = apparatus.config().map(|config| serde_json::to_value(config).expect("plain data"));
        let (mut bench, folder, is, name): (Box<dyn Bench>, _, _, _) = match apparatus {
            Apparatus::Simulated(brdf, config) => {
                let bench = self.on_time(common::bench(self.rig, &config, brdf));
                (Box::new(bench), folder, sample.simulate.clone().unwrap_or_default(), sample.name.clone())
            }
            Apparatus::Real(file) => {
                let bench = common::devices(&file, self.rig, self.args.yes, &self.control)?;
                // Whoever goes on may be elsewhere.
                let folder = folder.holding(DEVICES, file.from_anywhere()?.to_toml());
                (Box::new(bench), folder, sample.name.clone().unwrap_or_else(unnamed), None)
            }
        };
        let provenance = Provenance {
            sample: is,
            simulation,
            name,
            grain_deg: sample.grain_deg,
            started: Some(common::now()),
            merged: Vec::new(),
            assumed: self.assumed.clone(),
        };
        let request = Request {
            rig: self.rig,
            plan: self.plan,
            calibration,
            provenance: &provenance,
            control: &self.control,
            adviser: Some(&FitAdviser::default()),
        };
        let mut bar = common::frames_bar(sample.name.as_deref().unwrap_or("measure"));
        Ok(measure(&request, bench.as_mut(), Some(&folder), &mut bar)?)
    }

    /// Ends a run on the devices it was begun with.
    pub fn resumed(&self, out: &Path) -> anyhow::Result<Measurement> {
        for (name, given) in [("rig.toml", self.rig.to_toml()), ("plan.toml", self.plan.to_toml())] {
            let path = out.join(name);
            if store::read_text(&path).context("this is no run to resume")? != given {
                let message = format!("{} is not what was given: resume with the run's own", path.display());
                return Err(BadUsage(message).into());
            }
        }
        let bench = |rig: &Rig, record: &RunRecord| -> anyhow::Result<Box<dyn Bench>> {
            let Provenance { simulation, sample, grain_deg, .. } = &record.provenance;
            let Some(simulation) = simulation else {
                let path = self.args.devices.clone().unwrap_or_else(|| out.join(DEVICES));
                return Ok(Box::new(common::devices(
                    &common::devices_file(&path)?,
                    rig,
                    self.args.yes,
                    &self.control,
                )?));
            };
            if self.args.devices.is_some() {
                return Err(BadUsage("this run was simulated: resume it without --devices".into()).into());
            }
            let config: TwinConfig = serde_json::from_value(simulation.clone()).with_context(|| {
                format!("{}: `simulation` is damaged: measure again", out.join("run.json").display())
            })?;
            let sample = common::mounted(open(sample)?, *grain_deg);
            Ok(Box::new(self.on_time(common::bench(rig, &config, sample))))
        };
        resume(out, &self.control, Some(&FitAdviser::default()), bench, &mut common::frames_bar("measure"))
    }

    fn on_time(&self, bench: TwinBench) -> TwinBench {
        let bench = if self.args.paced { bench.paced() } else { bench };
        let bench = if self.args.free_running { bench.free_running() } else { bench };
        bench.failing(self.faults)
    }
}

/// Faults from their names and values.
fn faults(given: &[String]) -> anyhow::Result<Faults> {
    let mut json = serde_json::Map::new();
    for fault in given {
        let number = fault.split_once('=').and_then(|(name, value)| {
            let value = match value.parse::<u64>() {
                Ok(n) => n.into(),
                Err(_) => serde_json::Number::from_f64(value.parse().ok()?)?.into(),
            };
            Some((name.to_owned(), value))
        });
        let Some((name, value)) = number else {
            return Err(BadUsage(format!("--fault {fault} is not NAME=NUMBER, e.g. --fault drop=0.01")).into());
        };
        json.insert(name, value);
    }
    serde_json::from_value(json.into()).map_err(|e| BadUsage(format!("--fault: {e}")).into())
}

/// What a run says at its end.
pub fn report(record: &RunRecord, out: &Path) -> Report {
    let capture = &record.capture;
    let mut text = format!(
        "order {}: {} images, {} frames, {:.1} s on the rig ({:.1} s exposure, {:.1} s readout wait, {:.1} s pattern change)\n\
         computed in {:.1} s, {:.2} s after the last frame; noise {:.3}% of DC, {:.2}% of pixels saturated\n\
         {} frames taken again, engine {:.2} ms per frame, display latency {:.0} ms, lamp {:+.2}..{:+.2}%\n\
         coefficients.exr and run.json in {}",
        record.order,
        record.images,
        record.frames,
        record.rig_s,
        record.rig_s_items.exposure_s,
        record.rig_s_items.readout_wait_s,
        record.rig_s_items.pattern_change_s,
        record.compute_s,
        record.post_s,
        100.0 * record.noise_rel,
        100.0 * record.saturated_fraction,
        capture.rejected,
        1e3 * capture.engine_s_per_frame,
        1e3 * capture.latency_s,
        100.0 * (capture.lamp[0] - 1.0),
        100.0 * (capture.lamp[1] - 1.0),
        out.display()
    );
    if let Some(budget) = &record.budget {
        text += "\n";
        text += &crate::budget::text(budget);
    }
    let mut json = serde_json::to_value(record).expect("plain data");
    json["out"] = common::said(out).into();
    Report { text, json }
}
