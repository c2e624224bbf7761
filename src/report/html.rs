//! The page.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::figures::{accuracy_chart, chart_figure, slice_figure, spectrum_chart};
use super::text::{degrees, escape, number, percent, seconds, signed_percent};
use super::{DemoReport, MethodRow, Picture};
use crate::basis::Method;

/// The whole page.
pub fn page(report: &DemoReport) -> String {
    let title = escape(&report.title);
    let sections = [summary(report), spheres(report), speed(report), slices(report), spectrum(report)];
    let more = [pictures(report), gray_card(report), methods(report), rig_time(report), provenance(report)];
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\" />\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\" />\n<title>{title}</title>\n\
         <style>\n{}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n{}{}</main>\n</body>\n</html>\n",
        include_str!("page.css"),
        sections.concat(),
        more.concat()
    )
}

/// One sentence, and the key numbers as tiles.
fn summary(report: &DemoReport) -> String {
    let r = &report.record;
    let rig = if r.provenance.simulation.is_some() { "simulated rig" } else { "rig" };
    let mut sentence = format!(
        "{} on the {rig} {}: zonal order {} in {} of rig time, with {} noise",
        escape(&report.material),
        escape(&r.rig),
        r.order,
        seconds(r.rig_s),
        percent(r.noise_rel)
    );
    if let Some((inside, outside)) = exported(&report.methods) {
        sentence += &format!(
            "; the conversion is {} off inside the measured zone and {} outside",
            percent(inside),
            percent(outside)
        );
    }
    let zone = format!("{}° to {}°", degrees(r.zone_deg[0]), degrees(r.zone_deg[1]));
    let frames = format!("{} ({})", r.frames, r.images);
    let facts = [
        ("Rig time", seconds(r.rig_s)),
        ("Frames (patterns)", frames),
        ("Measured zone", zone),
        ("Noise, relative to z₀₀", percent(r.noise_rel)),
        ("Saturated pixels", percent(r.saturated_fraction)),
        ("Last frame to result", seconds(r.post_s)),
    ];
    let tiles = facts.map(|(name, value)| format!("<div><dt>{name}</dt><dd>{value}</dd></div>\n"));
    format!("<p class=\"summary\">{sentence}.</p>\n<dl class=\"facts\">\n{}</dl>\n", tiles.concat())
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

fn speed(report: &DemoReport) -> String {
    if report.accuracy.is_empty() {
        return String::new();
    }
    heading("Speed against accuracy")
        + &chart_figure(
            &accuracy_chart(&report.accuracy),
            "L: zonal order. Rig time is what the plan takes on the physical rig; down and left is better.",
        )
}

fn slices(report: &DemoReport) -> String {
    if report.slices.is_empty() {
        return String::new();
    }
    heading("Slices in the plane of incidence")
        + "<p class=\"note\">The radius is the cube root of f cos θᵢ, so that a lobe and what lies beside it are both seen. Light angles θᵢ are positive \
           away from the camera. Shaded: the measured zone. \
           Triangle: the camera. Dotted line: the mirror direction. Negative values lie at the centre, values beyond the scale on the rim.</p>\n"
        + "<div class=\"pair\">\n"
        + &report.slices.iter().map(slice_figure).collect::<String>()
        + "</div>\n"
}

fn spectrum(report: &DemoReport) -> String {
    if report.spectrum.is_empty() {
        return String::new();
    }
    heading("Zonal spectrum")
        + &chart_figure(
            &spectrum_chart(&report.spectrum),
            "Coefficients well above the noise carry the measurement; where they sink into it, a higher order adds nothing.",
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
    let head = METHOD_COLUMNS.map(|c| format!("<th scope=\"col\" class=\"number\">{c}</th>"));
    let rows: String = report.methods.iter().map(method_row).collect();
    heading("Methods of reconstruction")
        + "<p class=\"note\">Noise gain: standard error of the reconstruction over that of the zonal one, no unit. \
           Errors are relative to the RMS of the truth.</p>\n"
        + &format!(
            "<table class=\"cards\">\n<thead><tr><th scope=\"col\">Method</th>{}<th scope=\"col\">Outcome</th></tr>\
             </thead>\n<tbody>\n{rows}</tbody>\n</table>\n",
            head.concat()
        )
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
    let cells: String = METHOD_COLUMNS
        .iter()
        .zip(&values)
        .map(|(label, value)| format!("<td class=\"number\" data-label=\"{label}\">{value}</td>"))
        .collect();
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

fn provenance(report: &DemoReport) -> String {
    let r = &report.record;
    let own = [
        ("Material", &report.material),
        ("Rig", &r.rig),
        ("Plan", &r.plan),
        ("Sample", &r.provenance.sample),
        ("Software", &r.software),
        ("Status", &r.status),
    ];
    let given = report.provenance.iter().map(|(name, value)| (name.as_str(), value));
    let rows: String = own
        .into_iter()
        .chain(given)
        .map(|(name, value)| format!("<tr><th scope=\"row\">{}</th><td>{}</td></tr>\n", escape(name), escape(value)))
        .collect();
    heading("Provenance") + "<table>\n<tbody>\n" + &rows + "</tbody>\n</table>\n"
}

fn heading(text: &str) -> String {
    format!("<h2>{text}</h2>\n")
}

/// Pictures with their captions in a grid of the class `layout`.
fn gallery(layout: &str, pictures: &[Picture]) -> String {
    if pictures.is_empty() {
        return String::new();
    }
    let figures: String = pictures
        .iter()
        .map(|picture| {
            let (data, caption) = (STANDARD.encode(&picture.png), escape(&picture.caption));
            format!(
                "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{data}\" />\
                 <figcaption>{caption}</figcaption></figure>\n"
            )
        })
        .collect();
    format!("<div class=\"{layout}\">\n{figures}</div>\n")
}
