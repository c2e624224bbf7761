//! The dimensioned drawing of the rig's meridian section.

use super::canvas::{Anchor, Canvas, Line, PLAIN, Place, SMALL, width};
use super::layout::{BLOCK, BORDER, Layout};
use super::{HandoverError, Part, Parts};
use crate::optics::ProfilePoint;

/// Chord error of curves on paper, mm: a tenth of the narrowest line.
const CHORD: f64 = 0.02;
/// Polar angles between the chief rays drawn, degrees.
const FAN_DEG: f64 = 6.0;
/// Distance of dimension lines from each other, mm.
const LINES: f64 = 10.0;
/// Heights of rows in the table and in the title block, mm.
const ROW: f64 = 5.0;
const TITLE_ROW: f64 = 9.0;
/// Height of letters in the title block, mm; long names have smaller ones.
const TITLE: f64 = 4.0;

/// A drawing of the meridian section through the rig as SVG, 1:1 in mm: dome, convex mirror, sample, centre of projection, a fan
/// of chief rays, dimensions, and a table of the profile. The sheet is the smallest of A3 to A0 that holds it.
///
/// # Errors
/// [`HandoverError::TooFine`] for a dome of kilometres.
pub fn drawing_svg(parts: &Parts) -> Result<String, HandoverError> {
    let shell = parts.section(Part::Dome, CHORD)?;
    let convex = parts.section(Part::ConvexMirror, CHORD)?;
    let fan: Vec<ProfilePoint> = fan(parts);
    let mut sheet = Sheet { parts, layout: Layout::new(parts, &shell), canvas: Canvas::default() };
    sheet.frame();
    sheet.diameters();
    sheet.heights();
    sheet.rays(&fan);
    sheet.zone();
    sheet.bodies(&shell, &convex);
    sheet.axis();
    sheet.notes_at_the_wall();
    let below = sheet.table(&fan);
    sheet.notes(below);
    sheet.title();
    let title = format!("{}: meridian section", parts.rig().name);
    Ok(sheet.canvas.to_svg(sheet.layout.sheet, &super::one_line(&title)))
}

/// The profile's points that the chief rays meet: those whose polar angles in the zone are multiples of [`FAN_DEG`].
fn fan(parts: &Parts) -> Vec<ProfilePoint> {
    let (zone, mirrors) = (parts.rig().zone, parts.mirrors());
    let [first, last] = [(zone.theta_min_deg / FAN_DEG).ceil(), (zone.theta_max_deg / FAN_DEG).floor()];
    (first as i32..=last as i32)
        .filter_map(|i| mirrors.rho_of((f64::from(i) * FAN_DEG).to_radians(), mirrors.edge_radius()))
        .filter_map(|rho| mirrors.profile_point(rho))
        .collect()
}

/// A length or an angle to a hundredth.
fn figure(x: f64) -> String {
    let text = format!("{x:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.replace('-', "−") }
}

fn degrees(radians: f64) -> String {
    figure(radians.to_degrees()) + "°"
}

struct Sheet<'a> {
    parts: &'a Parts,
    layout: Layout,
    canvas: Canvas,
}

