//! `zonal outlook`.

use std::path::PathBuf;

use zonal::forecast::learn;
use zonal::geometry::Zone;
use zonal::reflectance::{Brdf, sgd_materials};
use zonal::store;

use crate::common::{self, Report};

#[derive(clap::Args)]
pub struct Args {
    /// TOML file to write.
    #[arg(long)]
    out: PathBuf,
    /// Of the SGD materials, every so many.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=10))]
    every: u16,
    /// Seed of the noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// The zone of the rig that has been built, degrees.
const BUILT: [f64; 2] = [9.0, 57.0];

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let out = common::writable(&args.out)?;
    let materials = sgd_materials();
    let some: Vec<&dyn Brdf> = materials.iter().step_by(args.every.into()).map(|m| &m.brdf as &dyn Brdf).collect();
    let outlook = learn(Zone::from_degrees(BUILT[0], BUILT[1])?, &some, args.seed)?;
    store::write(&out, outlook.to_toml().as_bytes())?;
    let classes: Vec<String> = outlook.class.iter().map(|c| format!("{} {}", c.materials, c.class.name())).collect();
    let text = format!("{}; {}", classes.join(", "), out.display());
    let json = serde_json::json!({ "materials": some.len(), "out": common::said(&out) });
    Ok(Report { text, json })
}
