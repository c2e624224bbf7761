//! What lies outside the zone, from what is inside it and from a population of known materials.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::conversion::{ConversionError, Estimate, require_finite};
use super::factor::{Factor, Key, factors};
use super::family::Family;
use super::gains::Regions;
use super::harmonics::{index, size};
use crate::geometry::Zone;

/// What a [`Population`] has been found to be good for: numbers learned on it, none by hand but the orders.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Learned {
    /// Variance of what no mixture of members explains, of a coefficient over z_00.
    pub misfit: f64,
    /// Members as near as this many count as alike.
    pub neighbours: usize,
    /// Exitant rings that err independently of one another.
    pub independent_rings: usize,
    /// Variance of a measured coefficient beyond noise, over z_00, when a ring is followed where it differs from the population.
    pub fidelity: f64,
    /// Factor of the standard errors that the population's own residuals give.
    pub widening: f64,
}

/// Share of the weight that all members have alike, so that none is ever without.
const EVERYONE: f64 = 2e-4;
/// A Slepian function follows the data if it has at least this share of its energy in the zone.
const CONCENTRATED: f64 = 0.5;

/// Materials as a rig would have measured them and as they are: isotropic, towards the same rings of exitant directions,
/// phi_o = 0, so that sines vanish.
#[derive(Clone)]
pub struct Population {
    zone: Zone,
    order: usize,
    sh_order: usize,
    /// Blocks that the zonal functions see: m <= order.
    factors: Arc<Vec<Factor>>,
    regions: Arc<Regions>,
    members: Vec<Member>,
    /// Per ring, row = member: zonal coefficients of the functions with m >= 0 (ascending k), over the member's z_00.
    z: Vec<DMatrix<f64>>,
    /// Per ring, row = member: coefficients of the odd harmonics with m >= 0, by m and l, over the member's z_00.
    y: Vec<DMatrix<f64>>,
    /// Row = member: log of z_00 of each ring, less their mean.
    levels: DMatrix<f64>,
}

/// Where a member of a [`Population`] comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Member {
    /// Its material; several models may describe one.
    pub material: usize,
    /// Its model.
    pub family: usize,
}

/// Mean coefficients of one ring in one channel.
#[derive(Debug, Clone, PartialEq)]
pub struct RingMean {
    /// Zonal coefficients of the functions with m >= 0, ascending k, turned to phi_o = 0.
    pub z: Vec<f64>,
    /// Their variances.
    pub variance: Vec<f64>,
    /// Variances of the same coefficients in one exitant direction of the ring.
    pub direction_variance: Vec<f64>,
}

/// The way of one ring and channel from zonal coefficients to spherical harmonics: y = K z + offset.
///
/// K is the same for cosines and sines; the offset belongs to the cosines at phi_o = 0 and turns with phi_o.
#[derive(Debug, Clone)]
pub struct RingMap {
    /// One block per |m|.
    pub blocks: Vec<RingBlock>,
    /// Row = member: one standard deviation of the model's error, columns in the order of the blocks' rows. The error's
    /// covariance is its transpose times itself.
    pub deviations: DMatrix<f64>,
    /// How much wider than the population the data are, in variance: 1 for a material like its members.
    pub surprise: f64,
    /// Condition number of the worst system solved.
    pub condition: f64,
}

/// One azimuthal order of a [`RingMap`].
#[derive(Debug, Clone)]
pub struct RingBlock {
    /// |m|.
    pub m: usize,
    /// Degrees l of the rows.
    pub degrees: Vec<usize>,
    /// K: columns are the zonal degrees |m|..=L, none above the zonal order.
    pub matrix: DMatrix<f64>,
    /// What is added to the cosine at phi_o = 0.
    pub offset: Vec<f64>,
    /// Variance of the model's error of that cosine.
    pub variance: Vec<f64>,
    /// How much of that cosine is data: 1 less the variance left over that of the population.
    pub data_share: Vec<f64>,
}

