//! Sections of a page on models fitted to a run.

use super::figures::{chart_figure, fits_chart};
use super::heat::heat_svg;
use super::html::{heading, number_cells, table_head};
use super::text::{escape, number, percent, seconds};
use super::{Fits, MethodFit};
use crate::fit::{Candidate, FitMethod, FitReport};
use crate::reflectance::ALBEDO_DEG;

/// How far the chosen model is from the truth, or from the coefficients where no truth is known: the end of a sentence.
pub fn found(fits: &Fits, truth: &str) -> String {
    let report = fits.chosen();
    match &fits.of(fits.requested).errors {
        Some(errors) => format!(
            "the fitted model ({}) is {} off {} inside the measured zone and {} outside",
            report.model,
            percent(errors.mean.rel_in),
            escape(truth),
            percent(errors.mean.rel_out)
        ),
        None => {
            format!(
                "the fitted model ({}) misses the coefficients by {} of z₀₀",
                report.model,
                percent(report.misfit_rel)
            )
        }
    }
}

/// What the user must know before using the chosen model.
pub fn warnings(fits: &Fits) -> String {
    let report = fits.chosen();
    if report.warnings.is_empty() {
        return String::new();
    }
    let items: String = report.warnings.iter().map(|w| format!("<li>{}</li>\n", escape(&sentence(w)))).collect();
    format!(
        "<div class=\"warnings\">\n<strong>Before you use the fit ({}):</strong>\n<ul>\n{items}</ul>\n</div>\n",
        report.model
    )
}

fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| format!("{}{}.", first.to_uppercase(), letters.as_str()))
}

/// The model asked for: parameters with their errors, and how `auto` compared the families.
pub fn chosen(fits: &Fits) -> String {
    let report = fits.chosen();
    let asked = match fits.requested {
        FitMethod::Auto => format!("{}, chosen by auto", report.model),
        method => format!("{method}, as asked for"),
    };
    heading(&format!("Fitted model: {asked}"))
        + &format!(
            "<p>It misses the coefficients it was fitted to by {} of z₀₀; their noise is {} (rings are averaged unless the \
             sample is anisotropic). Chi, misfit over noise, is {}. Deviations from isotropy are {} times their standard \
             error.</p>\n",
            percent(report.misfit_rel),
            percent(report.noise_rel),
            number(report.chi, 3),
            number(report.isotropy_chi, 2)
        )
        + &parameters(report)
        + &ladder(fits)
}

/// Columns of the table of parameters after the name.
const PARAMETER_COLUMNS: [&str; 4] = ["R, or all", "G", "B", "Unit"];

fn parameters(report: &FitReport) -> String {
    let mut rows = String::new();
    for name in report.parameters.keys() {
        let value = |name: &str| {
            let error = report.standard_errors.get(name).copied().flatten();
            report.parameters.get(name).map(|&value| with_error(value, error))
        };
        let (name, values) = match name.rsplit_once('_') {
            // One row for each colour.
            Some((_, "g" | "b")) => continue,
            Some((stem, "r")) => (stem, ["r", "g", "b"].map(|c| value(&format!("{stem}_{c}")).unwrap_or_default())),
            _ => (name.as_str(), [value(name).unwrap_or_default(), String::new(), String::new()]),
        };
        let unit = if name.ends_with("_rad") { "rad" } else { "1" };
        let cells = number_cells(&PARAMETER_COLUMNS, &[&values[..], &[unit.into()]].concat());
        rows += &format!("<tr><th scope=\"row\">{}</th>{cells}</tr>\n", escape(name));
    }
    "<table class=\"cards\">\n".to_owned()
        + &table_head("Parameter", &PARAMETER_COLUMNS, None)
        + &format!(
            "<tbody>\n{rows}</tbody>\n</table>\n<p class=\"note\">± one standard error: noise, misfit and calibration. \
             Without one, the parameter lies on a bound or the data do not tell it. Unit 1: albedos, weights and \
             roughness have none.</p>\n"
        )
}

