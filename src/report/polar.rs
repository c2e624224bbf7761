//! Slices of f_cos as half discs, the radius by its cube root: a lobe and what lies beside it are both seen.

use super::Slice;
use super::chart::{Mark, legend};
use super::drawing::{path, style_of};
use super::text::{escape, number};

const WIDTH: f64 = 360.0;
const HEIGHT: f64 = 226.0;
/// Middle of the disc and its radius, user units.
const MIDDLE: (f64, f64) = (180.0, 176.0);
const RADIUS: f64 = 146.0;
/// How far beyond the truth the rim may lie to show a reconstruction that overshoots.
const OVERSHOOT: f64 = 1.5;

/// The point at an angle from the normal and a share of the radius.
fn at(theta_deg: f64, r: f64) -> (f64, f64) {
    let (sin, cos) = theta_deg.to_radians().sin_cos();
    (MIDDLE.0 + RADIUS * r * sin, MIDDLE.1 - RADIUS * r * cos)
}

fn finite(point: &&(f64, f64)) -> bool {
    point.1.is_finite() && (-90.0..=90.0).contains(&point.0)
}

/// The value at the rim, eight times a round number (that at half the radius), that holds the truth and, within reason, the rest.
fn rim(slice: &Slice) -> f64 {
    let largest = |curve: &[(f64, f64)]| curve.iter().filter(finite).map(|p| p.1).fold(0.0, f64::max);
    let truth = slice.truth.as_deref().map_or(0.0, largest);
    let rest = slice.methods.iter().map(|m| largest(&m.1)).fold(0.0, f64::max);
    let value = if truth > 0.0 { truth.max(rest.min(OVERSHOOT * truth)) } else { rest };
    if value <= 0.0 {
        return 1.0;
    }
    let decade = 10f64.powf((value / 8.0).log10().floor());
    let round = [1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0];
    let nice = round.into_iter().map(|m| 8.0 * m * decade).find(|r| *r >= value * (1.0 - 1e-9));
    nice.filter(|r| r.is_normal()).unwrap_or(value)
}

/// The half disc of a slice, as an `svg` element styled by the page.
pub fn polar_svg(slice: &Slice) -> String {
    let rim = rim(slice);
    let theta_o = number(slice.theta_o_deg, 3);
    let mut svg = format!(
        "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"Polar plot of f_cos over \
         theta_i in the plane of incidence, camera at theta_o = {theta_o} degrees, rim {} per sr\">\n",
        number(rim, 2)
    );
    svg += &zone(slice.zone_deg);
    svg += &grid(rim);
    if slice.theta_o_deg.abs() <= 90.0 {
        let ((x0, y0), (x1, y1)) = (at(slice.theta_o_deg, 0.0), at(slice.theta_o_deg, 1.0));
        svg += &format!("<path class=\"marker\" d=\"M{x0:.1} {y0:.1}L{x1:.1} {y1:.1}\"/>\n");
        let (x, y) = at(-slice.theta_o_deg, 1.0);
        let turn = -slice.theta_o_deg;
        svg += &format!(
            "<path class=\"camera\" transform=\"translate({x:.1} {y:.1}) rotate({turn:.1})\" d=\"M0 11l6 -11h-12z\"/>\n"
        );
    }
    let radius = |f: f64| (f / rim).clamp(0.0, 1.0).cbrt();
    let draw = |style: usize, curve: &[(f64, f64)]| {
        let points = curve.iter().map(|p| finite(&p).then(|| at(p.0, radius(p.1))));
        format!("<path class=\"line s{}\" d=\"{}\"/>\n", style_of(style), path(points))
    };
    if let Some(truth) = &slice.truth {
        svg += &draw(0, truth);
    }
    for (i, (_, curve)) in slice.methods.iter().enumerate() {
        svg += &draw(i + 1, curve);
    }
    svg + "</svg>\n"
}

/// The legend of a slice's curves: an HTML list.
pub fn polar_legend(slice: &Slice) -> String {
    let truth = slice.truth.iter().map(|_| (0, Mark::Line, "truth"));
    let methods = slice.methods.iter().enumerate().map(|(i, m)| (i + 1, Mark::Line, m.0.as_str()));
    legend(truth.chain(methods))
}

/// The measured zone on both sides of the normal.
fn zone([min, max]: [f64; 2]) -> String {
    let (min, max) = (min.clamp(0.0, 90.0), max.clamp(0.0, 90.0));
    if min.is_nan() || max.is_nan() {
        return String::new();
    }
    let sector = |from: f64, to: f64| {
        let ((x0, y0), (x1, y1), (x, y)) = (at(from, 1.0), at(to, 1.0), MIDDLE);
        format!("<path class=\"zone\" d=\"M{x} {y}L{x0:.1} {y0:.1}A{RADIUS} {RADIUS} 0 0 1 {x1:.1} {y1:.1}z\"/>\n")
    };
    sector(min, max) + &sector(-max, -min)
}

fn grid(rim: f64) -> String {
    let mut svg = String::new();
    for r in [0.5, 1.0] {
        let ((x0, y), (x1, _), radius) = (at(-90.0, r), at(90.0, r), r * RADIUS);
        svg += &format!("<path class=\"grid\" d=\"M{x0:.1} {y}A{radius} {radius} 0 0 1 {x1:.1} {y}\"/>\n");
        let label = escape(&number(r * r * r * rim, 2));
        svg += &format!("<text class=\"mid\" x=\"{x1:.1}\" y=\"{:.1}\">{label}</text>\n", y + 16.0);
    }
    for degrees in [-90i32, -60, -30, 0, 30, 60, 90] {
        let ((x0, y0), (x1, y1)) = (MIDDLE, at(f64::from(degrees), 1.0));
        let class = if degrees.abs() == 90 { "axis" } else { "grid" };
        svg += &format!("<path class=\"{class}\" d=\"M{x0} {y0}L{x1:.1} {y1:.1}\"/>");
        let (x, y) = at(f64::from(degrees), 1.11);
        let sign = if degrees < 0 { "−" } else { "" };
        let angle = degrees.abs();
        svg += &format!("<text class=\"mid\" x=\"{x:.1}\" y=\"{:.1}\">{sign}{angle}°</text>\n", y + 4.0);
    }
    let (x, y) = (MIDDLE.0, HEIGHT - 8.0);
    svg + &format!(
        "<text class=\"mid name\" x=\"{x}\" y=\"{y}\">radius: cube root of f cos θᵢ (rings in 1/sr)</text>\n"
    )
}
