//! `zonal measure --batch`: many samples, one calibration.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::{Deserialize, Serialize};
use zonal::calibrate::CalibrationSet;
use zonal::capture::{CaptureError, RunFolder};
use zonal::measure::{MeasureError, RunRecord};
use zonal::store;

use crate::common::{self, BadUsage, Report, SamplesFailed};
use crate::measure::{Mounted, Session};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BatchFile {
    sample: Vec<Entry>,
}

/// A sample of the list.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    name: String,
    /// Material, on the simulated rig.
    simulate: Option<String>,
    #[serde(default)]
    grain_deg: f64,
    /// Seed of the simulated noise; by default that of the call plus the place in the list.
    seed: Option<u64>,
}

/// What became of a sample.
#[derive(Serialize)]
struct Outcome {
    name: String,
    grain_deg: f64,
    run: String,
    /// `measured`, `resumed`, `complete before` or `failed`.
    outcome: &'static str,
    noise_rel: Option<f64>,
    /// Albedo of the zone with its standard uncertainty, red, green, blue.
    albedo: Option<[f64; 3]>,
    standard_uncertainty: Option<[f64; 3]>,
    error: Option<String>,
}

/// Measures all samples of `file`; a failed one does not keep the others.
pub fn run(session: &Session<'_>, file: &Path) -> anyhow::Result<Report> {
    let args = session.args;
    let samples = read(file, args.seed)?;
    common::makeable(&args.out)?;
    if !args.resume {
        store::vacant(&args.out)?;
    }
    if args.devices.is_some() {
        // Devices are the same for all: what is wrong with them is found out before anything is written.
        samples.iter().try_for_each(|sample| session.checked(sample).map(drop))?;
    }
    let calibration = calibration(session)?;
    let mut outcomes = Vec::new();
    for sample in &samples {
        let run = args.out.join(folder_name(sample));
        let done = one(session, sample, &run, &calibration);
        if let Err(error) = &done
            && stopped(error)
        {
            return Err(done.unwrap_err().context("the batch goes on with --resume"));
        }
        let (outcome, record, error) = match done {
            Ok((outcome, record)) => (outcome, Some(record), None),
            Err(error) => ("failed", None, Some(common::message(&error))),
        };
        let albedo = record.as_ref().and_then(|r| r.budget.as_ref()).map(|b| b.albedo);
        outcomes.push(Outcome {
            name: sample.name.clone().unwrap_or_default(),
            grain_deg: sample.grain_deg,
            run: common::said(&run),
            outcome,
            noise_rel: record.map(|r| r.noise_rel),
            albedo: albedo.map(|a| a.value),
            standard_uncertainty: albedo.map(|a| a.standard_uncertainty),
            error,
        });
        // Whoever looks sees how far it has come.
        store::write_json(&args.out.join("batch.json"), &outcomes)?;
    }
    let table = table(&outcomes);
    let failed = outcomes.iter().filter(|o| o.error.is_some()).count();
    let json = serde_json::json!({ "out": common::said(&args.out), "samples": outcomes });
    if failed > 0 {
        return Err(SamplesFailed { failed, all: outcomes.len(), table, json }.into());
    }
    Ok(Report { text: table, json })
}

fn read(file: &Path, seed: u64) -> anyhow::Result<Vec<Mounted>> {
    let text = store::read_text(file)?;
    let list: BatchFile = toml::from_str(&text).map_err(|e| BadUsage(format!("{}: {e}", file.display())))?;
    let mounted = |(i, entry): (usize, Entry)| Mounted {
        name: Some(entry.name),
        simulate: entry.simulate,
        grain_deg: entry.grain_deg,
        seed: entry.seed.unwrap_or(seed.wrapping_add(i as u64)),
    };
    let samples: Vec<Mounted> = list.sample.into_iter().enumerate().map(mounted).collect();
    if samples.is_empty() {
        return Err(BadUsage(format!("{}: no [[sample]]: name at least one", file.display())).into());
    }
    let mut folders = HashSet::new();
    for sample in &samples {
        let folder = folder_name(sample);
        let taken = ["calibration", "batch.json", ".", ".."].contains(&folder.as_str());
        if folder.is_empty() || folder.contains(['/', '\\', '\0']) || taken || !folders.insert(folder.clone()) {
            let message =
                format!("{}: `{folder}` cannot name a run here: give each sample its own name", file.display());
            return Err(BadUsage(message).into());
        }
    }
    Ok(samples)
}

/// The folder of a sample's run: remounts of one sample differ by their angle.
fn folder_name(sample: &Mounted) -> String {
    let name = sample.name.clone().unwrap_or_default();
    if sample.grain_deg == 0.0 { name } else { format!("{name}-{}deg", sample.grain_deg) }
}

/// The calibration of the call, or the batch's own.
fn calibration(session: &Session<'_>) -> anyhow::Result<CalibrationSet> {
    let args = session.args;
    let own: PathBuf = args.out.join("calibration");
    let kept = args.resume && own.is_dir();
    let from = args.calibration.as_deref().or(kept.then_some(own.as_path()));
    let config = if args.devices.is_some() { None } else { Some(session.config(args.seed)?) };
    let calibration = common::calibration(from, session.rig, config.as_ref(), Some(args.max_age_days))?;
    if !kept {
        calibration.write(&own, session.rig)?;
    }
    Ok(calibration)
}

fn one(
    session: &Session<'_>,
    sample: &Mounted,
    run: &Path,
    calibration: &CalibrationSet,
) -> anyhow::Result<(&'static str, RunRecord)> {
    if session.args.resume && run.join("run.json").exists() {
        let record = RunRecord::read(run)?;
        if record.status == "complete" {
            return Ok(("complete before", record));
        }
        return Ok(("resumed", session.resumed(run)?.record));
    }
    let apparatus = session.checked(sample)?;
    let folder = RunFolder::create(run, session.args.keep_frames)?;
    let name = sample.name.as_deref().unwrap_or_default();
    if session.args.devices.is_some() {
        eprintln!("next sample: {name}");
    }
    let measured = session.measured(sample, apparatus, calibration, folder).context(name.to_owned())?;
    Ok(("measured", measured.record))
}

fn stopped(error: &anyhow::Error) -> bool {
    let by_user = |e: &CaptureError| matches!(e.cause(), CaptureError::Stopped { .. });
    error.chain().any(|cause| match cause.downcast_ref() {
        Some(MeasureError::Capture(e)) => by_user(e),
        _ => cause.downcast_ref().is_some_and(by_user),
    })
}

fn table(outcomes: &[Outcome]) -> String {
    let row = |o: &Outcome| {
        let head = format!("{:20} {:7.1} deg  {:16}", o.name, o.grain_deg, o.outcome);
        match (&o.error, o.albedo, o.standard_uncertainty, o.noise_rel) {
            (Some(error), ..) => format!("{head} {error}"),
            (None, Some(albedo), Some(sigma), Some(noise)) => {
                let each = [0, 1, 2].map(|c| format!("{:.4} +- {:.4}", albedo[c], sigma[c])).join("  ");
                format!("{head} noise {:.2}%  albedo of the zone {each}", 100.0 * noise)
            }
            _ => head,
        }
    };
    outcomes.iter().map(row).collect::<Vec<_>>().join("\n")
}
