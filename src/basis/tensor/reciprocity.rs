//! Is a measured tensor symmetric, and what does it gain if it must be?

use nalgebra::{DMatrix, DVector};

use super::{Tensor, TensorError, chi2};
use crate::basis::lm;

/// Reciprocity holds where chance alone would leave a larger asymmetry with at least this probability.
pub const RECIPROCAL_P: f64 = 0.01;

/// Pairs of functions tested at most, for the memory and time of their covariance; those of the highest degrees are left out.
const MAX_PAIRS: usize = 1500;

/// How far a tensor is from symmetry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reciprocity {
    /// ||T - T^T|| / ||T||, Frobenius norms over all entries with a counterpart, all channels.
    pub violation: f64,
    /// What noise and systematic errors alone would leave of it, RMS.
    pub expected: f64,
    /// Squared asymmetry in units of its covariance.
    pub chi2: f64,
    /// Pairs of entries tested.
    pub freedom: usize,
    /// Probability of a larger `chi2` if the sample is reciprocal.
    pub p: f64,
}

impl Reciprocity {
    /// Whether the data allow the sample to be reciprocal: p >= [`RECIPROCAL_P`].
    pub fn holds(&self) -> bool {
        self.p >= RECIPROCAL_P
    }

    /// Applies the rule that reciprocity is imposed on no data that contradict it.
    ///
    /// # Errors
    /// [`TensorError::NotReciprocal`] unless [`Reciprocity::holds`].
    pub fn check(&self) -> Result<(), TensorError> {
        if self.holds() {
            return Ok(());
        }
        Err(TensorError::NotReciprocal { violation: self.violation, expected: self.expected, p: self.p })
    }
}

/// Tests the antisymmetric part T_kj - T_jk of all channels against the noise of cells, which all j of one k share, and
/// against each tensor's systematic errors.
///
/// # Errors
/// [`TensorError::NoNoise`].
pub fn reciprocity(channels: &[Tensor]) -> Result<Reciprocity, TensorError> {
    let (mut asymmetry, mut power, mut expected, mut total, mut freedom) = (0.0, 0.0, 0.0, 0.0, 0);
    for tensor in channels {
        let pairs = pairs(tensor);
        for block in &tensor.blocks {
            let n = block.common();
            let square = block.values.view((0, 0), (n, n));
            asymmetry += block.copies as f64 * (square - square.transpose()).norm_squared();
            power += block.copies as f64 * square.norm_squared();
        }
        let d = differences(&pairs, tensor.blocks.iter().map(|b| &b.values));
        let covariance = covariance(tensor, &pairs);
        // Each pair stands twice in the norm.
        expected += pairs
            .iter()
            .enumerate()
            .map(|(i, p)| 2.0 * tensor.blocks[p.block].copies as f64 * covariance[(i, i)])
            .sum::<f64>();
        if !pairs.is_empty() {
            let factor = scaled_cholesky(covariance).ok_or(TensorError::NoNoise)?;
            total += factor.0.component_mul(&d).dot(&factor.1.solve(&factor.0.component_mul(&d)));
        }
        freedom += pairs.len();
    }
    let p = if freedom == 0 { 1.0 } else { chi2::tail(freedom, total) };
    Ok(Reciprocity {
        violation: (asymmetry / power).sqrt(),
        expected: (expected / power).sqrt(),
        chi2: total,
        freedom,
        p,
    })
}

impl Tensor {
    /// Whether reciprocity was imposed.
    pub fn is_symmetric(&self) -> bool {
        self.reciprocal
    }

    /// Makes the estimate symmetric, each pair weighted by inverse variance, and returns the total variance of the entries
    /// before over that after.
    pub fn impose_reciprocity(&mut self) -> f64 {
        let (mut before, mut after) = (0.0, 0.0);
        for block in &mut self.blocks {
            before += block.copies as f64 * block.variance().sum();
            let n = block.common();
            for k in 0..n {
                for j in (0..n).filter(|&j| j != k) {
                    let (own, other) = (block.covariance[k][(j, j)], block.covariance[j][(k, k)]);
                    block.shares[(k, j)] = if own + other > 0.0 { other / (own + other) } else { 0.5 };
                }
            }
            after += block.copies as f64 * block.variance().sum();
        }
        self.reciprocal = true;
        if after > 0.0 { before / after } else { 1.0 }
    }
}

