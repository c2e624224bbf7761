//! `zonal compare`.

use serde_json::json;
use zonal::geometry::Zone;
use zonal::reflectance::{ALBEDO_DEG, Metric};
use zonal::render::Shape;

use crate::common::{self, BadUsage, Report};
use crate::render;

#[derive(clap::Args)]
pub struct Args {
    /// A fit (.json), a converted run (.exr), a measured file (.bsdf, .binary, .dat) or a name of `zonal materials`.
    model: String,
    /// What it should be: a measured file or a name, not a reconstruction.
    #[arg(long)]
    truth: String,
    /// Polar angles that count as inside, in degrees: those of a fit, 9,57 for other models.
    #[arg(long, value_name = "MIN,MAX", value_parser = zone, allow_hyphen_values = true)]
    zone: Option<Zone>,
    /// Environment for the spheres: lat-long .hdr or .exr, or `studio`.
    #[arg(long, default_value = "studio")]
    probe: String,
}

/// Side of a sphere in pixels: twice as many change the difference by less than 2% of itself.
const SIZE: usize = 64;

/// The zone of "MIN,MAX" in degrees.
fn zone(text: &str) -> Result<Zone, String> {
    let limits = text.split_once(',').map(|(min, max)| (min.trim().parse::<f64>(), max.trim().parse::<f64>()));
    let Some((Ok(min), Ok(max))) = limits else { return Err("give two angles in degrees, as in 9,57".into()) };
    if max > 90.0 {
        return Err(format!("{max} deg lies below the horizon: choose at most 90"));
    }
    Zone::from_degrees(min, max).map_err(|e| e.to_string())
}

/// The zone asked for, which must be a fit's own: errors in another one would be read as those of the measurement.
fn zone_of(args: &Args, fitted: Option<Zone>) -> anyhow::Result<Zone> {
    let degrees = |z: Zone| format!("{:.2}..{:.2} deg", z.theta_min().to_degrees(), z.theta_max().to_degrees());
    match (args.zone, fitted) {
        (Some(asked), Some(own)) if !asked.is_close(&own) => Err(BadUsage(format!(
            "{} was fitted in {}, --zone asks for {}: leave --zone out, or fit a run of that zone",
            args.model,
            degrees(own),
            degrees(asked)
        ))
        .into()),
        (asked, own) => Ok(asked.or(own).unwrap_or(Zone::from_degrees(9.0, 57.0)?)),
    }
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let probe = render::probe(&args.probe)?;
    let (model, truth) = (common::material(&args.model)?, common::material(&args.truth)?.brdf);
    let zone = zone_of(args, model.zone)?;
    if let Some(why) = &model.unsuccessful {
        eprintln!("warning: {why}");
    }
    let model = model.brdf;
    let errors = Metric::new(zone).errors(truth.as_ref(), model.as_ref())?;
    let [of_model, of_truth] = [&model, &truth].map(|brdf| Shape::Sphere.in_probe(brdf.as_ref(), &probe, SIZE));
    let difference = of_model.relative_rms(&of_truth);

    let zone_deg = [zone.theta_min(), zone.theta_max()].map(f64::to_degrees);
    let mut json = serde_json::to_value(errors)?;
    json["zone_deg"] = json!(zone_deg);
    json["render_difference"] = json!(difference);
    json["model"] = json!(args.model);
    json["truth"] = json!(args.truth);
    json["probe"] = json!(args.probe);

    let percent = |value: f64| if value.is_nan() { "-".into() } else { format!("{:.1}%", 100.0 * value) };
    let plain = |value: f64| if value.is_nan() { "-".into() } else { format!("{value:.3}") };
    let e = errors.mean;
    let mut text = format!("{} against {}\n", args.model, args.truth);
    text +=
        &format!("{:28}{:>10}{:>10}\n", "", format!("{}..{} deg", zone_deg[0].round(), zone_deg[1].round()), "outside");
    text += &format!("{:28}{:>10}{:>10}\n", "f_cos, of the truth's RMS", percent(e.rel_in), percent(e.rel_out));
    text += &format!("{:28}{:>10}{:>10}\n", "ln f", plain(e.log_in), plain(e.log_out));
    for (theta, error) in ALBEDO_DEG.into_iter().zip(e.albedo_error) {
        text += &format!("{:28}{:>10}\n", format!("albedo at {theta} deg"), format!("{:+.1}%", 100.0 * error));
    }
    let difference = percent(difference.unwrap_or(f64::NAN));
    text += &format!("{:28}{:>10}", format!("spheres, probe {}", args.probe), difference);
    Ok(Report { text, json })
}
