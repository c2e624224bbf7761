//! The page of a dome's design: what it will measure, what ends its zone, what its tolerances cost.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::axis::Axis;
use super::chart::{Chart, Mark, Series};
use super::html::{document, heading, number_cells, provenance, table_head};
use super::sheet::Sheet;
use super::text::{degrees, escape, number, percent};
use crate::design::{Angle, MeasuredProfile, Survey, ToleranceTable, View};

/// Contributors that are named.
const NAMED: usize = 5;

/// A design, as a page.
#[derive(Debug, Clone, PartialEq)]
pub struct DesignReport {
    /// Name of the rig.
    pub rig: String,
    /// Where its numbers come from.
    pub source: String,
    /// What it will measure.
    pub survey: Survey,
    /// What its tolerances cost, with the name of the material they were analysed for.
    pub tolerances: Option<(String, ToleranceTable)>,
    /// What a measured profile of the dome does.
    pub measured: Option<MeasuredProfile>,
    /// Drawing of the section: an SVG element.
    pub drawing: String,
    /// Blur below which chief rays stand for a pupil, degrees.
    pub chief_deg: f64,
    /// Files handed over beside the page, with what they are.
    pub files: Vec<(String, String)>,
}

impl DesignReport {
    /// Where a device's pupil blurs or shifts directions by more than `chief_deg`, degrees, and by how much at most; none if
    /// nowhere: there chief rays stand for the pupil.
    pub fn beyond_chief(&self, of: impl Fn(&Angle) -> View) -> Option<([f64; 2], f64)> {
        let worst = |a: &Angle| of(a).blur_deg.max(of(a).shift_deg);
        let beyond: Vec<&Angle> = self.survey.angles.iter().filter(|a| worst(a) > self.chief_deg).collect();
        let (first, last) = (beyond.first()?, beyond.last()?);
        Some(([first.theta_deg, last.theta_deg], beyond.iter().map(|a| worst(a)).fold(0.0, f64::max)))
    }

    /// Charts over polar angles.
    pub fn sheet(&self) -> Sheet {
        let axis = || Axis::linear("polar angle / deg");
        let series = |name: &str, style: usize, of: &dyn Fn(&Angle) -> f64| {
            let points = self.survey.angles.iter().map(|a| (a.theta_deg, of(a))).collect();
            Series::new(name, points, Mark::Line, style)
        };
        let names =
            ["camera, along the meridian", "camera, across", "projector, along the meridian", "projector, across"];
        let four = |of: fn(&View) -> [f64; 2]| {
            vec![
                series(names[0], 1, &|a| of(&a.camera)[0]),
                series(names[1], 2, &|a| of(&a.camera)[1]),
                series(names[2], 3, &|a| of(&a.projector)[0]),
                series(names[3], 4, &|a| of(&a.projector)[1]),
            ]
        };
        let blur = vec![series(names[0], 1, &|a| a.camera.blur_deg), series(names[2], 3, &|a| a.projector.blur_deg)];
        let tight =
            self.survey.limits.iter().find(|l| l.binds && l.end == "outer" && l.theta_deg < self.survey.zone_deg[1]);
        let panel = |title: &str, y: Axis, series: Vec<Series>| {
            let mut chart = Chart::new(format!("{title} over polar angles"), axis(), y, series);
            chart.bands = tight.map(|l| [l.theta_deg, self.survey.zone_deg[1]]).into_iter().collect();
            Some((title.to_owned(), chart))
        };
        let draft = vec![series("dome", 0, &|a| a.draft_deg)];
        Sheet {
            title: format!("{}: resolution, footprints, blur and draft over polar angles", self.rig),
            columns: 3,
            panels: vec![
                panel("Pixels per degree", Axis::linear("px/deg"), four(|v| v.px_per_deg)),
                panel("Footprints on the sample", Axis::log("semi-axis / mm"), four(|v| v.footprint_mm)),
                panel("RMS blur of the pupils", Axis::linear("deg"), blur),
                panel("Draft of the dome's meridian", Axis::linear("deg"), draft),
                None,
            ],
            series: names.iter().enumerate().map(|(i, n)| (i + 1, Mark::Line, (*n).to_owned())).collect(),
            notes: tight.map(|l| format!("shaded: beyond the {}", l.name)).into_iter().collect(),
        }
    }

