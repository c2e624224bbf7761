//! `zonal design`.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use zonal::design::{Angle, MeasuredProfile, Survey, ToleranceTable};
use zonal::handover::{self, Part, Parts};
use zonal::report::DesignReport;
use zonal::store;

use crate::common::{self, Report};
use crate::design_search;

#[derive(clap::Args)]
pub struct Args {
    /// Rig file.
    rig: PathBuf,
    /// New or empty folder for the report, the drawing and the profile files.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Search for better dimensions, from the rig file's table `[search]`; writes the front to `--out`.
    #[arg(long, requires = "out")]
    search: bool,
    /// Random points that the search begins from.
    #[arg(long, default_value_t = 100, requires = "search", value_parser = clap::value_parser!(u16).range(2..=10_000))]
    starts: u16,
    /// Measured profile of the dome, CSV with the columns r_mm and z_mm from the axis outwards: what its departure does.
    #[arg(long)]
    profile: Option<PathBuf>,
    /// Wall of the dome, mm.
    #[arg(long, default_value_t = handover::WALL_MM, value_parser = common::within(0.1, 100.0))]
    wall_mm: f64,
    /// Distance of the profile's points along its arc, mm.
    #[arg(long, default_value_t = handover::SPACING_MM, value_parser = common::within(1e-3, 100.0))]
    spacing_mm: f64,
    /// Chord error of the solids, mm.
    #[arg(long, default_value_t = handover::CHORD_MM, value_parser = common::within(1e-4, 10.0))]
    chord_mm: f64,
    /// Step of the polar angle, degrees.
    #[arg(long, default_value_t = 1.0, value_parser = common::within(0.1, 10.0))]
    step_deg: f64,
    /// Also analyse what the tolerances cost (minutes).
    #[arg(long)]
    tolerances: bool,
    /// Material that tolerances are analysed for: a built-in name or a file.
    #[arg(long, default_value = "ggx-0.1")]
    material: String,
    /// Zonal order that it is measured to.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(0..=10))]
    order: u16,
    /// Rigs drawn at each scale of the tolerances.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u16).range(8..=10_000))]
    draws: u16,
    /// Seed of the draws, and of the search's random points.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Blur of a pupil, degrees, below which chief rays may stand for it.
    #[arg(long, default_value_t = 0.1, value_parser = common::within(1e-6, 90.0))]
    chief_deg: f64,
}

/// What is handed over beside the page.
const FILES: [(&str, &str); 9] = [
    ("profile.csv", "the dome's profile with normals and radii of curvature"),
    ("dome.dxf", "section 1:1"),
    ("mandrel.dxf", "section 1:1"),
    ("convex-mirror.dxf", "section 1:1"),
    ("dome.stl", "solid"),
    ("mandrel.stl", "solid"),
    ("convex-mirror.stl", "solid"),
    ("section.svg", "dimensioned drawing"),
    ("angles.svg", "what is measured over polar angles"),
];

pub fn run(args: &Args) -> anyhow::Result<Report> {
    if args.search {
        let out = args.out.as_deref().expect("clap requires it");
        return design_search::run(&args.rig, args.seed, args.starts.into(), out);
    }
    let started = Instant::now();
    let rig = common::rig(&args.rig)?;
    if let Some(out) = &args.out {
        common::makeable(out)?;
        store::vacant(out)?;
    }
    let survey = Survey::new(&rig, args.step_deg)?;
    let tolerances = if args.tolerances {
        let material = common::material(&args.material)?;
        let order = usize::from(args.order);
        let table = ToleranceTable::new(&rig, material.brdf.as_ref(), order, args.draws.into(), args.seed)?;
        Some((args.material.clone(), table))
    } else {
        None
    };
    let measured = match &args.profile {
        Some(path) => {
            let points = handover::read_profile(&store::read_text(path)?).with_context(|| common::said(path))?;
            Some(MeasuredProfile::new(&rig, &points).with_context(|| common::said(path))?)
        }
        None => None,
    };
    let parts = Parts::new(&rig, rig.alignment.opening_radius_mm, args.wall_mm)?;
    let report = DesignReport {
        rig: rig.name.clone(),
        source: rig.source.clone(),
        survey,
        tolerances,
        drawing: handover::drawing_svg(&parts)?,
        chief_deg: args.chief_deg,
        files: FILES.map(|(name, what)| (name.to_owned(), what.to_owned())).to_vec(),
        measured,
    };
    if let Some(out) = &args.out {
        let sheet = report.sheet();
        store::write_dir(out, |folder| -> anyhow::Result<()> {
            let write = |name: &str, bytes: &[u8]| store::write(&folder.join(name), bytes);
            write("profile.csv", handover::profile_csv(&parts, args.spacing_mm)?.as_bytes())?;
            for part in Part::ALL {
                let name = part.name().replace(' ', "-");
                write(&format!("{name}.dxf"), handover::dxf(&parts, part)?.as_bytes())?;
                write(&format!("{name}.stl"), &handover::stl(&parts, part, args.chord_mm)?)?;
            }
            write("section.svg", report.drawing.as_bytes())?;
            write("angles.svg", sheet.to_svg().as_bytes())?;
            write("angles.png", &sheet.to_png())?;
            write("rig.toml", rig.to_toml().as_bytes())?;
            write("index.html", report.to_html().as_bytes())?;
            Ok(())
        })?;
    }
    let mut json = serde_json::to_value(&report.survey)?;
    json["rig"] = report.rig.clone().into();
    if let Some((material, table)) = &report.tolerances {
        json["tolerances"] = serde_json::to_value(table)?;
        json["tolerances"]["material"] = material.as_str().into();
    }
    if let Some(measured) = &report.measured {
        json["measured_profile"] = serde_json::to_value(measured)?;
    }
    if let Some(out) = &args.out {
        json["page"] = common::said(&out.join("index.html")).into();
    }
    json["seconds"] = started.elapsed().as_secs_f64().into();
    Ok(Report { text: text(&report), json })
}

