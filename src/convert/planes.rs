//! One map for many cells: whole planes at a time, block by block.

use nalgebra::DMatrix;

use crate::basis::{Family, index, size};
use crate::geometry::ExitantGrid;
use crate::reduce::Coefficients;

/// Functions of all incident directions for every exitant cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Converted {
    /// Exitant directions.
    pub grid: ExitantGrid,
    /// Zonal order measured.
    pub zonal_order: usize,
    /// Name of the method.
    pub method: String,
    /// The functions.
    pub family: Family,
    /// Their order.
    pub sh_order: usize,
    /// Coefficients, linear RGB, 1/sr: index `(k * 3 + channel) * grid.len() + cell`.
    pub values: Vec<f32>,
    /// Standard errors, indexed alike.
    pub sigma: Vec<f32>,
    /// How much of each coefficient is data, 0..=1, indexed alike; the rest is what the method assumes.
    pub data_share: Vec<f32>,
    /// What was measured, with what.
    pub history: String,
}

/// What becomes of one coefficient in some neighbouring cells.
pub(super) struct Row<'a> {
    pub values: &'a mut [f32],
    pub sigma: &'a mut [f32],
    pub data_share: &'a mut [f32],
}

/// Planes cut into pieces of neighbouring cells, for tasks that share them out.
pub(super) struct Pieces<'a> {
    rows: Vec<Option<Row<'a>>>,
    per_plane: usize,
}

impl Converted {
    /// A result without values: zeros everywhere.
    pub(super) fn empty(coefficients: &Coefficients, method: &str, family: Family, sh_order: usize) -> Self {
        let n = size(sh_order) * 3 * coefficients.grid.len();
        Self {
            grid: coefficients.grid,
            zonal_order: coefficients.order,
            method: method.into(),
            family,
            sh_order,
            values: vec![0.0; n],
            sigma: vec![0.0; n],
            data_share: vec![0.0; n],
            history: coefficients.history.clone(),
        }
    }

    /// Its planes in pieces of `cells` cells, a divisor of the grid's.
    pub(super) fn pieces(&mut self, cells: usize) -> Pieces<'_> {
        let per_plane = self.grid.len() / cells;
        let pieces =
            self.values.chunks_mut(cells).zip(self.sigma.chunks_mut(cells)).zip(self.data_share.chunks_mut(cells));
        let rows = pieces.map(|((values, sigma), data_share)| Some(Row { values, sigma, data_share })).collect();
        Pieces { rows, per_plane }
    }
}

impl<'a> Pieces<'a> {
    /// The piece `at` of the functions (l, m) for `degrees` of one channel; each can be taken once.
    pub fn take(&mut self, degrees: &[usize], m: i32, channel: usize, at: usize) -> Vec<Row<'a>> {
        let place = |&l: &usize| (index(l, m) * 3 + channel) * self.per_plane + at;
        degrees.iter().map(|l| self.rows[place(l)].take().expect("taken once")).collect()
    }
}

/// Adds C z and the variance of it to rows of cells, `cells` the place of their first one: values and sigma hold sums so
/// far (of squares in sigma).
pub(super) fn add_product(
    coefficients: &Coefficients,
    matrix: &DMatrix<f64>,
    m: usize,
    sign: i32,
    channel: usize,
    first: usize,
    rows: &mut [Row<'_>],
) {
    /// Cells summed in double precision at a time.
    const CELLS: usize = 128;
    let planes: Vec<(&[f32], &[f32])> = (0..matrix.ncols())
        .map(|col| {
            let k = index(m + col, sign * m as i32);
            let at = (k * 3 + channel) * coefficients.grid.len() + first;
            (&coefficients.values[at..], &coefficients.sigma[at..])
        })
        .collect();
    for (i, row) in rows.iter_mut().enumerate() {
        let pieces = row.values.chunks_mut(CELLS).zip(row.sigma.chunks_mut(CELLS));
        for (at, (values, sigma)) in (0..).step_by(CELLS).zip(pieces) {
            let (mut sum, mut square) = ([0.0; CELLS], [0.0; CELLS]);
            for (col, (z, s)) in planes.iter().enumerate() {
                let c = matrix[(i, col)];
                for (((sum, square), z), s) in
                    sum.iter_mut().zip(&mut square).zip(&z[at..][..values.len()]).zip(&s[at..])
                {
                    *sum += c * f64::from(*z);
                    let part = c * f64::from(*s);
                    *square += part * part;
                }
            }
            for (value, sum) in values.iter_mut().zip(sum) {
                *value += sum as f32;
            }
            for (sigma, square) in sigma.iter_mut().zip(square) {
                *sigma += square as f32;
            }
        }
    }
}

/// Sums of squares to standard errors, and the share of data.
pub(super) fn finish(rows: &mut [Row<'_>], shares: &[f64]) {
    for (row, share) in rows.iter_mut().zip(shares) {
        row.sigma.iter_mut().for_each(|s| *s = s.sqrt());
        row.data_share.fill(share.clamp(0.0, 1.0) as f32);
    }
}
