//! The light of patterns, tabulated for sums over many directions.

use rayon::prelude::*;

/// Patterns are summed in blocks of this many: their sums stay in registers.
pub(super) const BLOCK: usize = 8;
/// Panel pixels along each side of a pixel of the coarse table: about a degree.
const COARSE: usize = 3;

/// Light of every projector pixel in each of several patterns, in units of full white.
pub struct PatternLight {
    width: usize,
    height: usize,
    origin: [usize; 2],
    /// Pixels of this table along a panel pixel: at most 1.
    per_pixel: f32,
    /// Number of patterns.
    pub(super) patterns: usize,
    /// `[block][pixel][pattern in block]`
    pub(super) blocks: Vec<Vec<[f32; BLOCK]>>,
}

impl PatternLight {
    /// Tabulates `light(pattern, column, row)` over a region of the panel: its first column and row, and its size.
    pub fn new(
        origin: [usize; 2],
        size: [usize; 2],
        patterns: usize,
        light: impl Fn(usize, usize, usize) -> f32 + Sync,
    ) -> Self {
        let [width, height] = size;
        let value = |block: usize, p: usize, i: usize| {
            let pattern = block * BLOCK + i;
            if pattern < patterns { light(pattern, origin[0] + p % width, origin[1] + p / width) } else { 0.0 }
        };
        let blocks = (0..patterns.div_ceil(BLOCK))
            .into_par_iter()
            .map(|block| (0..width * height).map(|p| std::array::from_fn(|i| value(block, p, i))).collect())
            .collect();
        Self { width, height, origin, per_pixel: 1.0, patterns, blocks }
    }

    /// The same light in means over `COARSE` x `COARSE` pixels: enough for what varies slowly, and small enough for a
    /// core's own cache.
    pub(super) fn coarsened(&self) -> Self {
        let (width, height) = (self.width / COARSE, self.height / COARSE);
        let mean = |pixels: &[[f32; BLOCK]], p: usize, i: usize| {
            let corner = p / width * COARSE * self.width + p % width * COARSE;
            let rows = (0..COARSE).map(|row| corner + row * self.width);
            let sum: f32 = rows.flat_map(|row| &pixels[row..row + COARSE]).map(|block| block[i]).sum();
            sum / (COARSE * COARSE) as f32
        };
        let coarsen = |pixels: &Vec<[f32; BLOCK]>| {
            (0..width * height).map(|p| std::array::from_fn(|i| mean(pixels, p, i))).collect()
        };
        let blocks = self.blocks.par_iter().map(coarsen).collect();
        Self { width, height, per_pixel: self.per_pixel / COARSE as f32, blocks, ..*self }
    }

    /// The pixel at a point of the panel; `None` beyond the region.
    #[inline]
    pub(super) fn pixel(&self, u: f32, v: f32) -> Option<u32> {
        let at = |u: f32, origin: usize| (u - origin as f32) * self.per_pixel;
        let (x, y) = (at(u, self.origin[0]), at(v, self.origin[1]));
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32;
        // Signed: what processors convert to in one step.
        inside.then(|| (y as i32 * self.width as i32 + x as i32) as u32)
    }
}