/// Drafts that workshops ask for, degrees, and the polar angles up to which a dome has them.
fn draft(angles: &[Angle]) -> String {
    let up_to = |draft_deg: f64| {
        let after = angles.iter().position(|a| a.draft_deg < draft_deg)?;
        let (a, b) = (angles.get(after.checked_sub(1)?)?, &angles[after]);
        Some(a.theta_deg + (a.draft_deg - draft_deg) / (a.draft_deg - b.draft_deg) * (b.theta_deg - a.theta_deg))
    };
    let said =
        [10.0, 8.0, 5.0, 3.0].map(|draft| up_to(draft).map(|deg| format!("{draft} deg of draft up to {deg:.1} deg")));
    let said: Vec<String> = said.into_iter().flatten().collect();
    if said.is_empty() { "a mandrel has more than 10 deg of draft everywhere".into() } else { said.join(", ") }
}

fn text(report: &DesignReport) -> String {
    let s = &report.survey;
    let mut lines = vec![
        format!(
            "{}: zone {:.2} to {:.2} deg, {:.1}% of the hemisphere, {:.1}% of it projected",
            report.rig,
            s.zone_deg[0],
            s.zone_deg[1],
            100.0 * s.coverage,
            100.0 * s.projected_coverage
        ),
        format!(
            "shadow to {:.2} deg, undercut {}",
            s.shadow_deg,
            s.undercut_deg.map_or("none".into(), |u| format!("beyond {u:.1} deg"))
        ),
        format!(
            "dome {:.1} mm across, opening {:.1} mm at {:.1} mm above the sample",
            s.diameter_mm,
            2.0 * s.opening_mm,
            s.height_mm
        ),
        format!(
            "pixels per degree at least {:.2} (camera), {:.2} (projector)",
            s.camera_min_px_per_deg, s.projector_min_px_per_deg
        ),
        if s.footprint_margin_mm >= 0.0 {
            format!(
                "footprint condition holds by {:.3} mm: the sample may be {:.2} mm off its height",
                s.footprint_margin_mm, s.height_tolerance_mm
            )
        } else {
            format!(
                "footprint condition fails beyond {:.1} deg, by {:.3} mm at the zone's end",
                s.footprint_up_to_deg, -s.footprint_margin_mm
            )
        },
        draft(&s.angles),
        format!(
            "draft at the zone's end {:.1} deg; polarisation at most {:.2}%; transmission {:.1}%",
            s.draft_deg,
            100.0 * s.polarisation_bound,
            100.0 * s.transmission
        ),
    ];
    let end = |name: &str| {
        let of: Vec<String> = s
            .limits
            .iter()
            .filter(|l| l.end == name)
            .map(|l| format!("{} {:.2} deg{}", l.name, l.theta_deg, if l.binds { " (binds)" } else { "" }))
            .collect();
        format!("{name} end: {}", of.join(", "))
    };
    lines.extend(["inner", "outer"].map(end));
    for (name, beyond) in
        [("camera", report.beyond_chief(|a| a.camera)), ("projector", report.beyond_chief(|a| a.projector))]
    {
        lines.push(match beyond {
            None => format!("chief rays stand for the {name}'s pupil to {} deg", report.chief_deg),
            Some(([from, to], most)) => {
                format!("the {name}'s pupil blurs by up to {most:.2} deg between {from:.1} and {to:.1} deg")
            }
        });
    }
    lines.push("theta   r mm     z mm   draft  camera px/deg  projector px/deg".into());
    let last = s.angles.len() - 1;
    let told = |i: usize, theta_deg: f64| i == 0 || i == last || theta_deg % 5.0 == 0.0;
    for (_, a) in s.angles.iter().enumerate().filter(|(i, a)| told(*i, a.theta_deg)) {
        lines.push(format!(
            "{:5.1} {:7.2} {:8.2} {:7.2} {:8.2} {:5.2} {:9.2} {:5.2}",
            a.theta_deg,
            a.r_mm,
            a.z_mm,
            a.draft_deg,
            a.camera.px_per_deg[0],
            a.camera.px_per_deg[1],
            a.projector.px_per_deg[0],
            a.projector.px_per_deg[1]
        ));
    }
    if let Some(m) = &report.measured {
        lines.push(format!(
            "measured profile: departs by up to {:.4} mm ({:.4} RMS), slopes by {:.3} mrad; chief rays miss the middle by up to {:.3} mm, \
             directions are off by {:.4} deg RMS",
            m.departure_mm, m.departure_rms_mm, m.slope_mrad, m.miss_mm, m.direction_deg
        ));
    }
    if let Some((material, table)) = &report.tolerances {
        lines.push(format!(
            "tolerances, {material} at order {}, the five costliest (RMS of coefficients over z_00):",
            table.order
        ));
        for row in table.rows.iter().take(5) {
            lines.push(format!("  {} = {}: {:.2}%", row.key, row.sigma, 100.0 * row.coefficients_rel));
        }
        for d in &table.drawn {
            lines.push(format!(
                "  all at {} x: linear {:.2}%, drawn {:.2} +- {:.2}%",
                d.scale,
                100.0 * d.linear_rel,
                100.0 * d.monte_carlo_rel,
                100.0 * d.standard_error
            ));
        }
    }
    lines.join("\n")
}