impl Population {
    /// A population from coefficients towards each ring: `z` and `moments` hold for each ring a row for each member, of the
    /// zonal functions with m >= 0 up to `order` (ascending k) and of the projection on the odd harmonics of `sh_order` by
    /// [`super::Projection`].
    ///
    /// # Errors
    /// As [`super::Conversion::new`].
    pub fn new(
        zone: Zone,
        order: usize,
        sh_order: usize,
        members: Vec<Member>,
        mut z: Vec<DMatrix<f64>>,
        mut y: Vec<DMatrix<f64>>,
    ) -> Result<Self, ConversionError> {
        let factors = factors(&zone, Key::new(&zone, order, Family::Odd, sh_order, false))?;
        let mut levels = DMatrix::zeros(members.len(), z.len());
        for (r, (z, y)) in z.iter_mut().zip(&mut y).enumerate() {
            for i in 0..members.len() {
                let dc = z[(i, 0)];
                levels[(i, r)] = dc.ln();
                z.row_mut(i).scale_mut(1.0 / dc);
                y.row_mut(i).scale_mut(1.0 / dc);
            }
        }
        for mut row in levels.row_iter_mut() {
            let mean = row.mean();
            row.add_scalar_mut(-mean);
        }
        let regions = Arc::new(Regions::new(zone, Family::Odd, sh_order, order.min(sh_order))?);
        Ok(Self { zone, order, sh_order, factors, regions, members, z, y, levels })
    }

    /// The same population as if only zonal functions up to `order`, no more than its own, had been shown.
    ///
    /// # Errors
    /// As [`super::Conversion::new`].
    pub fn truncated(&self, order: usize) -> Result<Self, ConversionError> {
        assert!(order <= self.order, "the population holds order {}", self.order);
        let factors = factors(&self.zone, Key::new(&self.zone, order, Family::Odd, self.sh_order, false))?;
        // Functions with m >= 0, ascending k: those of lower orders come first.
        let terms = (order + 1) * (order + 2) / 2;
        let z = self.z.iter().map(|z| z.columns(0, terms).into_owned()).collect();
        Ok(Self { order, factors, z, ..self.clone() })
    }

    /// The zone it was integrated over.
    pub fn zone(&self) -> Zone {
        self.zone
    }

    /// Zonal order.
    pub fn order(&self) -> usize {
        self.order
    }

    /// Order of the spherical harmonics.
    pub fn sh_order(&self) -> usize {
        self.sh_order
    }

    /// The population less all members of one material.
    pub fn without(&self, material: usize) -> Self {
        let rows: Vec<usize> = (0..self.members.len()).filter(|&i| self.members[i].material != material).collect();
        let select = |m: &DMatrix<f64>| m.select_rows(&rows);
        Self {
            members: rows.iter().map(|&i| self.members[i]).collect(),
            z: self.z.iter().map(select).collect(),
            y: self.y.iter().map(select).collect(),
            levels: select(&self.levels),
            ..self.clone()
        }
    }

    /// What one material's rings say of all of its functions, one map per ring.
    ///
    /// The mixture of members that explains all rings gives the mean; Gaussian regression among the members nearest to the
    /// data. What single rings say beyond it is added through the Slepian functions that lie in the zone. The error is what
    /// the members' own residuals show when each is predicted from those of other models of other materials.
    ///
    /// # Errors
    /// [`ConversionError::NotFinite`] for data or variances that are not finite, negative variances, and without z_00.
    pub fn maps(&self, rings: &[RingMean], learned: &Learned) -> Result<Vec<RingMap>, ConversionError> {
        assert_eq!(rings.len(), self.z.len(), "one ring of data for each of the population");
        for ring in rings {
            for (i, k) in self.terms().into_iter().enumerate() {
                let value = ring.z[i];
                for variance in [ring.variance[i], ring.direction_variance[i]] {
                    if !(value.is_finite() && variance.is_finite() && variance >= 0.0 && ring.z[0] > 0.0) {
                        return Err(ConversionError::NotFinite { k, value, variance });
                    }
                }
            }
        }
        let products = self.products(rings, learned);
        let everyone = vec![true; self.members.len()];
        let (weights, mixture) = products.mixture(&products.cross, products.own, &everyone, learned.neighbours);
        let residuals = self.residuals(&products, learned);
        Ok(rings
            .iter()
            .enumerate()
            .map(|(r, ring)| self.map(r, ring, &weights, &mixture, &residuals, learned))
            .collect())
    }

