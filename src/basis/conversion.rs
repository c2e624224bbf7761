//! From zonal coefficients to spherical harmonics, one dense block per m.

use std::f64::consts::PI;

use nalgebra::{DMatrix, DVector};
use thiserror::Error;

use super::harmonics::{Harmonics, OrderError, index, size};
use super::jacobi::{Svd, svd};
use crate::geometry::Zone;
use crate::geometry::quadrature::zone_mu_angular;

/// Nodes in mu: exact to rounding for the products met up to order 50.
const NODES: usize = 160;

/// Eigenvalues of the zone's Gram matrix below this share of the largest are cut by [`Method::Truncated`].
pub const TRUNCATED_CUT: f64 = 3e-2;

/// How zonal coefficients become spherical harmonics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// The literal dual basis of all SH up to L over the zone (Ghosh 2007, eq. 3.12-3.16). Fails on partial zones.
    Thesis,
    /// The same dual with the small eigenvalues of the Gram matrix cut at `TRUNCATED_CUT`.
    Truncated,
    /// Least squares over the zone in the SH with l + m odd, up to L + 1: those that vanish at the horizon, as f_cos does.
    Parity,
}

impl Method {
    /// All methods, in the order charts list them.
    pub const ALL: [Method; 3] = [Method::Thesis, Method::Truncated, Method::Parity];

    /// The name used at the prompt and in files.
    pub fn name(self) -> &'static str {
        match self {
            Method::Thesis => "thesis",
            Method::Truncated => "truncated",
            Method::Parity => "parity",
        }
    }

    /// The SH order that zonal order `order` leads to.
    pub fn sh_order(self, order: usize) -> usize {
        match self {
            Method::Parity => order + 1,
            Method::Thesis | Method::Truncated => order,
        }
    }

    fn keeps(self, l: usize, m: usize) -> bool {
        self != Method::Parity || (l + m) % 2 == 1
    }
}

/// Why a conversion could not be built or must not be used.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ConversionError {
    /// The order is out of range.
    #[error(transparent)]
    Order(#[from] OrderError),
    /// A decomposition left a residual: its result cannot be trusted.
    #[error("the decomposition of the block m = {m} left a residual of {residual:e}: lower the order")]
    Decomposition {
        /// The block.
        m: usize,
        /// ||A - U S V^T|| / ||A||.
        residual: f64,
    },
    /// The noise would swamp the reconstruction outside the zone.
    #[error(
        "method `{method}` at order {order} has noise_gain_out = {noise_gain_out:.3e}: with noise_rel = {noise_rel:.2e} the \
         noise outside the zone exceeds the signal; {remedy}, or `--force` to convert all the same"
    )]
    Unstable {
        /// The refused method.
        method: &'static str,
        /// Zonal order.
        order: usize,
        /// Its noise gain outside the zone.
        noise_gain_out: f64,
        /// RMS sigma / RMS DC of the measurement.
        noise_rel: f64,
        /// What to do instead.
        remedy: &'static str,
    },
}

/// The map of one azimuthal order: the same for cos(m phi) and sin(m phi).
#[derive(Debug, Clone)]
pub struct Block {
    /// |m|.
    pub m: usize,
    /// The degrees l of the SH rows.
    pub degrees: Vec<usize>,
    /// C: rows follow `degrees`, columns are the zonal degrees |m|..=L. y = C z.
    pub matrix: DMatrix<f64>,
    /// Condition number of the block's Gram matrix (before any cut).
    pub condition: f64,
}

/// A linear map y = C z from zonal coefficients to spherical harmonics, with what it does to noise.
#[derive(Debug, Clone)]
pub struct Conversion {
    /// The method.
    pub method: Method,
    /// Zonal order L.
    pub order: usize,
    /// Order of the resulting SH.
    pub sh_order: usize,
    /// One block per |m|.
    pub blocks: Vec<Block>,
    /// Condition of the worst block.
    pub condition: f64,
    /// RMS over the zone of the reconstruction's standard error for independent unit noise on every zonal coefficient,
    /// over the zonal reconstruction's own, sqrt((L+1)^2 / |Z|).
    pub noise_gain_in: f64,
    /// The same over the rest of the hemisphere.
    pub noise_gain_out: f64,
}