    /// The page.
    pub fn to_html(&self) -> String {
        let s = &self.survey;
        let body = self.summary()
            + &heading("Section")
            + &self.section()
            + &self.files()
            + &heading("What ends the zone")
            + &self.limits()
            + &heading("Over polar angles")
            + &self.sheet().to_html()
            + &self.chief()
            + &heading("What the projector lights of what the camera sees")
            + &self.pairs()
            + &self.measured()
            + &self.tolerances()
            + &provenance([
                ("Rig", self.rig.as_str()),
                ("Source", self.source.as_str()),
                ("Software", concat!("zonal ", env!("CARGO_PKG_VERSION"))),
            ]);
        document(&format!("Design of {}: {}° to {}°", self.rig, degrees(s.zone_deg[0]), degrees(s.zone_deg[1])), &body)
    }

    fn summary(&self) -> String {
        let s = &self.survey;
        let facts = [
            ("Zone asked for", format!("{}° to {}°", degrees(s.zone_deg[0]), degrees(s.zone_deg[1]))),
            ("Zone that limits allow", format!("{}° to {}°", degrees(s.theta_min_deg), degrees(s.theta_max_deg))),
            ("Coverage (projected)", format!("{} ({})", percent(s.coverage), percent(s.projected_coverage))),
            ("Diameter, height", format!("{} mm, {} mm", number(s.diameter_mm, 4), number(s.height_mm, 4))),
            ("Draft at the zone's end", format!("{}°", number(s.draft_deg, 3))),
            (
                "Least px/deg: camera, projector",
                format!("{}, {}", number(s.camera_min_px_per_deg, 3), number(s.projector_min_px_per_deg, 3)),
            ),
            ("Sample height error it bears", format!("{} mm", number(s.height_tolerance_mm, 2))),
            ("Light through splitter and mirrors", percent(s.transmission)),
            ("Polarisation, at most", percent(s.polarisation_bound)),
        ];
        let tiles = facts.map(|(name, value)| format!("<div><dt>{name}</dt><dd>{value}</dd></div>\n"));
        let condition = if s.footprint_margin_mm >= 0.0 {
            format!(
                "All that the camera sees is lit, for every pair of directions: the projector's smallest footprint exceeds the camera's \
                 largest by {} mm",
                number(s.footprint_margin_mm, 2)
            )
        } else {
            format!(
                "The footprint condition fails beyond {}°: the projector's smallest footprint falls short of the camera's largest by {} mm; \
                 enlarge the projector's pupil, stop down the camera, or mask the sample",
                degrees(s.footprint_up_to_deg),
                number(-s.footprint_margin_mm, 2)
            )
        };
        format!("<p class=\"summary\">{condition}.</p>\n<dl class=\"facts\">\n{}</dl>\n", tiles.concat())
    }

    /// The drawing as an image of its own: its styles are not those of the page.
    fn section(&self) -> String {
        let data = STANDARD.encode(&self.drawing);
        format!(
            "<figure><img alt=\"Meridian section of dome, convex mirror and sample\" style=\"width:100%\" \
             src=\"data:image/svg+xml;base64,{data}\" /></figure>\n"
        )
    }

    fn files(&self) -> String {
        if self.files.is_empty() {
            return String::new();
        }
        let links = self
            .files
            .iter()
            .map(|(name, what)| format!("<a href=\"{}\">{}</a> ({})", escape(name), escape(name), escape(what)));
        format!("<p class=\"note\">As files: {}.</p>\n", links.collect::<Vec<_>>().join(", "))
    }

    fn limits(&self) -> String {
        let columns = ["Polar angle"];
        let row = |l: &crate::design::Limit| {
            let cells = number_cells(&columns, &[format!("{}°", number(l.theta_deg, 4))]);
            let binds = if l.binds { "ends the zone here" } else { "" };
            format!("<tr><th scope=\"row\">{}</th>{cells}<td>{} {binds}</td></tr>\n", escape(l.name), l.end)
        };
        let rows: String = self.survey.limits.iter().map(row).collect();
        format!(
            "<table class=\"cards\">\n{}<tbody>\n{rows}</tbody>\n</table>\n",
            table_head("Limit", &columns, Some("End of the zone"))
        )
    }

    fn chief(&self) -> String {
        let say = |name: &str, beyond: Option<([f64; 2], f64)>| match beyond {
            None => format!("chief rays stand for the {name}'s pupil everywhere"),
            Some(([from, to], most)) => format!(
                "the {name}'s pupil blurs or shifts by up to {}° between {}° and {}°",
                number(most, 2),
                degrees(from),
                degrees(to)
            ),
        };
        format!(
            "<p class=\"note\">With a tolerance of {}°: {}; {}.</p>\n",
            number(self.chief_deg, 2),
            say("camera", self.beyond_chief(|a| a.camera)),
            say("projector", self.beyond_chief(|a| a.projector))
        )
    }

