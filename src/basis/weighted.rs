//! The weighted dual: linear coefficients of given columns from data with standard errors, free or non-negative.

use nalgebra::{DMatrix, DVector};

/// Normal equations of a weighted least-squares problem: min over x of sum over i of w_i (b_i - (A x)_i)^2.
///
/// With unit weights and orthonormal rows the solution applies the dual basis of the columns; weights 1 / sigma^2 make it
/// the estimate of least variance. Problems add up, so data may come in parts.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightedDual {
    gram: DMatrix<f64>,
    right: DVector<f64>,
    power: f64,
}

/// Coefficients of a weighted problem.
#[derive(Debug, Clone, PartialEq)]
pub struct DualSolution {
    /// One coefficient per column.
    pub x: DVector<f64>,
    /// sum of w (b - A x)^2.
    pub chi2: f64,
}

impl WeightedDual {
    /// An empty problem with this many columns.
    pub fn new(columns: usize) -> Self {
        Self { gram: DMatrix::zeros(columns, columns), right: DVector::zeros(columns), power: 0.0 }
    }

    /// Adds one datum `b` with the weight `w` = 1 / sigma^2 and its row of the matrix.
    pub fn add(&mut self, row: &[f64], b: f64, w: f64) {
        for (j, &a) in row.iter().enumerate() {
            let wa = w * a;
            self.right[j] += wa * b;
            for (i, &other) in row.iter().enumerate().take(j + 1) {
                self.gram[(i, j)] += wa * other;
            }
        }
        self.power += w * b * b;
    }

    /// From known sums: A^T W A (its upper triangle is used), A^T W b and b^T W b.
    pub fn from_sums(gram: DMatrix<f64>, right: DVector<f64>, power: f64) -> Self {
        Self { gram, right, power }
    }

    /// The problem with only some of its columns.
    pub fn subset(&self, columns: &[usize]) -> Self {
        let n = columns.len();
        let gram = DMatrix::from_fn(n, n, |i, j| {
            let (p, q) = (columns[i], columns[j]);
            self.gram[(p.min(q), p.max(q))]
        });
        Self { gram, right: DVector::from_fn(n, |i, _| self.right[columns[i]]), power: self.power }
    }

    /// Minimises over x >= 0 (Lawson & Hanson 1974, chapter 23, on normal equations of unit diagonal).
    ///
    /// Columns that vanish, or that repeat others to rounding, get 0.
    pub fn non_negative(&self) -> DualSolution {
        let n = self.right.len();
        let scale = DVector::from_fn(n, |i, _| {
            let norm = self.gram[(i, i)].sqrt();
            if norm > 0.0 { 1.0 / norm } else { 0.0 }
        });
        let gram = DMatrix::from_fn(n, n, |i, j| self.gram[(i.min(j), i.max(j))] * scale[i] * scale[j]);
        let right = DVector::from_fn(n, |i, _| self.right[i] * scale[i]);
        let mut x = DVector::zeros(n);
        let mut passive: Vec<usize> = Vec::new();
        let mut refused = vec![false; n];
        let least = GRADIENT * right.amax();
        // Each round lowers the error and no passive set returns; the bound is for rounding's sake.
        for _ in 0..10 * n + 10 {
            let gradient = &right - &gram * &x;
            let best = (0..n)
                .filter(|i| !passive.contains(i) && !refused[*i] && gradient[*i] > least)
                .max_by(|&i, &j| gradient[i].total_cmp(&gradient[j]));
            let Some(entering) = best else { break };
            passive.push(entering);
            loop {
                let Some(wanted) = solve_passive(&gram, &right, &passive) else {
                    passive.retain(|&i| i != entering);
                    refused[entering] = true;
                    break;
                };
                if wanted.iter().all(|&v| v > 0.0) {
                    x.fill(0.0);
                    passive.iter().zip(wanted.iter()).for_each(|(&i, &v)| x[i] = v);
                    refused.fill(false);
                    break;
                }
                if wanted[passive.len() - 1] <= 0.0 && passive.last() == Some(&entering) && x[entering] == 0.0 {
                    // Rounding: its gradient says up, the solution says down.
                    passive.pop();
                    refused[entering] = true;
                    break;
                }
                let step = passive
                    .iter()
                    .zip(wanted.iter())
                    .filter(|(_, v)| **v <= 0.0)
                    .map(|(&i, &v)| x[i] / (x[i] - v))
                    .fold(1.0, f64::min);
                for (&i, &v) in passive.iter().zip(wanted.iter()) {
                    x[i] += step * (v - x[i]);
                }
                let largest = x.amax();
                passive.retain(|&i| x[i] > EMPTY * largest);
                (0..n).filter(|i| !passive.contains(i)).for_each(|i| x[i] = 0.0);
            }
        }
        let chi2 = (self.power - 2.0 * right.dot(&x) + (&gram * &x).dot(&x)).max(0.0);
        DualSolution { x: x.component_mul(&scale), chi2 }
    }
}