/// One entry above the diagonal and its counterpart: positions in a block, `k < j`.
#[derive(Clone, Copy)]
struct Pair {
    block: usize,
    k: usize,
    j: usize,
}

impl Pair {
    /// T_kj - T_jk.
    fn of(&self, values: &DMatrix<f64>) -> f64 {
        values[(self.k, self.j)] - values[(self.j, self.k)]
    }
}

impl Pair {
    /// Variance of E T + T E' in this pair for matrices of norm 1, their power spread evenly over each row.
    fn mixed(&self, values: &DMatrix<f64>) -> f64 {
        let of = |i: usize| {
            values.row(i).norm_squared() / values.ncols() as f64
                + values.column(i).norm_squared() / values.nrows() as f64
        };
        of(self.k) + of(self.j)
    }
}

fn pairs(tensor: &Tensor) -> Vec<Pair> {
    let up_to = |order: usize| {
        let mut pairs = Vec::new();
        for (block, of) in tensor.blocks.iter().enumerate() {
            let n = of.incident[..of.common()].iter().filter(|&&k| lm(k).0 <= order).count();
            pairs.extend((0..n).flat_map(|k| (k + 1..n).map(move |j| Pair { block, k, j })));
        }
        pairs
    };
    let orders = (0..=tensor.order.min(tensor.exitant_order)).rev();
    orders.map(up_to).find(|pairs| pairs.len() <= MAX_PAIRS).unwrap_or_default()
}

/// T_kj - T_jk of every pair.
fn differences<'a>(pairs: &[Pair], blocks: impl Iterator<Item = &'a DMatrix<f64>>) -> DVector<f64> {
    let blocks: Vec<_> = blocks.collect();
    DVector::from_iterator(pairs.len(), pairs.iter().map(|p| p.of(blocks[p.block])))
}

/// Covariance of all T_kj - T_jk from every source of error.
fn covariance(tensor: &Tensor, pairs: &[Pair]) -> DMatrix<f64> {
    let mut covariance = noise(tensor, pairs);
    for source in &tensor.systematic {
        let shift = differences(pairs, source.iter());
        covariance.ger(1.0, &shift, &shift, 1.0);
    }
    // Lobes narrower than a ring are aliased, each entry in its own way.
    let rule = differences(pairs, tensor.rule_error.iter());
    for (i, pair) in pairs.iter().enumerate() {
        covariance[(i, i)] +=
            rule[i].powi(2) + tensor.rig_error.powi(2) * pair.mixed(&tensor.blocks[pair.block].values);
    }
    covariance
}

/// Covariance of all T_kj - T_jk from the noise of cells: entries of one row share it, rows do not.
fn noise(tensor: &Tensor, pairs: &[Pair]) -> DMatrix<f64> {
    DMatrix::from_fn(pairs.len(), pairs.len(), |a, b| {
        let (p, q) = (&pairs[a], &pairs[b]);
        if p.block != q.block {
            return 0.0;
        }
        let of = |row: usize| &tensor.blocks[p.block].covariance[row];
        let mut sum = 0.0;
        if p.k == q.k {
            sum += of(p.k)[(p.j, q.j)];
        }
        if p.j == q.j {
            sum += of(p.j)[(p.k, q.k)];
        }
        if p.k == q.j {
            sum -= of(p.k)[(p.j, q.k)];
        }
        if p.j == q.k {
            sum -= of(p.j)[(p.k, q.j)];
        }
        sum
    })
}

type Factor = (DVector<f64>, nalgebra::Cholesky<f64, nalgebra::Dyn>);

/// 1 / standard deviations and the factor of the correlations; None if a variance vanishes.
fn scaled_cholesky(covariance: DMatrix<f64>) -> Option<Factor> {
    let scale = covariance.diagonal().map(|v| 1.0 / v.sqrt());
    if !scale.iter().all(|s| s.is_finite()) {
        return None;
    }
    let n = scale.len();
    let correlation = DMatrix::from_fn(n, n, |i, j| covariance[(i, j)] * scale[i] * scale[j]);
    Some((scale, correlation.cholesky()?))
}
