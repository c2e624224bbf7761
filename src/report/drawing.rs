//! What charts are made of, before it becomes SVG or pixels, and how it looks.
//!
//! A page styles its charts with `page.css`, in the reader's light or dark scheme; what stands alone (an SVG file, a PNG) has
//! the light colours here, which are the same.

use super::label::Area;
use super::text::escape;

/// Styles of series: `.s0` to `.s6` in the page's style sheet.
pub(super) const STYLES: usize = 7;

/// Red, green, blue.
pub(super) type Colour = [u8; 3];

/// Background, text, what is less important, and grid lines.
pub(super) const PAGE: Colour = [0xff; 3];
pub(super) const TEXT: Colour = [0x1b, 0x1f, 0x24];
pub(super) const SOFT: Colour = [0x56, 0x60, 0x6b];
pub(super) const RULE: Colour = [0xd4, 0xda, 0xe1];
/// Opacity of [`Shape::Band`].
pub(super) const BAND_OPACITY: f64 = 0.12;

/// How a line is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stroke {
    pub colour: Colour,
    /// User units.
    pub width: f64,
    /// Lengths of dashes and gaps; none for a whole line.
    pub dash: &'static [f64],
}

/// Lines of series: Okabe and Ito's colours, darkened where they would be faint on white.
const SERIES: [Stroke; STYLES] = [
    Stroke { colour: TEXT, width: 3.0, dash: &[] },
    Stroke { colour: [0x00, 0x72, 0xb2], width: 2.0, dash: &[] },
    Stroke { colour: [0xd5, 0x5e, 0x00], width: 2.0, dash: &[7.0, 3.0] },
    Stroke { colour: [0x00, 0x9e, 0x73], width: 2.0, dash: &[2.0, 3.0] },
    Stroke { colour: [0xb7, 0x56, 0x8f], width: 2.0, dash: &[9.0, 3.0, 2.0, 3.0] },
    Stroke { colour: [0xb8, 0x7a, 0x00], width: 2.0, dash: &[4.0, 2.0] },
    Stroke { colour: [0x3b, 0x8f, 0xc2], width: 2.0, dash: &[1.0, 2.0] },
];
/// Width of the outline of a hollow mark, user units.
pub(super) const OUTLINE: f64 = 1.6;

/// What a line is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Look {
    Grid,
    Axis,
    Marker,
    /// A series of this style.
    Series(usize),
}

/// How a point is marked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    /// By the style's own mark.
    Point,
    /// By an arrow: it lies above the plot.
    Arrow,
}

/// What a text is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Letters {
    Plain,
    /// The name of an axis.
    Name,
    /// Of a point: set off from what it covers.
    Tag,
    Title,
}

/// One thing drawn; lengths in user units, y downwards.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Shape {
    /// A polyline, interrupted where there is no point.
    Line {
        look: Look,
        points: Vec<Option<(f64, f64)>>,
    },
    /// A shaded rectangle.
    Band(Area),
    Mark {
        style: usize,
        form: Form,
        hollow: bool,
        x: f64,
        y: f64,
    },
    /// `anchor`: in the text's `mid`dle, at its `end`, or at its start. `upright`: read from below.
    Text {
        anchor: &'static str,
        letters: Letters,
        x: f64,
        y: f64,
        upright: bool,
        text: String,
    },
}

impl Look {
    pub(super) fn stroke(self) -> Stroke {
        match self {
            Look::Grid => Stroke { colour: RULE, width: 1.0, dash: &[] },
            Look::Axis => Stroke { colour: SOFT, width: 1.2, dash: &[] },
            Look::Marker => Stroke { colour: SOFT, width: 1.4, dash: &[2.0, 3.0] },
            Look::Series(style) => SERIES[style_of(style)],
        }
    }

    fn class(self) -> String {
        match self {
            Look::Grid => "grid".into(),
            Look::Axis => "axis".into(),
            Look::Marker => "marker".into(),
            Look::Series(style) => format!("line s{}", style_of(style)),
        }
    }
}

impl Letters {
    /// Height of the letters, user units.
    pub(super) fn size(self) -> f64 {
        match self {
            Letters::Plain => 12.0,
            Letters::Name => 12.5,
            Letters::Tag => 11.5,
            Letters::Title => 13.5,
        }
    }

    fn class(self) -> &'static str {
        match self {
            Letters::Plain => "",
            Letters::Name => "name",
            Letters::Tag => "tag",
            Letters::Title => "title",
        }
    }
}

impl Shape {
    /// The same elsewhere.
    pub(super) fn shifted(self, dx: f64, dy: f64) -> Self {
        match self {
            Shape::Line { look, points } => {
                let points = points.into_iter().map(|p| p.map(|(x, y)| (x + dx, y + dy))).collect();
                Shape::Line { look, points }
            }
            Shape::Band([left, top, right, bottom]) => Shape::Band([left + dx, top + dy, right + dx, bottom + dy]),
            Shape::Mark { style, form, hollow, x, y } => Shape::Mark { style, form, hollow, x: x + dx, y: y + dy },
            Shape::Text { anchor, letters, x, y, upright, text } => {
                Shape::Text { anchor, letters, x: x + dx, y: y + dy, upright, text }
            }
        }
    }

