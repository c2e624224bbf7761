//! The page of a demonstration.

use super::figures::{accuracy_chart, chart_figure};
use super::html::{document, gallery, heading, number_cells, provenance, slices, spectrum, summary, table_head};
use super::text::{escape, number, percent, seconds, signed_percent};
use super::{DemoReport, MethodRow, fit_sections};
use crate::basis::Method;

/// The whole page.
pub fn page(report: &DemoReport) -> String {
    let sections = [
        summary(&report.material, &report.record, &off(report)),
        fit_sections::warnings(&report.fits),
        spheres(report),
        plans(report),
        speed(report),
        fit_sections::chosen(&report.fits),
        fit_sections::comparison(&report.fits),
        slices(&report.slices),
        spectrum(&report.spectrum),
        pictures(report),
        gray_card(report),
        methods(report),
        rig_time(report),
        origin(report),
    ];
    document(&report.title, &sections.concat())
}

/// How far the fit and the conversion are off, for the summary.
fn off(report: &DemoReport) -> String {
    let fit = fit_sections::found(&report.fits, "the truth");
    let conversion = exported(&report.methods).map_or_else(String::new, |(inside, outside)| {
        format!(", the conversion {} and {}", percent(inside), percent(outside))
    });
    format!("; {fit}{conversion}")
}

/// Errors, inside and outside, of the method that the run is exported with.
fn exported(methods: &[MethodRow]) -> Option<(f64, f64)> {
    let parity = methods.iter().find(|m| m.method == Method::Parity.name())?;
    Some((parity.error_in?, parity.error_out?)).filter(|e| e.0.is_finite() && e.1.is_finite())
}

fn spheres(report: &DemoReport) -> String {
    if report.spheres.is_empty() {
        return String::new();
    }
    heading("What was measured, against the truth") + &gallery("pictures", &report.spheres)
}

/// What other plans, run on the same material, leave of it.
fn plans(report: &DemoReport) -> String {
    report.pareto.as_ref().map_or_else(String::new, |pareto| {
        heading("What time on the rig buys")
            + "<p class=\"note\">Errors of a fit of this material, one figure for all four of <code>zonal compare</code>; \
               <code>zonal chart pareto</code> draws this for several materials.</p>\n"
            + &pareto.sheet().to_html()
    })
}

fn speed(report: &DemoReport) -> String {
    if report.accuracy.is_empty() {
        return String::new();
    }
    heading("Speed against accuracy of the conversion")
        + &chart_figure(
            &accuracy_chart(&report.accuracy),
            "L: zonal order. Rig time is what the plan takes on the physical rig; down and left is better.",
        )
}

fn pictures(report: &DemoReport) -> String {
    let response = gallery("pictures", std::slice::from_ref(&report.response));
    heading("Patterns and response") + &gallery("thumbs", &report.patterns) + &response
}

fn gray_card(report: &DemoReport) -> String {
    let c = &report.gray_card;
    let balance = c.white_balance.map(|b| number(b, 3)).join(" : ");
    let rows = [
        ("z₁₀, deviation from the ideal diffuser", signed_percent(c.z_10_error), "about 2 %"),
        ("z₂₀, deviation from 0", signed_percent(c.z_20_error), "about 10 %"),
        ("Worst coefficient of any channel", percent(c.worst_error), "–"),
    ];
    let rows = rows.map(|(name, here, thesis)| {
        format!(
            "<tr><th scope=\"row\">{name}</th><td class=\"number\">{here}</td><td class=\"number\">{thesis}</td></tr>\n"
        )
    });
    heading("Gray-card check")
        + "<p class=\"note\">Deviations are in units of z₀₀; the thesis (Ghosh 2007) does not say in what units its own are.</p>\n"
        + "<table>\n<thead><tr><th scope=\"col\">Quantity</th><th scope=\"col\" class=\"number\">This rig</th>\
           <th scope=\"col\" class=\"number\">Thesis</th></tr></thead>\n<tbody>\n"
        + &rows.concat()
        + &format!("</tbody>\n</table>\n<p class=\"note\">White balance, scale of R : G : B: {balance}.</p>\n")
}

/// Columns of the methods table after the method's name.
const METHOD_COLUMNS: [&str; 6] =
    ["Order", "Condition", "Noise gain in zone", "Noise gain outside", "Error in zone", "Error outside"];

fn methods(report: &DemoReport) -> String {
    if report.methods.is_empty() {
        return String::new();
    }
    let rows: String = report.methods.iter().map(method_row).collect();
    heading("Methods of reconstruction")
        + "<p class=\"note\">Noise gain: standard error of the reconstruction over that of the zonal one, no unit. \
           Errors are relative to the RMS of the truth.</p>\n<table class=\"cards\">\n"
        + &table_head("Method", &METHOD_COLUMNS, Some("Outcome"))
        + &format!("<tbody>\n{rows}</tbody>\n</table>\n")
}

fn method_row(m: &MethodRow) -> String {
    let error = |e: Option<f64>| e.map_or_else(|| "–".into(), percent);
    let values = [
        m.order.to_string(),
        number(m.condition, 2),
        number(m.noise_gain_in, 2),
        number(m.noise_gain_out, 2),
        error(m.error_in),
        error(m.error_out),
    ];
    let cells = number_cells(&METHOD_COLUMNS, &values);
    let outcome = match &m.refused {
        Some(reason) => format!("<td class=\"refused\" data-label=\"Outcome\">refused: {}</td>", escape(reason)),
        None => "<td data-label=\"Outcome\">allowed</td>".into(),
    };
    format!("<tr><th scope=\"row\">{}</th>{cells}{outcome}</tr>\n", escape(&m.method))
}

fn rig_time(report: &DemoReport) -> String {
    let (r, items) = (&report.record, &report.record.rig_s_items);
    let share = |s: f64| if items.total_s() > 0.0 { percent(s / items.total_s()) } else { "–".into() };
    let row = |class: &str, name: &str, s: f64, share: String| {
        format!(
            "<tr{class}><th scope=\"row\">{name}</th><td class=\"number\">{}</td><td class=\"number\">{share}</td></tr>\n",
            seconds(s)
        )
    };
    heading("Rig time, itemised")
        + "<p class=\"note\">Predicted wall time on the physical rig.</p>\n<table>\n<thead><tr><th scope=\"col\">Item</th>\
           <th scope=\"col\" class=\"number\">Time</th><th scope=\"col\" class=\"number\">Share</th></tr></thead>\n<tbody>\n"
        + &row("", "Shutter open", items.exposure_s, share(items.exposure_s))
        + &row("", "Waiting for the camera", items.readout_wait_s, share(items.readout_wait_s))
        + &row("", "Changing patterns", items.pattern_change_s, share(items.pattern_change_s))
        + &row(" class=\"total\"", "All together", items.total_s(), share(items.total_s()))
        + &format!(
            "</tbody>\n</table>\n<p class=\"note\">This program took {} from the first pattern to the coefficients, {} of it after the \
             last frame.</p>\n",
            seconds(r.compute_s),
            seconds(r.post_s)
        )
}

fn origin(report: &DemoReport) -> String {
    let r = &report.record;
    let own = [
        ("Material", report.material.as_str()),
        ("Rig", &r.rig),
        ("Plan", &r.plan),
        ("Sample", &r.provenance.sample),
        ("Software", &r.software),
        ("Status", &r.status),
    ];
    let given = report.provenance.iter().map(|(name, value)| (name.as_str(), value.as_str()));
    provenance(own.into_iter().chain(given))
}
