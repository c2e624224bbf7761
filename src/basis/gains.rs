//! What a map from zonal coefficients does to noise, in the zone and outside.

use std::f64::consts::PI;

use nalgebra::DMatrix;

use super::factor::polar_factor;
use super::family::Family;
use super::harmonics::{OrderError, size};
use crate::geometry::Zone;

/// Square roots of a family's Gram matrices over the zone and over the rest of the hemisphere, one block per m.
///
/// The trace of a Gram matrix times a covariance cancels where functions can hardly be told apart, down to negative values;
/// a sum of squares does not.
pub(super) struct Regions {
    zone: Zone,
    /// Per m: R over the zone and over the rest, where R^T R is the Gram matrix.
    roots: Vec<[DMatrix<f64>; 2]>,
}

impl Regions {
    /// The blocks m = 0..=`largest_m` of the functions up to `sh_order`.
    pub fn new(zone: Zone, family: Family, sh_order: usize, largest_m: usize) -> Result<Self, OrderError> {
        let functions = family.harmonics(sh_order)?;
        let (below, above) = (Zone::new(0.0, zone.theta_min()), Zone::new(zone.theta_max(), PI / 2.0));
        let roots = (0..=largest_m).map(|m| {
            let degrees = family.degrees(sh_order, m);
            let root = |zones: &[Zone]| {
                let rows: Vec<_> = zones.iter().map(|zone| polar_factor(&functions, m, &degrees, zone)).collect();
                let mut stacked = DMatrix::zeros(rows.iter().map(|r| r.nrows()).sum(), degrees.len());
                let mut at = 0;
                for rows in &rows {
                    stacked.rows_mut(at, rows.nrows()).copy_from(rows);
                    at += rows.nrows();
                }
                stacked.qr().r()
            };
            // A zone without a hole, or one that ends at the horizon, has less of a rest.
            let rest: Vec<Zone> = [below, above].into_iter().flatten().collect();
            [root(&[zone]), root(&rest)]
        });
        Ok(Self { zone, roots: roots.collect() })
    }

    /// RMS over the zone, and over the rest, of the reconstruction's standard error for independent unit noise on every zonal
    /// coefficient up to `order`, over the zonal reconstruction's own, sqrt((L+1)^2 / |Z|). `blocks` are (m, C).
    pub fn gains<'a>(&self, order: usize, blocks: impl Iterator<Item = (usize, &'a DMatrix<f64>)>) -> [f64; 2] {
        let mut power = [0.0; 2];
        for (m, matrix) in blocks {
            let copies = if m == 0 { 1.0 } else { 2.0 };
            for (power, root) in power.iter_mut().zip(&self.roots[m]) {
                *power += copies * (root * matrix).norm_squared();
            }
        }
        let own = size(order) as f64 / self.zone.solid_angle();
        let rest = Zone::hemisphere().solid_angle() - self.zone.solid_angle();
        let outside = if rest > 1e-12 { (power[1] / rest / own).sqrt() } else { 0.0 };
        [(power[0] / self.zone.solid_angle() / own).sqrt(), outside]
    }
}
