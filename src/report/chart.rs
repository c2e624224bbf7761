//! A chart of series over two axes, as inline SVG.

use super::axis::Axis;
use super::label;
use super::text::escape;

/// Drawn width in user units: about that of a phone, so that text keeps its size there.
const WIDTH: f64 = 360.0;
const HEIGHT: f64 = 270.0;
/// Space around the plot: left, top, right, bottom.
const MARGINS: [f64; 4] = [60.0, 26.0, 14.0, 44.0];
/// Mean width of a character of a tick label, user units.
const CHARACTER: f64 = 7.0;
/// Styles of series: colour and dash are in the page's style sheet as `.s0` (the truth) to `.s6`.
pub(super) const STYLES: usize = 7;

/// How the points of a series are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// Joined by a line.
    Line,
    /// As marks.
    Points,
    /// As marks joined by a line.
    Both,
}

/// A series of points.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Points; those an axis cannot show (not finite, not positive on a log axis) are left out.
    pub points: Vec<(f64, f64)>,
    /// How they are drawn.
    pub mark: Mark,
    /// Style from 1 on; 0 is for what others are compared with.
    pub style: usize,
    /// Text at each point; may be shorter than the points.
    pub labels: Vec<String>,
}

impl Series {
    /// A series without texts at its points.
    pub fn new(name: impl Into<String>, points: Vec<(f64, f64)>, mark: Mark, style: usize) -> Self {
        Self { name: name.into(), points, mark, style, labels: Vec::new() }
    }
}

/// A chart. Its legend is HTML, apart from the drawing.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// What it shows, for those who cannot see it.
    pub description: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// What is drawn, first at the bottom.
    pub series: Vec<Series>,
    /// Vertical lines with a text each.
    pub markers: Vec<(f64, String)>,
    /// Shaded intervals of x.
    pub bands: Vec<[f64; 2]>,
}

impl Chart {
    /// The drawing: an `svg` element, styled by the page.
    pub fn to_svg(&self) -> String {
        let markers = self.markers.iter().map(|m| m.0);
        let x_range = self.x.fit(self.shown().map(|p| p.0).chain(markers));
        let y_range = self.y.fit(self.shown().map(|p| p.1));
        let [left, top, right, bottom] = MARGINS;
        let px = |x: f64| left + self.x.place(x, x_range) * (WIDTH - left - right);
        let py = |y: f64| HEIGHT - bottom - self.y.place(y, y_range) * (HEIGHT - top - bottom);
        let mut svg = format!(
            "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">\n",
            escape(&self.description)
        );
        for [from, to] in &self.bands {
            let (x0, x1) = (px(*from), px(*to));
            let (w, h) = ((x1 - x0).max(0.0), HEIGHT - top - bottom);
            svg += &format!("<rect class=\"band\" x=\"{x0:.1}\" y=\"{top}\" width=\"{w:.1}\" height=\"{h:.1}\"/>\n");
        }
        svg += &self.axes(&px, &py, x_range, y_range);
        for (x, label) in self.markers.iter().filter(|m| self.x.shows(m.0)) {
            svg += &marker(px(*x), label);
        }
        for series in &self.series {
            svg += &self.draw(series, &px, &py);
        }
        svg + &self.texts(&px, &py) + "</svg>\n"
    }

    /// The legend: an HTML list.
    pub fn legend(&self) -> String {
        legend(self.series.iter().map(|s| (s.style, s.mark, s.name.as_str())))
    }

    /// All points that both axes can show.
    fn shown(&self) -> impl Iterator<Item = (f64, f64)> {
        let all = self.series.iter().flat_map(|s| s.points.iter().copied());
        all.filter(|p| self.x.shows(p.0) && self.y.shows(p.1))
    }

    fn axes(&self, px: &dyn Fn(f64) -> f64, py: &dyn Fn(f64) -> f64, x_range: [f64; 2], y_range: [f64; 2]) -> String {
        let [left, top, right, bottom] = MARGINS;
        let (x1, y1) = (WIDTH - right, HEIGHT - bottom);
        let mut svg = String::new();
        for (y, label) in self.y.ticks_in(y_range) {
            let y = py(y);
            svg += &format!("<path class=\"grid\" d=\"M{left} {y:.1}H{x1}\"/>");
            svg +=
                &format!("<text class=\"end\" x=\"{}\" y=\"{:.1}\">{}</text>\n", left - 6.0, y + 4.0, escape(&label));
        }
        let mut free = 0.0;
        for (x, label) in self.x.ticks_in(x_range) {
            let x = px(x);
            if self.x.ticks.is_none() {
                svg += &format!("<path class=\"grid\" d=\"M{x:.1} {top}V{y1}\"/>");
            }
            let half = 0.5 * CHARACTER * label.chars().count() as f64;
            if x - half >= free {
                let label = escape(&label);
                svg += &format!("<text class=\"mid\" x=\"{x:.1}\" y=\"{:.1}\">{label}</text>\n", y1 + 16.0);
                free = x + half + 2.0;
            }
        }
        svg += &format!("<path class=\"axis\" d=\"M{left} {top}V{y1}H{x1}\"/>\n");
        let middle = (left + x1) / 2.0;
        svg += &format!(
            "<text class=\"mid name\" x=\"{middle}\" y=\"{}\">{}</text>\n",
            HEIGHT - 8.0,
            escape(&self.x.label)
        );
        let middle = (top + y1) / 2.0;
        let label = escape(&self.y.label);
        svg + &format!("<text class=\"mid name\" transform=\"translate(13 {middle}) rotate(-90)\">{label}</text>\n")
    }

