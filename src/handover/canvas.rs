//! What drawings are made of: lines, texts, dimensions. Sheet coordinates in mm, x to the right and y down.

use std::fmt::Write as _;

/// A place on the sheet, mm.
pub(super) type Place = [f64; 2];

/// Kinds of lines, as ISO 128 has them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Line {
    /// Continuous, wide: outlines.
    Wide,
    /// Continuous, narrow: dimensions, extensions, leaders.
    Narrow,
    /// Long dashes and dots, narrow: axes.
    Axis,
    /// Dashes, narrow: limits of zones.
    Dashed,
    /// Rays.
    Ray,
}

/// How a text stands at its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// Heights of letters, mm.
pub(super) const SMALL: f64 = 2.5;
pub(super) const PLAIN: f64 = 3.5;
/// Mean width of a letter over its height.
const LETTER: f64 = 0.62;

/// An arrow's length and half its width.
const ARROW: [f64; 2] = [3.0, 0.5];
/// Extension lines begin off what they extend and end beyond the dimension line.
const EXTENSION: [f64; 2] = [1.0, 2.0];
/// Distance of the lines of a cut face along the sheet's edge.
const HATCH: f64 = 2.4;
/// Distance of a figure from its line.
const RISE: f64 = 1.0;

/// Styles of all elements.
const STYLE: &str = "\
path{fill:none;stroke:#000;stroke-linecap:round;stroke-linejoin:round}
.wide{stroke-width:0.5}
.narrow{stroke-width:0.18}
.axis{stroke-width:0.18;stroke-dasharray:8 1.5 0.5 1.5}
.dashed{stroke-width:0.18;stroke-dasharray:2.5 1.2}
.ray{stroke:#0072b2;stroke-width:0.18}
.arrow{fill:#000;stroke:none}
text{fill:#000;font-family:\"DejaVu Sans\",Arial,sans-serif}
.halo{fill:#fff;stroke:none}
";

/// A drawing that grows.
#[derive(Debug, Default)]
pub(super) struct Canvas {
    body: String,
    cuts: usize,
}

impl Canvas {
    /// The SVG file: a white sheet of this size at scale 1:1.
    pub(super) fn to_svg(&self, [width, height]: [f64; 2], title: &str) -> String {
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" viewBox=\"0 0 {width} \
             {height}\" role=\"img\" aria-label=\"{}\">\n<style>\n{STYLE}</style>\n<rect \
             width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n{}</svg>\n",
            escape(title),
            self.body
        )
    }

    fn add(&mut self, element: std::fmt::Arguments<'_>) {
        self.body.write_fmt(element).expect("a string takes all text");
        self.body.push('\n');
    }

    /// A polyline.
    pub(super) fn line(&mut self, line: Line, points: &[Place]) {
        let class = match line {
            Line::Wide => "wide",
            Line::Narrow => "narrow",
            Line::Axis => "axis",
            Line::Dashed => "dashed",
            Line::Ray => "ray",
        };
        self.add(format_args!("<path class=\"{class}\" d=\"{}\"/>", path(points)));
    }

    /// A cut face: an outline with lines at 45 deg, which rise to the left if `back`.
    pub(super) fn cut(&mut self, outline: &[Place], back: bool) {
        self.cuts += 1;
        let (name, d, s) = (self.cuts, path(outline), if back { -1.0 } else { 1.0 });
        self.add(format_args!("<clipPath id=\"cut{name}\"><path d=\"{d}Z\"/></clipPath>"));
        let range = |of: fn(&Place, f64) -> f64| {
            let values = outline.iter().map(|p| of(p, s));
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[lo, hi], v| [lo.min(v), hi.max(v)])
        };
        let ([top, bottom], [first, last]) = (range(|p, _| p[1]), range(|p, s| p[0] + s * p[1]));
        // Lines x + s y = c; clipped, they are the same in every viewer, which a pattern is not.
        let lines = ((first / HATCH).ceil() as i64..=(last / HATCH).floor() as i64).map(|i| {
            let c = HATCH * i as f64;
            path(&[[c - s * top, top], [c - s * bottom, bottom]])
        });
        let lines: String = lines.collect();
        self.add(format_args!("<path class=\"narrow\" clip-path=\"url(#cut{name})\" d=\"{lines}\"/>"));
        self.add(format_args!("<path class=\"wide\" d=\"{d}Z\"/>"));
    }

    /// A full circle, filled.
    pub(super) fn dot(&mut self, [x, y]: Place, radius: f64) {
        self.add(format_args!("<circle cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"{radius}\"/>"));
    }

    /// The part of a circle about `centre` from the angle `from` to `to`, radians clockwise from the upward direction.
    pub(super) fn arc(&mut self, centre: Place, radius: f64, [from, to]: [f64; 2]) {
        let [[x0, y0], [x1, y1]] = [from, to].map(|angle| polar(centre, radius, angle));
        let large = i32::from(to - from > std::f64::consts::PI);
        let d = format!("M{x0:.3} {y0:.3}A{radius:.3} {radius:.3} 0 {large} 1 {x1:.3} {y1:.3}");
        self.add(format_args!("<path class=\"narrow\" d=\"{d}\"/>"));
    }

    /// A text on its base line.
    pub(super) fn text(&mut self, size: f64, anchor: Anchor, at: Place, text: &str) {
        self.turned_text(size, anchor, at, 0.0, text);
    }

    /// A text that covers lines under it.
    pub(super) fn clear_text(&mut self, size: f64, anchor: Anchor, [x, y]: Place, text: &str) {
        let width = width(size, text);
        let left = match anchor {
            Anchor::Start => x,
            Anchor::Middle => x - width / 2.0,
            Anchor::End => x - width,
        };
        let (left, top, width, height) = (left - 0.5, y - 0.85 * size, width + 1.0, 1.1 * size);
        self.add(format_args!(
            "<rect class=\"halo\" x=\"{left:.3}\" y=\"{top:.3}\" width=\"{width:.3}\" height=\"{height:.3}\"/>"
        ));
        self.text(size, anchor, [x, y], text);
    }

    fn turned_text(&mut self, size: f64, anchor: Anchor, [x, y]: Place, degrees: f64, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let turn = if degrees == 0.0 { String::new() } else { format!(" rotate({degrees})") };
        self.add(format_args!(
            "<text transform=\"translate({x:.3} {y:.3}){turn}\" font-size=\"{size}\" text-anchor=\"{anchor}\">{}</text>",
            escape(text)
        ));
    }

    /// An arrowhead at `tip` that comes from the direction of `from`.
    pub(super) fn arrow(&mut self, tip: Place, from: Place) {
        let (dx, dy) = (from[0] - tip[0], from[1] - tip[1]);
        let length = dx.hypot(dy).max(1e-9);
        let ([along, across], [ux, uy]) = (ARROW, [dx / length, dy / length]);
        let foot = [tip[0] + along * ux, tip[1] + along * uy];
        let corners =
            [tip, [foot[0] - across * uy, foot[1] + across * ux], [foot[0] + across * uy, foot[1] - across * ux]];
        self.add(format_args!("<path class=\"arrow\" d=\"{}Z\"/>", path(&corners)));
    }

    /// A horizontal dimension at the height `y` between two points; the figure stands above the line, or `beside` it on the
    /// right, as it does where there is no room.
    pub(super) fn across(&mut self, from: Place, to: Place, y: f64, figure: &str, beside: bool) {
        for [x, start] in [from, to] {
            self.extension([x, start], [x, y]);
        }
        let long = width(PLAIN, figure);
        let room = !beside && to[0] - from[0] > long + 2.0 * ARROW[0];
        self.measure([[from[0], y], [to[0], y]], room, [to[0] + 3.0 * ARROW[0] + long, y]);
        let middle = (from[0] + to[0]) / 2.0;
        let (anchor, x) = if room { (Anchor::Middle, middle) } else { (Anchor::Start, to[0] + 2.5 * ARROW[0]) };
        self.clear_text(PLAIN, anchor, [x, y - RISE], figure);
    }

    /// A vertical dimension at `x` between two levels, without extension lines; the figure stands on its left, read from the
    /// right.
    pub(super) fn upright(&mut self, lower: f64, upper: f64, x: f64, figure: &str) {
        let room = lower - upper > 3.0 * ARROW[0];
        self.measure([[x, lower], [x, upper]], room, [x, upper - 3.0 * ARROW[0]]);
        self.turned_text(PLAIN, Anchor::Middle, [x - RISE, (lower + upper) / 2.0], -90.0, figure);
    }

    /// A line from what is measured to just beyond the dimension line.
    pub(super) fn extension(&mut self, start: Place, end: Place) {
        let (dx, dy) = (end[0] - start[0], end[1] - start[1]);
        let length = dx.hypot(dy);
        if length > EXTENSION[0] {
            let [near, far] = [EXTENSION[0] / length, 1.0 + EXTENSION[1] / length];
            let at = |t: f64| [start[0] + t * dx, start[1] + t * dy];
            self.line(Line::Narrow, &[at(near), at(far)]);
        }
    }

    /// A dimension line with arrows inside, or from outside where there is no room; it then goes on to `beyond`.
    fn measure(&mut self, [a, b]: [Place; 2], room: bool, beyond: Place) {
        if room {
            self.line(Line::Narrow, &[a, b]);
            self.arrow(a, b);
            self.arrow(b, a);
        } else {
            let outside = |tip: Place, other: Place| [2.0 * tip[0] - other[0], 2.0 * tip[1] - other[1]];
            let length = (a[0] - b[0]).hypot(a[1] - b[1]);
            let tail = |tip: Place, other: Place| {
                let far = outside(tip, other);
                let t = 2.5 * ARROW[0] / length;
                [tip[0] + t * (far[0] - tip[0]), tip[1] + t * (far[1] - tip[1])]
            };
            self.line(Line::Narrow, &[tail(a, b), b, beyond]);
            self.arrow(a, outside(a, b));
            self.arrow(b, outside(b, a));
        }
    }

    /// Texts above a shelf with an arrow to a place; the shelf begins at `elbow` and goes right.
    pub(super) fn leader(&mut self, tip: Place, elbow: Place, texts: &[&str]) {
        let long = texts.iter().map(|t| width(PLAIN, t)).fold(0.0, f64::max);
        self.line(Line::Narrow, &[tip, elbow, [elbow[0] + 2.0 + long, elbow[1]]]);
        self.arrow(tip, elbow);
        for (i, text) in texts.iter().rev().enumerate() {
            self.text(PLAIN, Anchor::Start, [elbow[0] + 1.5, elbow[1] - RISE - 1.5 * PLAIN * i as f64], text);
        }
    }

    /// A dimension of the angle at `vertex` from the upward direction to `angle`, radians; its figure stands on the arc, or
    /// beyond its end where there is no room.
    pub(super) fn angle(&mut self, vertex: Place, radius: f64, angle: f64, figure: &str) {
        let (half, long) = (ARROW[0] / radius / 2.0, width(PLAIN, figure));
        self.arc(vertex, radius, [0.0, angle]);
        self.arrow(polar(vertex, radius, 0.0), polar(vertex, radius, 2.0 * half));
        self.arrow(polar(vertex, radius, angle), polar(vertex, radius, angle - 2.0 * half));
        let (anchor, at) = if radius * angle > 2.2 * long {
            (Anchor::Middle, polar(vertex, radius, angle / 2.0))
        } else {
            (Anchor::Start, polar(vertex, radius, angle + 4.0 * half))
        };
        self.clear_text(PLAIN, anchor, [at[0], at[1] + 0.36 * PLAIN], figure);
    }
}

/// The place at a distance from a centre, the angle in radians clockwise from the upward direction.
fn polar([x, y]: Place, radius: f64, angle: f64) -> Place {
    [x + radius * angle.sin(), y - radius * angle.cos()]
}

/// About the width of a text, mm.
pub(super) fn width(size: f64, text: &str) -> f64 {
    LETTER * size * text.chars().count() as f64
}

fn path(points: &[Place]) -> String {
    let mut d = String::new();
    for (i, [x, y]) in points.iter().enumerate() {
        write!(d, "{}{x:.3} {y:.3}", if i == 0 { 'M' } else { 'L' }).expect("a string takes all text");
    }
    d
}

/// Text made safe for SVG, in content and attributes.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_escaped() {
        let mut canvas = Canvas::default();
        canvas.text(PLAIN, Anchor::Middle, [0.0, 0.0], "<\"a\" & b>");
        let svg = canvas.to_svg([10.0, 10.0], "<");
        assert!(svg.contains("&lt;&quot;a&quot; &amp; b&gt;</text>") && svg.contains("aria-label=\"&lt;\""));
    }

    #[test]
    fn figures_without_room_stand_outside() {
        let mut canvas = Canvas::default();
        canvas.across([0.0, 0.0], [5.0, 0.0], 10.0, "5", false);
        assert!(canvas.body.contains("text-anchor=\"start\""), "{}", canvas.body);
        let mut canvas = Canvas::default();
        canvas.across([0.0, 0.0], [50.0, 0.0], 10.0, "50", false);
        assert!(canvas.body.contains("translate(25.000 9.000)\" font-size=\"3.5\" text-anchor=\"middle\">50<"));
    }
}