impl Sheet<'_> {
    fn frame(&mut self) {
        let ([w, h], [left, other]) = (self.layout.sheet, BORDER);
        let (right, bottom) = (w - other, h - other);
        let corners = [[left, other], [right, other], [right, bottom], [left, bottom], [left, other]];
        self.canvas.line(Line::Wide, &corners);
    }

    /// The chief rays on the left of the axis, each named outside the dome.
    fn rays(&mut self, fan: &[ProfilePoint]) {
        let centre = self.parts.mirrors().centre().z;
        for p in fan {
            let z = self.parts.mirrors().convex().height(p.rho);
            let x = |height: f64| -p.rho * (centre - height) / (centre - z);
            let mut points = vec![self.layout.at(0.0, centre)];
            if let Some([lo, hi]) = self.layout.broken {
                let stub = [points[0], self.layout.at(x(hi), hi)];
                self.canvas.line(Line::Ray, &stub);
                points = vec![self.layout.at(x(lo), lo)];
            }
            points.extend([self.layout.at(-p.rho, z), self.layout.at(-p.r, p.z), self.layout.at(0.0, 0.0)]);
            self.canvas.line(Line::Ray, &points);
            let off = self.parts.wall_mm() + 2.5;
            let [x, y] = self.layout.at(off * p.normal[0] - p.r, p.z - off * p.normal[1]);
            self.canvas.clear_text(SMALL, Anchor::End, [x, y + 0.36 * SMALL], &degrees(p.theta));
        }
    }

    /// Limits of the zone and the dome's end on the right of the axis.
    fn zone(&mut self) {
        let (zone, mirrors) = (self.parts.rig().zone, self.parts.mirrors());
        let room = mirrors.convex().height(self.parts.rig().paraboloid_radius_mm());
        let sample = self.layout.at(0.0, 0.0);
        let [first, last] = [zone.theta_min_deg, zone.theta_max_deg].map(f64::to_radians);
        let end = self.parts.end().theta;
        let mut limits = vec![(0.72, first, "zone"), (0.36, last, "zone")];
        if end - last > 1e-6 {
            limits.push((0.54, end, "dome"));
        }
        for &(_, theta, _) in &limits {
            if let Some(d) = mirrors.rho_of(theta, mirrors.edge_radius()).and_then(|rho| mirrors.profile(rho)) {
                self.canvas.line(Line::Dashed, &[sample, self.layout.at(d.x, d.z)]);
            }
        }
        for (share, theta, name) in limits {
            self.canvas.angle(sample, share * room, theta, &format!("{name} {}", degrees(theta)));
        }
    }

    fn bodies(&mut self, shell: &[[f64; 2]], convex: &[[f64; 2]]) {
        for side in [-1.0, 1.0] {
            let outline: Vec<Place> = shell.iter().map(|p| self.layout.at(side * p[0], p[1])).collect();
            self.canvas.cut(&outline, false);
        }
        // Both halves of the convex mirror are one face; the last two points lie on the axis.
        let right = &convex[..convex.len() - 1];
        let left = right.iter().rev().skip(1).map(|p| [-p[0], p[1]]);
        let outline: Vec<Place> = right.iter().copied().chain(left).map(|p| self.layout.at(p[0], p[1])).collect();
        self.canvas.cut(&outline, true);
        let sample = [[-12.0, 0.0], [12.0, 0.0], [12.0, -4.0], [-12.0, -4.0]].map(|[x, z]| self.layout.at(x, z));
        self.canvas.cut(&sample, false);
        let [x, y] = self.layout.at(-15.0, -5.0);
        self.canvas.clear_text(PLAIN, Anchor::End, [x, y], "sample S");
    }

    /// The axis with its break, and C.
    fn axis(&mut self) {
        let centre = self.parts.mirrors().centre().z;
        let (bottom, top) = (self.layout.at(0.0, -9.0), self.layout.at(0.0, centre + 8.0));
        match self.layout.broken {
            Some([lo, hi]) => {
                let (lower, upper) = (self.layout.at(0.0, lo), self.layout.at(0.0, hi));
                self.canvas.line(Line::Axis, &[bottom, lower]);
                self.canvas.line(Line::Axis, &[upper, top]);
                for [x, y] in [lower, upper] {
                    let zigzag = [[-9.0, 0.0], [-1.5, 0.0], [-0.7, -2.0], [0.7, 2.0], [1.5, 0.0], [9.0, 0.0]];
                    self.canvas.line(Line::Narrow, &zigzag.map(|[dx, dy]| [x + dx, y + dy]));
                }
            }
            None => self.canvas.line(Line::Axis, &[bottom, top]),
        }
        let c = self.layout.at(0.0, centre);
        self.canvas.line(Line::Narrow, &[[c[0] - 5.0, c[1]], [c[0] + 5.0, c[1]]]);
        self.canvas.dot(c, 0.8);
        self.canvas.text(PLAIN, Anchor::End, [c[0] - 7.0, c[1] + 0.36 * PLAIN], "C, centre of projection");
        self.canvas.dot(self.layout.at(0.0, 0.0), 0.6);
    }

    /// Diameters: of the opening above the dome, of the convex mirror below it, of end and widest point below the sample.
    fn diameters(&mut self) {
        let (parts, edge) = (self.parts, self.parts.rig().paraboloid_radius_mm());
        let z_edge = parts.mirrors().convex().height(edge);
        let foot = self.layout.origin[1] + 14.0;
        let mut all = vec![
            (parts.opening().r, parts.opening().z, self.layout.at(0.0, parts.opening().z + parts.wall_mm() + 12.0)[1]),
            (edge, z_edge, self.layout.at(0.0, z_edge - 8.0)[1]),
            (parts.end().r, parts.end().z, foot + LINES * f64::from(u8::from(parts.undercut().is_none()))),
        ];
        all.extend(parts.undercut().map(|p| (p.r, p.z, foot + LINES)));
        for (i, (r, z, y)) in all.into_iter().enumerate() {
            let (left, right) = (self.layout.at(-r, z), self.layout.at(r, z));
            // Rays pass through the opening, where the first figure would stand.
            self.canvas.across(left, right, y, &format!("Ø{}", figure(2.0 * r)), i == 0);
        }
    }

    /// Heights above the sample: of the dome on the left, of convex mirror and C on the right.
    fn heights(&mut self) {
        let (parts, half) = (self.parts, self.layout.half);
        let (opening, end, mirrors) = (parts.opening(), parts.end(), parts.mirrors());
        let (vertex, centre) = (mirrors.convex().vertex_height, mirrors.centre().z);
        let at = |x: f64, z: f64| self.layout.at(x, z);
        let left = |column: f64| at(-half - 14.0 - LINES * column, 0.0)[0];
        let right = |column: f64| at(half + 46.0 + LINES * column, 0.0)[0];
        let (mut extensions, mut dimensions) = (Vec::new(), vec![(0.0, opening.z, left(2.0))]);
        extensions.push((at(-opening.r, opening.z), left(2.0)));
        if end.z > 0.005 {
            extensions.push((at(-end.r, end.z), left(1.0)));
            dimensions.extend([(end.z, opening.z, left(1.0)), (0.0, end.z, left(1.0))]);
        }
        dimensions.extend([(0.0, vertex, right(0.0)), (vertex, centre, right(0.0)), (0.0, centre, right(1.0))]);
        extensions.extend([(at(1.0, vertex), right(0.0)), (at(5.0, centre), right(1.0))]);
        extensions.extend([(at(-12.0, 0.0), left(2.0)), (at(12.0, 0.0), right(1.0))]);
        for (start, x) in extensions {
            self.canvas.extension(start, [x, start[1]]);
        }
        for (lower, upper, x) in dimensions {
            self.canvas.upright(at(0.0, lower)[1], at(0.0, upper)[1], x, &figure(upper - lower));
        }
    }

    /// Wall, widest point and draft, written beside the dome on its right.
    fn notes_at_the_wall(&mut self) {
        let (parts, half) = (self.parts, self.layout.half);
        let outside =
            |p: &ProfilePoint| self.layout.at(p.r - parts.wall_mm() * p.normal[0], p.z - parts.wall_mm() * p.normal[1]);
        let shelf = self.layout.at(half + 6.0, 0.0)[0];
        let mut leaders = Vec::new();
        let middle = parts.mirrors().profile_point(0.5 * parts.opening().rho + 0.5 * parts.end().rho);
        if let Some(p) = middle {
            leaders.push((outside(&p), vec![format!("wall {}", figure(parts.wall_mm()))], -14.0));
        }
        if let Some(p) = parts.undercut() {
            let texts = vec![format!("widest Ø{}", figure(2.0 * p.r)), format!("at θ = {}", degrees(p.theta))];
            leaders.push((outside(p), texts, -6.0));
        }
        let end = parts.end();
        leaders.push((outside(end), vec![format!("draft {}", degrees(end.draft())), "at the end".into()], -9.0));
        for (tip, texts, rise) in leaders {
            let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
            self.canvas.leader(tip, [shelf.max(tip[0] + 6.0), tip[1] + rise], &texts);
        }
    }

    /// The profile at opening, chief rays and end; returns the height of its lower edge.
    fn table(&mut self, fan: &[ProfilePoint]) -> f64 {
        const HEAD: [&str; 8] = ["", "θ", "r", "z", "draft", "R mer.", "R sag.", "ρ convex"];
        let mut rows = vec![("opening", *self.parts.opening())];
        rows.extend(fan.iter().map(|p| ("", *p)));
        rows.extend(self.parts.undercut().map(|p| ("widest", *p)));
        rows.push(("end", *self.parts.end()));
        rows.sort_by(|a, b| a.1.rho.total_cmp(&b.1.rho));
        let end = self.parts.end().rho;
        // A chief ray at the end of the dome is the end.
        rows.retain(|(name, p)| !name.is_empty() || end - p.rho > 1e-9);
        let (left, top) = (self.layout.block(), BORDER[1] + 14.0);
        let column = |i: usize| left + 16.0 + (BLOCK - 20.0) / 7.0 * i as f64;
        self.canvas.text(PLAIN, Anchor::Start, [left + 4.0, top - 4.0], "Dome profile, mm and degrees");
        let mut y = top + ROW;
        for (i, head) in HEAD.iter().enumerate() {
            self.canvas.text(SMALL, Anchor::End, [column(i), y - 1.4], head);
        }
        self.canvas.line(Line::Narrow, &[[left + 2.0, y], [left + BLOCK - 2.0, y]]);
        for (name, p) in rows {
            y += ROW;
            self.canvas.text(SMALL, Anchor::Start, [left + 4.0, y - 1.4], name);
            let angles = [p.theta, p.draft()].map(f64::to_degrees);
            let values = [angles[0], p.r, p.z, angles[1], p.meridional_radius, p.sagittal_radius, p.rho];
            for (i, x) in values.into_iter().enumerate() {
                // Adding 0 takes the sign from what rounds to none.
                let text = format!("{:.3}", (x * 1e3).round() / 1e3 + 0.0).replace('-', "−");
                self.canvas.text(SMALL, Anchor::End, [column(i + 1), y - 1.4], &text);
            }
        }
        self.canvas.line(Line::Narrow, &[[left + 2.0, y], [left + BLOCK - 2.0, y]]);
        y
    }

    /// What no dimension says, below the table.
    fn notes(&mut self, below: f64) {
        let (parts, conic) = (self.parts, self.parts.mirrors().convex());
        let kind = match conic.constant {
            -1.0 => "a paraboloid",
            k if k < -1.0 => "a hyperboloid",
            0.0 => "a sphere",
            _ => "an ellipsoid",
        };
        let edge = parts.rig().paraboloid_radius_mm();
        let (radius, constant) = (figure(conic.radius), figure(conic.constant));
        let mut notes = vec![
            "Heights are measured from the sample's plane, angles from the axis.".to_owned(),
            format!("Convex mirror: {kind}, vertex radius {radius}, conic constant {constant}."),
            format!("Its edge lies at r = {} and z = {}.", figure(edge), figure(conic.height(edge))),
            format!("Dome: wall {} along the normal; its full profile is in the CSV file.", figure(parts.wall_mm())),
            "Left: chief rays, named by their polar angle at S. Right: limits of the zone.".to_owned(),
        ];
        if self.layout.broken.is_some() {
            notes.push("The axis is broken; figures across the break are true.".to_owned());
        }
        match parts.undercut() {
            Some(p) => {
                notes.push(format!("The dome is undercut: it narrows below θ = {}, where", degrees(p.theta)));
                notes.push(format!(
                    "r = {} and z = {}. A mandrel in one piece cannot leave it:",
                    figure(p.r),
                    figure(p.z)
                ));
                notes.push("divide the mandrel, or end the dome there.".to_owned());
            }
            None => notes
                .push(format!("A mandrel can be drawn out: the draft is {} at the end.", degrees(parts.end().draft()))),
        }
        let left = self.layout.block() + 4.0;
        for (i, note) in notes.iter().enumerate() {
            self.canvas.text(SMALL, Anchor::Start, [left, below + 10.0 + 1.8 * SMALL * i as f64], note);
        }
    }

    fn title(&mut self) {
        let ([w, h], rig) = (self.layout.sheet, self.parts.rig());
        let (left, right, bottom) = (self.layout.block(), w - BORDER[1], h - BORDER[1]);
        let rows = [
            [("Rig", super::one_line(&rig.name)), ("Scale", "1:1".to_owned())],
            [("Title", "Meridian section".to_owned()), ("Units", "mm, degrees".to_owned())],
        ];
        let top = bottom - TITLE_ROW * rows.len() as f64;
        let middle = left + 0.68 * BLOCK;
        self.canvas.line(Line::Wide, &[[left, bottom], [left, top], [right, top]]);
        self.canvas.line(Line::Narrow, &[[middle, top], [middle, bottom]]);
        for (i, row) in rows.iter().enumerate() {
            let y = top + TITLE_ROW * i as f64;
            self.canvas.line(Line::Narrow, &[[left, y], [right, y]]);
            for (x, (name, value)) in [left, middle].into_iter().zip(row) {
                self.canvas.text(SMALL, Anchor::Start, [x + 2.0, y + 5.6], name);
                let room = if x == left { middle - left } else { right - middle } - 15.0;
                let size = TITLE.min(TITLE * room / width(TITLE, value));
                self.canvas.text(size, Anchor::Start, [x + 13.0, y + 6.0], value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::samples::thesis;
    use super::*;

    #[test]
    fn figures_are_short() {
        assert_eq!([32.6, 405.0, -8.104, -0.001].map(figure), ["32.6", "405", "−8.1", "0"]);
    }

    #[test]
    fn the_drawing_says_what_the_rig_is() {
        let [built, full] = thesis().map(|parts| drawing_svg(&parts).unwrap());
        for svg in [&built, &full] {
            assert!(
                svg.starts_with("<svg xmlns")
                    && svg.contains("width=\"594mm\" height=\"420mm\" viewBox=\"0 0 594 420\"")
            );
            for text in [">Ø32.6<", ">135<", ">270<", ">405<", "vertex radius 8, conic constant −1", "a paraboloid"]
            {
                assert!(svg.contains(text), "{text}");
            }
        }
        assert!(
            built.contains("A mandrel can be drawn out")
                && built.contains(">dome 57.5°<")
                && built.contains(">zone 9°<")
        );
        assert!(full.contains("The dome is undercut") && full.contains("at θ = 64."));
        let ray = "class=\"ray\"";
        // Each ray in two parts: 12 to 54 and 12 to 90 deg.
        assert_eq!((built.matches(ray).count(), full.matches(ray).count()), (16, 28));
    }

    #[test]
    fn names_do_not_break_the_file() {
        let [parts, _] = thesis();
        let mut rig = parts.rig().clone();
        rig.name = "<a\n&\"b\">".into();
        let svg = drawing_svg(&Parts::new(&rig, 16.3, 3.0).unwrap()).unwrap();
        assert!(svg.contains("&lt;a &amp;&quot;b&quot;&gt;") && !svg.contains("<a"));
    }
}
