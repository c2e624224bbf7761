//! Drawings as pixels.

use std::collections::HashMap;
use std::sync::LazyLock;

use ab_glyph_rasterizer::{Rasterizer, point};
use ttf_parser::{Face, OutlineBuilder};

use super::drawing::{
    BAND_OPACITY, Colour, Letters, Look, OUTLINE, PAGE, RULE, SOFT, STYLES, Shape, Stroke, TEXT, outline,
};

/// The letters charts use, of DejaVu Sans.
static FONT: LazyLock<Face<'static>> = LazyLock::new(|| {
    Face::parse(include_bytes!("../../data/dejavu-sans-subset.ttf"), 0).expect("the built-in font is tested")
});

type Point = (f64, f64);

/// A drawing of `width` by `height` user units as a PNG with `scale` pixels a unit.
pub(super) fn painted(shapes: &[Shape], width: f64, height: f64, scale: f64) -> Vec<u8> {
    let (w, h) = ((width * scale).ceil() as usize, (height * scale).ceil() as usize);
    let mut canvas = Canvas { width: w, height: h, scale, bytes: PAGE.repeat(w * h) };
    for shape in shapes {
        canvas.draw(shape);
    }
    canvas.encoded()
}

struct Canvas {
    width: usize,
    height: usize,
    scale: f64,
    bytes: Vec<u8>,
}

/// Steps between an ink and the page that a picture tells apart at the edges of lines.
const STEPS: usize = 20;

impl Canvas {
    /// The PNG file: each pixel in the nearest of the inks' shades, which makes it a third of the size.
    fn encoded(&self) -> Vec<u8> {
        let inks = [TEXT, SOFT, RULE].into_iter().chain((1..STYLES).map(|style| Look::Series(style).stroke().colour));
        let shade = |ink: Colour, share: f64| -> Colour {
            std::array::from_fn(|i| {
                (f64::from(PAGE[i]) + share * (f64::from(ink[i]) - f64::from(PAGE[i]))).round() as u8
            })
        };
        let shades = inks.flat_map(|ink| (1..=STEPS).map(move |i| shade(ink, i as f64 / STEPS as f64)));
        let palette: Vec<Colour> = std::iter::once(PAGE).chain(shades).collect();
        let distance =
            |a: &[u8], b: &Colour| a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b)).pow(2)).sum::<u32>();
        let nearest =
            |pixel: &[u8]| (0..palette.len()).min_by_key(|&i| distance(pixel, &palette[i])).unwrap_or(0) as u8;
        let mut known: HashMap<&[u8], u8> = HashMap::new();
        let indices: Vec<u8> =
            self.bytes.chunks_exact(3).map(|pixel| *known.entry(pixel).or_insert_with(|| nearest(pixel))).collect();
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_palette(palette.concat());
        encoder.set_compression(png::Compression::High);
        let mut writer = encoder.write_header().expect("memory takes any PNG");
        writer.write_image_data(&indices).expect("one index for each pixel");
        writer.finish().expect("memory takes any PNG");
        file
    }

    fn draw(&mut self, shape: &Shape) {
        match shape {
            Shape::Line { look, points } => {
                for run in points.split(Option::is_none) {
                    let run: Vec<Point> = run.iter().flatten().copied().collect();
                    self.stroke(&[run], &look.stroke());
                }
            }
            Shape::Band([left, top, right, bottom]) => {
                let corners = vec![(*left, *top), (*right, *top), (*right, *bottom), (*left, *bottom)];
                self.fill(&[corners], SOFT, BAND_OPACITY);
            }
            Shape::Mark { style, form, hollow, x, y } => {
                let corners: Vec<Point> = outline(*style, *form).iter().map(|(dx, dy)| (x + dx, y + dy)).collect();
                let colour = Look::Series(*style).stroke().colour;
                if *hollow {
                    self.fill(std::slice::from_ref(&corners), PAGE, 1.0);
                    self.stroke(&[closed(corners)], &Stroke { colour, width: OUTLINE, dash: &[] });
                } else {
                    self.fill(&[corners], colour, 1.0);
                }
            }
            Shape::Text { anchor, letters, x, y, upright, text } => {
                let (glyphs, width) = glyphs(text, letters.size());
                let from = match *anchor {
                    "mid" => -width / 2.0,
                    "end" => -width,
                    _ => 0.0,
                };
                let place = |(u, v): Point| if *upright { (x + v, y - u - from) } else { (x + u + from, y + v) };
                let glyphs: Vec<Vec<Point>> = glyphs.into_iter().map(|g| g.into_iter().map(place).collect()).collect();
                let edge = |colour, width| Stroke { colour, width, dash: &[] };
                let closed_glyphs = || glyphs.iter().cloned().map(closed).collect::<Vec<_>>();
                match letters {
                    Letters::Tag => self.stroke(&closed_glyphs(), &edge(PAGE, 3.0)),
                    Letters::Title => self.stroke(&closed_glyphs(), &edge(TEXT, 0.5)),
                    _ => {}
                }
                self.fill(&glyphs, TEXT, 1.0);
            }
        }
    }

    /// Lines of some width: a rectangle for each piece and a disc at each corner.
    fn stroke(&mut self, lines: &[Vec<Point>], stroke: &Stroke) {
        let r = stroke.width / 2.0;
        let mut areas = Vec::new();
        for line in lines.iter().flat_map(|line| dashes(line, stroke.dash)) {
            for (i, (&(x0, y0), &(x1, y1))) in line.iter().zip(line.iter().skip(1)).enumerate() {
                let length = (x1 - x0).hypot(y1 - y0);
                if length == 0.0 {
                    continue;
                }
                let (nx, ny) = (-(y1 - y0) / length * r, (x1 - x0) / length * r);
                areas.push(vec![(x0 - nx, y0 - ny), (x1 - nx, y1 - ny), (x1 + nx, y1 + ny), (x0 + nx, y0 + ny)]);
                if i > 0 {
                    let corner = |i: i32| {
                        let (sin, cos) = (f64::from(i) * std::f64::consts::FRAC_PI_4).sin_cos();
                        (x0 + r * cos, y0 + r * sin)
                    };
                    areas.push((0..8).map(corner).collect());
                }
            }
        }
        self.fill(&areas, stroke.colour, 1.0);
    }

    /// Areas within closed outlines; those turning the same way add up, the opposite ones are holes.
    fn fill(&mut self, outlines: &[Vec<Point>], colour: Colour, opacity: f64) {
        let points = || outlines.iter().flatten().map(|(x, y)| (x * self.scale, y * self.scale));
        let (x0, y0) = points().fold((f64::MAX, f64::MAX), |m, p| (m.0.min(p.0), m.1.min(p.1)));
        let (x1, y1) = points().fold((f64::MIN, f64::MIN), |m, p| (m.0.max(p.0), m.1.max(p.1)));
        let beyond = x1 < 0.0 || y1 < 0.0 || x0 > self.width as f64 || y0 > self.height as f64;
        if outlines.is_empty() || beyond || !(x1 - x0 + y1 - y0).is_finite() {
            return;
        }
        let (left, top) = (x0.floor(), y0.floor());
        let (w, h) = ((x1 - left).ceil() as usize + 2, (y1 - top).ceil() as usize + 2);
        let mut raster = Rasterizer::new(w, h);
        for outline in outlines {
            let at = |&(x, y): &Point| point((x * self.scale - left) as f32, (y * self.scale - top) as f32);
            for (from, to) in outline.iter().zip(outline.iter().cycle().skip(1)) {
                raster.draw_line(at(from), at(to));
            }
        }
        raster.for_each_pixel_2d(|x, y, cover| {
            let (x, y) = (left + f64::from(x), top + f64::from(y));
            if cover <= 0.0 || x < 0.0 || y < 0.0 || x >= self.width as f64 || y >= self.height as f64 {
                return;
            }
            let at = 3 * (y as usize * self.width + x as usize);
            let share = f64::from(cover.min(1.0)) * opacity;
            for (byte, ink) in self.bytes[at..at + 3].iter_mut().zip(colour) {
                *byte = (f64::from(*byte) * (1.0 - share) + f64::from(ink) * share).round() as u8;
            }
        });
    }
}

