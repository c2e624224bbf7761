//! `zonal prior`.

use std::path::PathBuf;

use zonal::convert::{half_of_the_materials, learn};
use zonal::geometry::Zone;
use zonal::store;

use crate::common::{self, Report};

#[derive(clap::Args)]
pub struct Args {
    /// TOML file to write.
    #[arg(long)]
    out: PathBuf,
    /// Materials to learn from, names of `zonal materials` of the family abc; every other one unless given.
    #[arg(long, num_args = 1.., value_name = "NAME")]
    materials: Vec<String>,
    /// Factor of the standard errors that the materials give by themselves: closed forms predict one another better than
    /// measurements. 2 was found on neural fits of the materials learned from.
    #[arg(long, default_value_t = 2.0)]
    widening: f64,
    /// Seed of the noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// The zone of the rig that has been built, degrees.
const BUILT: [f64; 2] = [9.0, 57.0];

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let out = common::writable(&args.out)?;
    let materials = if args.materials.is_empty() { half_of_the_materials() } else { args.materials.clone() };
    let zone = Zone::from_degrees(BUILT[0], BUILT[1])?;
    let table = learn(zone, materials, args.widening, args.seed)?;
    store::write(&out, table.to_toml().as_bytes())?;
    let text = format!(
        "{} materials, misfit {:.0e}, {} neighbours; {}",
        table.materials.len(),
        table.misfit,
        table.neighbours,
        out.display()
    );
    let json = serde_json::json!({
        "materials": table.materials.len(),
        "misfit": table.misfit,
        "neighbours": table.neighbours,
        "out": common::said(&out),
    });
    Ok(Report { text, json })
}