/// Gradients below this share of the largest right-hand side are rounding.
const GRADIENT: f64 = 1e-11;
/// Coefficients below this share of the largest have left the passive set.
const EMPTY: f64 = 1e-14;
/// Pivots below this mark a column as a repetition of others.
const REPEATED: f64 = 1e-12;

fn solve_passive(gram: &DMatrix<f64>, right: &DVector<f64>, passive: &[usize]) -> Option<DVector<f64>> {
    let n = passive.len();
    let sub = DMatrix::from_fn(n, n, |i, j| gram[(passive[i], passive[j])]);
    let factor = sub.cholesky()?;
    let diagonal = factor.l_dirty().diagonal();
    if diagonal.iter().any(|d| d * d < REPEATED) {
        return None;
    }
    Some(factor.solve(&DVector::from_fn(n, |i, _| right[passive[i]])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn problem(rows: usize, columns: usize, seed: u64) -> (DMatrix<f64>, DVector<f64>) {
        use rand::{RngExt, SeedableRng};
        let mut rng = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(seed);
        let a = DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-1.0..1.0));
        let b = DVector::from_fn(rows, |_, _| rng.random_range(-1.0..1.0));
        (a, b)
    }

    proptest! {
        /// Karush-Kuhn-Tucker: x >= 0, the gradient points down nowhere, and vanishes where x > 0.
        #[test]
        fn non_negative_solutions_are_optimal(rows in 1usize..30, columns in 1usize..12, seed in 0u64..1000) {
            let (a, b) = problem(rows, columns, seed);
            let mut dual = WeightedDual::new(columns);
            for i in 0..rows {
                dual.add(a.row(i).transpose().as_slice(), b[i], 2.0);
            }
            let solution = dual.non_negative();
            let residual = &b - &a * &solution.x;
            prop_assert!((solution.chi2 - 2.0 * residual.norm_squared()).abs() < 1e-9);
            let gradient = a.transpose() * residual;
            for j in 0..columns {
                prop_assert!(solution.x[j] >= 0.0);
                prop_assert!(gradient[j] < 1e-8, "{} at {j}", gradient[j]);
                prop_assert!(solution.x[j] == 0.0 || gradient[j].abs() < 1e-8);
            }
        }
    }

    #[test]
    fn repeated_and_empty_columns_do_no_harm() {
        let mut dual = WeightedDual::new(3);
        for (a, b) in [(1.0, 2.0), (2.0, 4.1), (3.0, 5.9)] {
            dual.add(&[a, a, 0.0], b, 1.0);
        }
        let x = dual.non_negative().x;
        assert!((x[0] + x[1] - 27.9 / 14.0).abs() < 1e-12 && x[2] == 0.0);
        assert_eq!(dual.subset(&[2, 0]).non_negative().x[0], 0.0);
    }
}
