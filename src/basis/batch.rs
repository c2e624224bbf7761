//! Many directions at once.

use std::ops::Range;

use nalgebra::{RealField, convert};
use pulp::{Arch, Simd, WithSimd, bytemuck::cast};
use rayon::prelude::*;
use thiserror::Error;

use super::Harmonics;
use crate::geometry::{Direction, Sample};

/// Rows of up to this many functions are written one after the other, in the order the memory's prefetcher follows; longer
/// ones for 8 directions at once, in tiles. Measured, as all that is chosen here: `benches/evaluation.rs`.
const WHOLE: usize = 128;
/// Functions between two such writes, whose columns are still in the nearest cache.
const BAND: usize = 16;
/// Directions one core takes at a time.
const SHARE: usize = 1024;
/// What f32 must hold: error relative to a function's maximum over its zone, against f64 in the same f32 directions.
pub const F32_ERROR: f64 = 1e-5;
/// Largest order at which f32 holds [`F32_ERROR`]: there errors reach 6e-6 on the sphere and on zones wide and narrow alike,
/// since x' itself comes from f64; at order 30 they reach 1.2e-5.
pub const F32_MAX_ORDER: usize = 20;

/// An order too high for f32.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error(
    "order {0} is too high for f32, which holds errors of {F32_ERROR:e} up to order {F32_MAX_ORDER}: \
     call eval_many_into, which computes in f64"
)]
pub struct PrecisionError(pub usize);

impl Harmonics {
    /// All functions in each of many directions, into `out`: index `direction * len() + k`. One core; the widest vectors
    /// the processor has.
    ///
    /// # Panics
    /// If `out` is not `directions.len() * len()` long.
    pub fn eval_many_into(&self, directions: &[Direction<Sample>], out: &mut [f64]) {
        assert_eq!(out.len(), directions.len() * self.len(), "one row of functions for each direction");
        let arch = Arch::new();
        if self.len() <= WHOLE {
            arch.dispatch(Batch::<_, _, 8, false> { basis: self, directions, out });
        } else {
            arch.dispatch(Batch::<_, _, 8, true> { basis: self, directions, out });
        }
    }

    /// [`Harmonics::eval_many_into`] on all cores: the same bits, whatever their number.
    ///
    /// # Panics
    /// If `out` is not `directions.len() * len()` long.
    pub fn par_eval_many_into(&self, directions: &[Direction<Sample>], out: &mut [f64]) {
        assert_eq!(out.len(), directions.len() * self.len(), "one row of functions for each direction");
        let rows = out.par_chunks_mut(SHARE * self.len());
        directions.par_chunks(SHARE).zip(rows).for_each(|(directions, rows)| self.eval_many_into(directions, rows));
    }

    /// All functions in each of many unit vectors [x, y, z] in f32, into `out`: index `direction * len() + k`. One core.
    ///
    /// Errors stay below [`F32_ERROR`] of each function's maximum over the zone, for directions inside of it.
    ///
    /// # Errors
    /// [`PrecisionError`] above [`F32_MAX_ORDER`].
    ///
    /// # Panics
    /// If `out` is not `directions.len() * len()` long.
    pub fn eval_many_f32_into(&self, directions: &[[f32; 3]], out: &mut [f32]) -> Result<(), PrecisionError> {
        if self.order > F32_MAX_ORDER {
            return Err(PrecisionError(self.order));
        }
        assert_eq!(out.len(), directions.len() * self.len(), "one row of functions for each direction");
        Arch::new().dispatch(Batch::<_, _, 8, false> { basis: self, directions, out });
        Ok(())
    }
}

/// A number of the recurrences.
trait Lane: RealField + Copy + Default {
    /// Rows for columns.
    #[inline(always)]
    fn transposed<S: Simd>(_: S, tile: [[Self; 4]; 4]) -> [[Self; 4]; 4] {
        std::array::from_fn(|i| std::array::from_fn(|j| tile[j][i]))
    }
}

impl Lane for f32 {}

impl Lane for f64 {
    /// In registers where four lanes fill one: left to itself the compiler stores one number at a time.
    #[inline(always)]
    fn transposed<S: Simd>(simd: S, tile: [[f64; 4]; 4]) -> [[f64; 4]; 4] {
        if S::F64_LANES == 4 {
            let registers: [S::f64s; 4] = cast(tile);
            cast(simd.deinterleave_shfl_f64s(registers))
        } else {
            std::array::from_fn(|i| std::array::from_fn(|j| tile[j][i]))
        }
    }
}

/// A unit vector of any kind.
trait Components {
    fn components(&self) -> [f64; 3];
}

