//! Many directions at once.

use pulp::Arch;

use super::Harmonics;
use crate::geometry::{Direction, Sample};

/// Directions that go through the recurrences side by side.
const LANES: usize = 8;

type Lanes = [f64; LANES];

impl Harmonics {
    /// All functions in each of many directions, into `out`: index `direction * len() + k`. One core; the widest vectors
    /// the processor has.
    ///
    /// # Panics
    /// If `out` is not `directions.len() * len()` long.
    pub fn eval_many_into(&self, directions: &[Direction<Sample>], out: &mut [f64]) {
        assert_eq!(out.len(), directions.len() * self.len(), "one row of functions for each direction");
        Arch::new().dispatch(
            #[inline(always)]
            || self.blocks(directions, out),
        );
    }

    #[inline(always)]
    fn blocks(&self, directions: &[Direction<Sample>], out: &mut [f64]) {
        let n = self.len();
        let mut columns = vec![[0.0; LANES]; n];
        for (directions, out) in directions.chunks(LANES).zip(out.chunks_mut(LANES * n)) {
            // The last block repeats its first direction.
            let lane = |i: usize| directions.get(i).unwrap_or(&directions[0]).vector();
            let mut at = Block::default();
            for i in 0..LANES {
                let v = lane(i);
                let r = (v.x * v.x + v.y * v.y).sqrt();
                let scale = if r > 0.0 { 1.0 / r } else { 0.0 };
                at.mu[i] = v.z;
                at.cos[i] = if r > 0.0 { v.x * scale } else { 1.0 };
                at.sin[i] = v.y * scale;
            }
            self.columns(&at, &mut columns);
            transpose(&columns, n, directions.len(), out);
        }
    }
}

/// Some directions, by component.
#[derive(Default)]
struct Block {
    mu: Lanes,
    cos: Lanes,
    sin: Lanes,
}

#[inline(always)]
fn map2(a: &Lanes, b: &Lanes, f: impl Fn(f64, f64) -> f64) -> Lanes {
    let mut out = [0.0; LANES];
    for i in 0..LANES {
        out[i] = f(a[i], b[i]);
    }
    out
}

impl Harmonics {
    /// The recurrences of [`Harmonics::eval_into`], lane by lane: `columns[k]` holds function k in every lane.
    #[inline(always)]
    fn columns(&self, at: &Block, columns: &mut [Lanes]) {
        let (a, b) = (self.zone.cos_min(), self.zone.cos_max());
        let scale = 1.0 / (a - b);
        let (mut x, mut root, mut sign, mut end) = ([0.0; LANES], [0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            let (to_a, to_b) = (at.mu[i] - a, at.mu[i] - b);
            x[i] = (to_a + to_b) / (a - b);
            root[i] = 2.0 * (to_a * to_b).abs().sqrt() * scale;
            sign[i] = if x[i] < 0.0 { -1.0 } else { 1.0 };
            end[i] = if x[i] < 0.0 { 2.0 * to_b / (a - b) } else { -2.0 * to_a / (a - b) };
        }
        let dc = self.dc();
        let (mut p, mut difference, mut parity) = ([1.0; LANES], [0.0; LANES], [1.0; LANES]);
        columns[0] = [dc; LANES];
        for l in 1..=self.order {
            let l1 = l as f64;
            let (keep, turn) = ((l1 - 1.0) / l1, (2.0 * l1 - 1.0) / l1);
            let norm = (2.0 * l1 + 1.0).sqrt() * dc;
            let column = &mut columns[l * (l + 1)];
            for i in 0..LANES {
                difference[i] = keep * difference[i] - turn * end[i] * p[i];
                p[i] += difference[i];
                parity[i] *= sign[i];
                column[i] = parity[i] * norm * p[i];
            }
        }
        let mut diagonal = [dc * 2f64.sqrt(); LANES];
        let (mut cos, mut sin) = ([1.0; LANES], [0.0; LANES]);
        for m in 1..=self.order {
            let steps = &self.steps[m];
            let step = steps[0].0;
            for i in 0..LANES {
                diagonal[i] *= step * root[i];
                (cos[i], sin[i]) = (cos[i] * at.cos[i] - sin[i] * at.sin[i], sin[i] * at.cos[i] + cos[i] * at.sin[i]);
            }
            let (mut before, mut p) = ([0.0; LANES], diagonal);
            columns[m * (m + 1) + m] = map2(&p, &cos, |p, c| p * c);
            columns[m * (m + 1) - m] = map2(&p, &sin, |p, s| p * s);
            for (l, &(first, second)) in (m + 1..).zip(&steps[1..]) {
                let mut next = [0.0; LANES];
                for i in 0..LANES {
                    next[i] = first * x[i] * p[i] - second * before[i];
                }
                (before, p) = (p, next);
                columns[l * (l + 1) + m] = map2(&p, &cos, |p, c| p * c);
                columns[l * (l + 1) - m] = map2(&p, &sin, |p, s| p * s);
            }
        }
    }
}

/// Columns of lanes to rows of functions, for the first `directions` lanes.
#[inline(always)]
fn transpose(columns: &[Lanes], n: usize, directions: usize, out: &mut [f64]) {
    const TILE: usize = 8;
    let whole = if directions == LANES { n / TILE * TILE } else { 0 };
    for k in (0..whole).step_by(TILE) {
        let tile: &[Lanes; TILE] = columns[k..k + TILE].try_into().expect("a whole tile");
        for lane in 0..LANES {
            let row: &mut [f64; TILE] = (&mut out[lane * n + k..][..TILE]).try_into().expect("a whole tile");
            *row = std::array::from_fn(|t| tile[t][lane]);
        }
    }
    for k in whole..n {
        for lane in 0..directions {
            out[lane * n + k] = columns[k][lane];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Zone;

    #[test]
    fn batches_are_what_single_directions_are() {
        // The same recurrences in another order of operations, relative to values of about sqrt(order).
        const SAME: f64 = 1e-13;
        for zone in [Zone::sphere(), Zone::from_degrees(9.0, 57.0).unwrap()] {
            for order in [0, 1, 2, 6, 13, 50] {
                let basis = Harmonics::zonal(zone, order).unwrap();
                for count in [0, 1, 7, 8, 21] {
                    let directions: Vec<Direction<Sample>> = (0..count)
                        .map(|i| {
                            let mu = zone.cos_max() + (zone.cos_min() - zone.cos_max()) * f64::from(i) / 20.0;
                            Direction::from_mu_phi(mu, 2.4 * f64::from(i))
                        })
                        .collect();
                    let mut out = vec![f64::NAN; directions.len() * basis.len()];
                    basis.eval_many_into(&directions, &mut out);
                    for (d, row) in directions.iter().zip(out.chunks_exact(basis.len())) {
                        for (got, want) in row.iter().zip(basis.eval(d)) {
                            assert!((got - want).abs() < SAME * (basis.len() as f64).sqrt(), "{got} {want}");
                        }
                    }
                }
            }
        }
    }
}
