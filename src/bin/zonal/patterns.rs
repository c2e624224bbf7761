//! `zonal patterns`.

use std::path::PathBuf;

use rayon::prelude::*;
use zonal::basis::size;
use zonal::calibrate::CalibrationSet;
use zonal::patterns::{Lobe, Lobes, Sign};
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
    let lobes = Lobes::new(&projector, rig.zone(), plan.order, width, height)?;
    store::write_dir(&args.out, |folder| {
        (0..size(plan.order)).into_par_iter().try_for_each(|k| {
            let pair = lobes.encode(k, &response, &flat);
            for (pattern, sign) in pair.patterns.iter().zip([Sign::Positive, Sign::Negative]) {
                pattern.write_png(&folder.join(format!("{}.png", Lobe { k, sign }.stem())))?;
            }
            let (l, m) = zonal::basis::lm(k);
            lobes.write_exr(k, &folder.join(format!("{k:03}_l{l}_m{m:+}.exr")))
        })
    })?;
    let text =
        format!("{} frames (PNG) and {} functions (EXR) in {}", plan.images(), size(plan.order), args.out.display());
    let json = serde_json::json!({ "order": plan.order, "images": plan.images(), "out": common::said(&args.out) });
    Ok(Report { text, json })
}
