//! `zonal export`.

use std::path::PathBuf;

use clap::ValueEnum;
use zonal::export::{write_bsdf, write_density};
use zonal::reflectance::Model;

use crate::common::{self, BadUsage, Report};

#[derive(Clone, Copy, ValueEnum)]
enum Format {
    /// RGL table for renderers (Mitsuba 3 `measured`, RGB variants), .bsdf.
    Bsdf,
    /// Half-vector density p(h) of a D-BRDF, .exr.
    Density,
}

impl Format {
    fn name(self) -> &'static str {
        match self {
            Self::Bsdf => "bsdf",
            Self::Density => "density",
        }
    }

    fn extension(self) -> &'static str {
        match self {
            Self::Bsdf => "bsdf",
            Self::Density => "exr",
        }
    }
}

#[derive(clap::Args)]
pub struct Args {
    /// A fit (.json), a converted run (.exr), a measured file (.bsdf, .binary, .dat) or a name of `zonal materials`.
    model: String,
    /// What to write.
    #[arg(long)]
    format: Format,
    /// File to write: .bsdf for `bsdf`, .exr for `density`.
    #[arg(long)]
    out: PathBuf,
    /// Export a fit even if its search failed.
    #[arg(long)]
    force: bool,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let out = common::writable(&args.out)?;
    let (format, extension) = (args.format.name(), args.format.extension());
    if out.extension().and_then(|e| e.to_str()) != Some(extension) {
        let message = format!("{}: --format {format} writes .{extension} files: name one", out.display());
        return Err(BadUsage(message).into());
    }
    let material = common::material(&args.model)?;
    match &material.unsuccessful {
        Some(why) if args.force => eprintln!("warning: {why}"),
        Some(why) => {
            let message = format!("{why}, its parameters are no minimum: fit another model, or add --force");
            return Err(BadUsage(message).into());
        }
        None => {}
    }
    match args.format {
        Format::Bsdf => write_bsdf(material.brdf.as_ref(), &material.history, &out)?,
        Format::Density => {
            let Some(Model::Dbrdf(model)) = &material.model else {
                let message =
                    format!("{} is no D-BRDF and has no density p(h): fit one to it, or use --format bsdf", args.model);
                return Err(BadUsage(message).into());
            };
            write_density(model, &material.history, &out)?
        }
    }
    let bytes = std::fs::metadata(&out).map(|m| m.len()).unwrap_or_default();
    let isotropic = material.brdf.is_isotropic();
    let text = format!(
        "{format} of {} ({}), {:.2} MB in {}",
        args.model,
        if isotropic { "isotropic" } else { "anisotropic" },
        bytes as f64 / 1e6,
        out.display()
    );
    let json =
        serde_json::json!({ "format": format, "bytes": bytes, "isotropic": isotropic, "out": common::said(&out) });
    Ok(Report { text, json })
}
