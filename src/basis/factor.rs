//! Decompositions of the zone's Gram matrices, one small block per m, kept for the next caller.

use std::collections::HashMap;
use std::f64::consts::PI;
use std::sync::{Arc, LazyLock, Mutex};

use nalgebra::{DMatrix, DVector};

use super::conversion::ConversionError;
use super::family::Family;
use super::harmonics::Harmonics;
use super::jacobi::{Svd, svd};
use crate::geometry::Zone;
use crate::geometry::quadrature::zone_mu_angular;

/// Nodes in mu: exact to rounding for the products met up to order 50.
const NODES: usize = 160;
/// Weight of what is not held down; small enough to be nothing, large enough to divide by.
const FREE: f64 = 1e-6;
/// Decompositions kept; beyond this many all are dropped.
const KEPT: usize = 256;

/// One azimuthal order of a family against the zonal functions of a zone.
///
/// With W the family's and Z the zonal functions at quadrature nodes of the zone times sqrt(weight), the Gram matrix is
/// W^T W. The decomposition is of W D^-1, where D weighs degrees: its singular values have the square root of the Gram
/// matrix's range.
#[derive(Debug)]
pub(super) struct Factor {
    /// |m|.
    pub m: usize,
    /// Degrees l of the family's functions.
    pub degrees: Vec<usize>,
    /// Diagonal of D^-1.
    pub inverse_weights: DVector<f64>,
    /// Singular values of W D^-1, descending.
    pub s: DVector<f64>,
    /// Its right singular vectors.
    pub v: DMatrix<f64>,
    /// U^T Z: what the zonal functions |m|..=L are along the left singular vectors.
    pub projected: DMatrix<f64>,
    /// Condition number of W^T W.
    pub condition: f64,
}

impl Factor {
    /// A = Z^T W: zonal coefficients of the family's functions; rows are the zonal degrees |m|..=L.
    pub fn forward(&self) -> DMatrix<f64> {
        let mut a = self.projected.transpose() * DMatrix::from_diagonal(&self.s) * self.v.transpose();
        for (mut column, w) in a.column_iter_mut().zip(self.inverse_weights.iter()) {
            column /= *w;
        }
        a
    }
}

/// What a set of blocks belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Key {
    theta: [u64; 2],
    /// Zonal order.
    pub order: usize,
    pub family: Family,
    /// Order of the family's functions.
    pub sh_order: usize,
    /// Whether D = l (l + 1) - 2, the curvature of a function beyond that of a cosine; else 1.
    pub curvature: bool,
}

impl Key {
    pub fn new(zone: &Zone, order: usize, family: Family, sh_order: usize, curvature: bool) -> Self {
        Self { theta: [zone.theta_min().to_bits(), zone.theta_max().to_bits()], order, family, sh_order, curvature }
    }
}

/// The blocks m = 0..=order of `key` over `zone`, those without functions left out.
///
/// # Errors
/// [`ConversionError::Order`] or [`ConversionError::Decomposition`].
pub(super) fn factors(zone: &Zone, key: Key) -> Result<Arc<Vec<Factor>>, ConversionError> {
    type Kept = HashMap<Key, Arc<Vec<Factor>>>;
    static CACHE: LazyLock<Mutex<Kept>> = LazyLock::new(Mutex::default);
    let cache = || CACHE.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    if let Some(kept) = cache().get(&key) {
        return Ok(kept.clone());
    }
    let zonal = Harmonics::zonal(*zone, key.order)?;
    let functions = key.family.harmonics(key.sh_order)?;
    let blocks = (0..=key.order.min(key.sh_order))
        .map(|m| (m, key.family.degrees(key.sh_order, m)))
        .filter(|(_, degrees)| !degrees.is_empty())
        .map(|(m, degrees)| factor(&zonal, &functions, m, degrees, key.curvature))
        .collect::<Result<Vec<_>, _>>()?;
    let blocks = Arc::new(blocks);
    let mut cache = cache();
    if cache.len() >= KEPT {
        cache.clear();
    }
    cache.insert(key, blocks.clone());
    Ok(blocks)
}

fn factor(
    zonal: &Harmonics,
    functions: &Harmonics,
    m: usize,
    degrees: Vec<usize>,
    curvature: bool,
) -> Result<Factor, ConversionError> {
    let zone = zonal.zone();
    let columns: Vec<usize> = (m..=zonal.order()).collect();
    let targets = polar_factor(zonal, m, &columns, &zone);
    let mut w = polar_factor(functions, m, &degrees, &zone);
    let mut decomposed = decompose(&w, m)?;
    let condition = condition(&decomposed.s);
    // The cosine of a Lambert surface, l = 1, has no curvature that were not its own.
    let weight = |l: usize| if curvature { ((l * (l + 1)) as f64 - 2.0).max(FREE) } else { 1.0 };
    let inverse_weights = DVector::from_iterator(degrees.len(), degrees.iter().map(|&l| 1.0 / weight(l)));
    if curvature {
        for (mut column, w) in w.column_iter_mut().zip(inverse_weights.iter()) {
            column *= *w;
        }
        decomposed = decompose(&w, m)?;
    }
    let Svd { u, s, v } = decomposed;
    Ok(Factor { m, degrees, inverse_weights, projected: u.transpose() * targets, s, v, condition })
}

/// Polar parts at quadrature nodes of `zone`, times the root of the weights and of 2 pi: the square root of a Gram block.
pub(super) fn polar_factor(basis: &Harmonics, m: usize, degrees: &[usize], zone: &Zone) -> DMatrix<f64> {
    let nodes = zone_mu_angular(NODES, zone);
    let mut factor = DMatrix::zeros(nodes.len(), degrees.len());
    let mut parts = Vec::new();
    for (i, (mu, w)) in nodes.into_iter().enumerate() {
        parts.clear();
        basis.polar_parts(m, mu, &mut parts);
        let root = (2.0 * PI * w).sqrt();
        for (j, &l) in degrees.iter().enumerate() {
            factor[(i, j)] = root * parts[l - m];
        }
    }
    factor
}

/// Condition number of A^T A from the singular values of A.
pub(super) fn condition(singular_values: &DVector<f64>) -> f64 {
    (singular_values.max() / singular_values.min()).powi(2)
}

/// The decomposition of the block `m`, checked.
pub(super) fn decompose(matrix: &DMatrix<f64>, m: usize) -> Result<Svd, ConversionError> {
    let svd = svd(matrix);
    let residual = svd.residual(matrix);
    // Trust, but check; NaN fails too.
    if residual < 1e-12 { Ok(svd) } else { Err(ConversionError::Decomposition { m, residual }) }
}
