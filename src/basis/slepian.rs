//! Slepian functions: combinations of harmonics with as much of their energy in the zone as can be.

use nalgebra::{DMatrix, DVector};

use super::conversion::ConversionError;
use super::factor::{decompose, polar_factor};
use super::family::Family;
use super::harmonics::{Harmonics, index, size};
use crate::geometry::{Direction, Sample, Zone};

/// The Slepian functions of a zone for one |m|, the same for cos(m phi) and sin(m phi).
#[derive(Debug, Clone, PartialEq)]
pub struct SlepianBlock {
    /// |m|.
    pub m: usize,
    /// Degrees l of the harmonics combined.
    pub degrees: Vec<usize>,
    /// Share of a function's energy that lies in the zone, descending, 0..=1.
    pub eigenvalues: DVector<f64>,
    /// Coefficients: rows follow `degrees`, columns `eigenvalues`; orthonormal columns.
    pub vectors: DMatrix<f64>,
}

/// The exact Slepian functions of a zone among the harmonics of a family up to an order.
///
/// They are eigenvectors of the zone's Gram matrix (Simons, Dahlen, Wieczorek 2006), which couples equal m only; a
/// decomposition of its square root finds small eigenvalues too. Orthonormal over the family's domain (the sphere, or the
/// hemisphere) and orthogonal over the zone.
#[derive(Debug, Clone)]
pub struct Slepian {
    /// One block per |m|.
    pub blocks: Vec<SlepianBlock>,
    harmonics: Harmonics,
    scale: f64,
}

impl Slepian {
    /// The functions of `zone` among those of `family` up to `order`.
    ///
    /// # Errors
    /// [`ConversionError::Order`] or [`ConversionError::Decomposition`].
    pub fn new(zone: Zone, family: Family, order: usize) -> Result<Self, ConversionError> {
        let harmonics = family.harmonics(order)?;
        let blocks = (0..=order)
            .map(|m| (m, family.degrees(order, m)))
            .filter(|(_, degrees)| !degrees.is_empty())
            .map(|(m, degrees)| {
                let svd = decompose(&polar_factor(&harmonics, m, &degrees, &zone), m)?;
                Ok(SlepianBlock { m, degrees, eigenvalues: svd.s.map(|s| s * s / family.energy()), vectors: svd.v })
            })
            .collect::<Result<Vec<_>, ConversionError>>()?;
        Ok(Self { blocks, harmonics, scale: family.energy().sqrt().recip() })
    }

    /// Number of functions.
    pub fn len(&self) -> usize {
        self.blocks.iter().map(|b| b.degrees.len() * if b.m == 0 { 1 } else { 2 }).sum()
    }

    /// Whether the family has no function of this order.
    pub fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    /// How many functions have at least this share of their energy in the zone.
    pub fn concentrated(&self, share: f64) -> usize {
        let count = |b: &SlepianBlock| b.eigenvalues.iter().filter(|e| **e >= share).count();
        self.blocks.iter().map(|b| count(b) * if b.m == 0 { 1 } else { 2 }).sum()
    }

    /// All functions in each of many directions, into `out`: index `direction * len() + i`. Functions are ordered by |m|,
    /// cosines before sines, and then by falling eigenvalue.
    ///
    /// # Panics
    /// If `out` is not `directions.len() * len()` long.
    pub fn eval_many_into(&self, directions: &[Direction<Sample>], out: &mut [f64]) {
        assert_eq!(out.len(), directions.len() * self.len(), "one row of functions for each direction");
        if self.is_empty() {
            return;
        }
        /// Directions evaluated between two products: their harmonics stay in the cache.
        const BLOCK: usize = 64;
        let n = size(self.harmonics.order());
        let mut harmonics = vec![0.0; BLOCK.min(directions.len()) * n];
        for (directions, out) in directions.chunks(BLOCK).zip(out.chunks_mut(BLOCK * self.len())) {
            let harmonics = &mut harmonics[..directions.len() * n];
            self.harmonics.eval_many_into(directions, harmonics);
            for (row, out) in harmonics.chunks_exact(n).zip(out.chunks_exact_mut(self.len())) {
                let mut at = 0;
                for block in &self.blocks {
                    for sign in if block.m == 0 { &[1][..] } else { &[1, -1] } {
                        for column in block.vectors.column_iter() {
                            let terms = block.degrees.iter().zip(column.iter());
                            let sum: f64 = terms.map(|(&l, v)| v * row[index(l, sign * block.m as i32)]).sum();
                            out[at] = self.scale * sum;
                            at += 1;
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::quadrature::zone_product;

    #[test]
    fn they_are_orthonormal_over_the_domain_and_orthogonal_over_the_zone() {
        let zone = Zone::from_degrees(9.0, 57.0).unwrap();
        let domains = [
            (Family::All, Zone::sphere()),
            (Family::Odd, Zone::hemisphere()),
            (Family::Hemispherical, Zone::hemisphere()),
        ];
        for (family, domain) in domains {
            let slepian = Slepian::new(zone, family, 6).unwrap();
            let n = slepian.len();
            for (over, inside) in [(domain, false), (zone, true)] {
                let mut gram = DMatrix::<f64>::zeros(n, n);
                for (d, w) in zone_product(&over, 40, 24) {
                    let mut row = vec![0.0; n];
                    slepian.eval_many_into(&[d], &mut row);
                    let row = DVector::from_vec(row);
                    gram.ger(w, &row, &row, 1.0);
                }
                let mut expected = DMatrix::identity(n, n);
                if inside {
                    let mut at = 0;
                    for block in &slepian.blocks {
                        for _ in 0..if block.m == 0 { 1 } else { 2 } {
                            for e in block.eigenvalues.iter() {
                                expected[(at, at)] = *e;
                                at += 1;
                            }
                        }
                    }
                }
                assert!((gram - expected).amax() < 1e-11, "{family:?} {inside}");
            }
        }
    }

    /// Figures of the derivation: at order 6, 10 of 49 on the built zone and 21 on the full one.
    #[test]
    fn a_zone_determines_so_many_functions() {
        for (theta_max, want) in [(57.0, 10), (90.0, 21)] {
            let zone = Zone::from_degrees(9.0, theta_max).unwrap();
            assert_eq!(Slepian::new(zone, Family::All, 6).unwrap().concentrated(0.5), want);
        }
        let sphere = Slepian::new(Zone::sphere(), Family::All, 5).unwrap();
        assert_eq!(sphere.concentrated(1.0 - 1e-12), 36);
    }
}
