//! Frames of mixtures at one azimuth: what an isotropic sample says of the functions in them, and of the rig.

use nalgebra::allocator::Allocator;
use nalgebra::{DMatrix, DVector, DefaultAllocator, Dim, Dyn, OMatrix};
use rayon::prelude::*;

use super::ReduceError;
use super::decoder::{Rates, Row, Taken, datum, functions, inverse, rows};
use super::displacement::{Displacement, LEAST_RINGS, is_cut};
use crate::basis::{index, lm};
use crate::geometry::ExitantGrid;

/// What every ring is solved with: rows are data, frames of a mixture by sectors of the ring; columns are functions with m >= 0.
pub(super) struct Design {
    pub grid: ExitantGrid,
    /// Data for a coefficient of 1.
    pub shown: DMatrix<f64>,
    /// Their derivative by phi_o.
    pub turned: DMatrix<f64>,
    /// Least-squares inverse of `shown`.
    pub inverse: DMatrix<f64>,
}

/// One ring in one channel.
#[derive(Clone)]
pub(super) struct Ring {
    /// Data, NaN where saturated, and their variances.
    pub data: Vec<[f64; 2]>,
    /// Coefficients and their variances; `None` if too few cells have data.
    pub zeta: Option<Vec<[f64; 2]>>,
}