    /// The element.
    pub(super) fn to_svg(&self) -> String {
        match self {
            Shape::Line { look, points } => {
                format!("<path class=\"{}\" d=\"{}\"/>\n", look.class(), path(points.iter().copied()))
            }
            Shape::Band([left, top, right, bottom]) => {
                let (w, h) = (right - left, bottom - top);
                format!("<rect class=\"band\" x=\"{left:.1}\" y=\"{top:.1}\" width=\"{w:.1}\" height=\"{h:.1}\"/>\n")
            }
            Shape::Mark { style, form, hollow, x, y } => symbol(*style, *form, *hollow, *x, *y),
            Shape::Text { anchor, letters, x, y, upright, text } => {
                let class = [*anchor, letters.class()].join(" ");
                let class = if class.trim().is_empty() { "".into() } else { format!(" class=\"{}\"", class.trim()) };
                let place = match upright {
                    true => format!("transform=\"translate({x:.1} {y:.1}) rotate(-90)\""),
                    false => format!("x=\"{x:.1}\" y=\"{y:.1}\""),
                };
                format!("<text{class} {place}>{}</text>\n", escape(text))
            }
        }
    }
}

/// The style sheet of a drawing that stands alone.
pub(super) fn style_sheet() -> String {
    let hex = |[r, g, b]: Colour| format!("#{r:02x}{g:02x}{b:02x}");
    let line = |class: &str, s: Stroke| {
        let dash: Vec<String> = s.dash.iter().map(f64::to_string).collect();
        let dash = if dash.is_empty() { "none".into() } else { dash.join(" ") };
        format!(".{class}{{stroke:{};stroke-width:{};stroke-dasharray:{dash}}}\n", hex(s.colour), s.width)
    };
    let mut css = format!(
        "path{{fill:none;stroke-linejoin:round}}\ntext{{fill:{};font-family:system-ui,\"DejaVu Sans\",sans-serif;font-size:12px}}\n\
         .mid{{text-anchor:middle}} .end{{text-anchor:end}} .title{{font-size:13.5px;font-weight:600}} .name{{font-size:12.5px}}\n\
         .tag{{font-size:11.5px;paint-order:stroke;stroke:{};stroke-width:3px;stroke-linejoin:round}}\n\
         .band{{fill:{};opacity:{BAND_OPACITY}}}\n",
        hex(TEXT),
        hex(PAGE),
        hex(SOFT)
    );
    css += &(line("grid", Look::Grid.stroke())
        + &line("axis", Look::Axis.stroke())
        + &line("marker", Look::Marker.stroke()));
    for (i, s) in SERIES.into_iter().enumerate() {
        let colour = hex(s.colour);
        css += &line(&format!("line.s{i}"), s);
        css += &format!(".mark.s{i}{{fill:{colour}}} .hollow.s{i}{{fill:{};stroke:{colour}}}\n", hex(PAGE));
    }
    css + &format!(".hollow{{stroke-width:{OUTLINE}}}\n")
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

/// The outline of a mark about its point: each style has its own.
pub(super) fn outline(style: usize, form: Form) -> Vec<(f64, f64)> {
    let ring = |n: usize, radius: fn(usize) -> f64, turn: f64| {
        let corner = |i: usize| {
            let (sin, cos) = (std::f64::consts::TAU * (i as f64 + turn) / n as f64).sin_cos();
            (radius(i) * sin, -radius(i) * cos)
        };
        (0..n).map(corner).collect()
    };
    if form == Form::Arrow {
        return vec![(0.0, -5.0), (4.5, 2.0), (1.5, 2.0), (1.5, 8.0), (-1.5, 8.0), (-1.5, 2.0), (-4.5, 2.0)];
    }
    match style_of(style) {
        0 => ring(10, |i| if i % 2 == 0 { 5.8 } else { 2.6 }, 0.0),
        1 => ring(20, |_| 4.0, 0.5),
        2 => ring(4, |_| 3.5 * std::f64::consts::SQRT_2, 0.5),
        3 => vec![(0.0, -4.5), (4.5, 3.5), (-4.5, 3.5)],
        4 => ring(4, |_| 5.0, 0.0),
        5 => vec![(0.0, 4.5), (-4.5, -3.5), (4.5, -3.5)],
        _ => ring(6, |_| 4.4, 0.0),
    }
}

/// A mark at its point.
pub(super) fn symbol(style: usize, form: Form, hollow: bool, x: f64, y: f64) -> String {
    let class = if hollow { "hollow" } else { "mark" };
    let shape = if style_of(style) == 1 && form == Form::Point {
        format!("M{x:.1} {y:.1}m-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z")
    } else {
        path(outline(style, form).into_iter().map(|(dx, dy)| Some((x + dx, y + dy)))) + "z"
    };
    format!("<path class=\"{class} s{}\" d=\"{shape}\"/>\n", style_of(style))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_and_files_have_the_same_colours() {
        let light = include_str!("page.css").split("@media").next().unwrap();
        let named = [("page", PAGE), ("text", TEXT), ("soft", SOFT), ("rule", RULE)].map(|(n, c)| (n.to_owned(), c));
        let series = SERIES.iter().enumerate().map(|(i, s)| (format!("s{i}"), s.colour));
        for (name, [r, g, b]) in named.into_iter().chain(series) {
            assert!(light.contains(&format!("--{name}: #{r:02x}{g:02x}{b:02x}")), "{name}");
        }
        for (i, s) in SERIES.iter().enumerate().filter(|(_, s)| !s.dash.is_empty()) {
            let dash: Vec<String> = s.dash.iter().map(f64::to_string).collect();
            let rule = format!(".line.s{i} {{ stroke-dasharray: {}; }}", dash.join(" "));
            assert!(include_str!("page.css").contains(&rule), "{rule}");
        }
    }
}
