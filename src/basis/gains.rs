//! What a map from zonal coefficients does to noise, in the zone and outside.

use std::f64::consts::PI;

use nalgebra::DMatrix;

use super::factor::polar_factor;
use super::family::Family;
use super::harmonics::{OrderError, size};
use crate::geometry::Zone;

/// Gram matrices of a family over the zone and over the rest of the hemisphere, one block per m.
pub(super) struct Regions {
    zone: Zone,
    /// Per m: over the zone, over the rest.
    grams: Vec<[DMatrix<f64>; 2]>,
}

impl Regions {
    /// The blocks m = 0..=`largest_m` of the functions up to `sh_order`.
    pub fn new(zone: Zone, family: Family, sh_order: usize, largest_m: usize) -> Result<Self, OrderError> {
        let functions = family.harmonics(sh_order)?;
        let grams = (0..=largest_m).map(|m| {
            let degrees = family.degrees(sh_order, m);
            let gram = |zone: Zone| {
                let factor = polar_factor(&functions, m, &degrees, &zone);
                factor.tr_mul(&factor)
            };
            let mut rest = DMatrix::zeros(degrees.len(), degrees.len());
            if zone.theta_min() > 0.0 {
                rest += gram(Zone::new(0.0, zone.theta_min()).expect("below the zone"));
            }
            if zone.theta_max() < PI / 2.0 {
                rest += gram(Zone::new(zone.theta_max(), PI / 2.0).expect("above the zone"));
            }
            [gram(zone), rest]
        });
        Ok(Self { zone, grams: grams.collect() })
    }

    /// RMS over the zone, and over the rest, of the reconstruction's standard error for independent unit noise on every zonal
    /// coefficient up to `order`, over the zonal reconstruction's own, sqrt((L+1)^2 / |Z|). `blocks` are (m, C).
    pub fn gains<'a>(&self, order: usize, blocks: impl Iterator<Item = (usize, &'a DMatrix<f64>)>) -> [f64; 2] {
        let mut power = [0.0; 2];
        for (m, matrix) in blocks {
            let copies = if m == 0 { 1.0 } else { 2.0 };
            let covariance = matrix * matrix.transpose();
            for (power, gram) in power.iter_mut().zip(&self.grams[m]) {
                *power += copies * gram.component_mul(&covariance).sum();
            }
        }
        let own = size(order) as f64 / self.zone.solid_angle();
        let rest = Zone::hemisphere().solid_angle() - self.zone.solid_angle();
        let outside = if rest > 1e-12 { (power[1] / rest / own).sqrt() } else { 0.0 };
        [(power[0] / self.zone.solid_angle() / own).sqrt(), outside]
    }
}
