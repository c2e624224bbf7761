//! The search for better dimensions: the front of a rig's objectives, one point for each of a fixed set of directions.

use std::f64::consts::PI;

use argmin::core::{CostFunction, Executor, State};
use argmin::solver::neldermead::NelderMead;
use nalgebra::DVector;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use thiserror::Error;

use super::dimensions::Dimensions;
use super::front::{hypervolume, nondominated};
use super::objectives::Values;
use crate::optics::{Objective, Parameter, Rig, SearchTable};

/// Why a rig cannot be searched from.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SearchError {
    /// The rig file has no `[search]`.
    #[error("the rig has no [search] table: add one with [search.free], [search.limits] and [search.reference]")]
    NoTable,
    /// Nothing may change.
    #[error(
        "[search.free] names no dimension: give bounds to one at least, such as dome.rim_radius_mm = [100.0, 140.0]"
    )]
    NothingFree,
    /// Too few objectives for a front, or too many for its volume; or one twice.
    #[error("search.objectives = {found}: choose two to five different ones")]
    Objectives {
        /// Those found.
        found: String,
    },
    /// An objective without a reference.
    #[error("search.reference has no {key}: add a value that is worse than the rig's own {own:.4}")]
    NoReference {
        /// The objective's key.
        key: &'static str,
        /// The rig's own value.
        own: f64,
    },
    /// A reference that the rig itself does not beat.
    #[error("search.reference.{key} = {value} is no worse than the rig's own {own:.4}: choose a {remedy} one")]
    Reference {
        /// The objective's key.
        key: &'static str,
        /// The reference.
        value: f64,
        /// The rig's own value.
        own: f64,
        /// `smaller` or `larger`.
        remedy: &'static str,
    },
    /// No start.
    #[error("starts = 0: choose 1 or more, 100 as a rule")]
    NoStarts,
    /// No random point makes a rig.
    #[error("none of {tried} random points makes a rig: narrow [search.free] to mirrors whose rays reach the rim")]
    NoRig {
        /// Points tried.
        tried: usize,
    },
    /// No rig within limits was found.
    #[error(
        "no rig keeps all limits, the best one breaks `{worst}`: loosen it in [search.limits] or widen [search.free]"
    )]
    NothingWithin {
        /// The limit exceeded most.
        worst: &'static str,
    },
}

/// A rig of the front.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// Its dimensions, as found.
    pub dimensions: Dimensions,
    /// What they are worth.
    pub values: Values,
    /// Gain in each objective: 0 at the reference, 1 at the rig searched from.
    pub gains: Vec<f64>,
    /// Limits and bounds it lies at.
    pub binding: Vec<&'static str>,
}

/// What a search found.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Rigs within all limits that none other found beats, in the order of directions.
    pub front: Vec<Design>,
    /// The rig found on the way from the reference point through the rig searched from: better in every objective alike if
    /// its gains exceed 1.
    pub balanced: Option<Design>,
    /// Volume of gains that the front dominates: that of the rig searched from alone is 1.
    pub hypervolume: f64,
    /// Rigs computed.
    pub evaluations: u64,
    /// Rounds of refinement.
    pub rounds: usize,
}

