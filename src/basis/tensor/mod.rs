//! Reflectance expanded on both sides: incident and exitant directions alike.
//!
//! `T_kj = integral over the zone of Z_j(wo) cos(theta_o) z_k(wo) dwo`, with `z_k(wo) = integral Z_k(wi) f cos(theta_i) dwi`:
//! the coefficients of `F(wi, wo) = f cos(theta_i) cos(theta_o)`. With both cosines, a reciprocal f (f(wi, wo) = f(wo, wi))
//! has a symmetric tensor. Of isotropic samples only equal m couple, cosines and sines alike: one block for each m.

mod chi2;
mod harmonic;
mod reciprocity;
mod rings;
mod shifts;
#[cfg(test)]
mod tests;

use nalgebra::DMatrix;
use thiserror::Error;

use super::harmonics::{OrderError, index, size};

pub use harmonic::HarmonicTensor;
pub use reciprocity::{RECIPROCAL_P, Reciprocity, reciprocity};
pub use rings::ExitantRule;
pub use shifts::{edge_shift, rotation_shift};

/// Why there is no tensor, or none of the kind asked for.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum TensorError {
    /// The order is out of range.
    #[error(transparent)]
    Order(#[from] OrderError),
    /// The exitant grid is too coarse for the order.
    #[error(
        "{rings} rings and {sectors} sectors are too few for exitant order {order}, which needs more than {order} and more \
         than {}: ask for more in the plan, or for a lower order", 2 * order
    )]
    Grid {
        /// Rings.
        rings: usize,
        /// Sectors.
        sectors: usize,
        /// Exitant order.
        order: usize,
    },
    /// Some cells hold no data, and integrals over exitant directions need all of them.
    #[error(
        "{missing} of {cells} exitant cells hold no data, the first at ring {ring}, sector {sector}: measure with shorter \
         exposures or fewer exitant.rings and exitant.sectors, or convert incident directions alone"
    )]
    Missing {
        /// Cells without a value or a standard error in some function or channel.
        missing: usize,
        /// Cells of the grid.
        cells: usize,
        /// Ring of the first one.
        ring: usize,
        /// Sector of the first one.
        sector: usize,
    },
    /// Without noise nothing says how much asymmetry is too much.
    #[error(
        "the standard errors of the coefficients vanish or are no numbers: reciprocity cannot be tested; reduce again"
    )]
    NoNoise,
    /// Reciprocity was asked for where the data contradict it.
    #[error(
        "the sample is not reciprocal: {:.2}% of the signal is antisymmetric, {:.2}% would be expected of noise and \
         calibration (p = {p:.1e}): use `--reciprocity auto` or `ignore`, or `--force` to impose it all the same",
        100.0 * violation,
        100.0 * expected
    )]
    NotReciprocal {
        /// As [`Reciprocity::violation`].
        violation: f64,
        /// As [`Reciprocity::expected`].
        expected: f64,
        /// As [`Reciprocity::p`].
        p: f64,
    },
    /// Conversions of other orders than the tensor's.
    #[error(
        "the tensor has orders {tensor:?} (incident, exitant), the conversions {conversions:?}: use those of its orders"
    )]
    Orders {
        /// Of the tensor.
        tensor: [usize; 2],
        /// Of the conversions.
        conversions: [usize; 2],
    },
}

/// Zonal coefficients of F = f cos(theta_i) cos(theta_o) on both sides, of one channel, no unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Zonal order of incident directions.
    pub order: usize,
    /// Zonal order of exitant directions.
    pub exitant_order: usize,
    /// Whether only equal m couple: one block for each |m|, else a single block of all functions.
    pub isotropic: bool,
    /// The blocks, ascending in |m|.
    pub blocks: Vec<TensorBlock>,
    /// Errors that cells share: for each independent source the change of every block by one standard deviation.
    pub systematic: Vec<Vec<DMatrix<f64>>>,
    /// By block, what the rule over exitant directions may be off by, entry by entry.
    pub rule_error: Vec<DMatrix<f64>>,
    /// What else may be wrong with the rig, relative: small independent matrices E and E' of norm `rig_error` mix functions
    /// on either side, T + E T + T E'. 0 unless set.
    pub rig_error: f64,
    reciprocal: bool,
}

/// Entries of a tensor that belong together.
#[derive(Debug, Clone, PartialEq)]
pub struct TensorBlock {
    /// Incident functions, index k; of an isotropic block those with m >= 0, which stand for -m too.
    pub incident: Vec<usize>,
    /// Exitant functions, index j.
    pub exitant: Vec<usize>,
    /// How often the block stands in the whole tensor: 2 for +-m, else 1.
    pub copies: usize,
    /// Measured T_kj: rows follow `incident`, columns `exitant`.
    pub values: DMatrix<f64>,
    /// By row, the covariance of its entries from the noise of cells; rows are independent.
    pub covariance: Vec<DMatrix<f64>>,
    /// The share a_kj of the measured T_kj in the estimate a_kj T_kj + (1 - a_kj) T_jk: 1 until reciprocity is imposed.
    pub shares: DMatrix<f64>,
}