impl Conversion {
    /// Builds the map for a zone.
    ///
    /// # Errors
    /// [`ConversionError::Order`] or [`ConversionError::Decomposition`].
    pub fn new(method: Method, zone: Zone, order: usize) -> Result<Self, ConversionError> {
        let sh_order = method.sh_order(order);
        let zonal = Harmonics::zonal(zone, order)?;
        let sh = Harmonics::spherical(sh_order)?;
        let blocks = (0..=order)
            .map(|m| block(method, &zonal, &sh, m))
            .filter(|b| !matches!(b, Ok(b) if b.degrees.is_empty()))
            .collect::<Result<Vec<_>, _>>()?;
        let condition = blocks.iter().map(|b| b.condition).fold(1.0, f64::max);
        let mut conversion =
            Self { method, order, sh_order, blocks, condition, noise_gain_in: 0.0, noise_gain_out: 0.0 };
        let own = (size(order) as f64 / zone.solid_angle()).sqrt();
        let (inside, outside) = conversion.noise_power(&zone, &sh);
        let rest = Zone::hemisphere().solid_angle() - zone.solid_angle();
        conversion.noise_gain_in = (inside / zone.solid_angle()).sqrt() / own;
        conversion.noise_gain_out = if rest > 1e-12 { (outside / rest).sqrt() / own } else { 0.0 };
        Ok(conversion)
    }

    /// Applies the rule that refuses methods whose noise outside the zone exceeds the signal.
    ///
    /// # Errors
    /// [`ConversionError::Unstable`] if noise_gain_out * noise_rel > 1.
    pub fn check(&self, noise_rel: f64) -> Result<(), ConversionError> {
        // A NaN must be refused as well.
        if self.noise_gain_out * noise_rel <= 1.0 {
            return Ok(());
        }
        Err(ConversionError::Unstable {
            method: self.method.name(),
            order: self.order,
            noise_gain_out: self.noise_gain_out,
            noise_rel,
            remedy: match self.method {
                Method::Parity => "use a lower `--order`",
                Method::Thesis | Method::Truncated => "use `--method parity`",
            },
        })
    }

    /// SH coefficients (index k, length (sh_order+1)^2) of one function with zonal coefficients `z` (length (order+1)^2).
    pub fn apply(&self, z: &[f64]) -> Vec<f64> {
        self.accumulate(z, |c, z| c * z)
    }

    /// Variances of the SH coefficients for independent variances of the zonal ones.
    pub fn variance(&self, variance: &[f64]) -> Vec<f64> {
        self.accumulate(variance, |c, v| c * c * v)
    }

    fn accumulate(&self, z: &[f64], term: impl Fn(f64, f64) -> f64) -> Vec<f64> {
        let mut y = vec![0.0; size(self.sh_order)];
        for block in &self.blocks {
            let m = block.m as i32;
            for sign in if m == 0 { &[1][..] } else { &[1, -1][..] } {
                for (row, &l) in block.degrees.iter().enumerate() {
                    let sum = (0..block.matrix.ncols())
                        .map(|col| term(block.matrix[(row, col)], z[index(block.m + col, sign * m)]))
                        .sum();
                    y[index(l, sign * m)] = sum;
                }
            }
        }
        y
    }

