//! `zonal calibrate`.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::ValueEnum;
use zonal::calibrate::{CalibrationSet, flat_field, gray_card, gray_card_plan, response};
use zonal::store::{self, StoreError};
use zonal::twin::TwinConfig;

use crate::common::{self, Report};

#[derive(Clone, Copy, ValueEnum)]
enum Kind {
    /// The projector's response, black level and contrast.
    Response,
    /// The projector's light over its panel.
    FlatField,
    /// The scale of every channel; needs the other two in the same folder.
    GrayCard,
}

#[derive(clap::Args)]
pub struct Args {
    /// What to calibrate.
    kind: Kind,
    /// Rig file.
    rig: PathBuf,
    /// Folder the calibration is written to.
    #[arg(long)]
    out: PathBuf,
    /// Calibrate the simulated rig.
    #[arg(long)]
    simulate: bool,
    /// Seed of the simulated noise.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let rig = common::rig(&args.rig)?;
    common::makeable(&args.out)?;
    if !args.simulate {
        return Err(common::no_devices());
    }
    let config = common::for_calibration(&TwinConfig::pinhole(args.seed));
    let mut bench = common::bench(&rig, &config, zonal::reflectance::open("gray-card")?);
    match args.kind {
        Kind::Response => {
            let response = response(&rig, &mut bench)?;
            write(&args.out, |folder| CalibrationSet::write_response(&response, folder, &rig))?;
            let text = format!("contrast {:.1}:1; response.json in {}", response.contrast(), args.out.display());
            Ok(Report { text, json: serde_json::json!({ "kind": "response", "contrast": response.contrast() }) })
        }
        Kind::FlatField => {
            let flat = flat_field(&rig, &mut bench)?;
            write(&args.out, |folder| CalibrationSet::write_flat_field(&flat, folder, &rig))?;
            let darkest = flat.values.iter().copied().fold(1.0f32, f32::min);
            let text = format!("darkest pixel {darkest:.3} of the brightest; flat-field.exr in {}", args.out.display());
            Ok(Report { text, json: serde_json::json!({ "kind": "flat-field", "darkest": darkest }) })
        }
        Kind::GrayCard => {
            let needs = "the gray card needs `zonal calibrate response` and `flat-field` in the same --out first";
            let response = CalibrationSet::read_response(&args.out, &rig).context(needs)?;
            let flat = CalibrationSet::read_flat_field(&args.out, &rig).context(needs)?;
            let mut bar = common::frames_bar("gray card");
            let (scale, check) = gray_card(&rig, &mut bench, &gray_card_plan(&rig), &response, &flat, &mut bar)?;
            CalibrationSet::write_gray_card(&scale, &check, &args.out, &rig)?;
            let text = format!(
                "z_10 off by {:.3}% of z_00, z_20 by {:.3}% (largest {:.3}%); gray-card.json in {}",
                100.0 * check.z_10_error,
                100.0 * check.z_20_error,
                100.0 * check.worst_error,
                args.out.display()
            );
            Ok(Report { text, json: serde_json::json!({ "kind": "gray-card", "check": check }) })
        }
    }
}

/// Adds a file to the folder, or makes the folder with it.
fn write(folder: &Path, file: impl FnOnce(&Path) -> Result<(), StoreError>) -> Result<(), StoreError> {
    if folder.is_dir() { file(folder) } else { store::write_dir(folder, file) }
}