    /// Indices of the zonal functions with m >= 0.
    pub fn terms(&self) -> Vec<usize> {
        (0..=self.order).flat_map(|l| (0..=l as i32).map(move |m| index(l, m))).collect()
    }

    /// Inner products of members and data, each feature in units of its standard deviation.
    fn products(&self, rings: &[RingMean], learned: &Learned) -> Products {
        let crowding = (rings.len() as f64 / learned.independent_rings as f64).max(1.0);
        let logs: Vec<f64> = rings.iter().map(|r| r.z[0].ln()).collect();
        let mean = logs.iter().sum::<f64>() / logs.len() as f64;
        let (mut columns, mut data) = (Vec::new(), Vec::new());
        for (r, ring) in rings.iter().enumerate() {
            let dc = ring.z[0];
            let unit = |variance: f64| (crowding * (learned.misfit + variance / (dc * dc))).sqrt().recip();
            for k in 1..ring.z.len() {
                columns.push(self.z[r].column(k) * unit(ring.variance[k]));
                data.push(ring.z[k] / dc * unit(ring.variance[k]));
            }
            columns.push(self.levels.column(r) * unit(ring.variance[0]));
            data.push((logs[r] - mean) * unit(ring.variance[0]));
        }
        let x = DMatrix::from_columns(&columns);
        let data = DVector::from_vec(data);
        Products { gram: &x * x.transpose(), cross: &x * &data, own: data.norm_squared() }
    }

    /// Row = member: the member less its mixture of others, as weights of members.
    fn residuals(&self, products: &Products, learned: &Learned) -> DMatrix<f64> {
        let n = self.members.len();
        let mut residuals = DMatrix::identity(n, n);
        for (i, member) in self.members.iter().enumerate() {
            let others: Vec<bool> =
                self.members.iter().map(|m| m.material != member.material && m.family != member.family).collect();
            let cross = products.gram.column(i).into_owned();
            let near = (learned.neighbours / 2).max(1);
            let (_, mixture) = products.mixture(&cross, products.gram[(i, i)], &others, near);
            residuals.row_mut(i).zip_apply(&mixture.transpose(), |r, m| *r -= m);
        }
        residuals
    }

    fn map(
        &self,
        r: usize,
        ring: &RingMean,
        weights: &DVector<f64>,
        mixture: &DVector<f64>,
        residuals: &DMatrix<f64>,
        learned: &Learned,
    ) -> RingMap {
        let dc = ring.z[0];
        let (z_mean, y_mean) = (self.z[r].tr_mul(mixture), self.y[r].tr_mul(mixture));
        let mut roots = residuals.clone();
        for (mut row, w) in roots.row_iter_mut().zip(weights.iter()) {
            row.scale_mut(w.sqrt());
        }
        let (z_errors, y_errors) = (&roots * &self.z[r], &roots * &self.y[r]);
        let noise: f64 = ring.variance.iter().map(|v| v / (dc * dc)).sum();
        let innovation: f64 = ring.z.iter().zip(z_mean.iter()).map(|(z, m)| (z / dc - m).powi(2)).sum();
        let surprise = (innovation / (z_errors.norm_squared() + noise)).max(1.0);
        let spread = surprise.sqrt() * learned.widening * dc;
        let follow = self.follow((innovation - noise).max(0.0));
        let population = self.y[r].row_variance();
        let mut deviations = DMatrix::zeros(self.members.len(), y_mean.len());
        let (mut blocks, mut at, mut condition) = (Vec::new(), 0, 1.0f64);
        for m in 0..self.sh_order {
            let degrees = Family::Odd.degrees(self.sh_order, m);
            let rows = degrees.len();
            let columns = self.columns(m);
            let variance: Vec<f64> =
                columns.iter().map(|&c| ring.direction_variance[c] / (dc * dc) + learned.fidelity).collect();
            let factor = self.factors.iter().find(|f| f.m == m);
            let (matrix, of_block) =
                factor.map_or_else(|| (DMatrix::zeros(rows, 0), 1.0), |f| following(f, follow, &variance));
            condition = condition.max(of_block);
            let left = y_errors.columns(at, rows) - z_errors.select_columns(&columns) * matrix.transpose();
            deviations.columns_mut(at, rows).copy_from(&(&left * spread));
            let z_block = DVector::from_iterator(columns.len(), columns.iter().map(|&c| z_mean[c]));
            let offset = (y_mean.rows(at, rows) - &matrix * z_block) * dc;
            let variance: Vec<f64> = left.column_iter().map(|c| c.norm_squared() * spread * spread).collect();
            let share = |(i, v): (usize, &f64)| (1.0 - v / (dc * dc) / population[at + i].max(1e-300)).clamp(0.0, 1.0);
            blocks.push(RingBlock {
                m,
                degrees,
                offset: offset.iter().copied().collect(),
                data_share: variance.iter().enumerate().map(share).collect(),
                variance,
                matrix,
            });
            at += rows;
        }
        RingMap { blocks, deviations, surprise, condition }
    }