fn closed(mut outline: Vec<Point>) -> Vec<Point> {
    outline.extend(outline.first().copied());
    outline
}

/// The dashes of a line; all of it without a pattern.
fn dashes(line: &[Point], pattern: &[f64]) -> Vec<Vec<Point>> {
    if pattern.is_empty() {
        return vec![line.to_vec()];
    }
    let (mut dashes, mut dash) = (Vec::new(), Vec::new());
    let (mut i, mut left) = (0, pattern[0]);
    for (&(x0, y0), &(x1, y1)) in line.iter().zip(line.iter().skip(1)) {
        let length = (x1 - x0).hypot(y1 - y0);
        let mut done = 0.0;
        while done < length {
            let step = left.min(length - done);
            let at = |s: f64| (x0 + (x1 - x0) * s / length, y0 + (y1 - y0) * s / length);
            if i % 2 == 0 {
                if dash.is_empty() {
                    dash.push(at(done));
                }
                dash.push(at(done + step));
            }
            done += step;
            left -= step;
            if left <= 1e-9 {
                dashes.extend((!dash.is_empty()).then(|| std::mem::take(&mut dash)));
                i += 1;
                left = pattern[i % pattern.len()];
            }
        }
    }
    dashes.extend((!dash.is_empty()).then_some(dash));
    dashes
}