impl Components for Direction<Sample> {
    #[inline(always)]
    fn components(&self) -> [f64; 3] {
        let v = self.vector();
        [v.x, v.y, v.z]
    }
}

impl Components for [f32; 3] {
    #[inline(always)]
    fn components(&self) -> [f64; 3] {
        self.map(f64::from)
    }
}

/// One call: functions in `T`, `N` directions at a time, written in tiles or row after row.
struct Batch<'a, T, D, const N: usize, const TILES: bool> {
    basis: &'a Harmonics,
    directions: &'a [D],
    out: &'a mut [T],
}

/// What turns row l - 1 of the functions into row l.
struct Row<T> {
    /// Factors of the climb by differences of m = 0, and sqrt(2 l + 1).
    keep: T,
    turn: T,
    norm: T,
    /// From (l-1, l-1) to (l, l).
    step: T,
    /// From (l-1, l-1) to (l, l-1): the factor of x'.
    second: T,
    /// For |m| < l - 1, from the least m: factors of x' times row l - 1, and of row l - 2. Those of m = 0 are not used.
    climb: Vec<(T, T)>,
}

/// Some directions, by component.
struct Block<T, const N: usize> {
    /// x' of the zone.
    x: [T; N],
    /// s' cos(phi) and s' sin(phi).
    u: [T; N],
    v: [T; N],
    /// Sign of x', and 1 - |x'|.
    sign: [T; N],
    end: [T; N],
}

// A closure is not inlined into the function that has the vector instructions; this is.
impl<T: Lane, D: Components, const N: usize, const TILES: bool> WithSimd for Batch<'_, T, D, N, TILES> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (basis, n) = (self.basis, self.basis.len());
        let rows: Vec<Row<T>> = (1..=basis.order).map(|l| basis.row(l)).collect();
        let mut columns = vec![[T::zero(); N]; n];
        for (directions, out) in self.directions.chunks(N).zip(self.out.chunks_mut(N * n)) {
            let block = Block::new(basis, directions);
            block.fill::<S, TILES>(simd, convert(basis.dc()), &rows, &mut columns, out);
        }
    }
}

impl Harmonics {
    fn row<T: Lane>(&self, l: usize) -> Row<T> {
        let degree = l as f64;
        let factors = |m: usize| self.steps[m][l - m];
        Row {
            keep: convert((degree - 1.0) / degree),
            turn: convert((2.0 * degree - 1.0) / degree),
            norm: convert((2.0 * degree + 1.0).sqrt()),
            step: convert(factors(l).0),
            second: convert(factors(l - 1).0),
            climb: (2..2 * l - 1).map(|j| factors(j.abs_diff(l))).map(|(a, b)| (convert(a), convert(b))).collect(),
        }
    }
}

#[inline(always)]
fn lanes<T: Copy + Default, const N: usize>(f: impl Fn(usize) -> T) -> [T; N] {
    let mut out = [T::default(); N];
    for (i, out) in out.iter_mut().enumerate() {
        *out = f(i);
    }
    out
}

/// x, y and z of some directions; the last block repeats its first direction.
#[inline(always)]
fn by_component<D: Components, const N: usize>(directions: &[D]) -> [[f64; N]; 3] {
    let mut at = [[0.0; N]; 3];
    let mut put = |i: usize, d: &D| [at[0][i], at[1][i], at[2][i]] = d.components();
    match directions.first_chunk::<N>() {
        Some(all) => (0..N).for_each(|i| put(i, &all[i])),
        None => (0..N).for_each(|i| put(i, directions.get(i).unwrap_or(&directions[0]))),
    }
    at
}