    /// Prior variance of every Slepian function in the zone that makes an innovation of this power as likely as can be.
    fn follow(&self, power: f64) -> f64 {
        let seen = |f: &Factor| (DMatrix::from_diagonal(&slepian_gains(f)) * &f.projected).norm_squared();
        let seen: f64 = self.factors.iter().map(seen).sum();
        (power / seen.max(1e-300)).max(1e-9)
    }

    /// Positions among the terms of the zonal functions m..=L of one m.
    fn columns(&self, m: usize) -> Vec<usize> {
        (m..=self.order).map(|l| l * (l + 1) / 2 + m).collect()
    }
}

impl RingMap {
    /// Coefficients of all harmonics up to `sh_order` in one exitant direction at `phi_o` (radians), from the zonal
    /// coefficients there and their variances, index k in both.
    ///
    /// # Errors
    /// [`ConversionError::NotFinite`].
    pub fn estimate(&self, z: &[f64], variance: &[f64], phi_o: f64) -> Result<Estimate, ConversionError> {
        require_finite(z, variance)?;
        let n = size(self.blocks.len());
        let mut estimate = Estimate { y: vec![0.0; n], sigma: vec![0.0; n], data_share: vec![0.0; n] };
        for block in &self.blocks {
            let m = block.m as i32;
            let (sin, cos) = (f64::from(m) * phi_o).sin_cos();
            for (row, &l) in block.degrees.iter().enumerate() {
                for (sign, turned) in [(1, cos), (-1, sin)].into_iter().take(if m == 0 { 1 } else { 2 }) {
                    let (mut y, mut v) = (block.offset[row] * turned, block.variance[row] * turned * turned);
                    for col in 0..block.matrix.ncols() {
                        let (c, k) = (block.matrix[(row, col)], index(block.m + col, sign * m));
                        y += c * z[k];
                        v += c * c * variance[k];
                    }
                    let k = index(l, sign * m);
                    (estimate.y[k], estimate.sigma[k]) = (y, v.sqrt());
                    estimate.data_share[k] = block.data_share[row];
                }
            }
        }
        Ok(estimate)
    }

    /// Noise gains in and out of the zone: see [`super::Conversion::noise_gain_in`].
    pub fn noise_gains(&self, population: &Population) -> [f64; 2] {
        let blocks = self.blocks.iter().filter(|b| b.matrix.ncols() > 0).map(|b| (b.m, &b.matrix));
        population.regions.gains(population.order, blocks)
    }

