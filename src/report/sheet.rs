//! Small multiples: charts of one subject side by side, under one legend, in one picture.

use super::chart::{Chart, HEIGHT, Mark, WIDTH, legend, text};
use super::drawing::{Form, Letters, Look, Shape, style_sheet};
use super::paint;
use super::text::escape;

/// Height of the sheet's title, user units.
const HEAD: f64 = 34.0;
/// Distance of the lines of the legend, user units.
const LINE: f64 = 22.0;
/// Pixels a user unit of the PNG: letters are 18 pixels high.
const SCALE: f64 = 1.5;

/// Charts that share series, and so a legend.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheet {
    /// What all of them show.
    pub title: String,
    /// Charts in a row.
    pub columns: usize,
    /// Titles and charts, each in the first cells free, row by row; the legend stands in a cell where there is none.
    pub panels: Vec<Option<(String, Chart)>>,
    /// Styles of the series, how they are drawn, and their names.
    pub series: Vec<(usize, Mark, String)>,
    /// What else the legend says, a line each.
    pub notes: Vec<String>,
}

impl Sheet {
    /// The picture as an SVG file: light colours, no other file needed.
    pub fn to_svg(&self) -> String {
        let (width, height) = self.size();
        let shapes: String = self.shapes().iter().map(Shape::to_svg).collect();
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
             role=\"img\" aria-label=\"{}\">\n<style>\n{}</style>\n<rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n\
             {shapes}</svg>\n",
            escape(&self.title),
            style_sheet()
        )
    }

    /// The same picture as a PNG file.
    pub fn to_png(&self) -> Vec<u8> {
        let (width, height) = self.size();
        paint::painted(&self.shapes(), width, height, SCALE)
    }

    /// The charts as figures of a page, one below the other where it is narrow; one legend above.
    pub(super) fn to_html(&self) -> String {
        let figure = |panel: &Option<(String, Chart)>| match panel {
            Some((title, chart)) => {
                let class = if chart.cells[0] > 1 { " class=\"broad\"" } else { "" };
                format!("<figure{class}><figcaption>{}</figcaption>{}</figure>\n", escape(title), chart.to_svg())
            }
            None => "<div></div>\n".into(),
        };
        let notes: Vec<String> = self.notes.iter().map(|n| escape(n)).collect();
        legend(self.series.iter().map(|(style, mark, name)| (*style, *mark, name.as_str())))
            + &format!("<p class=\"note\">{}.</p>\n<div class=\"trio\">\n", notes.join("; "))
            + &self.panels.iter().map(figure).collect::<String>()
            + "</div>\n"
    }

    /// Column and row of each panel, and the number of rows.
    fn cells(&self) -> (Vec<(usize, usize)>, usize) {
        let mut taken: Vec<Vec<bool>> = Vec::new();
        let mut place = |[across, down]: [usize; 2]| {
            let across = across.min(self.columns);
            let free = |taken: &[Vec<bool>], column: usize, row: usize| {
                taken.iter().skip(row).take(down).all(|cells| !cells[column..column + across].contains(&true))
            };
            let all = (0..).flat_map(|row| (0..=self.columns - across).map(move |column| (column, row)));
            let (column, row) = all.into_iter().find(|&(column, row)| free(&taken, column, row)).unwrap_or((0, 0));
            taken.resize(taken.len().max(row + down), vec![false; self.columns]);
            for cells in &mut taken[row..row + down] {
                cells[column..column + across].fill(true);
            }
            (column, row)
        };
        let places = self.panels.iter().map(|p| place(p.as_ref().map_or([1, 1], |(_, chart)| chart.cells))).collect();
        (places, taken.len())
    }

    fn size(&self) -> (f64, f64) {
        (WIDTH * self.columns as f64, HEAD + HEIGHT * self.cells().1 as f64)
    }

    fn shapes(&self) -> Vec<Shape> {
        let mut shapes = vec![text("mid", Letters::Title, self.size().0 / 2.0, 22.0, self.title.clone())];
        for (panel, (column, row)) in self.panels.iter().zip(self.cells().0) {
            let (x, y) = (WIDTH * column as f64, HEAD + HEIGHT * row as f64);
            let drawn = match panel {
                Some((title, chart)) => {
                    let ([left, _, right, _], mut drawn) = (chart.plot(), chart.shapes());
                    drawn.push(text("mid", Letters::Title, (left + right) / 2.0, 17.0, title.clone()));
                    drawn
                }
                None => self.legend(),
            };
            shapes.extend(drawn.into_iter().map(|s| s.shifted(x, y)));
        }
        shapes
    }

    fn legend(&self) -> Vec<Shape> {
        let mut shapes = Vec::new();
        let mut y = 24.0;
        for (style, mark, name) in &self.series {
            if *mark != Mark::Points {
                let points = vec![Some((16.0, y)), Some((60.0, y))];
                shapes.push(Shape::Line { look: Look::Series(*style), points });
            }
            if *mark != Mark::Line {
                shapes.push(Shape::Mark { style: *style, form: Form::Point, hollow: false, x: 38.0, y });
            }
            shapes.push(text("", Letters::Name, 68.0, y + 4.0, name.clone()));
            y += LINE;
        }
        y += 4.0;
        for note in &self.notes {
            shapes.push(text("", Letters::Plain, 16.0, y + 4.0, note.clone()));
            y += 17.0;
        }
        shapes
    }
}
