//! `zonal calibrate`.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::ValueEnum;
use zonal::calibrate::{CalibrationSet, DeviceAlignment, align, flat_field, gray_card, gray_card_plan, map, response};
use zonal::store::{self, StoreError};

use crate::common::{self, Report};

#[derive(Clone, Copy, ValueEnum)]
enum Kind {
    /// The projector's response, black level and contrast.
    Response,
    /// Where camera and projector stand, from crosses on the optical axis.
    Align,
    /// Where devices and mirrors stand, from fringes in a mirror; needs `response`, uses `align` from the same folder.
    Map,
    /// The projector's light over its panel; uses `map`.
    FlatField,
    /// The scale of every channel; needs `response` and `flat-field` in the same folder, uses `map`.
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
    /// What is out of place in the simulated rig: a JSON file with any of the keys of `perturbation` in run.json.
    #[arg(long, value_name = "FILE.json")]
    misalign: Option<PathBuf>,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let rig = common::rig(&args.rig)?;
    common::makeable(&args.out)?;
    if !args.simulate {
        return Err(common::no_devices());
    }
    let config = common::twin(args.seed, args.misalign.as_deref())?;
    let config = common::for_calibration(&config);
    let mut bench = common::bench(&rig, &config, zonal::reflectance::open("gray-card")?);
    match args.kind {
        Kind::Response => {
            let response = response(&rig, &mut bench)?;
            write(&args.out, |folder| CalibrationSet::write_response(&response, folder, &rig))?;
            let text = format!("contrast {:.1}:1; response.json in {}", response.contrast(), args.out.display());
            Ok(Report { text, json: serde_json::json!({ "kind": "response", "contrast": response.contrast() }) })
        }
        Kind::Align => {
            let found = align(&rig, &mut bench)?;
            write(&args.out, |folder| CalibrationSet::write_align(&found, folder, &rig))?;
            let told = |name: &str, d: &DeviceAlignment| {
                let ([x, y], [ex, ey], [a, b], [ea, eb]) =
                    (d.displacement_mm, d.displacement_error_mm, d.turn_deg, d.turn_error_deg);
                format!(
                    "{name}: x {x:+.3} +- {ex:.3} mm, y {y:+.3} +- {ey:.3} mm; turned {a:+.3} +- {ea:.3} deg about x, \
                     {b:+.3} +- {eb:.3} deg about y\n  {}\n",
                    d.instruction(name)
                )
            };
            let text = format!(
                "{}{}x and y as the device sees them, through the beam splitter; align.json in {}",
                told("camera", &found.camera),
                told("projector", &found.projector),
                args.out.display()
            );
            let instructions = [found.camera.instruction("camera"), found.projector.instruction("projector")];
            let json = serde_json::json!({ "kind": "align", "alignment": found, "instructions": instructions });
            Ok(Report { text, json })
        }
        Kind::Map => {
            let needs = "the map needs `zonal calibrate response` in the same --out first";
            let response = CalibrationSet::read_response(&args.out, &rig).context(needs)?;
            let known = CalibrationSet::read_align(&args.out, &rig)?;
            let found = map(&rig, &mut bench, &response, known.as_ref())?;
            found.check_zone(&rig)?;
            CalibrationSet::write_map(&found, &args.out, &rig)?;
            let text = format!(
                "{} + {} pairs, residuals {:.3} and {:.3} px; directions to {:.3} deg (camera) and {:.3} deg (projector){}\n\
                 usable zone {:.2} +- {:.2} to {:.2} +- {:.2} deg, fringes seen in {:.1}% of it; map.json in {}",
                found.pairs[0],
                found.pairs[1],
                found.residual_px[0],
                found.residual_px[1],
                found.direction_error_deg[0],
                found.direction_error_deg[1],
                if known.is_some() { "" } else { "; `zonal calibrate align` first would tell more" },
                found.zone_deg[0],
                found.zone_error_deg[0],
                found.zone_deg[1],
                found.zone_error_deg[1],
                100.0 * found.seen_share,
                args.out.display()
            );
            Ok(Report { text, json: serde_json::json!({ "kind": "map", "map": found }) })
        }
        Kind::FlatField => {
            let map = CalibrationSet::read_map(&args.out, &rig)?;
            let flat = flat_field(&rig, &mut bench, map.as_ref())?;
            write(&args.out, |folder| CalibrationSet::write_flat_field(&flat, folder, &rig))?;
            let darkest = flat.values.iter().copied().fold(1.0f32, f32::min);
            let text = format!("darkest pixel {darkest:.3} of the brightest; flat-field.exr in {}", args.out.display());
            Ok(Report { text, json: serde_json::json!({ "kind": "flat-field", "darkest": darkest }) })
        }
        Kind::GrayCard => {
            let needs = "the gray card needs `zonal calibrate response` and `flat-field` in the same --out first";
            let response = CalibrationSet::read_response(&args.out, &rig).context(needs)?;
            let flat = CalibrationSet::read_flat_field(&args.out, &rig).context(needs)?;
            let map = CalibrationSet::read_map(&args.out, &rig)?;
            let mut bar = common::frames_bar("gray card");
            let plan = gray_card_plan(&rig);
            let (scale, check) = gray_card(&rig, &mut bench, &plan, &response, &flat, map.as_ref(), &mut bar)?;
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