impl<T: Lane, const N: usize> Block<T, N> {
    /// Always from f64: at an end of the zone mu - a has digits that are lost once a is rounded to f32.
    #[inline(always)]
    fn new<D: Components>(basis: &Harmonics, directions: &[D]) -> Self {
        let (a, b) = (basis.zone.cos_min(), basis.zone.cos_max());
        let scale = 1.0 / (a - b);
        let [px, py, pz] = by_component::<D, N>(directions);
        let (lower, upper): ([f64; N], [f64; N]) = (lanes(|i| pz[i] - a), lanes(|i| pz[i] - b));
        let square: [f64; N] = lanes(|i| px[i] * px[i] + py[i] * py[i]);
        // On the axis the azimuth is 0. Only numbers that exist are chosen from, or the choice becomes a branch for each lane.
        let on_axis: [bool; N] = lanes(|i| square[i] < f64::MIN_POSITIVE);
        let px: [f64; N] = lanes(|i| if on_axis[i] { 1.0 } else { px[i] });
        let py: [f64; N] = lanes(|i| if on_axis[i] { 0.0 } else { py[i] });
        let square: [f64; N] = lanes(|i| if on_axis[i] { 1.0 } else { square[i] });
        let per_r: [f64; N] = lanes(|i| 2.0 * scale.abs() * ((lower[i] * upper[i]).abs() / square[i]).sqrt());
        let x: [f64; N] = lanes(|i| (lower[i] + upper[i]) * scale);
        let (to_upper, to_lower): ([f64; N], [f64; N]) =
            (lanes(|i| 2.0 * upper[i] * scale), lanes(|i| -2.0 * lower[i] * scale));
        Self {
            u: lanes(|i| convert(px[i] * per_r[i])),
            v: lanes(|i| convert(py[i] * per_r[i])),
            sign: lanes(|i| convert(if x[i] < 0.0 { -1.0 } else { 1.0 })),
            end: lanes(|i| convert(if x[i] < 0.0 { to_upper[i] } else { to_lower[i] })),
            x: lanes(|i| convert(x[i])),
        }
    }

    /// The functions row by row, so that those of one row do not wait for each other: `columns[k]` holds function k in
    /// every lane. Azimuths ride along: row l starts from s'^l cos(l phi) and s'^l sin(l phi).
    #[inline(always)]
    fn fill<S: Simd, const TILES: bool>(&self, simd: S, dc: T, rows: &[Row<T>], columns: &mut [[T; N]], out: &mut [T]) {
        let Self { x, u, v, sign, end } = self;
        let (n, zero) = (columns.len(), [T::zero(); N]);
        let (mut p, mut difference, mut parity) = ([T::one(); N], zero, [dc; N]);
        let (mut cos, mut sin) = ([dc * convert::<f64, T>(2f64.sqrt()); N], zero);
        columns[0] = [dc; N];
        // Fewer directions than lanes are left at the end only.
        let tiles = TILES && out.len() == N * n;
        let mut written = 0;
        for (l, row) in (1..).zip(rows) {
            difference = lanes(|i| row.keep * difference[i] - row.turn * end[i] * p[i]);
            p = lanes(|i| p[i] + difference[i]);
            parity = lanes(|i| parity[i] * sign[i]);
            let zonal = lanes(|i| parity[i] * row.norm * p[i]);
            (cos, sin) = (
                lanes(|i| row.step * (cos[i] * u[i] - sin[i] * v[i])),
                lanes(|i| row.step * (sin[i] * u[i] + cos[i] * v[i])),
            );
            let (above, new) = columns.split_at_mut(l * l);
            let (above, last) = above.split_at((l - 1) * (l - 1));
            if l > 1 {
                new[1] = lanes(|i| row.second * x[i] * last[0][i]);
                new[2 * l - 1] = lanes(|i| row.second * x[i] * last[2 * l - 2][i]);
                let before = &above[(l - 2) * (l - 2)..];
                for (((new, last), before), &(first, second)) in
                    new[2..].iter_mut().zip(&last[1..]).zip(before).zip(&row.climb)
                {
                    *new = lanes(|i| first * x[i] * last[i] - second * before[i]);
                }
            }
            new[0] = sin;
            new[l] = zonal;
            new[2 * l] = cos;
            let ready = (l + 1) * (l + 1) / BAND * BAND;
            if tiles && ready > written {
                write_tiles(simd, columns, written..ready, out);
                written = ready;
            }
        }
        write_rows(columns, written..n, out);
    }
}

/// Some columns of lanes to rows of functions, for as many lanes as `out` has rows: one row after the other.
#[inline(always)]
fn write_rows<T: Lane, const N: usize>(columns: &[[T; N]], range: Range<usize>, out: &mut [T]) {
    let (tiles, rest) = columns[range.clone()].as_chunks::<8>();
    for (lane, row) in out.chunks_exact_mut(columns.len()).enumerate() {
        let (row_tiles, row_rest) = row[range.clone()].as_chunks_mut::<8>();
        for (row, tile) in row_tiles.iter_mut().zip(tiles) {
            *row = std::array::from_fn(|k| tile[k][lane]);
        }
        for (row, column) in row_rest.iter_mut().zip(rest) {
            *row = column[lane];
        }
    }
}

