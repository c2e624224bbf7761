//! What all pages are made of.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::figures::{chart_figure, slice_figure, spectrum_chart};
use super::text::{degrees, escape, number, percent, seconds};
use super::{Picture, Slice, SpectrumPoint};
use crate::measure::{Budget, Kind, RunRecord};

/// A whole page: a title and HTML below it.
pub fn document(title: &str, body: &str) -> String {
    let title = escape(title);
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\" />\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\" />\n<title>{title}</title>\n\
         <style>\n{}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n{body}</main>\n</body>\n</html>\n",
        include_str!("page.css")
    )
}

/// One sentence on the run, with an HTML `tail`, and its key numbers as tiles.
pub fn summary(sample: &str, r: &RunRecord, tail: &str) -> String {
    let rig = if r.provenance.simulation.is_some() { "simulated rig" } else { "rig" };
    let sentence = format!(
        "{} on the {rig} {}: zonal order {} in {} of rig time, with {} noise{tail}",
        escape(sample),
        escape(&r.rig),
        r.order,
        seconds(r.rig_s),
        percent(r.noise_rel)
    );
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

pub fn slices(slices: &[Slice]) -> String {
    if slices.is_empty() {
        return String::new();
    }
    heading("Slices in the plane of incidence")
        + "<p class=\"note\">The radius is the cube root of f cos θᵢ, so that a lobe and what lies beside it are both seen. Light angles θᵢ are positive \
           away from the camera. Shaded: the measured zone. \
           Triangle: the camera. Dotted line: the mirror direction. Negative values lie at the centre, values beyond the scale on the rim.</p>\n"
        + "<div class=\"pair\">\n"
        + &slices.iter().map(slice_figure).collect::<String>()
        + "</div>\n"
}

pub fn spectrum(points: &[SpectrumPoint]) -> String {
    if points.is_empty() {
        return String::new();
    }
    heading("Zonal spectrum")
        + &chart_figure(
            &spectrum_chart(points),
            "Coefficients in the frame of each exitant direction; rings of an isotropic sample are averaged, and their coefficients of \
             m < 0 are zero. Those well above the noise carry the measurement; where they sink into it, a higher order adds nothing. \
             Where the model's line leaves the measured points, the model does not describe the sample.",
        )
}

/// What the albedo of the zone is uncertain by, and why.
pub fn budget(budget: &Budget) -> String {
    const COLUMNS: [&str; 3] = ["Red", "Green", "Blue"];
    let row = |name: &str, values: [String; 3], last: &str| {
        let name = escape(name);
        let cells = number_cells(&COLUMNS, &values);
        format!("<tr><th scope=\"row\">{name}</th>{cells}<td>{}</td></tr>\n", escape(last))
    };
    let kind = |kind: Kind| match kind {
        Kind::Random => "each coefficient",
        Kind::Azimuthal => "each direction, not in means over azimuth",
        Kind::Channel => "each channel",
        Kind::Common => "common to all",
    };
    let components = budget
        .components
        .iter()
        .map(|c| row(&c.name, c.relative.map(percent), &format!("{}; {}", kind(c.kind), c.source)));
    let a = &budget.albedo;
    let interval = a.interval_95.map(|[low, high]| format!("{} – {}", number(low, 4), number(high, 4)));
    let total = [0, 1, 2].map(|c| percent(a.standard_uncertainty[c] / a.value[c]));
    heading("Uncertainty of the albedo")
        + "<p class=\"note\">Integral of f cos θᵢ over the measured zone, mean over exitant directions. Relative standard uncertainties; \
           all but the azimuthal ones add up by their squares.</p>\n<table class=\"cards\">\n"
        + &table_head("Component", &COLUMNS, Some("Kind and source"))
        + "<tbody>\n"
        + &components.collect::<String>()
        + &row("all together", total, "")
        + &row("albedo of the zone", a.value.map(|v| number(v, 4)), "")
        + &row("its 95 % interval", interval, "")
        + "</tbody>\n</table>\n"
}

/// A table of names and values.
pub fn provenance<'a>(rows: impl IntoIterator<Item = (&'a str, &'a str)>) -> String {
    let row = |(name, value): (&str, &str)| {
        format!("<tr><th scope=\"row\">{}</th><td>{}</td></tr>\n", escape(name), escape(value))
    };
    heading("Provenance")
        + "<table>\n<tbody>\n"
        + &rows.into_iter().map(row).collect::<String>()
        + "</tbody>\n</table>\n"
}

/// The head of a table of numbers: the name of the rows, and columns.
pub fn table_head(first: &str, columns: &[&str], last: Option<&str>) -> String {
    let number = |c: &&str| format!("<th scope=\"col\" class=\"number\">{c}</th>");
    let last = last.map_or_else(String::new, |c| format!("<th scope=\"col\">{c}</th>"));
    let columns: String = columns.iter().map(number).collect();
    format!("<thead><tr><th scope=\"col\">{first}</th>{columns}{last}</tr></thead>\n")
}

/// The cells of a row below [`table_head`], each with its column's name for narrow screens.
pub fn number_cells(columns: &[&str], values: &[String]) -> String {
    let cell = |(label, value): (&&str, &String)| format!("<td class=\"number\" data-label=\"{label}\">{value}</td>");
    columns.iter().zip(values).map(cell).collect()
}

pub fn heading(text: &str) -> String {
    format!("<h2>{text}</h2>\n")
}

/// Pictures with their captions in a grid of the class `layout`.
pub fn gallery(layout: &str, pictures: &[Picture]) -> String {
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