    fn draw(&self, series: &Series, px: &dyn Fn(f64) -> f64, py: &dyn Fn(f64) -> f64) -> String {
        let style = style_of(series.style);
        let shown = |p: &(f64, f64)| self.x.shows(p.0) && self.y.shows(p.1);
        let places: Vec<Option<(f64, f64)>> =
            series.points.iter().map(|p| shown(p).then(|| (px(p.0), py(p.1)))).collect();
        let mut svg = String::new();
        if series.mark != Mark::Points {
            svg += &format!("<path class=\"line s{style}\" d=\"{}\"/>\n", path(places.iter().copied()));
        }
        if series.mark != Mark::Line {
            svg.extend(places.iter().flatten().map(|&(x, y)| symbol(style, x, y)));
        }
        svg
    }

    /// The texts at the points, above all that is drawn.
    fn texts(&self, px: &dyn Fn(f64) -> f64, py: &dyn Fn(f64) -> f64) -> String {
        let marks: Vec<(f64, f64)> = self.shown().map(|(x, y)| (px(x), py(y))).collect();
        let labelled = self.series.iter().flat_map(|s| s.points.iter().zip(&s.labels));
        let labels: Vec<(f64, f64, &str)> = labelled
            .filter(|((x, y), label)| self.x.shows(*x) && self.y.shows(*y) && !label.is_empty())
            .map(|(&(x, y), label)| (px(x), py(y), label.as_str()))
            .collect();
        let [left, top, right, bottom] = MARGINS;
        let places = label::places(&labels, &marks, [left, top, WIDTH - right, HEIGHT - bottom]);
        let text = |(place, &(.., label)): (&label::Place, &(f64, f64, &str))| {
            let (class, label) = (place.class, escape(label));
            format!("<text class=\"{class} tag\" x=\"{:.1}\" y=\"{:.1}\">{label}</text>\n", place.x, place.y)
        };
        places.iter().zip(&labels).map(text).collect()
    }
}

/// A vertical line whose text stands above the plot, away from the nearer side.
fn marker(x: f64, label: &str) -> String {
    let [_, top, _, bottom] = MARGINS;
    let (class, from) = if x > WIDTH / 2.0 { ("end tag", x + 4.0) } else { ("tag", x - 4.0) };
    format!("<path class=\"marker\" d=\"M{x:.1} {}V{}\"/>", top - 6.0, HEIGHT - bottom)
        + &format!("<text class=\"{class}\" x=\"{from:.1}\" y=\"{}\">{}</text>\n", top - 12.0, escape(label))
}

/// The class number of a style.
pub(super) fn style_of(style: usize) -> usize {
    if style < STYLES { style } else { 1 + (style - 1) % (STYLES - 1) }
}

/// The `d` attribute of a polyline; it is interrupted where there is no point.
pub(super) fn path(points: impl Iterator<Item = Option<(f64, f64)>>) -> String {
    let mut d = String::new();
    let mut pen = 'M';
    for point in points {
        match point {
            Some((x, y)) => {
                d += &format!("{pen}{x:.1} {y:.1}");
                pen = 'L';
            }
            None => pen = 'M',
        }
    }
    d
}

/// The mark of a style: circle, square, triangle or diamond.
fn symbol(style: usize, x: f64, y: f64) -> String {
    let shape = match style % 4 {
        1 => "m-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z",
        2 => "m-3.5 -3.5h7v7h-7z",
        3 => "m0 -4.5l4.5 8h-9z",
        _ => "m0 -5l5 5l-5 5l-5 -5z",
    };
    format!("<path class=\"mark s{style}\" d=\"M{x:.1} {y:.1}{shape}\"/>\n")
}

/// A legend of styles, how they are drawn, and names.
pub(super) fn legend<'a>(entries: impl Iterator<Item = (usize, Mark, &'a str)>) -> String {
    let mut html = String::from("<ul class=\"legend\">");
    for (style, mark, name) in entries {
        let style = style_of(style);
        let line = format!("<path class=\"line s{style}\" d=\"M1 7H33\"/>");
        let drawing = match mark {
            Mark::Line => line,
            Mark::Points => symbol(style, 17.0, 7.0),
            Mark::Both => line + &symbol(style, 17.0, 7.0),
        };
        html += &format!("<li><svg class=\"key\" viewBox=\"0 0 34 14\" aria-hidden=\"true\">{drawing}</svg>");
        html += &format!("{}</li>", escape(name));
    }
    html + "</ul>\n"
}