/// A value to the digits that its error leaves.
fn with_error(value: f64, error: Option<f64>) -> String {
    let Some(error) = error.filter(|e| e.is_finite() && *e > 0.0) else { return number(value, 3) };
    let digits = ((value.abs() / error).log10().floor() + 2.0).clamp(2.0, 6.0) as usize;
    format!("{} ± {}", number(value, digits), number(error, 2))
}

const LADDER_COLUMNS: [&str; 2] = ["Error of what was held out", "Error of what was seen"];

fn ladder(fits: &Fits) -> String {
    let Some(selection) = fits.selection() else { return String::new() };
    let taken = fits.of(FitMethod::Auto).report.model;
    let row = |c: &Candidate| {
        let class = if c.model == taken { " class=\"chosen\"" } else { "" };
        let cells = number_cells(&LADDER_COLUMNS, &[percent(c.predicted_error), percent(c.fitted_error)]);
        let outcome = match (c.model == taken, c.successful) {
            (true, _) => "<td data-label=\"Outcome\">chosen</td>",
            (false, true) => "<td data-label=\"Outcome\">passed over</td>",
            (false, false) => "<td class=\"refused\" data-label=\"Outcome\">the search failed</td>",
        };
        format!("<tr{class}><th scope=\"row\">{}</th>{cells}{outcome}</tr>\n", c.model)
    };
    let rows: String = selection.candidates.iter().map(row).collect();
    format!("<h3>Why auto chooses {taken}</h3>\n<p>{}.</p>\n<table class=\"cards\">\n", escape(&selection.reason))
        + &table_head("From simple to rich", &LADDER_COLUMNS, Some("Outcome"))
        + &format!(
            "<tbody>\n{rows}</tbody>\n</table>\n<p class=\"note\">Errors are RMS over z₀₀. A richer family must predict \
             held-out coefficients better by {:.0} % to be taken.</p>\n",
            100.0 * crate::fit::PRICE
        )
}

/// Every method in a table and on a chart of time against error.
pub fn comparison(fits: &Fits) -> String {
    let compared = fits.all.iter().any(|f| f.errors.is_some());
    let albedos = ALBEDO_DEG.map(|theta| format!("Albedo {theta}°"));
    let mut columns = vec!["Chi", "Misfit", "Time"];
    if compared {
        let errors = ["Error in zone", "Error outside", "ln f in zone", "ln f outside"];
        columns.splice(..0, errors.into_iter().chain(albedos.iter().map(String::as_str)));
    }
    let rows: String = fits.all.iter().map(|f| comparison_row(f, &columns, fits.requested)).collect();
    let note = if compared {
        "Errors of f cos θᵢ are relative to the RMS of the truth, those of ln f are RMS, those of albedos signed. Chi: misfit \
         over noise. Misfit: RMS over z₀₀."
    } else {
        "Chi: misfit over noise. Misfit: RMS over z₀₀. Without a truth (--truth) errors are not known."
    };
    let caption = if compared {
        "Down and left is better."
    } else {
        "Down and left is better. The misfit judges what was measured only; a rich model can fit it and be wrong elsewhere."
    };
    heading("Methods of fitting")
        + &format!("<p class=\"note\">{note}</p>\n<table class=\"cards\">\n")
        + &table_head("Method", &columns, None)
        + &format!("<tbody>\n{rows}</tbody>\n</table>\n")
        + &chart_figure(&fits_chart(fits), caption)
}

