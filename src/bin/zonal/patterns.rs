//! `zonal patterns`.

use std::path::PathBuf;

use rayon::prelude::*;
use zonal::calibrate::CalibrationSet;
use zonal::patterns::{Lobe, Lobes};
use zonal::radiometry::{FlatField, Response};
use zonal::store;

use crate::common::{self, Report};

#[derive(clap::Args)]
pub struct Args {
    /// Rig file.
    rig: PathBuf,
    /// Plan file.
    plan: PathBuf,
    /// Folder for the frames.
    #[arg(long)]
    out: PathBuf,
    /// Folder with the rig's calibrations; without it the frames suit a linear, even projector.
    #[arg(long)]
    calibration: Option<PathBuf>,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let rig = common::rig(&args.rig)?;
    let plan = common::plan(&args.plan)?;
    common::makeable(&args.out)?;
    store::vacant(&args.out)?;
    let (width, height) = (rig.projector.width_px, rig.projector.height_px);
    let (response, flat, projector) = match &args.calibration {
        Some(folder) => {
            let set = CalibrationSet::read(folder, &rig)?;
            if let Some(map) = &set.map {
                map.check_zone(&rig)?;
            }
            let projector = set.maps(&rig).projector;
            (set.response, set.flat, projector)
        }
        None => (Response::linear(), FlatField::uniform(width, height), rig.projector_map()),
    };
    let lobes = Lobes::new(&projector, rig.zone(), plan.steps(rig.zone()), width, height)?;
    let mixed = plan.is_mixed();
    store::write_dir(&args.out, |folder| {
        (0..lobes.len()).into_par_iter().try_for_each(|k| {
            let pair = lobes.encode(k, &response, &flat);
            for (pattern, lobe) in pair.patterns.iter().zip(Lobe::both(k, mixed)) {
                pattern.write_png(&folder.join(format!("{}.png", lobe.stem())))?;
            }
            let (l, m) = zonal::basis::lm(k);
            let name = if mixed { format!("{k:03}.exr") } else { format!("{k:03}_l{l}_m{m:+}.exr") };
            lobes.write_exr(k, &folder.join(name))
        })
    })?;
    let (images, functions) = (2 * lobes.len(), lobes.len());
    let text = format!("{images} frames (PNG) and {functions} functions (EXR) in {}", args.out.display());
    let json = serde_json::json!({ "order": plan.order, "images": images, "out": common::said(&args.out) });
    Ok(Report { text, json })
}
