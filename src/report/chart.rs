//! A chart of series over two axes, as inline SVG.

use super::axis::Axis;
use super::drawing::{Form, Letters, Look, Shape, symbol};
use super::label::{self, Area};
use super::text::escape;

/// Drawn size of a chart of one cell in user units: about the width of a phone, so that text keeps its size there.
pub(super) const WIDTH: f64 = 360.0;
pub(super) const HEIGHT: f64 = 270.0;
/// Space around the plot: left, top, right, bottom.
const MARGINS: [f64; 4] = [60.0, 26.0, 14.0, 44.0];
/// Mean width of a character of a tick label, user units.
const CHARACTER: f64 = 7.0;
/// Distance of the arrows of points beyond the plot from its upper edge and from one another, user units.
const ARROW: f64 = 5.0;
const ARROWS: f64 = 10.0;
/// Distance of the points that stand for a line where texts are placed, user units.
const TRACE: f64 = 4.0;

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
    /// Whether the mark of each point is hollow; may be shorter than the points.
    pub hollow: Vec<bool>,
}

impl Series {
    /// A series without texts at its points.
    pub fn new(name: impl Into<String>, points: Vec<(f64, f64)>, mark: Mark, style: usize) -> Self {
        Self { name: name.into(), points, mark, style, labels: Vec::new(), hollow: Vec::new() }
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
    /// Dotted lines between two points, with a text at their middle each: differences worth telling.
    pub spans: Vec<([(f64, f64); 2], String)>,
    /// Columns and rows of a [`super::Sheet`] it fills, at least 1 each: its size, that of letters stays.
    pub cells: [usize; 2],
}

/// From values to places in the drawing.
struct Frame<'a> {
    chart: &'a Chart,
    x_range: [f64; 2],
    y_range: [f64; 2],
}

impl Frame<'_> {
    fn x(&self, x: f64) -> f64 {
        let [left, _, right, _] = self.chart.plot();
        left + self.chart.x.place(x, self.x_range).clamp(0.0, 1.0) * (right - left)
    }

    /// Above or below the plot where the value is.
    fn y_unclamped(&self, y: f64) -> f64 {
        let [_, top, _, bottom] = self.chart.plot();
        bottom - self.chart.y.place(y, self.y_range) * (bottom - top)
    }

    fn y(&self, y: f64) -> f64 {
        let [_, top, _, bottom] = self.chart.plot();
        self.y_unclamped(y).clamp(top, bottom)
    }

    /// Where a point's mark stands.
    fn mark(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let [_, top, ..] = self.chart.plot();
        let beyond = self.y_unclamped(y) < top - EDGE;
        (self.x(x), if beyond { top + ARROW } else { self.y(y) })
    }
}

impl Chart {
    /// A chart of series alone, of one cell.
    pub fn new(description: impl Into<String>, x: Axis, y: Axis, series: Vec<Series>) -> Self {
        let (markers, bands, spans) = (Vec::new(), Vec::new(), Vec::new());
        Self { description: description.into(), x, y, series, markers, bands, spans, cells: [1, 1] }
    }

    /// Width and height, user units.
    pub(super) fn size(&self) -> (f64, f64) {
        (WIDTH * self.cells[0] as f64, HEIGHT * self.cells[1] as f64)
    }

    /// Where the plot lies in the drawing.
    pub(super) fn plot(&self) -> Area {
        let ([left, top, right, bottom], (width, height)) = (MARGINS, self.size());
        [left, top, width - right, height - bottom]
    }

    /// The drawing: an `svg` element, styled by the page. What lies beyond the range of the vertical axis is cut off; an
    /// arrow stands for the mark of what lies above.
    pub fn to_svg(&self) -> String {
        let shapes: String = self.shapes().iter().map(Shape::to_svg).collect();
        let (width, height) = self.size();
        format!(
            "<svg class=\"chart\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{}\">\n{shapes}</svg>\n",
            escape(&self.description)
        )
    }

