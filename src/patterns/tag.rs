//! A coded patch outside the zone: every frame says which one it is, and a camera frame shows which one was lit.

use super::Pattern;
use crate::optics::Rig;

/// Cells along the shorter side of the panel.
const CELLS_ACROSS: usize = 6;
/// Rays within this many times the radius of the paraboloid's edge may still meet a mirror that is a little out of place.
const CLEARANCE: f64 = 1.02;
/// Bits of a code: enough to tell a frame from any that could still be under way.
const MAX_BITS: usize = 6;
/// Fewer bits cannot tell neighbours from next neighbours.
const MIN_BITS: usize = 2;

/// A rectangle of pixels, half-open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rect {
    /// First column.
    pub u0: usize,
    /// First row.
    pub v0: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Rect {
    /// Its pixels as (column, row), row by row.
    pub fn pixels(self) -> impl Iterator<Item = (usize, usize)> {
        (self.v0..self.v0 + self.height).flat_map(move |v| (self.u0..self.u0 + self.width).map(move |u| (u, v)))
    }
}

/// One bit: of its two cells one is lit, so that every code sends the same light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TagBit {
    /// The cells on the panel: the first is lit for a one, the second for a zero.
    pub panel: [Rect; 2],
    /// The inner part of both as the camera sees it.
    pub sensor: [Rect; 2],
}

/// Where the coded patch lies on the panel, and where the camera sees it.
///
/// Rays beyond the paraboloid's edge miss the mirrors and fall on the border around the sample. Camera and projector share
/// their centre of projection, so the camera sees there what the projector shows, at whatever distance the border lies.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TagLayout {
    bits: Vec<TagBit>,
}

impl TagLayout {
    /// The largest patch that fits a rig's panel and sensor; `None` if there is no room beside the mirrors' image.
    pub fn of(rig: &Rig) -> Option<Self> {
        let mirrors = rig.mirrors();
        let (projector, camera) = (rig.projector.lens(), rig.camera.lens());
        let edge = rig.paraboloid_radius_mm();
        let reach_px = projector.focal_px * edge / (mirrors.centre().z - mirrors.convex().height(edge)) * CLEARANCE;
        let (width, height) = (rig.projector.width_px, rig.projector.height_px);
        let side = height.min(width) / CELLS_ACROSS;
        if side == 0 {
            return None;
        }
        let nearest = |start: usize, centre: f64| {
            let (lo, hi) = (start as f64, (start + side) as f64);
            if centre < lo { lo - centre } else { (centre - hi).max(0.0) }
        };
        let outside =
            |u: usize, v: usize| nearest(u, projector.centre_u).hypot(nearest(v, projector.centre_v)) >= reach_px;
        let seen = |cell: Rect| {
            // Half of each side: what a slight misalignment or blur moves stays within the cell.
            let middle = |start: usize| (start as f64) + side as f64 / 2.0;
            let ray = projector.ray(middle(cell.u0), middle(cell.v0));
            let (u, v) = camera.pixel(&ray);
            let half = side as f64 / 4.0 * camera.focal_px / projector.focal_px;
            let (u0, v0, u1, v1) = ((u - half).ceil(), (v - half).ceil(), (u + half).floor(), (v + half).floor());
            let inside = u0 >= 0.0
                && v0 >= 0.0
                && u1 <= rig.camera.width_px as f64
                && v1 <= rig.camera.height_px as f64
                && u1 - u0 >= 2.0
                && v1 - v0 >= 2.0;
            inside.then(|| {
                // Whole pairs of columns and rows hold every colour of a mosaic alike.
                let even = |from: f64, to: f64| (to - from) as usize / 2 * 2;
                Rect { u0: u0 as usize, v0: v0 as usize, width: even(u0, u1), height: even(v0, v1) }
            })
        };
        let mut bits = Vec::new();
        for column in (0..width / side).map(|i| if i % 2 == 0 { i / 2 } else { width / side - 1 - i / 2 }) {
            let mut rows = (0..height / side).filter(|row| outside(column * side, row * side)).peekable();
            while let (Some(row), Some(&below)) = (rows.next(), rows.peek()) {
                if below != row + 1 || bits.len() == MAX_BITS {
                    continue;
                }
                rows.next();
                let panel = [row, below].map(|r| Rect { u0: column * side, v0: r * side, width: side, height: side });
                if let (Some(first), Some(second)) = (seen(panel[0]), seen(panel[1])) {
                    bits.push(TagBit { panel, sensor: [first, second] });
                }
            }
        }
        (bits.len() >= MIN_BITS).then_some(Self { bits })
    }