    fn pairs(&self) -> String {
        let mut angles: Vec<f64> = self.survey.pairs.iter().map(|p| p.theta_o_deg).collect();
        angles.sort_by(f64::total_cmp);
        angles.dedup();
        let columns: Vec<String> = angles.iter().map(|a| format!("θₒ = {}°", degrees(*a))).collect();
        let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
        let rows: String = self
            .survey
            .pairs
            .chunks(angles.len())
            .map(|row| {
                let cells: Vec<String> = row.iter().map(|p| percent(p.lit_share)).collect();
                let name = format!("θᵢ = {}°", degrees(row[0].theta_i_deg));
                format!("<tr><th scope=\"row\">{name}</th>{}</tr>\n", number_cells(&columns, &cells))
            })
            .collect();
        format!(
            "<p class=\"note\">|F<sub>p</sub> ∩ F<sub>c</sub>| / |F<sub>c</sub>|, least over azimuths. At 100 % a pattern is what it should be; \
             below, a factor of both directions remains that no calibration of pixels removes.</p>\n<table class=\"cards\">\n{}<tbody>\n{rows}</tbody>\n</table>\n",
            table_head("Light", &columns, None)
        )
    }

    fn measured(&self) -> String {
        let Some(m) = &self.measured else { return String::new() };
        heading("The dome as measured")
            + &format!(
                "<p>{} points depart by up to {} mm ({} mm RMS) from the profile, its slopes by up to {} mrad. Chief rays then miss the \
                 sample's middle by up to {} mm, and directions are off by {}° RMS before a calibration.</p>\n",
                m.points,
                number(m.departure_mm, 2),
                number(m.departure_rms_mm, 2),
                number(m.slope_mrad, 2),
                number(m.miss_mm, 2),
                number(m.direction_deg, 2)
            )
    }

    fn tolerances(&self) -> String {
        let Some((material, table)) = &self.tolerances else { return String::new() };
        let mut columns = vec!["One sigma", "Directions: camera, projector", "Coefficients", "Linear up to"];
        let shapes: Vec<usize> =
            (0..table.parameters.len()).filter(|&i| table.rows.iter().any(|r| r.parameters[i] > 0.0)).collect();
        columns.extend(shapes.iter().map(|&i| table.parameters[i].0.as_str()));
        let rows: String = table
            .rows
            .iter()
            .enumerate()
            .map(|(i, r)| {
                let mut cells = vec![
                    number(r.sigma, 2),
                    format!("{}°, {}°", number(r.direction_deg[0], 2), number(r.direction_deg[1], 2)),
                    percent(r.coefficients_rel),
                    r.linear_up_to.map_or("blurs".into(), |x| format!("{} sigma", number(x, 2))),
                ];
                cells.extend(shapes.iter().map(|&i| number(r.parameters[i], 2)));
                let name = if i < NAMED { format!("<strong>{}</strong>", r.key) } else { r.key.to_owned() };
                format!("<tr><th scope=\"row\">{name}</th>{}</tr>\n", number_cells(&columns, &cells))
            })
            .collect();
        let drawn: Vec<String> = table
            .drawn
            .iter()
            .map(|d| {
                format!(
                    "{} x: {} by linear terms, {} ± {} drawn",
                    number(d.scale, 2),
                    percent(d.linear_rel),
                    percent(d.monte_carlo_rel),
                    percent(d.standard_error)
                )
            })
            .collect();
        let stops = table.linear_up_to().map_or_else(
            || "Linear terms do not foretell the draws to 10 % at any of these scales".to_owned(),
            |x| format!("Linear terms foretell the draws to 10 % up to {} times the tolerances", number(x, 2)),
        );
        let tighter: Vec<&str> = table.rows.iter().take(NAMED).map(|r| r.key).collect();
        heading("What tolerances cost")
            + &format!(
                "<p class=\"note\">{} measured to order {} before any calibration, and the fit {} of it. Coefficients: RMS error over RMS z₀₀. \
                 To be held tighter first: {}.</p>\n<table class=\"cards\">\n{}<tbody>\n{rows}</tbody>\n</table>\n\
                 <p>All at once, {} draws, in multiples of the tolerances: {}. {stops}.</p>\n",
                escape(material),
                table.order,
                escape(&table.family),
                tighter.join(", "),
                table_head("Tolerance", &columns, None),
                table.draws,
                drawn.join("; ")
            )
    }
}
