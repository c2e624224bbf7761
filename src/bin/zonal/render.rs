//! `zonal render`.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use zonal::render::{Image, Probe, Shape};

use crate::common::{self, BadUsage, Report};

#[derive(Clone, Copy, ValueEnum)]
enum ShapeArg {
    /// Grain along the circles of latitude.
    Sphere,
    /// Upright, grain round it.
    Cylinder,
}

impl From<ShapeArg> for Shape {
    fn from(arg: ShapeArg) -> Self {
        match arg {
            ShapeArg::Sphere => Shape::Sphere,
            ShapeArg::Cylinder => Shape::Cylinder,
        }
    }
}

#[derive(clap::Args)]
pub struct Args {
    /// A fit (.json), a converted run (.exr), a measured file (.bsdf, .binary, .dat) or a name of `zonal materials`.
    model: String,
    /// PNG or EXR to write.
    #[arg(long)]
    out: PathBuf,
    /// Another material beside it, e.g. the truth.
    #[arg(long)]
    beside: Option<String>,
    /// Add the difference to the one beside: signed in an EXR; in a PNG red where brighter, blue where darker, full at the
    /// mean of the one beside.
    #[arg(long, requires = "beside")]
    difference: bool,
    /// What the material covers.
    #[arg(long, default_value = "sphere")]
    shape: ShapeArg,
    /// Light it by an environment (lat-long .hdr or .exr, or `studio`) instead of one directional light.
    #[arg(long)]
    probe: Option<String>,
    /// Side of a shape's picture in pixels.
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
    let shape = Shape::from(args.shape);
    let mut pictures = Vec::new();
    for name in std::iter::once(&args.model).chain(&args.beside) {
        let brdf = common::material(name)?.brdf;
        pictures.push(match &probe {
            Some(probe) => shape.in_probe(brdf.as_ref(), probe, args.size),
            None => shape.in_key_light(brdf.as_ref(), args.size),
        });
    }
    let errors = match &pictures[..] {
        [model, beside] => model.relative_rms(beside).zip(model.relative_mean(beside)),
        _ => None,
    };
    if let (true, [model, beside]) = (args.difference, &pictures[..]) {
        let difference = model.difference(beside).expect("one size");
        pictures.push(if exr { difference } else { coloured(&difference, beside, args.exposure) });
    }
    let image = Image::side_by_side(&pictures);
    if exr {
        image.write_exr(&out)?
    } else {
        image.write_png(&out, args.exposure)?
    }
    let mut text = format!("{} x {} px in {}", image.width, image.height, out.display());
    if let Some((rms, mean)) = errors {
        text +=
            &format!("; difference to the second picture: RMS {:.1}%, mean {:.1}% of it", 100.0 * rms, 100.0 * mean);
    }
    let json = serde_json::json!({
        "out": common::said(&out),
        "rms_difference": errors.map(|e| e.0),
        "mean_difference": errors.map(|e| e.1),
    });
    Ok(Report { text, json })
}

/// The colours of a signed difference, full at the mean of `beside`, whatever the exposure of the other pictures.
fn coloured(difference: &Image, beside: &Image, exposure: f32) -> Image {
    let full = (beside.mean() as f32).max(f32::MIN_POSITIVE);
    let mut colours = difference.diverging(full);
    colours.pixels.iter_mut().flatten().for_each(|v| *v /= exposure);
    colours
}
