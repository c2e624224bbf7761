//! `zonal measure`.

use std::path::PathBuf;

use zonal::capture::RunFolder;
use zonal::measure::{Provenance, RunRecord, measure};
use zonal::reflectance::open;

use crate::common::{self, Report};

#[derive(clap::Args)]
pub struct Args {
    /// Rig file.
    rig: PathBuf,
    /// Plan file.
    plan: PathBuf,
    /// Run folder to create.
    #[arg(long)]
    out: PathBuf,
    /// Measure this material on the simulated rig: a .bsdf, .binary or .dat file, or a name of `zonal materials`.
    #[arg(long, value_name = "MATERIAL")]
    simulate: Option<String>,
    /// Seed of the simulated noise.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
    /// Simulate a camera without shot and dark noise.
    #[arg(long)]
    noiseless: bool,
    /// What is out of place in the simulated rig: a JSON file with any of the keys of `perturbation` in run.json.
    #[arg(long, value_name = "FILE.json")]
    misalign: Option<PathBuf>,
    /// Folder with the rig's calibrations; without it a simulated rig is calibrated first.
    #[arg(long)]
    calibration: Option<PathBuf>,
    /// Keep every camera frame as a 16-bit PNG.
    #[arg(long)]
    keep_frames: bool,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let rig = common::rig(&args.rig)?;
    let plan = common::plan(&args.plan)?;
    common::makeable(&args.out)?;
    let Some(material) = &args.simulate else { return Err(common::no_devices()) };
    let sample = open(material)?;
    let mut config = common::twin(args.seed, args.misalign.as_deref())?;
    if args.noiseless {
        config = config.noiseless();
    }
    // Found out before a calibration is made; the folder itself appears with the first frame.
    let mut folder = RunFolder::create(&args.out, args.keep_frames)?;
    let calibration = common::calibration(args.calibration.as_deref(), &rig, &config)?;
    let mut bench = common::bench(&rig, &config, sample);
    let provenance =
        Provenance { sample: material.clone(), simulation: Some(serde_json::to_value(&config).expect("plain data")) };
    let mut bar = common::frames_bar("measure");
    let measured = measure(&rig, &plan, &mut bench, &calibration, provenance, Some(&mut folder), &mut bar)?;
    Ok(report(&measured.record, &args.out))
}

/// What a run says at its end.
pub fn report(record: &RunRecord, out: &std::path::Path) -> Report {
    let text = format!(
        "order {}: {} images, {} frames, {:.1} s on the rig ({:.1} s exposure, {:.1} s readout wait, {:.1} s pattern change)\n\
         computed in {:.1} s, {:.2} s after the last frame; noise {:.3}% of DC, {:.2}% of pixels saturated\n\
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
        out.display()
    );
    let mut json = serde_json::to_value(record).expect("plain data");
    json["out"] = common::said(out).into();
    Report { text, json }
}