/// A search from a rig with a `[search]` table.
#[derive(Debug, Clone)]
pub struct Search {
    base: Dimensions,
    own: Values,
    table: SearchTable,
    free: Vec<(Parameter, &'static str, [f64; 2])>,
}

/// Penalty for an excess of one limit by its own size, in logarithms of gain: several times what breaking a limit can gain.
const PENALTY: f64 = 20.0;
/// Power of the mean that stands for the least gain.
const POWER: f64 = 8.0;
/// Gain below which the logarithm gives way to a line.
const FADES: f64 = 0.02;
/// Least component of a direction: at 0, an objective would not count at all.
const LEAST: f64 = 0.05;
/// Limits are tightened by this, relative, so that what converges onto one from without is still within.
const TIGHTER: f64 = 1e-6;
/// An excess up to this, relative, binds.
const BINDS: f64 = 2e-3;
/// Rounds in which gains grow by less than this share in the mean end the search, four of them in turn: two of each kind.
const SETTLED: f64 = 2e-5;
const SETTLED_ROUNDS: usize = 4;
/// Rounds at most.
const ROUNDS: usize = 40;
/// Spans of the simplices that rounds begin with, in the search variable, of pi for the whole range.
const SPANS: [f64; 4] = [0.4, 0.1, 0.03, 0.2];
/// Iterations of a simplex for each free dimension.
const PATIENCE: u64 = 80;
/// Random points tried for each that makes a rig.
const TRIES: usize = 200;

/// A point searched: variables, and what became of them.
#[derive(Debug, Clone)]
struct Point {
    inner: Vec<f64>,
    gains: Vec<f64>,
    excess: f64,
}

impl Point {
    /// What a simplex maximises: the logarithm of the least gain in units of `direction`, less the exact penalty. A mean of high
    /// power stands for the least gain: it has no kinks, and the other gains count a little.
    fn score(&self, direction: &[f64]) -> f64 {
        if self.gains.is_empty() {
            return -1e9;
        }
        // Gains fade out below: the way back from beyond the reference is found.
        let positive = |g: f64| if g > FADES { g } else { FADES * (g / FADES - 1.0).exp() };
        let power = |(g, d): (&f64, &f64)| (POWER * (d / positive(*g)).ln()).exp();
        let sum: f64 = self.gains.iter().zip(direction).map(power).sum();
        -sum.ln() / POWER - PENALTY * self.excess
    }
}

impl Search {
    /// A search from `rig`.
    ///
    /// # Errors
    /// [`SearchError`] if its table is missing or cannot be searched by.
    pub fn new(rig: &Rig) -> Result<Self, SearchError> {
        let table = rig.search.clone().ok_or(SearchError::NoTable)?;
        let free = table.free();
        if free.is_empty() {
            return Err(SearchError::NothingFree);
        }
        let keys: Vec<_> = table.objectives.iter().map(|o| o.key()).collect();
        if !(2..=5).contains(&keys.len()) || (1..keys.len()).any(|i| keys[..i].contains(&keys[i])) {
            return Err(SearchError::Objectives { found: format!("[{}]", keys.join(", ")) });
        }
        let own = Values::of(rig).expect("a rig that was read shows its zone");
        for &objective in &table.objectives {
            let (key, own) = (objective.key(), own.get(objective));
            let value = *table.reference.get(&objective).ok_or(SearchError::NoReference { key, own })?;
            let more = objective.more_is_better();
            if if more { value >= own } else { value <= own } {
                let remedy = if more { "smaller" } else { "larger" };
                return Err(SearchError::Reference { key, value, own, remedy });
            }
        }
        Ok(Self { base: Dimensions::of(rig), own, table, free })
    }

    /// The objectives of the front.
    pub fn objectives(&self) -> &[Objective] {
        &self.table.objectives
    }

    /// Dimensions of the rig searched from.
    pub fn base(&self) -> &Dimensions {
        &self.base
    }

    /// What the rig searched from is worth.
    pub fn own(&self) -> &Values {
        &self.own
    }

    /// Gains of values over the reference point, relative to those of the rig searched from.
    pub fn gains(&self, values: &Values) -> Vec<f64> {
        let gain = |o: &Objective| {
            let reference = self.table.reference[o];
            (values.get(*o) - reference) / (self.own.get(*o) - reference)
        };
        self.table.objectives.iter().map(gain).collect()
    }

