//! Least squares whose unknowns have a lower bound.

use nalgebra::{DMatrix, DVector};

/// Exchanges of bound and free unknowns at most, for each unknown.
const EXCHANGES: usize = 20;
/// Without progress over so many exchanges one unknown is exchanged at a time, which cannot run in circles.
const PATIENCE: usize = 5;

/// The minimum of `x' H x / 2 - b' x` over all x >= `floor`, H symmetric and positive definite: block principal pivoting
/// (Portugal, Judice and Vicente 1994). `None` if H is singular.
pub(super) fn bounded_minimum(h: &DMatrix<f64>, b: &DVector<f64>, floor: f64) -> Option<DVector<f64>> {
    let n = b.len();
    // y = x - floor >= 0.
    let c = b - h * DVector::from_element(n, floor);
    let tolerance = 1e-10 * c.amax();
    let mut free = vec![true; n];
    let (mut fewest, mut patience) = (n + 1, PATIENCE);
    for _ in 0..EXCHANGES * n {
        let set: Vec<usize> = (0..n).filter(|&i| free[i]).collect();
        let mut y = DVector::zeros(n);
        if !set.is_empty() {
            let solved = h.select_rows(&set).select_columns(&set).cholesky()?.solve(&c.select_rows(&set));
            set.iter().zip(solved.iter()).for_each(|(&i, v)| y[i] = *v);
        }
        let gradient = h * &y - &c;
        let wrong: Vec<usize> =
            (0..n).filter(|&i| if free[i] { y[i] < 0.0 } else { gradient[i] < -tolerance }).collect();
        let Some(&last) = wrong.last() else { return Some(y.add_scalar(floor)) };
        if wrong.len() < fewest {
            (fewest, patience) = (wrong.len(), PATIENCE);
        } else {
            patience = patience.saturating_sub(1);
        }
        let exchanged = if patience > 0 { &wrong[..] } else { &[last][..] };
        exchanged.iter().for_each(|&i| free[i] = !free[i]);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Karush, Kuhn and Tucker: on the bound the gradient pushes against it, elsewhere it vanishes.
        #[test]
        fn the_minimum_fulfils_its_conditions(values in proptest::collection::vec(-1.0..1.0f64, 90), floor in -0.5..0.5f64) {
            let a = DMatrix::from_column_slice(10, 8, &values[..80]);
            let h = a.transpose() * &a + 0.01 * DMatrix::identity(8, 8);
            let b = DVector::from_column_slice(&values[80..88]);
            let x = bounded_minimum(&h, &b, floor).unwrap();
            let gradient = &h * &x - &b;
            for i in 0..8 {
                prop_assert!(x[i] >= floor && gradient[i] > -1e-8);
                prop_assert!((x[i] - floor) * gradient[i] < 1e-7);
            }
        }
    }

    #[test]
    fn singular_systems_have_no_minimum() {
        assert_eq!(bounded_minimum(&DMatrix::zeros(2, 2), &DVector::from_element(2, 1.0), 0.0), None);
    }
}
