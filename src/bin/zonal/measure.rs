//! `zonal measure`.

use std::path::PathBuf;

use anyhow::Context;
use zonal::capture::{Bench, RunFolder};
use zonal::measure::{Measurement, Provenance, Request, RunRecord, measure, resume};
use zonal::optics::Rig;
use zonal::reflectance::open;
use zonal::store;
use zonal::twin::{Faults, TwinBench, TwinConfig};

use crate::common::{self, BadUsage, Report};

#[derive(clap::Args)]
pub struct Args {
    /// Rig file.
    rig: PathBuf,
    /// Plan file.
    plan: PathBuf,
    /// Run folder to create, or with --resume to go on with.
    #[arg(long)]
    out: PathBuf,
    /// Go on with a run that was stopped, failed or killed; rig, plan, calibration and sample are the run's own.
    #[arg(long)]
    resume: bool,
    /// Measure this material on the simulated rig: a .bsdf, .binary or .dat file, or a name of `zonal materials`.
    #[arg(long, value_name = "MATERIAL")]
    simulate: Option<String>,
    /// Seed of the simulated noise.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
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
    calibration: Option<PathBuf>,
    /// Days after which a calibration is too old.
    #[arg(long, value_name = "DAYS", default_value_t = 30.0)]
    max_age_days: f64,
    /// Colours of the coefficients instead of the plan's.
    #[arg(long, value_enum)]
    colour: Option<common::Colours>,
    /// Keep every camera frame as a 16-bit PNG.
    #[arg(long)]
    keep_frames: bool,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let rig = common::rig(&args.rig)?;
    let mut plan = common::plan(&args.plan)?;
    if let Some(colours) = args.colour {
        plan = plan.in_colours(colours.space());
    }
    if args.max_age_days.is_nan() || args.max_age_days <= 0.0 {
        return Err(BadUsage(format!("--max-age-days {}: choose a number above 0", args.max_age_days)).into());
    }
    let faults = faults(&args.fault)?;
    let mut bar = common::frames_bar("measure");
    if args.resume {
        let measured = resumed(args, &rig, &plan.to_toml(), faults, &mut bar)?;
        return Ok(report(&measured.record, &args.out));
    }
    common::makeable(&args.out)?;
    let Some(material) = &args.simulate else { return Err(common::no_devices()) };
    let sample = open(material)?;
    let mut config = common::twin(args.seed, args.misalign.as_deref())?;
    if args.noiseless {
        config = config.noiseless();
    }
    // Found out before a calibration is made; the folder itself appears with the first frame.
    let folder = RunFolder::create(&args.out, args.keep_frames)?;
    let calibration = common::calibration(args.calibration.as_deref(), &rig, &config, Some(args.max_age_days))?;
    let mut bench = on_time(common::bench(&rig, &config, sample), args).failing(faults);
    let provenance =
        Provenance { sample: material.clone(), simulation: Some(serde_json::to_value(&config).expect("plain data")) };
    let control = common::steered();
    let request =
        Request { rig: &rig, plan: &plan, calibration: &calibration, provenance: &provenance, control: &control };
    let measured = measure(&request, &mut bench, Some(&folder), &mut bar)?;
    Ok(report(&measured.record, &args.out))
}

/// Ends a run on the devices it was begun with.
fn resumed(
    args: &Args,
    rig: &Rig,
    plan: &str,
    faults: Faults,
    bar: &mut dyn FnMut(usize, usize),
) -> anyhow::Result<Measurement> {
    for (name, given) in [("rig.toml", rig.to_toml()), ("plan.toml", plan.to_owned())] {
        let path = args.out.join(name);
        if store::read_text(&path).context("this is no run to resume")? != given {
            let message = format!("{} is not what was given: resume with the run's own", path.display());
            return Err(BadUsage(message).into());
        }
    }
    let bench = |rig: &Rig, record: &RunRecord| -> anyhow::Result<Box<dyn Bench>> {
        let Some(simulation) = &record.provenance.simulation else { return Err(common::no_devices()) };
        let config: TwinConfig = serde_json::from_value(simulation.clone()).with_context(|| {
            format!("{}: `simulation` is damaged: measure again", args.out.join("run.json").display())
        })?;
        let sample = open(&record.provenance.sample)?;
        Ok(Box::new(on_time(common::bench(rig, &config, sample), args).failing(faults)))
    };
    resume(&args.out, &common::steered(), bench, bar)
}

fn on_time(bench: TwinBench, args: &Args) -> TwinBench {
    let bench = if args.paced { bench.paced() } else { bench };
    if args.free_running { bench.free_running() } else { bench }
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
pub fn report(record: &RunRecord, out: &std::path::Path) -> Report {
    let capture = &record.capture;
    let text = format!(
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
    let mut json = serde_json::to_value(record).expect("plain data");
    json["out"] = common::said(out).into();
    Report { text, json }
}