/// The same in tiles of 4 by 4, turned in registers; `columns` are a multiple of 4, as `out` has of rows.
#[inline(always)]
fn write_tiles<T: Lane, S: Simd, const N: usize>(simd: S, columns: &[[T; N]], range: Range<usize>, out: &mut [T]) {
    let n = columns.len();
    for (four, rows) in out.chunks_exact_mut(4 * n).enumerate() {
        for k in range.clone().step_by(4) {
            let tile = std::array::from_fn(|i| std::array::from_fn(|lane| columns[k + i][4 * four + lane]));
            for (row, tile) in T::transposed(simd, tile).iter().enumerate() {
                rows[row * n + k..][..4].copy_from_slice(tile);
            }
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
            for order in [0, 1, 2, 3, 6, 7, 10, 13, 50] {
                let basis = Harmonics::zonal(zone, order).unwrap();
                for count in [0, 1, 4, 7, 8, 21] {
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

    fn spread(count: usize, zone: Zone) -> Vec<Direction<Sample>> {
        (0..count)
            .map(|i| {
                let part = (i as f64 * 0.618_033_988_749_895).fract();
                Direction::from_mu_phi(zone.cos_max() + (zone.cos_min() - zone.cos_max()) * part, i as f64)
            })
            .collect()
    }

    #[test]
    fn all_cores_give_the_bits_of_one() {
        let basis = Harmonics::zonal(Zone::from_degrees(9.0, 90.0).unwrap(), 7).unwrap();
        let directions = spread(2 * SHARE + 5, basis.zone());
        let (mut one, mut all) = (vec![0.0; directions.len() * basis.len()], vec![1.0; directions.len() * basis.len()]);
        basis.eval_many_into(&directions, &mut one);
        basis.par_eval_many_into(&directions, &mut all);
        assert!(one.iter().zip(&all).all(|(a, b)| a.to_bits() == b.to_bits()));
    }

    /// The largest error of f32 at any (l, m) and direction, relative to the function's maximum over the zone.
    fn f32_error(zone: Zone, order: usize) -> f64 {
        let basis = Harmonics::zonal(zone, order).unwrap();
        let n = basis.len();
        let near = |side: f64, end: f64| (0..40).map(move |i| (end + side * 10f64.powf(-7.0 + 0.15 * f64::from(i)), i));
        let ends = near(-1.0, zone.cos_min()).chain(near(1.0, zone.cos_max()));
        let ends = ends.map(|(mu, i)| Direction::from_mu_phi(mu.clamp(zone.cos_max(), zone.cos_min()), f64::from(i)));
        let narrow: Vec<[f32; 3]> = spread(2000, zone)
            .into_iter()
            .chain(ends)
            .map(|d: Direction<Sample>| [d.vector().x as f32, d.vector().y as f32, d.vector().z as f32])
            .collect();
        let wide: Vec<Direction<Sample>> =
            narrow.iter().map(|v| Direction::new_unchecked(v.map(f64::from).into())).collect();
        let (mut got, mut want) = (vec![0.0f32; n * narrow.len()], vec![0.0; n * narrow.len()]);
        Arch::new().dispatch(Batch::<_, _, 8, false> { basis: &basis, directions: &narrow[..], out: &mut got });
        basis.eval_many_into(&wide, &mut want);
        let (mut most, mut error) = (vec![0.0f64; n], vec![0.0f64; n]);
        for (got, want) in got.chunks_exact(n).zip(want.chunks_exact(n)) {
            for k in 0..n {
                assert!(got[k].is_finite());
                most[k] = most[k].max(want[k].abs());
                error[k] = error[k].max((f64::from(got[k]) - want[k]).abs());
            }
        }
        error.iter().zip(most).map(|(e, m)| e / m).fold(0.0, f64::max)
    }

    #[test]
    fn f32_holds_its_promise_up_to_its_largest_order() {
        let zones = [[0.0, 180.0], [9.0, 57.0], [9.0, 90.0], [0.0, 90.0], [40.0, 41.0], [100.0, 170.0], [0.0, 2.0]];
        for [from, to] in zones {
            for order in [1, 2, 6, 10, F32_MAX_ORDER] {
                let error = f32_error(Zone::from_degrees(from, to).unwrap(), order);
                assert!(error < F32_ERROR, "{from}..{to} deg, order {order}: {error:e}");
            }
        }
    }

    #[test]
    fn orders_too_high_for_f32_are_refused() {
        let sh = Harmonics::spherical(F32_MAX_ORDER + 1).unwrap();
        let refused = sh.eval_many_f32_into(&[], &mut []).unwrap_err();
        assert_eq!(refused, PrecisionError(F32_MAX_ORDER + 1));
        let said = refused.to_string();
        assert!(said.contains(&format!("order {}", F32_MAX_ORDER + 1)) && said.contains("eval_many_into"), "{said}");
    }
}
