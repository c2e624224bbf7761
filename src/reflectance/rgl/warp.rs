//! Tables over the unit square, interpolated bilinearly within a slice and linearly between slices.

/// Slices and their weights: what interpolation in up to two parameters needs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Taps {
    taps: [(usize, f64); 4],
    count: usize,
}

impl Taps {
    /// The one slice of a table without parameters.
    pub const SINGLE: Self = Self { taps: [(0, 1.0); 4], count: 1 };

    /// The slices around a point of the grid `outer` x `inner` (both ascending, not empty), clamped to it.
    pub fn between(outer: &[f64], inner: &[f64], at_outer: f64, at_inner: f64) -> Self {
        let (j, v) = interval(inner, at_inner);
        if outer.len() == 1 {
            let taps = [(j, 1.0 - v), ((j + 1).min(inner.len() - 1), v), (0, 0.0), (0, 0.0)];
            return Self { taps, count: 2 };
        }
        let (i, u) = interval(outer, at_outer);
        let slice = |i: usize, j: usize| i.min(outer.len() - 1) * inner.len() + j.min(inner.len() - 1);
        let taps = [
            (slice(i, j), (1.0 - u) * (1.0 - v)),
            (slice(i, j + 1), (1.0 - u) * v),
            (slice(i + 1, j), u * (1.0 - v)),
            (slice(i + 1, j + 1), u * v),
        ];
        Self { taps, count: 4 }
    }

    fn iter(&self) -> impl Iterator<Item = (usize, f64)> {
        self.taps[..self.count].iter().copied()
    }
}

/// Index of the node left of `x` and the position between it and the next, 0..=1.
fn interval(nodes: &[f64], x: f64) -> (usize, f64) {
    if nodes.len() < 2 {
        return (0, 0.0);
    }
    let left = nodes.partition_point(|&node| node < x).clamp(1, nodes.len() - 1) - 1;
    (left, ((x - nodes[left]) / (nodes[left + 1] - nodes[left])).clamp(0.0, 1.0))
}

/// Index of the patch that holds `u` in 0..=1, and the position in it, for `nodes` >= 2 nodes.
fn patch(u: f64, nodes: usize) -> (usize, f64) {
    let x = u.clamp(0.0, 1.0) * (nodes - 1) as f64;
    let i = (x as usize).min(nodes - 2);
    (i, x - i as f64)
}

/// Where in a unit cell, over which a density runs linearly from `a` to `b`, its integral reaches `part`.
fn share_of_cell(a: f64, b: f64, part: f64) -> f64 {
    // The root of a t + (b - a) t^2 / 2 = part in the form that survives a = b.
    let root = (a * a + 2.0 * (b - a) * part).max(0.0).sqrt();
    if a + root > 0.0 { (2.0 * part / (a + root)).clamp(0.0, 1.0) } else { 0.0 }
}