/// Ring by ring, as if the sample were isotropic: at phi_o its coefficients are zeta_lm cos(m phi_o) and zeta_lm sin(m phi_o), so
/// that the azimuths of a ring tell the m of a mixture apart. Standard errors are those of the ring as if each of its cells had
/// been measured by itself.
///
/// There are twice as many data as coefficients. What contradicts isotropy as a shift of the rig would is taken for one, and taken
/// away: see [`Displacement`].
pub(super) fn isotropic_sample(
    taken: &[Taken<'_>],
    grid: ExitantGrid,
    stray: &(dyn Fn(usize, usize) -> Option<[f64; 2]> + Sync),
) -> Result<Rates, ReduceError> {
    let rows = rows(taken)?;
    let (sectors, cells) = (grid.sectors(), grid.len());
    let functions = functions(&rows);
    let terms: Vec<usize> = functions.iter().copied().filter(|&k| lm(k).1 >= 0).collect();
    let design = Design::new(&rows, grid, &terms)?;
    let measured = |at: usize| {
        let first = at / grid.rings() * cells + at % grid.rings() * sectors;
        let data = rows.iter().flat_map(|row| (0..sectors).map(move |s| datum(taken, row, first + s, stray)));
        design.solved(data.collect())
    };
    let measured: Vec<Ring> = (0..3 * grid.rings()).into_par_iter().map(measured).collect();
    let passes = if grid.rings() >= LEAST_RINGS { PASSES } else { 0 };
    let mut found = Displacement::none();
    let mut rings = measured.clone();
    for _ in 0..passes {
        found = Displacement::of(&design, &measured, &rings);
        let corrected = |at: usize| {
            let effect = found.effect(&design, &rings, at);
            effect.map_or_else(
                || measured[at].clone(),
                |effect| design.corrected(&measured[at], &effect, is_cut(&grid, at % grid.rings())),
            )
        };
        rings = (0..rings.len()).into_par_iter().map(corrected).collect();
    }
    let power: f64 = rows.iter().flat_map(|r| r.mixture.0.iter().map(|&(_, factor)| factor * factor)).sum();
    let power = power / rows.len() as f64;
    let excesses = rings.par_iter().map(|ring| design.excess(ring)).collect::<Vec<_>>();
    let [excess, freedom] = excesses.iter().fold([0.0; 2], |[e, f], x| [e + x[0], f + x[1]]);
    let spread = |k: usize| -> Vec<[f64; 2]> {
        let (l, m) = lm(k);
        let term = terms.binary_search(&index(l, m.abs())).expect("mixtures hold both of a pair");
        let at = |i: usize| {
            let ring = &rings[i / cells * grid.rings() + i % cells / sectors];
            let [zeta, variance] = ring.zeta.as_ref().map_or([f64::NAN; 2], |zeta| zeta[term]);
            let (sin, cos) = (f64::from(m.abs()) * grid.phi(i % sectors)).sin_cos();
            [zeta * if m >= 0 { cos } else { sin }, variance * sectors as f64]
        };
        (0..3 * cells).map(at).collect()
    };
    let planes = functions.par_iter().map(|&k| spread(k)).collect();
    let deviation = (excess / freedom.max(1.0) / power).max(0.0).sqrt();
    Ok(Rates { functions, cells: planes, deviation, displacement: found.rms(&grid) })
}

impl Design {
    fn new(rows: &[Row<'_>], grid: ExitantGrid, terms: &[usize]) -> Result<Self, ReduceError> {
        let sectors = grid.sectors();
        let mut shown = DMatrix::zeros(rows.len() * sectors, terms.len());
        let mut turned = shown.clone();
        for (r, row) in rows.iter().enumerate() {
            for &(k, factor) in &row.mixture.0 {
                let (l, m) = lm(k);
                let Ok(term) = terms.binary_search(&index(l, m.abs())) else { continue };
                let order = f64::from(m.abs());
                for sector in 0..sectors {
                    let (sin, cos) = (order * grid.phi(sector)).sin_cos();
                    let (value, derivative) = if m >= 0 { (cos, -order * sin) } else { (sin, order * cos) };
                    shown[(r * sectors + sector, term)] += factor * value;
                    turned[(r * sectors + sector, term)] += factor * derivative;
                }
            }
        }
        let inverse = inverse(&shown)?;
        Ok(Self { grid, shown, turned, inverse })
    }

    /// A ring with its coefficients.
    fn solved(&self, data: Vec<[f64; 2]>) -> Ring {
        let valid: Vec<usize> = (0..data.len()).filter(|&i| data[i][0].is_finite()).collect();
        let solve = |inverse: &DMatrix<f64>| {
            let values = DVector::from_iterator(valid.len(), valid.iter().map(|&i| data[i][0]));
            let variances = DVector::from_iterator(valid.len(), valid.iter().map(|&i| data[i][1]));
            let (zeta, variance) = (inverse * values, inverse.map(|x| x * x) * variances);
            zeta.iter().zip(variance.iter()).map(|(z, v)| [*z, *v]).collect()
        };
        let zeta = if valid.len() == data.len() {
            Some(solve(&self.inverse))
        } else if 2 * valid.len() < data.len() {
            None
        } else {
            inverse(&self.shown.select_rows(&valid)).ok().map(|partial| solve(&partial))
        };
        Ring { data, zeta }
    }

    /// A ring without the effect of a displacement.
    fn corrected(&self, ring: &Ring, effect: &DVector<f64>, cut: bool) -> Ring {
        let data = ring.data.iter().zip(effect.iter()).map(|(&[value, variance], e)| [value - e, variance]);
        let mut corrected = self.solved(data.collect());
        if let (true, Some(before), Some(zeta)) = (cut, &ring.zeta, &mut corrected.zeta) {
            for ([value, variance], [before, _]) in zeta.iter_mut().zip(before) {
                *variance += (UNKNOWN_AT_EDGES * (*value - before)).powi(2);
            }
        }
        corrected
    }

    /// What no isotropic sample sends of some data, column by column.
    pub fn unexplained<C: Dim>(&self, data: &OMatrix<f64, Dyn, C>) -> OMatrix<f64, Dyn, C>
    where
        DefaultAllocator: Allocator<Dyn, C>,
    {
        data - &self.shown * (&self.inverse * data)
    }

    /// Squared deviation of the data from isotropy beyond noise, and degrees of freedom.
    fn excess(&self, ring: &Ring) -> [f64; 2] {
        let Some(zeta) = &ring.zeta else { return [0.0; 2] };
        let valid = ring.data.iter().enumerate().filter(|(_, d)| d[0].is_finite());
        let [excess, count] = valid.fold([0.0; 2], |[excess, count], (i, &[value, variance])| {
            let isotropic: f64 = self.shown.row(i).iter().zip(zeta).map(|(d, z)| d * z[0]).sum();
            [excess + (value - isotropic).powi(2) - variance, count + 1.0]
        });
        [excess, (count - zeta.len() as f64).max(0.0)]
    }
}

/// Gradients of what leaked are wrong by as much: the second pass has hardly any of it.
const PASSES: usize = 2;
/// Share of what a displacement does to lobes at the zone's edges that is not known.
const UNKNOWN_AT_EDGES: f64 = 0.5;

impl Ring {
    /// Whether nothing saturated.
    pub fn is_whole(&self) -> bool {
        self.data.iter().all(|d| d[0].is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::super::CellResponse;
    use super::*;
    use crate::basis::Harmonics;
    use crate::geometry::{Direction, Zone};
    use crate::patterns::{Scheme, Step};

    /// Electrons per second of a coefficient of 1; the variance is that of a thousandth.
    const RATE: f64 = 1000.0;
    const ORDER: usize = 4;

    fn grid() -> ExitantGrid {
        ExitantGrid::new(Zone::from_degrees(9.0, 57.0).unwrap(), 32, 64)
    }

    /// What a mirror sends that sees a pattern in the direction that `displaced` says, as coefficients by ring and function.
    fn of_mirror(displaced: impl Fn(f64, f64) -> [f64; 2]) -> Rates {
        let grid = grid();
        let steps = Scheme::Isotropic.steps(grid.zone(), ORDER).unwrap();
        let basis = Harmonics::zonal(grid.zone(), ORDER).unwrap();
        let frame = |step: &Step, part: usize| {
            let cell = |i: usize| {
                let wo = grid.direction(i % grid.len());
                let [theta, phi] = displaced(wo.theta(), wo.phi());
                let Step::Parts(mixture) = step else { unreachable!("isotropic schemes show parts") };
                let value = mixture.of(&basis.eval(&Direction::from_angles(theta, phi)));
                RATE * if part == 0 { value } else { 0.0 }
            };
            let n = 3 * grid.len();
            CellResponse { rate: (0..n).map(cell).collect(), variance: vec![1.0; n] }
        };
        let frames: Vec<_> = steps.iter().map(|s| [frame(s, 0), frame(s, 1)]).collect();
        let taken: Vec<_> = (steps.iter().zip(&frames))
            .map(|(step, frames)| Taken { step, gains: [1.0; 2], frames: frames.each_ref() })
            .collect();
        isotropic_sample(&taken, grid, &|_, _| None).unwrap()
    }

    /// RMS error of coefficients over RMS z_00, of the rings first..end.
    fn error(rates: &Rates, [first, end]: [usize; 2]) -> f64 {
        let grid = grid();
        let basis = Harmonics::zonal(grid.zone(), ORDER).unwrap();
        let (mut sum, mut count) = (0.0, 0.0);
        for i in first * grid.sectors()..end * grid.sectors() {
            let truth = basis.eval(&grid.direction(i));
            for (&k, cells) in rates.functions.iter().zip(&rates.cells) {
                sum += (cells[i][0] / RATE - truth[k]).powi(2);
                count += 1.0;
            }
        }
        (sum / count).sqrt() * grid.zone().solid_angle().sqrt()
    }

    #[test]
    fn a_rig_in_place_is_left_as_it_is() {
        let rates = of_mirror(|theta, phi| [theta, phi]);
        assert!(error(&rates, [0, 32]) < 1e-6, "{}", error(&rates, [0, 32]));
        assert!(rates.displacement < 1e-6, "{}", rates.displacement);
    }

    /// A displacement to the side of this size along theta_o and, by its arc, along phi_o is found in what it does to a mirror's
    /// image, and hardly anything of it remains.
    fn is_taken_away(size: impl Fn(f64) -> [f64; 2]) {
        let rates = of_mirror(|theta, phi| {
            let ([along, arc], (sin, cos)) = (size(theta), (phi - 0.4).sin_cos());
            [theta + along * cos, phi - arc * sin / theta.sin()]
        });
        // Without the correction it is 0.0019 for the tilt, 0.0027 with the edges.
        let (inner, whole) = (error(&rates, [2, 30]), error(&rates, [0, 32]));
        assert!(inner < 1.5e-4 && whole < 6e-4, "{inner} {whole}");
        assert!(rates.displacement > 2e-4 && rates.displacement < 6e-4, "{}", rates.displacement);
    }

    #[test]
    fn a_tilt_is_found_and_taken_away() {
        is_taken_away(|theta| [6e-4, 6e-4 * theta.cos()]);
    }

    #[test]
    fn a_shift_that_grows_over_the_zone_is_found_and_taken_away() {
        is_taken_away(|theta| [6e-4 * theta, 3e-4]);
    }
}
