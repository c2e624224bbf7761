//! The page of a run.

use std::path::Path;

use super::html::{budget, document, gallery, heading, provenance, slices, spectrum, summary};
use super::text::{degrees, percent};
use super::{RunReport, fit_sections};

/// The whole page.
pub fn page(report: &RunReport) -> String {
    let (record, fits) = (&report.record, &report.fits);
    let sample = file_name(&record.provenance.sample);
    let truth = report.truth.as_deref().map_or("the truth", file_name);
    let sections = [
        summary(sample, record, &format!("; {}", fit_sections::found(fits, truth))),
        fit_sections::warnings(fits),
        pictures(report),
        fit_sections::chosen(fits),
        fit_sections::comparison(fits),
        slices(&report.slices),
        spectrum(&report.spectrum),
        fit_sections::residuals(fits),
        fit_sections::plausibility(fits),
        record.budget.as_ref().map_or_else(String::new, budget),
        origin(report),
    ];
    document(&format!("{sample} measured by {}", record.rig), &sections.concat())
}

/// The last part of a path; a name stays as it is.
fn file_name(material: &str) -> &str {
    Path::new(material).file_name().and_then(|name| name.to_str()).unwrap_or(material)
}

fn pictures(report: &RunReport) -> String {
    if report.pictures.is_empty() {
        return String::new();
    }
    // With the truth beside it, a picture takes twice the room.
    let (title, layout) =
        if report.truth.is_some() { ("The fit, against the truth", "pair") } else { ("The fit", "row") };
    heading(title) + &gallery(layout, &report.pictures)
}

fn origin(report: &RunReport) -> String {
    let (r, fit) = (&report.record, report.fits.chosen());
    let calibration = format!(
        "edges of the zone known to {}°, scales of the channels to {}; both are part of the standard errors",
        degrees(fit.calibration.edge_deg),
        percent(fit.calibration.scale_rel)
    );
    let seed = r.provenance.simulation.as_ref().and_then(|s| s.get("seed")).map(ToString::to_string);
    let history = fit.history.replace(',', ", ");
    let rows = [
        ("Sample", Some(r.provenance.sample.as_str())),
        ("Truth", report.truth.as_deref()),
        ("Rig", Some(&r.rig)),
        ("Plan", Some(&r.plan)),
        ("Measured by", Some(&r.software)),
        ("Fitted by", Some(&fit.software)),
        ("Calibration", Some(&calibration)),
        ("Seed of the simulated rig", seed.as_deref()),
        ("Units", Some(&fit.units)),
        ("Colours", Some(&fit.colour_space)),
        ("History", Some(&history)),
    ];
    provenance(rows.into_iter().filter_map(|(name, value)| Some((name, value?))))
}
