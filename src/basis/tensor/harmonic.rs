//! Spherical harmonics on both sides.

use nalgebra::{DMatrix, DVector};

use super::{Tensor, TensorBlock, TensorError};
use crate::basis::{Conversion, index, lm, size};

/// Y_ab of F = sum over a, b of Y_ab Y_a(wi) Y_b(wo) in real spherical harmonics, of one channel, no unit.
#[derive(Debug, Clone, PartialEq)]
pub struct HarmonicTensor {
    /// SH order of incident directions.
    pub order: usize,
    /// SH order of exitant directions.
    pub exitant_order: usize,
    /// By |m|, up to the lower order, for isotropic samples, rows and columns l - |m|, the same for cosines and sines; else one matrix by index k.
    pub values: Vec<DMatrix<f64>>,
    /// Standard errors from the noise of cells, indexed alike.
    pub sigma: Vec<DMatrix<f64>>,
}

impl Tensor {
    /// Y = C T C^T with one conversion for each side, and its standard errors.
    ///
    /// # Errors
    /// [`TensorError::Orders`] if a conversion is of another zonal order.
    pub fn to_harmonics(&self, incident: &Conversion, exitant: &Conversion) -> Result<HarmonicTensor, TensorError> {
        let (tensor, conversions) = ([self.order, self.exitant_order], [incident.order, exitant.order]);
        if tensor != conversions {
            return Err(TensorError::Orders { tensor, conversions });
        }
        let (order, exitant_order) = (incident.sh_order, exitant.sh_order);
        let rows = |m: usize, order: usize| -> Vec<usize> {
            if self.isotropic { (m..=order).map(|l| index(l, m as i32)).collect() } else { (0..size(order)).collect() }
        };
        let blocks: Vec<(DMatrix<f64>, DMatrix<f64>)> = self
            .blocks
            .iter()
            .enumerate()
            .map(|(m, block)| {
                let left = matrix(incident, &rows(m, order), &block.incident);
                let right = matrix(exitant, &rows(m, exitant_order), &block.exitant);
                let sigma = DMatrix::from_fn(left.nrows(), right.nrows(), |a, b| {
                    variance(block, &left.row(a).transpose(), &right.row(b).transpose()).sqrt()
                });
                (&left * block.estimate() * right.transpose(), sigma)
            })
            .collect();
        let (mut values, mut sigma): (Vec<_>, Vec<_>) = blocks.into_iter().unzip();
        if self.isotropic {
            // Harmonics of higher |m| than was measured have no partners.
            for m in values.len()..=order.min(exitant_order) {
                let nothing = DMatrix::zeros(order - m + 1, exitant_order - m + 1);
                values.push(nothing.clone());
                sigma.push(nothing);
            }
        }
        Ok(HarmonicTensor { order, exitant_order, values, sigma })
    }
}

/// C with the given SH rows and zonal columns, indices k.
fn matrix(conversion: &Conversion, rows: &[usize], columns: &[usize]) -> DMatrix<f64> {
    DMatrix::from_fn(rows.len(), columns.len(), |i, j| {
        let ((l, m), (zonal, other)) = (lm(rows[i]), lm(columns[j]));
        let m_abs = m.unsigned_abs() as usize;
        let block = conversion.blocks.iter().find(|b| m == other && b.m == m_abs);
        block
            .and_then(|b| b.degrees.iter().position(|&d| d == l).map(|row| b.matrix[(row, zonal - m_abs)]))
            .unwrap_or(0.0)
    })
}

/// The variance of sum over k, j of `left`_k S_kj `right`_j, S the block's estimate: each measured T_kj stands in S_kj with
/// its share and in S_jk with the share that is left there.
fn variance(block: &TensorBlock, left: &DVector<f64>, right: &DVector<f64>) -> f64 {
    let used = |v: &DVector<f64>| (0..v.len()).filter(|&i| v[i] != 0.0).collect::<Vec<_>>();
    let (in_left, in_right) = (used(left), used(right));
    let n = block.common();
    let mut rows: Vec<usize> = in_left.iter().chain(in_right.iter().filter(|&&k| k < n)).copied().collect();
    let mut columns: Vec<usize> = in_right.iter().chain(in_left.iter().filter(|&&j| j < n)).copied().collect();
    for list in [&mut rows, &mut columns] {
        list.sort_unstable();
        list.dedup();
    }
    let mut sum = 0.0;
    for &k in &rows {
        let weight = |j: usize| {
            let own = block.shares[(k, j)] * left[k] * right[j];
            if k < n && j < n { own + (1.0 - block.shares[(j, k)]) * left[j] * right[k] } else { own }
        };
        let weights: Vec<f64> = columns.iter().map(|&j| weight(j)).collect();
        for (a, &i) in columns.iter().enumerate() {
            for (b, &j) in columns.iter().enumerate() {
                sum += weights[a] * weights[b] * block.covariance[k][(i, j)];
            }
        }
    }
    sum
}