    /// The bits.
    pub fn bits(&self) -> &[TagBit] {
        &self.bits
    }

    /// Number of different codes.
    pub fn codes(&self) -> usize {
        1 << self.bits.len()
    }

    /// The code of the frame at `position` of a sequence, one bit for each pair of cells. Frames near each other differ in
    /// several bits, and codes repeat only after [`TagLayout::codes`] frames.
    pub fn code(&self, position: usize) -> usize {
        // An odd multiplier permutes the codes; of all, this one sets neighbours furthest apart.
        position.wrapping_mul(13) % self.codes()
    }

    /// The frame with `code` in its patch, lit cells at the projector's code `level`.
    pub fn draw(&self, pattern: &Pattern, code: usize, level: u8) -> Pattern {
        let mut codes = pattern.codes.to_vec();
        for (i, bit) in self.bits.iter().enumerate() {
            let one = code >> i & 1 == 1;
            for (cell, lit) in bit.panel.into_iter().zip([one, !one]) {
                for v in cell.v0..cell.v0 + cell.height {
                    let row = v * pattern.width + cell.u0;
                    codes[row..row + cell.width].fill(if lit { level } else { 0 });
                }
            }
        }
        Pattern { codes: codes.into(), ..*pattern }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn built() -> Rig {
        Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap()
    }

    #[test]
    fn the_patch_lies_outside_of_all_that_the_mirrors_send_and_codes_are_equally_bright() {
        for text in
            [include_str!("../../optics/ghosh-2007-built.toml"), include_str!("../../optics/ghosh-2007-full.toml")]
        {
            let rig = Rig::from_toml(text).unwrap();
            let layout = TagLayout::of(&rig).unwrap();
            assert_eq!(layout.bits().len(), 6);
            let map = rig.projector_map();
            let blank = Pattern::full(rig.projector.width_px, rig.projector.height_px, 0);
            let lit = |code| layout.draw(&blank, code, 200).codes.iter().filter(|&&c| c == 200).count();
            let first = layout.draw(&blank, 0b101101, 200);
            for (p, _) in first.codes.iter().enumerate().filter(|(_, c)| **c > 0) {
                let (u, v) = ((p % blank.width) as f64 + 0.5, (p / blank.width) as f64 + 0.5);
                assert!(map.direction(u, v).is_none(), "({u}, {v}) meets the mirrors");
            }
            assert!((0..layout.codes()).all(|code| lit(code) == lit(0)));
        }
    }

    #[test]
    fn the_camera_sees_a_cell_where_its_rays_go() {
        let rig = built();
        let layout = TagLayout::of(&rig).unwrap();
        let (projector, camera) = (rig.projector.lens(), rig.camera.lens());
        for bit in layout.bits() {
            for (panel, sensor) in bit.panel.into_iter().zip(bit.sensor) {
                for (u, v) in sensor.pixels() {
                    let (pu, pv) = projector.pixel(&camera.ray(u as f64 + 0.5, v as f64 + 0.5));
                    let (du, dv) = (pu - panel.u0 as f64, pv - panel.v0 as f64);
                    let guard = 0.2 * panel.width as f64;
                    let inside = |x: f64| x > guard && x < panel.width as f64 - guard;
                    assert!(inside(du) && inside(dv));
                }
            }
        }
    }

    #[test]
    fn codes_of_neighbours_differ_and_none_returns_early() {
        let layout = TagLayout::of(&built()).unwrap();
        let n = layout.codes();
        for position in 0..2 * n {
            for lag in 1..n {
                let distance = (layout.code(position) ^ layout.code(position + lag)).count_ones();
                assert!(distance >= if lag < 4 { 3 } else { 1 }, "{position} + {lag}: {distance}");
            }
        }
    }

    #[test]
    fn rigs_without_room_have_no_patch() {
        let mut rig = built();
        rig.projector.width_px = 560;
        rig.projector.height_px = 560;
        assert_eq!(TagLayout::of(&rig), None);
    }
}