    /// Integrals over the zone and over the rest of the hemisphere of the reconstruction's variance for unit noise.
    fn noise_power(&self, zone: &Zone, sh: &Harmonics) -> (f64, f64) {
        let mut power = (0.0, 0.0);
        for block in &self.blocks {
            let copies = if block.m == 0 { 1.0 } else { 2.0 };
            let covariance = &block.matrix * block.matrix.transpose();
            let trace = |zone: &Zone| {
                let factor = polar_factor(sh, block.m, &block.degrees, zone);
                (factor.transpose() * &factor).component_mul(&covariance).sum()
            };
            power.0 += copies * trace(zone);
            if zone.theta_min() > 0.0 {
                power.1 += copies * trace(&Zone::new(0.0, zone.theta_min()).expect("below the zone"));
            }
            if zone.theta_max() < PI / 2.0 {
                power.1 += copies * trace(&Zone::new(zone.theta_max(), PI / 2.0).expect("above the zone"));
            }
        }
        power
    }
}

/// Condition number of the worst Gram block of all SH up to `order` over `zone` (`parity`: of those with l + m odd).
///
/// # Errors
/// As [`Conversion::new`].
pub fn gram_condition(zone: Zone, order: usize, parity: bool) -> Result<f64, ConversionError> {
    let sh = Harmonics::spherical(order)?;
    let mut worst = 1.0f64;
    for m in 0..=order {
        let degrees: Vec<usize> = (m..=order).filter(|l| !parity || (l + m) % 2 == 1).collect();
        if !degrees.is_empty() {
            let svd = decompose(polar_factor(&sh, m, &degrees, &zone), m)?;
            worst = worst.max(condition(&svd.s));
        }
    }
    Ok(worst)
}

fn block(method: Method, zonal: &Harmonics, sh: &Harmonics, m: usize) -> Result<Block, ConversionError> {
    let degrees: Vec<usize> = (m..=sh.order()).filter(|&l| method.keeps(l, m)).collect();
    let zone = zonal.zone();
    let columns: Vec<usize> = (m..=zonal.order()).collect();
    if degrees.is_empty() {
        return Ok(Block { m, degrees, matrix: DMatrix::zeros(0, columns.len()), condition: 1.0 });
    }
    // With W the SH and Z the zonal functions at quadrature nodes times sqrt(weight), G = W^T W and C = G^-1 W^T Z. The
    // SVD of W gives the same map with the square root of G's condition number.
    let targets = polar_factor(zonal, m, &columns, &zone);
    let svd = decompose(polar_factor(sh, m, &degrees, &zone), m)?;
    let condition = condition(&svd.s);
    let cut = match method {
        Method::Truncated => svd.s.max() * TRUNCATED_CUT.sqrt(),
        Method::Thesis | Method::Parity => 0.0,
    };
    let mut projected = svd.u.transpose() * targets;
    for (i, s) in svd.s.iter().enumerate() {
        projected.row_mut(i).scale_mut(if *s > cut { 1.0 / s } else { 0.0 });
    }
    Ok(Block { m, degrees, matrix: &svd.v * projected, condition })
}

