//! `zonal plan`.

use std::path::PathBuf;

use zonal::patterns::Timing;

use crate::common::{self, Report};

#[derive(clap::Args)]
pub struct Args {
    /// Rig file.
    rig: PathBuf,
    /// Plan file.
    plan: PathBuf,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let rig = common::rig(&args.rig)?;
    let plan = common::plan(&args.plan)?;
    let timing = Timing::of(&rig);
    let items = plan.rig_time(&timing);
    let exposures: Vec<String> = plan.exposures_s(&timing).iter().map(|e| format!("{:.1}", e * 1e3)).collect();
    let text = format!(
        "{} on {}: {} images x {} exposures ({} ms) x {} = {} frames\n{:.1} s on the rig: {:.1} s exposure, {:.1} s readout wait, {:.1} s pattern change",
        plan.name,
        rig.name,
        plan.images(),
        exposures.len(),
        exposures.join(", "),
        plan.repeats,
        plan.frames(),
        items.total_s(),
        items.exposure_s,
        items.readout_wait_s,
        items.pattern_change_s
    );
    let text = match &plan.automatic {
        Some(target) => format!(
            "{text}\nas many exposures of {} to {} refresh periods are taken as noise of {}% needs: this is the time of two for each lobe",
            target.shortest_refreshes,
            target.longest_refreshes,
            100.0 * target.noise_rel
        ),
        None => text,
    };
    let json = serde_json::json!({
        "order": plan.order,
        "images": plan.images(),
        "frames": plan.frames(),
        "rig_s": items.total_s(),
        "rig_s_items": items,
    });
    Ok(Report { text, json })
}
