//! `zonal render`.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use zonal::geometry::Direction;
use zonal::render::{Image, Probe, sphere_directional, sphere_probe};

use crate::common::{self, BadUsage, Report};

#[derive(clap::Args)]
pub struct Args {
    /// A converted run (.exr), a measured file (.bsdf, .binary, .dat) or a name of `zonal materials`.
    model: String,
    /// PNG or EXR to write.
    #[arg(long)]
    out: PathBuf,
    /// Another material beside it, e.g. the truth.
    #[arg(long)]
    beside: Option<String>,
    /// Light it by an environment (lat-long .hdr or .exr, or `studio`) instead of one directional light.
    #[arg(long)]
    probe: Option<String>,
    /// Side of a sphere in pixels.
    #[arg(long, default_value_t = 256, allow_negative_numbers = true)]
    size: usize,
    /// Multiplies the image before it is encoded as PNG.
    #[arg(long, default_value_t = 1.0, allow_negative_numbers = true)]
    exposure: f32,
}

/// A light probe from a file, or the one built in.
pub fn probe(name: &str) -> anyhow::Result<Probe> {
    if name == "studio" { Ok(Probe::studio()) } else { Ok(Probe::read(Path::new(name))?) }
}

/// The light of a directional picture: from above, to the right, towards the viewer.
pub fn key_light<F>() -> Direction<F> {
    Direction::new(Vector3::new(0.45, 0.55, 0.7))
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let out = common::writable(&args.out)?;
    if !(8..=4096).contains(&args.size) {
        return Err(BadUsage(format!("--size {} is out of range: choose 8..=4096", args.size)).into());
    }
    if !(args.exposure.is_finite() && args.exposure > 0.0) {
        return Err(BadUsage(format!("--exposure {} is out of range: choose a positive number", args.exposure)).into());
    }
    let exr = match out.extension().and_then(|e| e.to_str()) {
        Some("exr") => true,
        Some("png") => false,
        _ => return Err(BadUsage(format!("{}: name a .png or .exr file", out.display())).into()),
    };
    let probe = args.probe.as_deref().map(probe).transpose()?;
    let mut spheres = Vec::new();
    for name in std::iter::once(&args.model).chain(&args.beside) {
        let brdf = common::material(name)?;
        spheres.push(match &probe {
            Some(probe) => sphere_probe(brdf.as_ref(), probe, args.size),
            None => sphere_directional(brdf.as_ref(), key_light(), [std::f64::consts::PI; 3], args.size),
        });
    }
    let difference = spheres.get(1).and_then(|truth| spheres[0].relative_rms(truth));
    let image = Image::side_by_side(&spheres);
    if exr {
        image.write_exr(&out)?
    } else {
        image.write_png(&out, args.exposure)?
    }
    let mut text = format!("{} x {} px in {}", image.width, image.height, out.display());
    if let Some(difference) = difference {
        text += &format!("; RMS difference {:.1}% of the second sphere", 100.0 * difference);
    }
    let json = serde_json::json!({ "out": common::said(&out), "rms_difference": difference });
    Ok(Report { text, json })
}