    /// All that is drawn, the lowest first, within its size.
    pub(super) fn shapes(&self) -> Vec<Shape> {
        let markers = self.markers.iter().map(|m| m.0);
        let x_range = self.x.fit(self.shown().map(|p| p.0).chain(markers));
        let frame = Frame { chart: self, x_range, y_range: self.y.fit(self.shown().map(|p| p.1)) };
        let [_, top, _, bottom] = self.plot();
        let band = |[from, to]: &[f64; 2]| {
            let left = frame.x(*from);
            Shape::Band([left, top, frame.x(*to).max(left), bottom])
        };
        let mut shapes: Vec<Shape> = self.bands.iter().map(band).collect();
        shapes.extend(self.axes(&frame));
        for (x, label) in self.markers.iter().filter(|m| self.x.shows(m.0)) {
            shapes.extend(self.marker(frame.x(*x), label));
        }
        for ([from, to], _) in self.spans_shown() {
            let points = [from, to].map(|p| Some((frame.x(p.0), frame.y(p.1)))).into();
            shapes.push(Shape::Line { look: Look::Marker, points });
        }
        let mut arrows = Vec::new();
        for series in &self.series {
            self.draw(series, &frame, &mut shapes, &mut arrows);
        }
        shapes.extend(self.texts(&frame));
        shapes
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

    fn axes(&self, frame: &Frame<'_>) -> Vec<Shape> {
        let [left, top, x1, y1] = self.plot();
        let line =
            |look, points: &[(f64, f64)]| Shape::Line { look, points: points.iter().copied().map(Some).collect() };
        let mut shapes = Vec::new();
        for (y, label) in self.y.ticks_in(frame.y_range) {
            let y = frame.y(y);
            shapes.push(line(Look::Grid, &[(left, y), (x1, y)]));
            shapes.push(text("end", Letters::Plain, left - 6.0, y + 4.0, label));
        }
        let mut free = 0.0;
        for (x, label) in self.x.ticks_in(frame.x_range) {
            let x = frame.x(x);
            if self.x.ticks.is_none() {
                shapes.push(line(Look::Grid, &[(x, top), (x, y1)]));
            }
            let half = 0.5 * CHARACTER * label.chars().count() as f64;
            if x - half >= free {
                shapes.push(text("mid", Letters::Plain, x, y1 + 16.0, label));
                free = x + half + 2.0;
            }
        }
        shapes.push(line(Look::Axis, &[(left, top), (left, y1), (x1, y1)]));
        shapes.push(text("mid", Letters::Name, (left + x1) / 2.0, self.size().1 - 8.0, self.x.label.clone()));
        let (anchor, letters, upright, text) = ("mid", Letters::Name, true, self.y.label.clone());
        shapes.push(Shape::Text { anchor, letters, x: 13.0, y: (top + y1) / 2.0, upright, text });
        shapes
    }

    /// `arrows` holds where arrows are.
    fn draw(&self, series: &Series, frame: &Frame<'_>, shapes: &mut Vec<Shape>, arrows: &mut Vec<f64>) {
        let [_, top, _, bottom] = self.plot();
        let shown = |p: &(f64, f64)| self.x.shows(p.0) && self.y.shows(p.1);
        let places: Vec<Option<(f64, f64)>> =
            series.points.iter().map(|p| shown(p).then(|| (frame.x(p.0), frame.y_unclamped(p.1)))).collect();
        if series.mark != Mark::Points {
            shapes.push(Shape::Line { look: Look::Series(series.style), points: clipped(&places, top, bottom) });
        }
        if series.mark == Mark::Line {
            return;
        }
        for (i, &(x, y)) in places.iter().enumerate().filter_map(|(i, p)| Some((i, p.as_ref()?))) {
            let (style, hollow) = (series.style, series.hollow.get(i) == Some(&true));
            if y < top - EDGE {
                let beside = arrows.iter().filter(|a| **a == x).count() as f64;
                arrows.push(x);
                shapes.push(Shape::Mark { style, form: Form::Arrow, hollow, x: x + ARROWS * beside, y: top + ARROW });
            } else if y <= bottom + EDGE {
                shapes.push(Shape::Mark { style, form: Form::Point, hollow, x, y });
            }
        }
    }

    /// The texts at the points, above all that is drawn.
    fn texts(&self, frame: &Frame<'_>) -> Vec<Shape> {
        let marks: Vec<(f64, f64)> = self.shown().map(|p| frame.mark(p)).collect();
        let labelled = self.series.iter().flat_map(|s| s.points.iter().zip(&s.labels));
        let labels: Vec<(f64, f64, &str)> = labelled
            .filter(|((x, y), label)| self.x.shows(*x) && self.y.shows(*y) && !label.is_empty())
            .map(|(&p, label)| (frame.mark(p).0, frame.mark(p).1, label.as_str()))
            .chain(self.spans_shown().map(|([from, to], label)| {
                let middle = |a: f64, b: f64| (a + b) / 2.0;
                (middle(frame.x(from.0), frame.x(to.0)), middle(frame.y(from.1), frame.y(to.1)), label)
            }))
            .collect();
        let places = label::places(&labels, &marks, &self.traces(frame), self.plot());
        let tag = |(place, &(.., label)): (&label::Place, &(f64, f64, &str))| {
            text(place.class, Letters::Tag, place.x, place.y, label.to_owned())
        };
        places.iter().zip(&labels).map(tag).collect()
    }

    /// Points close together on all lines: what texts had better not cover.
    fn traces(&self, frame: &Frame<'_>) -> Vec<(f64, f64)> {
        let shown = |p: &(f64, f64)| self.x.shows(p.0) && self.y.shows(p.1);
        let series = self.series.iter().filter(|s| s.mark != Mark::Points);
        let pieces =
            series.flat_map(|s| s.points.windows(2)).map(|p| [p[0], p[1]]).chain(self.spans_shown().map(|s| s.0));
        let pieces = pieces.filter(|ends| ends.iter().all(shown));
        let trace = |ends: [(f64, f64); 2]| {
            let [(x0, y0), (x1, y1)] = ends.map(|p| (frame.x(p.0), frame.y(p.1)));
            let n = ((x1 - x0).hypot(y1 - y0) / TRACE).ceil().max(1.0);
            (0..=n as usize).map(move |i| (x0 + (x1 - x0) * i as f64 / n, y0 + (y1 - y0) * i as f64 / n))
        };
        pieces.flat_map(trace).collect()
    }

    /// Spans that both axes can show.
    fn spans_shown(&self) -> impl Iterator<Item = ([(f64, f64); 2], &str)> {
        let shown = |ends: &[(f64, f64); 2]| ends.iter().all(|p| self.x.shows(p.0) && self.y.shows(p.1));
        self.spans.iter().filter(move |s| shown(&s.0)).map(|(ends, label)| (*ends, label.as_str()))
    }

    /// A vertical line whose text stands above the plot, away from the nearer side.
    fn marker(&self, x: f64, label: &str) -> [Shape; 2] {
        let [_, top, _, bottom] = self.plot();
        let (anchor, from) = if x > self.size().0 / 2.0 { ("end", x + 4.0) } else { ("", x - 4.0) };
        let points = vec![Some((x, top - 6.0)), Some((x, bottom))];
        [Shape::Line { look: Look::Marker, points }, text(anchor, Letters::Tag, from, top - 12.0, label.to_owned())]
    }
}

/// Rounding of places, user units.
const EDGE: f64 = 1e-6;

/// A polyline without its parts above `top` and below `bottom`.
fn clipped(points: &[Option<(f64, f64)>], top: f64, bottom: f64) -> Vec<Option<(f64, f64)>> {
    let inside = |y: f64| y >= top - EDGE && y <= bottom + EDGE;
    let mut out: Vec<Option<(f64, f64)>> = Vec::new();
    for (i, &point) in points.iter().enumerate() {
        let (Some((x, y)), before) = (point, i.checked_sub(1).and_then(|i| points[i])) else {
            out.push(None);
            continue;
        };
        if let Some((x0, y0)) = before.filter(|p| inside(p.1) != inside(y) || (p.1 < top) != (y < top)) {
            // Where the piece crosses the edges, in the order it does.
            let mut cuts: Vec<f64> = [top, bottom].map(|edge| (edge - y0) / (y - y0)).into();
            cuts.retain(|t| *t > 0.0 && *t < 1.0);
            cuts.sort_by(f64::total_cmp);
            out.extend(cuts.into_iter().map(|t| Some((x0 + t * (x - x0), y0 + t * (y - y0)))));
        }
        out.push(inside(y).then_some((x, y)));
    }
    out
}

/// A text read as usual.
pub(super) fn text(anchor: &'static str, letters: Letters, x: f64, y: f64, text: String) -> Shape {
    Shape::Text { anchor, letters, x, y, upright: false, text }
}

/// A legend of styles, how they are drawn, and names.
pub(super) fn legend<'a>(entries: impl Iterator<Item = (usize, Mark, &'a str)>) -> String {
    let mut html = String::from("<ul class=\"legend\">");
    for (style, mark, name) in entries {
        let line =
            Shape::Line { look: Look::Series(style), points: vec![Some((1.0, 7.0)), Some((33.0, 7.0))] }.to_svg();
        let drawing = match mark {
            Mark::Line => line,
            Mark::Points => symbol(style, Form::Point, false, 17.0, 7.0),
            Mark::Both => line + &symbol(style, Form::Point, false, 17.0, 7.0),
        };
        html += &format!("<li><svg class=\"key\" viewBox=\"0 0 34 14\" aria-hidden=\"true\">{drawing}</svg>");
        html += &format!("{}</li>", escape(name));
    }
    html + "</ul>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_end_at_the_edges() {
        let line = [Some((0.0, 5.0)), Some((1.0, -5.0)), Some((2.0, 15.0)), None, Some((3.0, 20.0)), Some((4.0, 30.0))];
        let want =
            [Some((0.0, 5.0)), Some((0.5, 0.0)), None, Some((1.25, 0.0)), Some((1.75, 10.0)), None, None, None, None];
        assert_eq!(clipped(&line, 0.0, 10.0), want);
    }
}