    /// Searches from `starts` random points drawn with `seed`: the same seed finds the same rigs to the bit, on any number of
    /// threads.
    ///
    /// Each direction starts from the best of the random points; in each round it goes on from the best that any direction has
    /// found for it, by a simplex about it or by one through the best of the others, until no direction gains any more.
    ///
    /// # Errors
    /// [`SearchError`] if there is no start, or no rig within the limits.
    pub fn run(&self, seed: u64, starts: usize) -> Result<Found, SearchError> {
        let mut pool = self.random(seed, starts)?;
        let directions = directions(self.table.objectives.len());
        let best = |pool: &[Point], d: &[f64]| -> Point {
            pool.iter().reduce(|a, b| if b.score(d) > a.score(d) { b } else { a }).expect("starts > 0").clone()
        };
        let mut points: Vec<Point> = directions.iter().map(|d| best(&pool, d)).collect();
        let (mut evaluations, mut rounds, mut settled) = (pool.len() as u64, 0, 0);
        while rounds < ROUNDS && settled < SETTLED_ROUNDS {
            let improved: Vec<(Point, u64)> =
                directions.par_iter().map(|d| self.improve(d, &best(&pool, d), &pool, rounds)).collect();
            evaluations += improved.iter().map(|i| i.1).sum::<u64>();
            let next: Vec<Point> = improved.into_iter().map(|i| i.0).collect();
            let growth = directions.iter().enumerate().map(|(i, d)| next[i].score(d) - points[i].score(d));
            settled = if growth.sum::<f64>() / directions.len() as f64 > SETTLED { 0 } else { settled + 1 };
            points = next;
            pool = points.clone();
            rounds += 1;
        }
        let within: Vec<Design> = points.iter().filter(|p| p.excess <= 0.0).filter_map(|p| self.design(p)).collect();
        if within.is_empty() {
            let least = points.iter().min_by(|a, b| a.excess.total_cmp(&b.excess)).expect("directions");
            let values = self.values(&least.inner).map(|v| v.1.excesses(&self.table.limits)).unwrap_or_default();
            let worst = values.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or("none", |e| e.0);
            return Err(SearchError::NothingWithin { worst });
        }
        let gains: Vec<Vec<f64>> = within.iter().map(|d| d.gains.clone()).collect();
        Ok(Found {
            balanced: points.last().filter(|p| p.excess <= 0.0).and_then(|p| self.design(p)),
            front: nondominated(&gains).into_iter().map(|i| within[i].clone()).collect(),
            hypervolume: hypervolume(&gains),
            evaluations,
            rounds,
        })
    }

    /// Random points that make rigs, whatever limits say.
    fn random(&self, seed: u64, starts: usize) -> Result<Vec<Point>, SearchError> {
        if starts == 0 {
            return Err(SearchError::NoStarts);
        }
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut draw = || {
            // Evenly in the dimension itself.
            let inner = self.free.iter().map(|_| (2.0 * rng.random::<f64>() - 1.0).asin()).collect();
            self.point(inner)
        };
        let tried = TRIES * starts;
        let points: Vec<Point> = (0..tried).map(|_| draw()).filter(|p| !p.gains.is_empty()).take(starts).collect();
        if points.is_empty() { Err(SearchError::NoRig { tried }) } else { Ok(points) }
    }

    /// Dimensions at variables: each within its bounds by a sine, as in MINUIT.
    fn dimensions(&self, inner: &[f64]) -> Dimensions {
        let mut dimensions = self.base;
        for (&(parameter, _, [lo, hi]), v) in self.free.iter().zip(inner) {
            dimensions.set(parameter, lo + (hi - lo) * 0.5 * (v.sin() + 1.0));
        }
        dimensions
    }

    fn values(&self, inner: &[f64]) -> Option<(Dimensions, Values)> {
        let dimensions = self.dimensions(inner);
        let mirrors = dimensions.mirrors()?;
        let dimensions = dimensions.trimmed(&mirrors)?;
        Some((dimensions, Values::over(&dimensions, &mirrors)?))
    }

    fn point(&self, inner: Vec<f64>) -> Point {
        match self.values(&inner) {
            Some((_, values)) => {
                let mut excess = 0.0;
                values.for_each_excess(&self.table.limits, |_, e| excess += (e + TIGHTER).max(0.0));
                // What is tightened here is within the limit itself.
                let excess = if excess <= TIGHTER { 0.0 } else { excess };
                Point { gains: self.gains(&values), inner, excess }
            }
            None => Point { inner, gains: Vec::new(), excess: f64::INFINITY },
        }
    }

