//! Fronts: which points no other beats, and the volume they dominate. Every coordinate is a gain: more is better.

/// Whether `a` is nowhere worse than `b` and somewhere better.
pub fn dominates(a: &[f64], b: &[f64]) -> bool {
    let pairs = || a.iter().zip(b);
    pairs().all(|(a, b)| a >= b) && pairs().any(|(a, b)| a > b)
}

/// Indices of the points that no other dominates, in their order; of equal points the first.
pub fn nondominated(points: &[Vec<f64>]) -> Vec<usize> {
    let beaten =
        |i: usize| points.iter().enumerate().any(|(j, p)| dominates(p, &points[i]) || (j < i && *p == points[i]));
    (0..points.len()).filter(|&i| !beaten(i)).collect()
}

/// Volume of the union of the boxes from the origin to each point; points with a gain that is not above 0 add nothing.
///
/// Exclusive volumes one after the other (While, Bradstreet and Barone 2012): exact, for some hundred points of two to five
/// coordinates.
pub fn hypervolume(points: &[Vec<f64>]) -> f64 {
    let inside = points.iter().filter(|p| p.iter().all(|x| *x > 0.0)).cloned().collect();
    of_front(front(inside))
}

fn front(points: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    nondominated(&points).into_iter().map(|i| points[i].clone()).collect()
}

fn of_front(mut points: Vec<Vec<f64>>) -> f64 {
    let dimension = points.first().map_or(0, Vec::len);
    points.sort_by(|a, b| b[dimension - 1].total_cmp(&a[dimension - 1]));
    if dimension == 2 {
        // From the highest down, each adds a strip beside those before.
        let widths = std::iter::once(0.0).chain(points.iter().map(|p| p[0]));
        return points.iter().zip(widths).map(|(p, before)| (p[0] - before) * p[1]).sum();
    }
    let exclusive = |(i, p): (usize, &Vec<f64>)| {
        let cut = |q: &Vec<f64>| p.iter().zip(q).map(|(a, b)| a.min(*b)).collect();
        p.iter().product::<f64>() - of_front(front(points[i + 1..].iter().map(cut).collect()))
    };
    points.iter().enumerate().map(exclusive).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    #[test]
    fn dominance_is_a_strict_order() {
        assert!(dominates(&[1.0, 2.0], &[1.0, 1.0]));
        assert!(!dominates(&[1.0, 2.0], &[1.0, 2.0]));
        assert!(!dominates(&[1.0, 2.0], &[2.0, 1.0]) && !dominates(&[2.0, 1.0], &[1.0, 2.0]));
        let points = [[1.0, 3.0], [2.0, 2.0], [1.0, 2.0], [3.0, 1.0], [2.0, 2.0]].map(|p| p.to_vec());
        assert_eq!(nondominated(&points), [0, 1, 3]);
    }

    #[test]
    fn volumes_of_known_fronts() {
        let of = |points: &[&[f64]]| hypervolume(&points.iter().map(|p| p.to_vec()).collect::<Vec<_>>());
        assert_eq!(of(&[]), 0.0);
        assert_eq!(of(&[&[2.0, 3.0]]), 6.0);
        assert_eq!(of(&[&[1.0, 3.0], &[2.0, 2.0], &[3.0, 1.0], &[1.0, 1.0], &[-1.0, 9.0]]), 6.0);
        assert_eq!(of(&[&[2.0, 3.0, 4.0]]), 24.0);
        // By inclusion and exclusion: 3 x 3 - 3 x 1 + 1 with sides 3, 1, 1 turned about.
        assert_eq!(of(&[&[3.0, 1.0, 1.0], &[1.0, 3.0, 1.0], &[1.0, 1.0, 3.0]]), 7.0);
        assert_eq!(of(&[&[2.0, 2.0, 1.0], &[1.0, 1.0, 2.0]]), 5.0);
    }

    #[test]
    fn volumes_against_random_points() {
        const DRAWS: usize = 200_000;
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(5);
        for dimension in [2, 3, 4, 5] {
            let points: Vec<Vec<f64>> =
                (0..20).map(|_| (0..dimension).map(|_| rng.random::<f64>()).collect()).collect();
            let hit = |x: &[f64]| points.iter().any(|p| p.iter().zip(x).all(|(p, x)| x <= p));
            let hits =
                (0..DRAWS).filter(|_| hit(&(0..dimension).map(|_| rng.random::<f64>()).collect::<Vec<_>>())).count();
            let share = hits as f64 / DRAWS as f64;
            // Four standard errors.
            let margin = 4.0 * (share * (1.0 - share) / DRAWS as f64).sqrt();
            assert!((hypervolume(&points) - share).abs() < margin, "{dimension}: {} {share}", hypervolume(&points));
        }
    }
}