fn comparison_row(f: &MethodFit, columns: &[&str], requested: FitMethod) -> String {
    let report = &f.report;
    let mut values: Vec<String> = match &f.errors {
        Some(e) => {
            let e = &e.mean;
            let rel = [e.rel_in, e.rel_out].map(percent);
            let log = [e.log_in, e.log_out].map(|l| number(l, 2));
            rel.into_iter().chain(log).chain(e.albedo_error.map(tenth_percent)).collect()
        }
        None => vec!["–".into(); columns.len() - 3],
    };
    values.extend([number(report.chi, 3), percent(report.misfit_rel), seconds(report.fit_s)]);
    let class = if report.requested == requested { " class=\"chosen\"" } else { "" };
    let mut name = report.requested.to_string();
    if report.requested == FitMethod::Auto {
        name += &format!(": {}", report.model);
    }
    if !report.successful {
        name += " (the search failed)";
    }
    format!("<tr{class}><th scope=\"row\">{name}</th>{}</tr>\n", number_cells(columns, &values))
}

/// A signed ratio in percent, to a tenth.
fn tenth_percent(ratio: f64) -> String {
    if !ratio.is_finite() {
        return "–".into();
    }
    let tenths = (1000.0 * ratio).round();
    let sign = if tenths > 0.0 {
        "+"
    } else if tenths < 0.0 {
        "−"
    } else {
        ""
    };
    format!("{sign}{:.1} %", tenths.abs() / 10.0)
}

/// Where the chosen model misses.
pub fn residuals(fits: &Fits) -> String {
    heading("Where the model misses")
        + &format!(
            "<figure class=\"wide\">{}<figcaption><p>RMS of measured less predicted coefficients, over z₀₀, mean of the \
             channels and of m. Noise alone would leave {} everywhere.</p></figcaption></figure>\n",
            heat_svg(&fits.chosen().residuals),
            percent(fits.chosen().noise_rel)
        )
}

/// Whether the chosen model can be a reflectance.
pub fn plausibility(fits: &Fits) -> String {
    const COLUMNS: [&str; 3] = ["R", "G", "B"];
    /// Reciprocity is exact but for rounding.
    const ROUNDING: f64 = 1e-9;
    let p = &fits.chosen().plausibility;
    let row = |(theta, albedo): (&f64, &[f64; 3])| {
        let cells = number_cells(&COLUMNS, &albedo.map(|a| number(a, 3)));
        format!("<tr><th scope=\"row\">{}</th>{cells}</tr>\n", format_args!("{theta:.0}°"))
    };
    let rows: String = p.theta_o_deg.iter().zip(&p.albedo).map(row).collect();
    let verdict = |good: bool, yes: &str, no: String| {
        if good { format!("<li>{yes}</li>\n") } else { format!("<li class=\"refused\">{no}</li>\n") }
    };
    let energy = verdict(
        p.conserves_energy,
        "Energy: no albedo exceeds 1.",
        "Energy: the model reflects more than it receives.".into(),
    );
    let reciprocity = verdict(
        p.reciprocity_error < ROUNDING,
        "Reciprocity: exact.",
        format!(
            "Reciprocity: f changes by up to {} when light and camera change places.",
            percent(p.reciprocity_error)
        ),
    );
    let sign = verdict(
        p.smallest >= 0.0,
        &format!("Sign: f is nowhere negative; the smallest value found is {}/sr.", number(p.smallest, 2)),
        format!("Sign: f falls to {}/sr.", number(p.smallest, 2)),
    );
    heading("Physical plausibility")
        + &format!("<ul>\n{energy}{reciprocity}{sign}</ul>\n<table>\n")
        + &table_head("Albedo at θₒ", &COLUMNS, None)
        + &format!("<tbody>\n{rows}</tbody>\n</table>\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_the_digits_their_errors_leave() {
        assert_eq!(with_error(0.123_456, Some(0.002)), "0.123 ± 0.0020");
        assert_eq!(with_error(0.1, None), "0.100");
        assert_eq!(with_error(0.0, Some(0.01)), "0 ± 0.010");
        assert_eq!(with_error(0.5, Some(f64::NAN)), "0.500");
    }

    #[test]
    fn small_ratios_have_no_sign() {
        assert_eq!(
            [0.0004, -0.0004, 0.0123, -0.5, f64::NAN].map(tenth_percent),
            ["0.0 %", "0.0 %", "+1.2 %", "−50.0 %", "–"]
        );
    }
}
