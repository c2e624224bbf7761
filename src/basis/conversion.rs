//! From zonal coefficients to functions of the hemisphere, one dense block per m.

use nalgebra::DMatrix;
use thiserror::Error;

use super::factor::{Factor, Key, condition, decompose, factors, polar_factor};
use super::family::Family;
use super::gains::Regions;
use super::harmonics::{Harmonics, OrderError, index, size};
use super::method::{Method, Strength};
use crate::geometry::Zone;

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
    /// Some functions cannot be told apart in the zone.
    #[error(
        "method `{method}` at order {order}: of the {functions} functions of m = {m} only {rank} can be told apart from {theta_min_deg} to \
         {theta_max_deg} deg in double precision; use a lower `--order`, or `--method prior` or `truncated`"
    )]
    RankDeficient {
        /// The method.
        method: &'static str,
        /// Zonal order.
        order: usize,
        /// The block.
        m: usize,
        /// Its functions.
        functions: usize,
        /// Its numerical rank.
        rank: usize,
        /// Lower limit of the zone, degrees.
        theta_min_deg: f64,
        /// Upper limit of the zone, degrees.
        theta_max_deg: f64,
    },
    /// A coefficient or its variance is not a number, or a variance is negative.
    #[error(
        "coefficient {k} is {value} with the variance {variance}: give finite values and variances >= 0, or leave this direction out"
    )]
    NotFinite {
        /// Index of the zonal function.
        k: usize,
        /// Its coefficient.
        value: f64,
        /// Its variance.
        variance: f64,
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
    /// The degrees l of the rows.
    pub degrees: Vec<usize>,
    /// C: rows follow `degrees`, columns are the zonal degrees |m|..=L. y = C z.
    pub matrix: DMatrix<f64>,
    /// Condition number of the block's Gram matrix (before any cut).
    pub condition: f64,
    /// Per row: how much of the coefficient is data, the diagonal of the resolution matrix C A where A gives the zonal
    /// coefficients of each function. 1: all; 0: the coefficient is what the method assumes.
    pub data_share: Vec<f64>,
}

/// Coefficients of one function with what is known of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Values, index k = l(l+1) + m.
    pub y: Vec<f64>,
    /// Standard errors.
    pub sigma: Vec<f64>,
    /// How much of each coefficient is data, 0..=1; the rest is what the method assumes.
    pub data_share: Vec<f64>,
}

/// A linear map y = C z from zonal coefficients to a family of functions, with what it does to noise.
#[derive(Debug, Clone)]
pub struct Conversion {
    /// The method.
    pub method: Method,
    /// How strongly it holds back.
    pub strength: Strength,
    zone: Zone,
    /// Zonal order L.
    pub order: usize,
    /// Order of the resulting functions.
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
    /// Builds the map for a zone, with the method's own strength.
    ///
    /// # Errors
    /// [`ConversionError::Order`], [`ConversionError::Decomposition`] or [`ConversionError::RankDeficient`].
    pub fn new(method: Method, zone: Zone, order: usize) -> Result<Self, ConversionError> {
        Self::with_strength(method, zone, order, method.strength(zone, order)?)
    }

    /// The same with another strength: see [`super::Evidence`].
    ///
    /// # Errors
    /// As [`Conversion::new`].
    pub fn with_strength(
        method: Method,
        zone: Zone,
        order: usize,
        strength: Strength,
    ) -> Result<Self, ConversionError> {
        let (family, sh_order) = (method.family(), method.sh_order(zone, order)?);
        let curvature = matches!(strength, Strength::Curvature(_));
        let factors = factors(&zone, Key::new(&zone, order, family, sh_order, curvature))?;
        // In a thin zone no function has much of its energy: the best ones are kept all the same.
        let strength = match strength {
            Strength::Concentration(share) => {
                let best = factors.iter().map(|f| f.s[0] * f.s[0] / family.energy()).fold(0.0, f64::max);
                Strength::Concentration(share.min(best * (1.0 - 1e-9)))
            }
            other => other,
        };
        let blocks: Vec<Block> = factors.iter().map(|f| block(f, family, strength)).collect();
        if strength == Strength::Exact {
            for f in factors.iter() {
                let rank = numerical_rank(f);
                if rank < f.degrees.len() {
                    return Err(ConversionError::RankDeficient {
                        method: method.name(),
                        order,
                        m: f.m,
                        functions: f.degrees.len(),
                        rank,
                        theta_min_deg: rounded_degrees(zone.theta_min()),
                        theta_max_deg: rounded_degrees(zone.theta_max()),
                    });
                }
            }
        }
        let condition = blocks.iter().map(|b| b.condition).fold(1.0, f64::max);
        let regions = Regions::new(zone, family, sh_order, order.min(sh_order))?;
        let [noise_gain_in, noise_gain_out] = regions.gains(order, blocks.iter().map(|b| (b.m, &b.matrix)));
        Ok(Self { method, strength, zone, order, sh_order, blocks, condition, noise_gain_in, noise_gain_out })
    }

    /// The functions of the result.
    pub fn harmonics(&self) -> Harmonics {
        self.method.family().harmonics(self.sh_order).expect("a conversion has a valid order")
    }