    fn design(&self, point: &Point) -> Option<Design> {
        let (dimensions, values) = self.values(&point.inner)?;
        let limits = values.excesses(&self.table.limits).into_iter().filter(|e| e.1 > -BINDS).map(|e| e.0);
        let at_bound = |v: &f64| v.sin().abs() > 1.0 - 2.0 * BINDS;
        let bounds = self.free.iter().zip(&point.inner).filter(|(_, v)| at_bound(v)).map(|(f, _)| f.1);
        let binding = limits.chain(bounds).collect();
        Some(Design { dimensions, values, gains: point.gains.clone(), binding })
    }

    /// A better point for a direction than `start`, if there is one, and evaluations spent.
    fn improve(&self, direction: &[f64], start: &Point, pool: &[Point], round: usize) -> (Point, u64) {
        let n = self.free.len();
        let about = || {
            let span = SPANS[(round / 2) % SPANS.len()];
            let sign = if (round / 2).is_multiple_of(2) { 1.0 } else { -1.0 };
            let corner = |j: usize| {
                let mut corner = start.inner.clone();
                // At a bound the sine is flat: both ways lead inwards.
                corner[j] += span * sign * if j.is_multiple_of(2) { 1.0 } else { -1.0 };
                DVector::from_vec(corner)
            };
            std::iter::once(DVector::from_column_slice(&start.inner)).chain((0..n).map(corner)).collect::<Vec<_>>()
        };
        // The best for this direction lie along its constraints, where a simplex about one point hardly gets on.
        let through = || {
            let mut order: Vec<&Point> = pool.iter().collect();
            order.sort_by(|a, b| b.score(direction).total_cmp(&a.score(direction)));
            order.dedup_by(|a, b| a.inner == b.inner);
            let corners: Vec<_> = order.iter().take(n + 1).map(|p| DVector::from_column_slice(&p.inner)).collect();
            (corners.len() == n + 1).then_some(corners)
        };
        let corners = if round % 2 == 1 { through().unwrap_or_else(about) } else { about() };
        let solver = NelderMead::new(corners).with_sd_tolerance(1e-8).expect("a positive tolerance");
        let run = Executor::new(Cost { search: self, direction }, solver)
            .configure(|state| state.max_iters(PATIENCE * n as u64))
            .timer(false)
            .ctrlc(false)
            .run();
        let Ok(result) = run else { return (start.clone(), 0) };
        let evaluations = result.problem().counts.values().sum::<u64>();
        let found = result.state().get_best_param().map(|p| {
            // Turns of a whole circle are the same dimensions.
            self.point(p.iter().map(|v| (v + PI).rem_euclid(2.0 * PI) - PI).collect())
        });
        let better = found.filter(|p| p.score(direction) > start.score(direction));
        (better.unwrap_or_else(|| start.clone()), evaluations)
    }
}

struct Cost<'a> {
    search: &'a Search,
    direction: &'a [f64],
}

impl CostFunction for Cost<'_> {
    type Param = DVector<f64>;
    type Output = f64;

    fn cost(&self, inner: &DVector<f64>) -> Result<f64, argmin::core::Error> {
        Ok(-self.search.point(inner.as_slice().to_vec()).score(self.direction))
    }
}

