//! The projection of known materials on harmonics, for the prior.

use nalgebra::{DMatrix, DVector};

use super::conversion::ConversionError;
use super::factor::polar_factor;
use super::family::Family;
use super::harmonics::index;
use crate::geometry::Zone;

/// The projection on odd harmonics that a population is described by.
///
/// It minimises the squared error over the hemisphere with the zone counted less: what lies inside has been measured, and
/// a series that cannot hold a sharp lobe there should not ring outside.
#[derive(Debug, Clone)]
pub struct Projection {
    /// |m|, degrees, inverse of the weighted Gram matrix.
    blocks: Vec<(usize, Vec<usize>, DMatrix<f64>)>,
}

impl Projection {
    /// The projection on the odd harmonics up to `sh_order`, directions in `zone` counting `zone_weight` (0..=1).
    ///
    /// # Errors
    /// [`ConversionError::Order`]; [`ConversionError::Decomposition`] for a weight of 0 or less.
    pub fn new(zone: Zone, sh_order: usize, zone_weight: f64) -> Result<Self, ConversionError> {
        let harmonics = Family::Odd.harmonics(sh_order)?;
        let mut blocks = Vec::new();
        for m in 0..sh_order {
            let degrees = Family::Odd.degrees(sh_order, m);
            let gram = |zone: &Zone| {
                let w = polar_factor(&harmonics, m, &degrees, zone);
                w.transpose() * w
            };
            let all = gram(&Zone::hemisphere());
            let weighted = &all + gram(&zone) * (zone_weight - 1.0);
            let inverse =
                weighted.cholesky().ok_or(ConversionError::Decomposition { m, residual: f64::NAN })?.inverse();
            blocks.push((m, degrees, inverse));
        }
        Ok(Self { blocks })
    }

    /// Indices k of the cosines that are projected on, in the order of the columns of [`super::Population::new`].
    pub fn terms(&self) -> Vec<usize> {
        self.blocks.iter().flat_map(|(m, degrees, _)| degrees.iter().map(|&l| index(l, *m as i32))).collect()
    }

    /// Coefficients from `moments`, the weighted integrals of f_cos with the functions of [`Projection::terms`].
    pub fn apply(&self, moments: &DVector<f64>) -> DVector<f64> {
        let mut y = DVector::zeros(moments.len());
        let mut at = 0;
        for (_, degrees, inverse) in &self.blocks {
            let rows = degrees.len();
            y.rows_mut(at, rows).copy_from(&(inverse * moments.rows(at, rows)));
            at += rows;
        }
        y
    }
}