/// Polar parts at quadrature nodes of `zone`, times the root of the weights and of 2 pi: the square root of a Gram block.
fn polar_factor(basis: &Harmonics, m: usize, degrees: &[usize], zone: &Zone) -> DMatrix<f64> {
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

fn condition(singular_values: &DVector<f64>) -> f64 {
    (singular_values.max() / singular_values.min()).powi(2)
}

fn decompose(matrix: DMatrix<f64>, m: usize) -> Result<Svd, ConversionError> {
    let svd = svd(&matrix);
    let residual = svd.residual(&matrix);
    // Trust, but check; NaN fails too.
    if residual < 1e-12 { Ok(svd) } else { Err(ConversionError::Decomposition { m, residual }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn built() -> Zone {
        Zone::from_degrees(9.0, 57.0).unwrap()
    }
    fn full() -> Zone {
        Zone::from_degrees(9.0, 90.0).unwrap()
    }

    /// The table is given to two digits.
    const TABLE: f64 = 0.06;

    #[test]
    fn condition_tables_are_reproduced() {
        let orders = [2, 4, 6, 8, 10, 12];
        let rows: [(Zone, bool, &[f64]); 4] = [
            (built(), false, &[3.0e4, 1.1e9, 5.1e13]),
            (full(), false, &[2.5e2, 1.6e5, 1.3e8, 1.2e11, 1.1e14]),
            (built(), true, &[1.0, 4.1, 20.0, 1.4e2, 1.1e3, 1.0e4]),
            (full(), true, &[1.0, 1.1, 1.3, 1.6, 2.0, 2.6]),
        ];
        for (zone, parity, values) in rows {
            for (i, order) in orders.into_iter().enumerate() {
                let got = gram_condition(zone, order, parity).unwrap();
                match values.get(i) {
                    Some(want) => assert!((got / want - 1.0).abs() < TABLE, "{order} {parity}: {got:e} not {want:e}"),
                    // The table's bounds: beyond 1e16 on the built zone, beyond 1e15 on the full one.
                    None => assert!(got > if zone == built() { 1e16 } else { 1e15 }, "{order}: {got:e}"),
                }
            }
        }
    }

    #[test]
    fn on_the_sphere_the_conversion_is_the_identity() {
        let c = Conversion::new(Method::Thesis, Zone::sphere(), 6).unwrap();
        for block in &c.blocks {
            let n = block.matrix.nrows();
            assert!((&block.matrix - DMatrix::identity(n, n)).amax() < 1e-12, "m = {}", block.m);
        }
        assert!((c.noise_gain_in - 1.0).abs() < 1e-12);
    }

    /// Lambert is exactly Y_10, and an odd-parity expansion finds it from the zone alone, at any order.
    #[test]
    fn parity_recovers_lambert_from_a_zone() {
        let order = 4;
        let zonal = Harmonics::zonal(built(), order).unwrap();
        let mut z = vec![0.0; size(order)];
        for (d, w) in crate::geometry::quadrature::zone_product(&built(), 24, 24) {
            for (z, f) in z.iter_mut().zip(zonal.eval(&d)) {
                *z += w * f * d.cos_theta() / PI;
            }
        }
        let y = Conversion::new(Method::Parity, built(), order).unwrap().apply(&z);
        let want = (1.0 / PI) * (4.0 * PI / 3.0f64).sqrt();
        for (k, y) in y.iter().enumerate() {
            let want = if k == index(1, 0) { want } else { 0.0 };
            assert!((y - want).abs() < 1e-12, "k = {k}: {y}");
        }
    }

    #[test]
    fn the_literal_dual_is_refused_where_its_noise_explodes() {
        let mut last = 0.0;
        for order in [2, 4, 6] {
            let c = Conversion::new(Method::Thesis, built(), order).unwrap();
            assert!(c.noise_gain_out > 10.0 * last);
            last = c.noise_gain_out;
        }
        let thesis = Conversion::new(Method::Thesis, built(), 6).unwrap();
        let error = thesis.check(0.01).unwrap_err().to_string();
        assert!(error.contains("noise_gain_out") && error.contains("parity") && error.contains("--force"));
        assert!(thesis.check(f64::NAN).is_err());
        assert!(Conversion::new(Method::Parity, built(), 6).unwrap().check(0.01).is_ok());
    }

    #[test]
    fn a_truncated_dual_stays_small_inside_and_out() {
        let c = Conversion::new(Method::Truncated, built(), 6).unwrap();
        assert!(c.noise_gain_in < 1.0 && c.noise_gain_out < 3.0, "{} {}", c.noise_gain_in, c.noise_gain_out);
    }

    #[test]
    fn order_zero_and_thin_zones_work() {
        for method in Method::ALL {
            Conversion::new(method, built(), 0).unwrap();
            Conversion::new(method, Zone::from_degrees(20.0, 20.1).unwrap(), 0).unwrap();
        }
    }
}
