//! `zonal design --search`.

use std::path::Path;
use std::time::Instant;

use anyhow::Context;
use zonal::design::{Search, Values};
use zonal::optics::{Objective, Rig};
use zonal::report::{front_csv, front_sheet};
use zonal::store;

use crate::common::{self, Report};

/// Searches from a rig file's `[search]` table; writes table, pictures and the balanced rig to the new folder `out`.
pub fn run(rig: &Path, seed: u64, starts: usize, out: &Path) -> anyhow::Result<Report> {
    let started = Instant::now();
    common::makeable(out)?;
    store::vacant(out)?;
    let path = rig;
    let rig = common::rig(path)?;
    let search = Search::new(&rig).with_context(|| path.display().to_string())?;
    let found = search.run(seed, starts).with_context(|| path.display().to_string())?;
    let balanced = found.balanced.as_ref().map(|d| d.dimensions.to_rig(&rig)).map(|b| Rig {
        name: format!("{}-balanced", rig.name),
        source: format!("found by search from {} with seed {seed}, {starts} starts; devices: {}", rig.name, rig.source),
        ..b
    });
    // Rounded, it must still be a rig.
    let balanced = balanced.filter(|b| Rig::from_toml(&b.to_toml()).is_ok());
    let values = balanced.as_ref().and_then(Values::of);
    let sheet = front_sheet(&search, &found);
    store::write_dir(out, |folder| {
        store::write(&folder.join("front.csv"), &front_csv(&search, &found))?;
        store::write(&folder.join("front.svg"), sheet.to_svg().as_bytes())?;
        store::write(&folder.join("front.png"), &sheet.to_png())?;
        match &balanced {
            Some(b) => store::write(&folder.join("balanced.toml"), b.to_toml().as_bytes()),
            None => Ok(()),
        }
    })?;
    let seconds = started.elapsed().as_secs_f64();
    let [csv, svg, png, toml] =
        ["front.csv", "front.svg", "front.png", "balanced.toml"].map(|name| common::said(&out.join(name)));
    let mut text = format!(
        "{} rigs on the front, hypervolume {:.3}; {} rigs computed in {} rounds, {seconds:.0} s\n\n{:24}{:>12}{:>12}{:>24}\n",
        found.front.len(),
        found.hypervolume,
        found.evaluations,
        found.rounds,
        "",
        rig.name.get(..12).unwrap_or(&rig.name),
        "balanced",
        "front"
    );
    for objective in Objective::ALL {
        let on_front = found.front.iter().map(|d| d.values.get(objective));
        let (lo, hi) = on_front.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)));
        let balanced = values.map_or("-".into(), |v| format!("{:.4}", v.get(objective)));
        let own = search.own().get(objective);
        text += &format!("{:24}{own:>12.4}{balanced:>12}{lo:>12.4}{hi:>12.4}\n", objective.key());
    }
    let binding = found.balanced.as_ref().map(|d| d.binding.clone()).unwrap_or_default();
    text += &match &balanced {
        Some(_) => format!("\nbalanced rig: {toml}\n  binds: {}", binding.join(", ")),
        None => "\nno balanced rig keeps all limits".into(),
    };
    text += &format!("\npicture: {png}\n         {svg}\ntable: {csv}");
    let front: Vec<_> = found
        .front
        .iter()
        .map(|d| serde_json::json!({"values": d.values, "gains": d.gains, "binding": d.binding}))
        .collect();
    let json = serde_json::json!({
        "seed": seed, "starts": starts, "hypervolume": found.hypervolume, "evaluations": found.evaluations,
        "rounds": found.rounds, "seconds": seconds, "objectives": search.objectives(), "own": search.own(),
        "balanced": values, "binding": binding, "front": front, "csv": csv, "svg": svg, "png": png,
        "rig": balanced.is_some().then_some(toml),
    });
    Ok(Report { text, json })
}