/// Directions from the reference point: all with components that are multiples of 1 / p and sum up to 1 (Das and Dennis 1998),
/// scaled to a mean of 1, and last the one through the rig searched from.
fn directions(objectives: usize) -> Vec<Vec<f64>> {
    let p = match objectives {
        2 => 63,
        3 => 13,
        4 => 7,
        _ => 5,
    };
    let mut all: Vec<Vec<usize>> = vec![Vec::new()];
    for i in 0..objectives {
        let extended = |head: Vec<usize>| {
            let left = p - head.iter().sum::<usize>();
            let next = if i + 1 == objectives { left..=left } else { 0..=left };
            next.map(move |k| head.iter().copied().chain([k]).collect::<Vec<_>>()).collect::<Vec<_>>()
        };
        all = all.into_iter().flat_map(extended).collect();
    }
    let scaled = |k: Vec<usize>| -> Vec<f64> {
        k.into_iter().map(|k| (k as f64 / p as f64 * objectives as f64).max(LEAST)).collect()
    };
    all.into_iter().map(scaled).chain([vec![1.0; objectives]]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const RIG: &str = include_str!("../../optics/ghosh-2007-search.toml");

    fn rig() -> Rig {
        Rig::from_toml(RIG).unwrap()
    }

    /// Three free dimensions and two objectives: seconds instead of minutes.
    fn small_rig() -> Rig {
        let mut rig = rig();
        let table = rig.search.as_mut().unwrap();
        table.objectives = vec![Objective::ProjectedCoverage, Objective::ToleranceDegPerMm];
        table.free.paraboloid.conic = None;
        table.free.centre_height_mm = None;
        table.free.dome.rim_radius_mm = None;
        rig
    }

    fn small() -> Search {
        Search::new(&small_rig()).unwrap()
    }

    #[test]
    fn directions_fill_the_simplex() {
        for (objectives, count) in [(2, 65), (3, 106), (4, 121), (5, 127)] {
            let all = directions(objectives);
            assert_eq!(all.len(), count);
            assert!(all.iter().flatten().all(|d| *d >= LEAST) && all.last().unwrap().iter().all(|d| *d == 1.0));
        }
    }

    #[test]
    fn searches_from_other_points_find_the_same_front() {
        let search = small();
        let volumes = [1, 2, 3].map(|seed| search.run(seed, 30).unwrap().hypervolume);
        let (lo, hi) = volumes.iter().fold((f64::INFINITY, 0.0f64), |(lo, hi), v| (lo.min(*v), hi.max(*v)));
        assert!(hi / lo - 1.0 < 0.01, "{volumes:?}");
        assert!(lo > 1.5, "the front lies beyond the rig searched from: {lo}");
    }

    #[test]
    fn the_same_seed_finds_the_same_bits_on_any_number_of_threads() {
        let search = small();
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| search.run(7, 10).unwrap())
        };
        assert_eq!(on(1), on(3));
    }

    #[test]
    fn rigs_of_the_front_keep_all_limits_and_none_beats_another() {
        let search = small();
        let found = search.run(1, 10).unwrap();
        let limits = &search.table.limits;
        for design in &found.front {
            assert!(design.values.excesses(limits).iter().all(|e| e.1 <= 0.0), "{design:?}");
            assert!(!found.front.iter().any(|other| super::super::dominates(&other.gains, &design.gains)));
        }
        let balanced = found.balanced.unwrap();
        assert!(balanced.gains.iter().all(|g| *g > 1.0), "{balanced:?}");
        assert!(!balanced.binding.is_empty());
    }

    #[test]
    fn what_cannot_be_searched_is_named() {
        let error = |change: fn(&mut SearchTable)| {
            let mut rig = small_rig();
            change(rig.search.as_mut().unwrap());
            Search::new(&rig).and_then(|s| s.run(1, 3)).unwrap_err()
        };
        let none = Search::new(&Rig { search: None, ..rig() }).unwrap_err();
        assert_eq!(none, SearchError::NoTable);
        assert_eq!(error(|t| t.free = Default::default()), SearchError::NothingFree);
        assert!(matches!(error(|t| t.objectives.truncate(1)), SearchError::Objectives { .. }));
        assert!(matches!(error(|t| t.objectives[1] = t.objectives[0]), SearchError::Objectives { .. }));
        assert!(matches!(error(|t| t.reference.clear()), SearchError::NoReference { key: "projected_coverage", .. }));
        let beaten = error(|t| t.reference.extend([(Objective::ToleranceDegPerMm, 4.0)])).to_string();
        assert!(beaten.contains("tolerance_deg_per_mm = 4") && beaten.contains("larger"), "{beaten}");
        let within = error(|t| t.limits.box_mm = Some([50.0, 50.0, 50.0]));
        assert!(matches!(within, SearchError::NothingWithin { .. }), "{within}");
        let bounds = error(|t| {
            t.free = Default::default();
            t.free.dome.rim_radius_mm = Some([0.1, 0.2]);
        });
        assert!(matches!(bounds, SearchError::NoRig { .. }), "{bounds}");
        assert_eq!(Search::new(&rig()).unwrap().run(1, 0).unwrap_err(), SearchError::NoStarts);
    }
}