fn lerp(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// Slices of `height` x `width` nodes with `C` values each; the nodes span the unit square, edges included.
#[derive(Debug, Clone)]
pub(crate) struct Table<const C: usize> {
    width: usize,
    height: usize,
    nodes: Vec<[f32; C]>,
}

impl<const C: usize> Table<C> {
    /// A table from its nodes, slice by slice and row by row; at least 2 x 2 nodes per slice.
    pub fn new(width: usize, height: usize, nodes: Vec<[f32; C]>) -> Self {
        debug_assert!(width >= 2 && height >= 2 && nodes.len().is_multiple_of(width * height));
        Self { width, height, nodes }
    }

    /// The corners (x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1), each interpolated between the slices.
    fn corners(&self, taps: &Taps, x: usize, y: usize) -> [[f64; C]; 4] {
        let mut corners = [[0.0; C]; 4];
        for (slice, weight) in taps.iter() {
            let first = (slice * self.height + y) * self.width + x;
            for (corner, at) in corners.iter_mut().zip([0, 1, self.width, self.width + 1]) {
                corner.iter_mut().zip(self.nodes[first + at]).for_each(|(sum, v)| *sum += weight * f64::from(v));
            }
        }
        corners
    }

    /// The values at (u, v).
    pub fn at(&self, taps: &Taps, u: f64, v: f64) -> [f64; C] {
        let ((x, fx), (y, fy)) = (patch(u, self.width), patch(v, self.height));
        let [p00, p10, p01, p11] = self.corners(taps, x, y);
        std::array::from_fn(|c| lerp(lerp(p00[c], p10[c], fx), lerp(p01[c], p11[c], fx), fy))
    }
}

/// A bilinear density per slice that can be flattened: the inverse of the warp that samples it.
#[derive(Debug, Clone)]
pub(crate) struct Flattening {
    /// Density, and its integral along the row up to the node.
    density: Table<2>,
    /// Per slice and row: the integral of the row, and of all rows before it.
    rows: Vec<[f32; 2]>,
}

impl Flattening {
    /// From densities >= 0, slice by slice, each slice of `height` x `width` nodes (at least 2 x 2), scaled here to
    /// integrate to 1. `Err` is the index of the first slice that is 0 everywhere.
    pub fn new(width: usize, height: usize, densities: &[f32]) -> Result<Self, usize> {
        let (dx, dy) = (1.0 / (width - 1) as f64, 1.0 / (height - 1) as f64);
        let mut nodes = Vec::with_capacity(densities.len());
        let mut rows = Vec::with_capacity(densities.len() / width);
        let trapezoid = |a: f64, b: f64| 0.5 * (a + b);
        for (index, slice) in densities.chunks_exact(width * height).enumerate() {
            let totals: Vec<f64> = slice
                .chunks_exact(width)
                .map(|row| row.windows(2).map(|p| dx * trapezoid(p[0].into(), p[1].into())).sum())
                .collect();
            let total: f64 = totals.windows(2).map(|p| dy * trapezoid(p[0], p[1])).sum();
            if total <= 0.0 {
                return Err(index);
            }
            let mut before = 0.0;
            for (y, row) in slice.chunks_exact(width).enumerate() {
                rows.push([(totals[y] / total) as f32, (before / total) as f32]);
                before += totals.get(y + 1).map_or(0.0, |next| dy * trapezoid(totals[y], *next));
                let mut along = 0.0;
                for (x, &v) in row.iter().enumerate() {
                    nodes.push([(f64::from(v) / total) as f32, (along / total) as f32]);
                    along += row.get(x + 1).map_or(0.0, |&next| dx * trapezoid(v.into(), next.into()));
                }
            }
        }
        Ok(Self { density: Table::new(width, height, nodes), rows })
    }

    /// The point of the unit square that the warp moves to (u, v); coordinates without density become 0.
    pub fn flatten(&self, taps: &Taps, u: f64, v: f64) -> (f64, f64) {
        let (width, height) = (self.density.width, self.density.height);
        let ((x, fx), (y, fy)) = (patch(u, width), patch(v, height));
        let [p00, p10, p01, p11] = self.density.corners(taps, x, y);
        let (mut row, mut next, mut before) = (0.0, 0.0, 0.0);
        for (slice, weight) in taps.iter() {
            let first = slice * height + y;
            row += weight * f64::from(self.rows[first][0]);
            next += weight * f64::from(self.rows[first + 1][0]);
            before += weight * f64::from(self.rows[first][1]);
        }
        // The integral of a linear function over the first part of a cell.
        let part = |a: f64, b: f64, t: f64, nodes: usize| t * (a + 0.5 * t * (b - a)) / (nodes - 1) as f64;
        let (left, right) = (lerp(p00[0], p01[0], fy), lerp(p10[0], p11[0], fy));
        let along = lerp(p00[1], p01[1], fy) + part(left, right, fx, width);
        let row_total = lerp(row, next, fy);
        let flat_u = if row_total > 0.0 { along / row_total } else { 0.0 };
        (flat_u, before + part(row, next, fy, height))
    }

    /// The point (u, v) that [`Flattening::flatten`] moves to (s, t), in the first slice: how samples are drawn.
    pub fn unflatten(&self, s: f64, t: f64) -> (f64, f64) {
        let (width, height) = (self.density.width, self.density.height);
        let rows: &[[f32; 2]] = &self.rows[..height];
        let row = |y: usize| rows[y].map(f64::from);
        let y = rows[1..height - 1].partition_point(|row| f64::from(row[1]) <= t);
        let fy = share_of_cell(row(y)[0], row(y + 1)[0], (t - row(y)[1]) * (height - 1) as f64);
        let total = lerp(row(y)[0], row(y + 1)[0], fy);

        let nodes = &self.density.nodes[y * width..][..2 * width];
        let node = |x: usize, i: usize| lerp(nodes[x][i].into(), nodes[x + width][i].into(), fy);
        // Which cell of the row holds the point: integrals along the row ascend.
        let (mut x, mut end) = (0, width - 1);
        while end - x > 1 {
            let middle = (x + end) / 2;
            if node(middle, 1) <= s * total { x = middle } else { end = middle }
        }
        let fx = share_of_cell(node(x, 0), node(x + 1, 0), (s * total - node(x, 1)) * (width - 1) as f64);
        ((x as f64 + fx) / (width - 1) as f64, (y as f64 + fy) / (height - 1) as f64)
    }
}