    /// Variance of the reconstruction in one incident direction for `wo` at phi_o = 0: `functions` holds all harmonics there,
    /// `variance` those of the zonal coefficients, index k in both. First the model's part, then the noise's.
    pub fn variance_at(&self, functions: &[f64], variance: &[f64]) -> [f64; 2] {
        let (mut row, mut noise) = (Vec::new(), 0.0);
        for block in &self.blocks {
            let m = block.m as i32;
            row.extend(block.degrees.iter().map(|&l| functions[index(l, m)]));
            for sign in [1, -1].into_iter().take(if m == 0 { 1 } else { 2 }) {
                for col in 0..block.matrix.ncols() {
                    let column = block.matrix.column(col);
                    let rows = block.degrees.iter().zip(column.iter());
                    let gain: f64 = rows.map(|(&l, c)| c * functions[index(l, sign * m)]).sum();
                    noise += gain * gain * variance[index(block.m + col, sign * m)];
                }
            }
        }
        [(&self.deviations * DVector::from_vec(row)).norm_squared(), noise]
    }
}

/// Singular values of the Slepian functions that lie in the zone; 0 for others.
fn slepian_gains(factor: &Factor) -> DVector<f64> {
    factor.s.map(|s| {
        let share = s * s / Family::Odd.energy();
        if share >= CONCENTRATED { s * share.sqrt() } else { 0.0 }
    })
}

/// S A^T (A S A^T + R)^-1 and the condition number of the inverse, for the covariance S = `prior` V diag(share) V^T and R = diag(`variance`).
fn following(factor: &Factor, prior: f64, variance: &[f64]) -> (DMatrix<f64>, f64) {
    let gains = slepian_gains(factor);
    let seen = DMatrix::from_diagonal(&gains) * &factor.projected;
    let mut total = seen.transpose() * &seen * prior;
    for (i, v) in variance.iter().enumerate() {
        total[(i, i)] += v;
    }
    // V diag(share s) P: one root of the share is in the gains.
    let roots = factor.s.zip_map(&gains, |s, g| if s > 0.0 { g / s } else { 0.0 });
    let cross = &factor.v * DMatrix::from_diagonal(&roots) * seen * prior;
    let eigenvalues = total.symmetric_eigenvalues();
    let inverse = total.cholesky().expect("variances are positive").inverse();
    (cross * inverse, eigenvalues.max() / eigenvalues.min())
}

/// Inner products of features in units of their standard deviations.
struct Products {
    /// Members with members.
    gram: DMatrix<f64>,
    /// Members with the data.
    cross: DVector<f64>,
    /// The data with themselves.
    own: f64,
}

impl Products {
    /// Weights of the members near a target, and the mixture (sum 1) that explains it: the posterior mean of a Gaussian
    /// with the weighted members' mean and covariance.
    fn mixture(
        &self,
        cross: &DVector<f64>,
        own: f64,
        allowed: &[bool],
        neighbours: usize,
    ) -> (DVector<f64>, DVector<f64>) {
        let n = cross.len();
        let distance =
            |i: usize| if allowed[i] { (self.gram[(i, i)] - 2.0 * cross[i] + own).max(0.0) } else { f64::INFINITY };
        let distances: Vec<f64> = (0..n).map(distance).collect();
        let mut sorted: Vec<f64> = distances.iter().copied().filter(|d| d.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let count = sorted.len() as f64;
        let near = sorted[neighbours.min(sorted.len() - 1)].max(f64::MIN_POSITIVE);
        let mut w = DVector::from_iterator(n, distances.iter().map(|d| 1.0 / (1.0 + (d / near).powi(2))));
        let sum = w.sum();
        for (w, d) in w.iter_mut().zip(&distances) {
            *w = if d.is_finite() { (1.0 - EVERYONE) * *w / sum + EVERYONE / count } else { 0.0 };
        }
        let mean = &self.gram * &w;
        let (mean_own, mean_cross) = (mean.dot(&w), w.dot(cross));
        let roots = w.map(f64::sqrt);
        let system = DMatrix::from_fn(n, n, |i, j| {
            let one = if i == j { 1.0 } else { 0.0 };
            one + roots[i] * roots[j] * (self.gram[(i, j)] - mean[i] - mean[j] + mean_own)
        });
        let right = DVector::from_fn(n, |i, _| roots[i] * (cross[i] - mean[i] - mean_cross + mean_own));
        let q = system.cholesky().expect("a covariance plus one").solve(&right).component_mul(&roots);
        let rest = 1.0 - q.sum();
        let mixture = q + &w * rest;
        (w, mixture)
    }
}