/// Outlines of a text whose base line starts at (0, 0), and its width.
fn glyphs(text: &str, size: f64) -> (Vec<Vec<Point>>, f64) {
    let unit = size / f64::from(FONT.units_per_em());
    let mut pen = Pen { unit, x: 0.0, outlines: Vec::new() };
    for c in text.chars() {
        let glyph = FONT.glyph_index(c).or_else(|| FONT.glyph_index('?')).unwrap_or_default();
        FONT.outline_glyph(glyph, &mut pen);
        pen.x += unit * f64::from(FONT.glyph_hor_advance(glyph).unwrap_or(0));
    }
    (pen.outlines, pen.x)
}

struct Pen {
    unit: f64,
    x: f64,
    outlines: Vec<Vec<Point>>,
}

/// Straight pieces of a curve of a letter.
const PIECES: u32 = 5;

impl Pen {
    fn at(&self, x: f32, y: f32) -> Point {
        (self.x + self.unit * f64::from(x), -self.unit * f64::from(y))
    }

    /// Joins the last point to a Bezier curve's end over its inner points.
    fn curve(&mut self, inner: &[Point], end: Point) {
        let outline = self.outlines.last_mut().expect("a curve follows a point");
        let mut points = vec![*outline.last().expect("a curve follows a point")];
        points.extend_from_slice(inner);
        points.push(end);
        for i in 1..=PIECES {
            let t = f64::from(i) / f64::from(PIECES);
            let mut level = points.clone();
            while level.len() > 1 {
                level = level
                    .windows(2)
                    .map(|p| (p[0].0 + t * (p[1].0 - p[0].0), p[0].1 + t * (p[1].1 - p[0].1)))
                    .collect();
            }
            outline.push(level[0]);
        }
    }
}

impl OutlineBuilder for Pen {
    fn move_to(&mut self, x: f32, y: f32) {
        self.outlines.push(vec![self.at(x, y)]);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let end = self.at(x, y);
        self.outlines.last_mut().expect("a line follows a point").push(end);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let (inner, end) = (self.at(x1, y1), self.at(x, y));
        self.curve(&[inner], end);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let (inner, end) = ([self.at(x1, y1), self.at(x2, y2)], self.at(x, y));
        self.curve(&inner, end);
    }

    fn close(&mut self) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::drawing::Form;

    fn ink(shape: Shape) -> (f64, image::RgbImage) {
        let image = image::load_from_memory(&painted(&[shape], 60.0, 40.0, 2.0)).unwrap().to_rgb8();
        let dark = |p: &image::Rgb<u8>| (255.0 - f64::from(p.0[0])) / (255.0 - f64::from(TEXT[0]));
        (image.pixels().map(dark).sum::<f64>() / 4.0, image)
    }

    #[test]
    fn lines_cover_their_length_times_their_width() {
        let line = |points: &[Option<Point>]| ink(Shape::Line { look: Look::Series(0), points: points.to_vec() }).0;
        let whole = line(&[Some((10.0, 20.0)), Some((30.0, 20.0)), Some((50.0, 20.0))]);
        assert!((whole - 120.0).abs() < 0.5, "{whole}");
        let half = line(&[Some((10.0, 20.0)), Some((30.0, 20.0)), None, Some((50.0, 20.0))]);
        assert!((half - 60.0).abs() < 0.5, "{half}");
        assert_eq!(line(&[]), 0.0);
        let pieces = dashes(&[(0.0, 0.0), (4.0, 0.0), (4.0, 8.0)], &[7.0, 3.0]);
        assert_eq!(pieces, [vec![(0.0, 0.0), (4.0, 0.0), (4.0, 3.0)], vec![(4.0, 6.0), (4.0, 8.0)]]);
    }

    #[test]
    fn marks_are_full_hollow_or_cut_off_by_the_edge() {
        let mark = |hollow, x| ink(Shape::Mark { style: 0, form: Form::Point, hollow, x, y: 20.0 });
        let (full, hollow) = (mark(false, 30.0), mark(true, 30.0));
        assert!(full.1.get_pixel(60, 40).0 == TEXT && hollow.1.get_pixel(60, 40).0 == PAGE && hollow.0 > 1.0);
        assert!((mark(false, 0.0).0 / full.0 - 0.5).abs() < 0.05);
        assert_eq!(mark(false, -20.0).0, 0.0);
        assert_eq!(mark(false, f64::NAN).0, 0.0);
    }

    /// Letters of charts and pages that are drawn: each has an outline of its own.
    #[test]
    fn the_font_has_all_letters() {
        for c in ('!'..='~').chain("°·×−–≤≥√θ⁰¹²³⁴⁵⁶⁷⁸⁹⁻₀".chars()) {
            assert!(FONT.glyph_index(c).is_some(), "{c}");
        }
        let (wide, narrow) = (glyphs("MM", 12.0), glyphs("ii", 12.0));
        assert!(wide.1 > 2.0 * narrow.1 && narrow.0.len() == 4);
        let text = |upright| {
            ink(Shape::Text { anchor: "mid", letters: Letters::Plain, x: 30.0, y: 20.0, upright, text: "lll".into() })
        };
        assert!((text(true).0 - text(false).0).abs() < 0.5 && text(false).0 > 10.0);
    }
}
