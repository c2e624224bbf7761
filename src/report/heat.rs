//! Residuals by exitant angle and degree, as shades.

use super::axis::round_up;
use super::text::{degrees, percent};
use crate::fit::ResidualMap;

const WIDTH: f64 = 360.0;
/// Space around the cells: left, top, right, bottom.
const MARGINS: [f64; 4] = [60.0, 34.0, 14.0, 44.0];
/// Height of one degree's row, user units.
const ROW: f64 = 26.0;
/// Exitant angles written below the columns, at most.
const TICKS: usize = 8;

/// The map as an `svg` element styled by the page; columns are exitant angles, rows degrees from 0 at the bottom.
/// Shades are proportional to the residual, from none to a round number that holds the largest.
pub fn heat_svg(map: &ResidualMap) -> String {
    let rows = map.by_ring_and_degree.iter().map(Vec::len).max().unwrap_or(0);
    let columns = map.by_ring_and_degree.len();
    let largest = map.by_ring_and_degree.iter().flatten().copied().filter(|r| r.is_finite()).fold(0.0, f64::max);
    let full = if largest > 0.0 { round_up(largest) } else { 1.0 };
    let [left, top, right, bottom] = MARGINS;
    let (height, cell) = (top + bottom + ROW * rows as f64, (WIDTH - left - right) / columns.max(1) as f64);
    let mut svg = format!(
        "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"RMS residual of the chosen model \
         by exitant angle and degree, largest {}\">\n",
        percent(largest)
    );
    let y_of = |l: usize| top + ROW * (rows - 1 - l) as f64;
    for (i, (theta_o_deg, residuals)) in map.theta_o_deg.iter().zip(&map.by_ring_and_degree).enumerate() {
        let x = left + cell * i as f64;
        for (l, residual) in residuals.iter().enumerate().filter(|r| r.1.is_finite()) {
            svg += &shade(x, y_of(l), cell, ROW, residual / full);
        }
        let stride = columns.div_ceil(TICKS);
        if i % stride == stride / 2 {
            let (x, y) = (x + cell / 2.0, height - bottom + 16.0);
            svg += &format!("<text class=\"mid\" x=\"{x:.1}\" y=\"{y:.1}\">{}</text>\n", degrees(theta_o_deg.round()));
        }
    }
    for l in 0..rows {
        let y = y_of(l) + ROW / 2.0 + 4.0;
        svg += &format!("<text class=\"end\" x=\"{}\" y=\"{y:.1}\">{l}</text>\n", left - 6.0);
    }
    let (x1, y1) = (WIDTH - right, height - bottom);
    svg += &format!("<path class=\"axis\" d=\"M{left} {top}V{y1}H{x1}\"/>\n");
    let (x, y) = ((left + x1) / 2.0, (top + y1) / 2.0);
    svg += &format!("<text class=\"mid name\" x=\"{x}\" y=\"{}\">exitant angle θₒ (°)</text>\n", height - 8.0);
    svg += &format!("<text class=\"mid name\" transform=\"translate(13 {y}) rotate(-90)\">degree l</text>\n");
    svg + &scale(full) + "</svg>\n"
}

fn shade(x: f64, y: f64, width: f64, height: f64, share: f64) -> String {
    let share = share.clamp(0.0, 1.0);
    format!(
        "<rect class=\"heat\" x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" \
         fill-opacity=\"{share:.3}\"/>\n"
    )
}

/// The shades and what they stand for, above the map.
fn scale(full: f64) -> String {
    const STEPS: usize = 20;
    let (x0, y, step) = (150.0, 8.0, 5.0);
    let end = x0 + step * STEPS as f64;
    let shades = (0..STEPS).map(|i| shade(x0 + step * i as f64, y, step, 12.0, (i as f64 + 0.5) / STEPS as f64));
    shades.collect::<String>()
        + &format!("<text class=\"end\" x=\"{}\" y=\"{}\">RMS over z₀₀: 0</text>\n", x0 - 6.0, y + 10.0)
        + &format!("<text x=\"{}\" y=\"{}\">{}</text>\n", end + 6.0, y + 10.0, percent(full))
}