impl Tensor {
    /// Projects exitant directions: `plane(k)` are z_k in all cells of the rule's grid, `variance(k)` their variances.
    ///
    /// `isotropic` averages +-m and leaves out what couples different m.
    ///
    /// # Errors
    /// [`TensorError::Order`].
    pub fn project(
        rule: &ExitantRule,
        order: usize,
        isotropic: bool,
        plane: impl Fn(usize) -> Vec<f64>,
        variance: impl Fn(usize) -> Vec<f64>,
    ) -> Result<Self, TensorError> {
        if order > super::MAX_ORDER {
            return Err(OrderError(order).into());
        }
        let mut tensor = Self::empty(order, rule.order(), isotropic);
        tensor.fill(rule, plane);
        for block in &mut tensor.blocks {
            let of = |k: usize, functions: &[usize]| rule.covariance(&variance(k), functions);
            let row = |&k: &usize| match partner(k) {
                Some(sine) if isotropic => {
                    let sines: Vec<usize> = block.exitant.iter().filter_map(|&j| partner(j)).collect();
                    (of(k, &block.exitant) + of(sine, &sines)) / 4.0
                }
                _ => of(k, &block.exitant),
            };
            block.covariance = block.incident.iter().map(row).collect();
        }
        Ok(tensor)
    }

    /// Takes the difference to the tensor `rough` of a coarser rule as the error of the rule.
    ///
    /// # Panics
    /// If the two are of different orders or kinds.
    pub fn set_rule_error(&mut self, rough: &Self) {
        self.rule_error = self.blocks.iter().zip(&rough.blocks).map(|(a, b)| &a.values - &b.values).collect();
    }

    /// Adds a source of systematic errors: `plane(k)` is what one standard deviation adds to z_k in all cells.
    pub fn add_systematic(&mut self, rule: &ExitantRule, plane: impl Fn(usize) -> Vec<f64>) {
        let mut change = Self::empty(self.order, self.exitant_order, self.isotropic);
        change.fill(rule, plane);
        self.systematic.push(change.blocks.into_iter().map(|b| b.values).collect());
    }

    /// Adds a source of systematic errors that changes coefficients of incident directions by `shift` z: [`edge_shift`],
    /// [`rotation_shift`]. A full tensor takes any, one of an isotropic sample what couples equal m.
    ///
    /// # Panics
    /// If `shift` is smaller than the incident functions.
    pub fn add_shift(&mut self, shift: &DMatrix<f64>) {
        let of = |block: &TensorBlock| {
            let n = block.incident.len();
            DMatrix::from_fn(n, n, |i, j| shift[(block.incident[i], block.incident[j])]) * &block.values
        };
        self.systematic.push(self.blocks.iter().map(of).collect());
    }

    fn empty(order: usize, exitant_order: usize, isotropic: bool) -> Self {
        let block = |incident: Vec<usize>, exitant: Vec<usize>, copies| {
            let (n, columns) = (incident.len(), exitant.len());
            TensorBlock {
                values: DMatrix::zeros(n, columns),
                covariance: vec![DMatrix::zeros(columns, columns); n],
                shares: DMatrix::from_element(n, columns, 1.0),
                incident,
                exitant,
                copies,
            }
        };
        let of = |m: usize, order: usize| (m..=order).map(|l| index(l, m as i32)).collect();
        let blocks = if isotropic {
            (0..=order.min(exitant_order))
                .map(|m| block(of(m, order), of(m, exitant_order), if m == 0 { 1 } else { 2 }))
                .collect()
        } else {
            vec![block((0..size(order)).collect(), (0..size(exitant_order)).collect(), 1)]
        };
        let rule_error = blocks.iter().map(|b: &TensorBlock| b.values.clone()).collect();
        Self {
            order,
            exitant_order,
            isotropic,
            blocks,
            systematic: Vec::new(),
            rule_error,
            rig_error: 0.0,
            reciprocal: false,
        }
    }

    fn fill(&mut self, rule: &ExitantRule, plane: impl Fn(usize) -> Vec<f64>) {
        for block in &mut self.blocks {
            for (row, &k) in block.incident.iter().enumerate() {
                let integrals = rule.project(&plane(k));
                let sines = partner(k).filter(|_| self.isotropic).map(|k| rule.project(&plane(k)));
                for (column, &j) in block.exitant.iter().enumerate() {
                    block.values[(row, column)] = match (&sines, partner(j)) {
                        (Some(sines), Some(sine)) => (integrals[j] + sines[sine]) / 2.0,
                        _ => integrals[j],
                    };
                }
            }
        }
    }

    /// RMS standard error of the entries, over the magnitude of T_00.
    pub fn noise_rel(&self) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        for block in &self.blocks {
            sum += block.copies as f64 * block.variance().sum();
            count += block.copies * block.values.len();
        }
        (sum / count as f64).sqrt() / self.blocks[0].values[(0, 0)].abs()
    }
}

impl TensorBlock {
    /// The estimate of every entry: the measured values, symmetric once reciprocity is imposed.
    pub fn estimate(&self) -> DMatrix<f64> {
        DMatrix::from_fn(self.incident.len(), self.exitant.len(), |k, j| {
            let share = self.shares[(k, j)];
            let other = if share < 1.0 { (1.0 - share) * self.values[(j, k)] } else { 0.0 };
            share * self.values[(k, j)] + other
        })
    }

    /// Variances of [`TensorBlock::estimate`] from the noise of cells.
    pub fn variance(&self) -> DMatrix<f64> {
        DMatrix::from_fn(self.incident.len(), self.exitant.len(), |k, j| {
            let share = self.shares[(k, j)];
            let other = if share < 1.0 { (1.0 - share).powi(2) * self.covariance[j][(k, k)] } else { 0.0 };
            share * share * self.covariance[k][(j, j)] + other
        })
    }

    /// Number of functions on both sides: the leading square of a block can be symmetric.
    fn common(&self) -> usize {
        self.incident.len().min(self.exitant.len())
    }
}

/// The function with -m, where m > 0.
fn partner(k: usize) -> Option<usize> {
    let (l, m) = super::lm(k);
    (m > 0).then(|| index(l, -m))
}
