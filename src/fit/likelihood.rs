//! How well linear combinations of predicted columns explain the data.

use nalgebra::{DMatrix, DVector};

use super::{Forward, Observations};
use crate::basis::WeightedDual;

/// The data of some observations with weights, and what predicts them: r = w (z - sum over columns of x A), w = 1 / sigma.
///
/// Columns are vectors over `station * terms + term`; column 0 is always the Lambert part.
pub(super) struct Likelihood<'a> {
    pub forward: &'a Forward,
    pub lambert: &'a [f64],
    /// By channel.
    pub z: [Vec<f64>; 3],
    /// 1 / sigma by channel; 0 for data held out.
    pub weight: [Vec<f64>; 3],
}

/// Coefficients of some columns in all channels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Solution {
    /// `[column][channel]`, column 0 the Lambert part; never negative.
    pub x: Vec<[f64; 3]>,
    /// Sum of squared residuals over all channels.
    pub chi2: f64,
}

impl<'a> Likelihood<'a> {
    pub fn new(observations: &Observations, forward: &'a Forward, lambert: &'a [f64]) -> Self {
        let gather = |f: &dyn Fn([f64; 3], [f64; 3], usize) -> f64| {
            [0, 1, 2].map(|c| {
                observations
                    .stations
                    .iter()
                    .flat_map(|s| s.z.iter().zip(&s.sigma).map(move |(z, sigma)| (*z, *sigma)))
                    .map(|(z, sigma)| f(z, sigma, c))
                    .collect::<Vec<f64>>()
            })
        };
        Self { forward, lambert, z: gather(&|z, _, c| z[c]), weight: gather(&|_, sigma, c| 1.0 / sigma[c]) }
    }

    /// The same with the data that `held_out` marks left out of every sum.
    pub fn without(&self, held_out: &[bool]) -> Self {
        let weight = [0, 1, 2]
            .map(|c| self.weight[c].iter().zip(held_out).map(|(&w, &out)| if out { 0.0 } else { w }).collect());
        Self { forward: self.forward, lambert: self.lambert, z: self.z.clone(), weight }
    }

    /// The mean of the channels as channel 0, nothing in the others: a shape is found on it, channels share it.
    pub fn gray(&self) -> Self {
        let n = self.lambert.len();
        let z = (0..n).map(|i| self.z.iter().map(|z| z[i]).sum::<f64>() / 3.0).collect();
        let weight = (0..n)
            .map(|i| {
                let variance: f64 = self.weight.iter().map(|w| w[i].powi(-2)).sum();
                3.0 / variance.sqrt()
            })
            .collect();
        Self {
            forward: self.forward,
            lambert: self.lambert,
            z: [z, vec![0.0; n], vec![0.0; n]],
            weight: [weight, vec![0.0; n], vec![0.0; n]],
        }
    }

    /// Number of data that count, all channels.
    pub fn len(&self) -> usize {
        self.weight.iter().flatten().filter(|w| **w > 0.0).count()
    }

    /// The best non-negative coefficients, each channel by itself.
    pub fn solve(&self, columns: &[Vec<f64>]) -> Solution {
        let mut x = vec![[0.0; 3]; columns.len() + 1];
        let mut chi2 = 0.0;
        for c in 0..3 {
            let solution = self.dual(columns, c).non_negative();
            x.iter_mut().zip(solution.x.iter()).for_each(|(x, s)| x[c] = *s);
            chi2 += solution.chi2;
        }
        Solution { x, chi2 }
    }

    /// The normal equations of one channel.
    pub fn dual(&self, columns: &[Vec<f64>], channel: usize) -> WeightedDual {
        let mut dual = WeightedDual::new(columns.len() + 1);
        let mut row = vec![0.0; columns.len() + 1];
        for (i, (&z, &w)) in self.z[channel].iter().zip(&self.weight[channel]).enumerate() {
            if w > 0.0 {
                row[0] = self.lambert[i];
                row[1..].iter_mut().zip(columns).for_each(|(r, column)| *r = column[i]);
                dual.add(&row, z, w * w);
            }
        }
        dual
    }

    /// What a solution predicts for one channel.
    pub fn predict(&self, columns: &[Vec<f64>], x: &[[f64; 3]], channel: usize) -> Vec<f64> {
        let mut prediction: Vec<f64> = self.lambert.iter().map(|l| x[0][channel] * l).collect();
        for (column, x) in columns.iter().zip(&x[1..]) {
            if x[channel] != 0.0 {
                prediction.iter_mut().zip(column).for_each(|(p, a)| *p += x[channel] * a);
            }
        }
        prediction
    }

    /// Weighted residuals of a solution, channel after channel.
    pub fn residuals(&self, columns: &[Vec<f64>], x: &[[f64; 3]]) -> DVector<f64> {
        let all = (0..3).flat_map(|c| {
            let prediction = self.predict(columns, x, c);
            let parts: Vec<f64> =
                prediction.iter().zip(&self.z[c]).zip(&self.weight[c]).map(|((p, z), w)| w * (z - p)).collect();
            parts
        });
        DVector::from_iterator(3 * self.lambert.len(), all)
    }

    /// Takes from weighted vectors (columns over all channels) what the free columns of a solution could follow.
    pub fn project_out(&self, columns: &[Vec<f64>], x: &[[f64; 3]], vectors: &mut DMatrix<f64>) {
        let n = self.lambert.len();
        for c in 0..3 {
            let free: Vec<&[f64]> = std::iter::once(self.lambert)
                .chain(columns.iter().map(Vec::as_slice))
                .zip(x)
                .filter(|(_, x)| x[c] > 0.0)
                .map(|(column, _)| column)
                .collect();
            if free.is_empty() {
                continue;
            }
            let q = DMatrix::from_fn(n, free.len(), |i, j| self.weight[c][i] * free[j][i]).qr().q();
            let mut block = vectors.rows_mut(c * n, n);
            let along = q.tr_mul(&block);
            block -= q * along;
        }
    }
}