    /// Applies the rule that refuses methods whose noise outside the zone exceeds the signal.
    ///
    /// # Errors
    /// [`ConversionError::Unstable`] if noise_gain_out * noise_rel > 1.
    pub fn check(&self, noise_rel: f64) -> Result<(), ConversionError> {
        if self.holds(noise_rel) {
            return Ok(());
        }
        let parity = || Self::new(Method::Parity, self.zone, self.order).is_ok_and(|c| c.holds(noise_rel));
        Err(ConversionError::Unstable {
            method: self.method.name(),
            order: self.order,
            noise_gain_out: self.noise_gain_out,
            noise_rel,
            remedy: match self.method {
                Method::Thesis | Method::Hsh if parity() => "use `--method parity` or `--method prior`",
                _ => "use a lower `--order` or `--method prior`",
            },
        })
    }

    /// Whether noise outside the zone stays below the signal; a NaN does not.
    fn holds(&self, noise_rel: f64) -> bool {
        self.noise_gain_out * noise_rel <= 1.0
    }

    /// Values, standard errors and shares of data of the function with zonal coefficients `z` and independent variances
    /// `variance`, both of length (order+1)^2.
    ///
    /// # Errors
    /// [`ConversionError::NotFinite`].
    pub fn estimate(&self, z: &[f64], variance: &[f64]) -> Result<Estimate, ConversionError> {
        require_finite(z, variance)?;
        Ok(Estimate {
            y: self.apply(z),
            sigma: self.variance(variance).into_iter().map(f64::sqrt).collect(),
            data_share: self.data_share(),
        })
    }

    /// How much of each coefficient is data, 0..=1, index k; 0 where the method has no function.
    pub fn data_share(&self) -> Vec<f64> {
        let mut shares = vec![0.0; size(self.sh_order)];
        for block in &self.blocks {
            for (&l, share) in block.degrees.iter().zip(&block.data_share) {
                for m in [block.m as i32, -(block.m as i32)] {
                    shares[index(l, m)] = share.clamp(0.0, 1.0);
                }
            }
        }
        shares
    }

    /// Coefficients (index k, length (sh_order+1)^2) of one function with zonal coefficients `z` (length (order+1)^2).
    pub fn apply(&self, z: &[f64]) -> Vec<f64> {
        self.accumulate(z, |c, z| c * z)
    }

    /// Variances of the coefficients for independent variances of the zonal ones.
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
}

/// Condition number of the worst Gram block of the functions of `family` up to `order` over `zone`.
///
/// # Errors
/// As [`Conversion::new`].
pub fn gram_condition(zone: Zone, order: usize, family: Family) -> Result<f64, ConversionError> {
    let functions = family.harmonics(order)?;
    let mut worst = 1.0f64;
    for m in 0..=order {
        let degrees = family.degrees(order, m);
        if !degrees.is_empty() {
            worst = worst.max(condition(&decompose(&polar_factor(&functions, m, &degrees, &zone), m)?.s));
        }
    }
    Ok(worst)
}

/// Refuses what no estimate can be made of.
pub(super) fn require_finite(z: &[f64], variance: &[f64]) -> Result<(), ConversionError> {
    for (k, (&value, &variance)) in z.iter().zip(variance).enumerate() {
        if !(value.is_finite() && variance.is_finite() && variance >= 0.0) {
            return Err(ConversionError::NotFinite { k, value, variance });
        }
    }
    Ok(())
}

fn block(factor: &Factor, family: Family, strength: Strength) -> Block {
    let mut filtered = factor.projected.clone();
    for (mut row, s) in filtered.row_iter_mut().zip(factor.s.iter()) {
        row *= strength.inverse(*s, factor.s[0], family);
    }
    let matrix = DMatrix::from_diagonal(&factor.inverse_weights) * &factor.v * filtered;
    let data_share = (&matrix * factor.forward()).diagonal().iter().copied().collect();
    Block { m: factor.m, degrees: factor.degrees.clone(), matrix, condition: factor.condition, data_share }
}

/// To a billionth, for people.
fn rounded_degrees(theta: f64) -> f64 {
    (theta.to_degrees() * 1e9).round() / 1e9
}

fn numerical_rank(factor: &Factor) -> usize {
    let least = factor.s[0] * factor.s.len() as f64 * f64::EPSILON;
    factor.s.iter().filter(|s| **s > least).count()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

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
        let rows: [(Zone, Family, &[f64]); 4] = [
            (built(), Family::All, &[3.0e4, 1.1e9, 5.1e13]),
            (full(), Family::All, &[2.5e2, 1.6e5, 1.3e8, 1.2e11, 1.1e14]),
            (built(), Family::Odd, &[1.0, 4.1, 20.0, 1.4e2, 1.1e3, 1.0e4]),
            (full(), Family::Odd, &[1.0, 1.1, 1.3, 1.6, 2.0, 2.6]),
        ];
        for (zone, family, values) in rows {
            for (i, order) in orders.into_iter().enumerate() {
                let got = gram_condition(zone, order, family).unwrap();
                match values.get(i) {
                    Some(want) => assert!((got / want - 1.0).abs() < TABLE, "{order} {family:?}: {got:e} not {want:e}"),
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
