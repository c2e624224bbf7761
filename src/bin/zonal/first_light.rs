//! `zonal first-light`.

use std::path::PathBuf;

use zonal::capture::Control;
use zonal::devices::{Verdict, first_light};

use crate::common::{self, DevicesFail, Report};

#[derive(clap::Args)]
pub struct Args {
    /// Rig file.
    rig: PathBuf,
    /// Devices file, as `zonal devices` prints its tables.
    devices: PathBuf,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let rig = common::rig(&args.rig)?;
    // Whatever is in place will do, if it is white.
    let bench = common::devices(&common::devices_file(&args.devices)?, &rig, true, &Control::default())?;
    let found = first_light(&rig, &bench);
    if !found.is_good() {
        let failed = found.findings.iter().filter(|f| f.verdict == Verdict::Fails).count();
        let (all, table) = (found.findings.len(), found.to_string());
        return Err(DevicesFail { failed, all, table, json: serde_json::to_value(&found)? }.into());
    }
    Ok(Report { text: found.to_string(), json: serde_json::to_value(&found)? })
}
