//! The runs and the forecasts that [`ParetoReport`] draws.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Instant;

use thiserror::Error;

use super::pareto::{ComputePoint, ParetoReport, PlanPoint, SeedPoint, Stage};
use crate::basis::{Harmonics, Method, Rule};
use crate::calibrate::CalibrationSet;
use crate::capture::{Bench, Control};
use crate::convert::{self, ConvertError, PriorTable};
use crate::export::ShMaterial;
use crate::fit::{Fineness, FitError, FitMethod, FitOptions, Forward, Observations, fit};
use crate::forecast::{Class, FitAdviser, NoiseModel, Outlook, contrast};
use crate::geometry::Direction;
use crate::geometry::quadrature::polar_about_mirror;
use crate::measure::{MeasureError, Measurement, Provenance, Request, lobe_pairs, measure};
use crate::optics::Rig;
use crate::patterns::{Adaptive, Pattern, Plan, Scheme, Timing};
use crate::reduce::{Coefficients, ReduceError};
use crate::reflectance::{Brdf, Metric, MetricError, Reference, ZoneErrors};
use crate::twin::{Accuracy, TwinBench, TwinConfig};

/// Orders of the published runs, and their times on its rig, s (Ghosh 2007, sections 3.4 and 3.5).
const PUBLISHED: [(usize, [f64; 2]); 2] = [(4, [60.0, 60.0]), (10, [300.0, 420.0])];
/// Highest order of what is forecast.
const FORECAST: usize = 10;

/// What is tried.
pub struct ParetoScan<'a> {
    /// The rig.
    pub rig: &'a Rig,
    /// Its calibrations.
    pub calibration: &'a CalibrationSet,
    /// The simulated devices.
    pub config: &'a TwinConfig,
    /// Materials with their names.
    pub materials: &'a [(String, Arc<dyn Brdf>)],
    /// Order of the run of pairs, whose beginnings are the lower orders.
    pub pairs: usize,
    /// Further plans that are run.
    pub plans: Vec<Plan>,
    /// Whether ways of computing are timed too, on the material in the middle of the list.
    pub computing: bool,
}

/// What a scan found.
pub struct ParetoRuns {
    /// The chart.
    pub report: ParetoReport,
    /// Coefficients of the run of pairs, one for each material.
    pub pairs: Vec<Coefficients>,
}

/// Why there is no chart.
#[derive(Debug, Error)]
pub enum ParetoError {
    /// A run failed.
    #[error(transparent)]
    Measure(#[from] MeasureError),
    /// A plan cannot be read back.
    #[error(transparent)]
    Reduce(#[from] ReduceError),
    /// A fit failed.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// A conversion failed.
    #[error(transparent)]
    Convert(#[from] ConvertError),
    /// A material or a model has a value that cannot be compared.
    #[error(transparent)]
    Metric(#[from] MetricError),
}

/// Plans whose runs show what the schemes are worth: order by order for isotropic samples, one each of the others, and adaptive.
pub fn pareto_plans() -> Vec<Plan> {
    let isotropic = [2, 4, 6, 10].map(|order| Plan::of_order(order).by(Scheme::Isotropic));
    let others = [Scheme::Offset, Scheme::Multiplexed].map(|scheme| Plan::of_order(4).by(scheme));
    let adaptive = Plan::of_order(FORECAST).adapted(Adaptive::default());
    isotropic.into_iter().chain(others).chain([adaptive]).collect()
}

/// One run of one material.
struct Run {
    scheme: String,
    order: usize,
    exposures: usize,
    frames: usize,
    rig_s: f64,
    method: FitMethod,
    error: f64,
}

/// What `task` makes of 0..count, as many at a time as there are cores. In threads of their own: a run waits for the thread that
/// reduces its frames with rayon, and once every thread of rayon waited so, none would be left to do it.
fn side_by_side<T: Send, E: Send>(count: usize, task: impl Fn(usize) -> Result<T, E> + Sync) -> Result<Vec<T>, E> {
    let next = AtomicUsize::new(0);
    let some = || -> Vec<(usize, Result<T, E>)> {
        let indices = std::iter::from_fn(|| Some(next.fetch_add(1, Ordering::Relaxed)).filter(|index| *index < count));
        indices.map(|index| (index, task(index))).collect()
    };
    let cores = thread::available_parallelism().map_or(1, usize::from).min(count);
    let mut done: Vec<_> = thread::scope(|scope| {
        let threads: Vec<_> = (0..cores).map(|_| scope.spawn(some)).collect();
        threads.into_iter().flat_map(|t| t.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
    });
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

/// What is known of one material.
struct Tried<'a> {
    /// One for all plans: patterns that several of them show are computed once.
    bench: TwinBench,
    reference: Reference<'a>,
    runs: Vec<Run>,
    /// Of the run of pairs.
    pairs: Coefficients,
}

impl Tried<'_> {
    fn error(&self, coefficients: &Coefficients, method: FitMethod) -> Result<f64, ParetoError> {
        let fitted = fit(coefficients, method, &FitOptions::default())?;
        Ok(self.reference.errors(&fitted.brdf)?.mean.overall())
    }
}

impl ParetoScan<'_> {
    /// Runs all of it; `progress` is told what is done, and of how much.
    ///
    /// # Errors
    /// [`ParetoError`].
    pub fn run(&self, progress: &mut (dyn FnMut(usize, usize) + Send)) -> Result<ParetoRuns, ParetoError> {
        let metric = Metric::new(self.rig.zone());
        let total = self.materials.len() * (self.plans.len() + 1) + usize::from(self.computing);
        let counted = Mutex::new((0, progress));
        let step = || {
            let mut counted = counted.lock().unwrap_or_else(PoisonError::into_inner);
            counted.0 += 1;
            let done = counted.0;
            (counted.1)(done, total);
        };
        let (adaptive, fixed): (Vec<&Plan>, Vec<&Plan>) = self.plans.iter().partition(|plan| plan.adaptive.is_some());
        let shown = self.shown(&fixed)?;
        let of_material = |index: usize| -> Result<Tried<'_>, ParetoError> {
            let mut tried = self.begun(index, &metric, &shown)?;
            step();
            for plan in &fixed {
                self.add(plan, &mut tried)?;
                step();
            }
            Ok(tried)
        };
        let mut materials = side_by_side(self.materials.len(), of_material)?;
        // What is timed has the machine to itself: ways of computing, and decisions, which count as seconds of a run.
        for tried in &mut materials {
            for plan in &adaptive {
                self.add(plan, tried)?;
                step();
            }
        }
        let mut computing = Vec::new();
        let middle = self.materials.len() / 2;
        if let Some(tried) = materials.get(middle).filter(|_| self.computing) {
            let (known, truth) = (tried.pairs.truncated(PUBLISHED[0].0), &self.materials[middle].1);
            computing = self.conversions(&known, truth.as_ref())?;
            computing.extend(self.fits(&known, &tried.reference)?);
            computing.extend(self.simulations(truth)?);
            step();
        }
        let (runs, pairs): (Vec<Vec<Run>>, _) = materials.into_iter().map(|tried| (tried.runs, tried.pairs)).unzip();
        let report = ParetoReport {
            materials: self.materials.iter().map(|(name, _)| name.clone()).collect(),
            plans: self.points(&runs)?,
            computing,
            seed: published(&runs),
            provenance: vec![
                ("Simulated rig".into(), format!("{} `{}`, seed {}", self.rig.name, self.config.twin, self.config.seed)),
                ("Final error".into(), "geometric mean of the relative and logarithmic errors inside and outside of the zone (zonal compare), median over the materials".into()),
                ("Prediction".into(), "misfit of the families to published SGD materials by class and order, and the noise model of the rig: data/outlook.toml".into()),
                ("Order 10 of the published method".into(), "its fit to coefficients measured by isotropic mixtures".into()),
            ],
        };
        Ok(ParetoRuns { report, pairs })
    }

    /// The frames of the run of pairs and of these plans.
    fn shown(&self, plans: &[&Plan]) -> Result<Vec<Pattern>, MeasureError> {
        let pairs = Plan::of_order(self.pairs);
        let lobes = |plan| lobe_pairs(self.rig, plan, self.calibration);
        let lobes = std::iter::once(&pairs).chain(plans.iter().copied()).map(lobes).collect::<Result<Vec<_>, _>>()?;
        Ok(lobes.into_iter().flatten().flat_map(|pair| pair.patterns).collect())
    }

    /// A material after the run of pairs, whose beginnings are plans of lower orders; `shown` is all that it will be shown.
    fn begun<'a>(&'a self, index: usize, metric: &'a Metric, shown: &[Pattern]) -> Result<Tried<'a>, ParetoError> {
        let brdf = &self.materials[index].1;
        let config = TwinConfig { seed: self.config.seed + index as u64, ..self.config.clone() };
        let mut bench = TwinBench::new(self.rig, config, brdf.clone());
        bench.foresee(shown);
        let pairs = self.measured(&Plan::of_order(self.pairs), &mut bench)?.coefficients;
        let reference = metric.reference(brdf.as_ref())?;
        let mut tried = Tried { bench, reference, runs: Vec::new(), pairs };
        for order in 0..=self.pairs {
            let known = tried.pairs.truncated(order);
            tried.runs.push(self.fixed(order, FitMethod::Auto, tried.error(&known, FitMethod::Auto)?));
            if order == PUBLISHED[0].0 {
                tried.runs.push(self.fixed(order, FitMethod::Thesis, tried.error(&known, FitMethod::Thesis)?));
            }
        }
        Ok(tried)
    }

    /// Runs another plan.
    fn add(&self, plan: &Plan, tried: &mut Tried<'_>) -> Result<(), ParetoError> {
        let Measurement { coefficients, record, .. } = self.measured(plan, &mut tried.bench)?;
        let adaptive = plan.adaptive.is_some();
        let exposures = if adaptive { 1 } else { record.frames / (record.images * plan.repeats) };
        tried.runs.push(Run {
            scheme: if adaptive { "adaptive".into() } else { plan.scheme.name().into() },
            order: record.order,
            exposures,
            frames: record.frames,
            rig_s: record.rig_s,
            method: FitMethod::Auto,
            error: tried.error(&coefficients, FitMethod::Auto)?,
        });
        if record.order == PUBLISHED[1].0 && !adaptive {
            let found = tried.error(&coefficients, FitMethod::Thesis)?;
            tried.runs.push(self.fixed(record.order, FitMethod::Thesis, found));
        }
        Ok(())
    }

    fn measured(&self, plan: &Plan, bench: &mut TwinBench) -> Result<Measurement, MeasureError> {
        let provenance = Provenance { sample: "chart".into(), ..Provenance::default() };
        let (control, adviser) = (Control::default(), FitAdviser::default());
        let request = Request {
            rig: self.rig,
            plan,
            calibration: self.calibration,
            provenance: &provenance,
            control: &control,
            adviser: Some(&adviser),
        };
        measure(&request, bench, None, &mut |_, _| ())
    }

    fn fixed(&self, order: usize, method: FitMethod, error: f64) -> Run {
        let plan = Plan::of_order(order);
        Run {
            scheme: plan.scheme.name().into(),
            order,
            exposures: plan.frames() / plan.images(),
            frames: plan.frames(),
            rig_s: plan.rig_time(&Timing::of(self.rig)).total_s(),
            method,
            error,
        }
    }

    /// Medians over materials, and forecasts, those of orders that were not run too.
    fn points(&self, runs: &[Vec<Run>]) -> Result<Vec<PlanPoint>, ParetoError> {
        let timing = Timing::of(self.rig);
        let noise = NoiseModel::new(self.rig, &Plan::of_order(2))?;
        let outlook = Outlook::built_in();
        let classes: Vec<Class> =
            self.materials.iter().map(|(_, brdf)| Class::of_contrast(contrast(brdf.as_ref()))).collect();
        let mut points = Vec::new();
        for scheme in Scheme::ALL {
            for order in (0..=FORECAST).filter(|&order| scheme.step_count(order).is_ok()) {
                let plan = Plan::of_order(order).by(scheme);
                let noise_rel = noise.noise_rel(&plan, 0.3)?;
                let predicted = classes.iter().map(|&class| outlook.error(class, order, noise_rel)).collect();
                points.push(PlanPoint {
                    scheme: scheme.name().into(),
                    order,
                    exposures: plan.frames() / plan.images(),
                    frames: plan.frames(),
                    rig_s: plan.rig_time(&timing).total_s(),
                    method: FitMethod::Auto.name().into(),
                    predicted: Some(median(predicted)),
                    measured: None,
                });
            }
        }
        for i in 0..runs.first().map_or(0, Vec::len) {
            let of = |value: fn(&Run) -> f64| median(runs.iter().map(|r| value(&r[i])).collect());
            let run = &runs[0][i];
            let point = PlanPoint {
                scheme: run.scheme.clone(),
                order: of(|r| r.order as f64) as usize,
                exposures: run.exposures,
                frames: of(|r| r.frames as f64) as usize,
                rig_s: of(|r| r.rig_s),
                method: run.method.name().into(),
                predicted: None,
                measured: Some(of(|r| r.error)),
            };
            let same = |p: &&mut PlanPoint| {
                (&p.scheme, p.order, p.exposures, &p.method)
                    == (&point.scheme, point.order, point.exposures, &point.method)
            };
            match points.iter_mut().find(same) {
                Some(forecast) => forecast.measured = point.measured,
                None => points.push(point),
            }
        }
        Ok(points)
    }

    fn conversions(&self, known: &Coefficients, truth: &dyn Brdf) -> Result<Vec<ComputePoint>, ParetoError> {
        let point = |method: &str, seconds: f64, material: &ShMaterial| {
            let errors = ZoneErrors::new(material, truth, self.rig.zone());
            let baseline = [Method::Thesis, Method::Hsh].iter().any(|m| m.name() == method);
            let error = errors.inside.hypot(errors.outside);
            ComputePoint { stage: Stage::Conversion, method: method.into(), seconds, error, baseline }
        };
        let mut points = Vec::new();
        for method in Method::ALL {
            let started = Instant::now();
            let conversion = convert::tuned(known, method, Rule::Auto).map_err(ConvertError::from)?;
            let material = ShMaterial::new(known, &conversion);
            points.push(point(method.name(), started.elapsed().as_secs_f64(), &material));
        }
        let started = Instant::now();
        if let Ok((converted, _)) = convert::prior(known, &PriorTable::built_in()) {
            points.push(point("prior", started.elapsed().as_secs_f64(), &converted.into()));
        }
        Ok(points)
    }

    fn fits(&self, known: &Coefficients, reference: &Reference<'_>) -> Result<Vec<ComputePoint>, ParetoError> {
        let point = |method: FitMethod| {
            let fitted = fit(known, method, &FitOptions::default())?;
            Ok(ComputePoint {
                stage: Stage::Fit,
                method: method.name().into(),
                seconds: fitted.fit_s,
                error: reference.errors(&fitted.brdf)?.mean.overall(),
                baseline: matches!(method, FitMethod::Thesis | FitMethod::GgxToReconstruction),
            })
        };
        FitMethod::ALL.into_iter().map(point).collect()
    }

    /// Zonal coefficients of a material, order 4, by quadratures of different size and by the simulated rig as a whole; errors
    /// against the finest, of z_00.
    fn simulations(&self, brdf: &Arc<dyn Brdf>) -> Result<Vec<ComputePoint>, ParetoError> {
        const ORDER: usize = 4;
        let zone = self.rig.zone();
        let mut points = Vec::new();
        let plan = Plan::of_order(ORDER).by(Scheme::Isotropic);
        let rig_run = |accuracy: Accuracy| -> Result<(f64, Coefficients), ParetoError> {
            let started = Instant::now();
            let mut bench = TwinBench::with_accuracy(self.rig, self.config.clone().noiseless(), brdf.clone(), accuracy);
            let measured = self.measured(&plan, &mut bench)?;
            Ok((started.elapsed().as_secs_f64(), measured.coefficients))
        };
        let fine = Accuracy::default();
        let coarse = Accuracy { dome_nodes: 1597, lobe_nodes: 987, sectors: 64, rings_per_lobe: 1.0 };
        let (_, best) = rig_run(Accuracy::doubled())?;
        for (name, accuracy) in [("rig", fine), ("rig, half", coarse)] {
            let (seconds, found) = rig_run(accuracy)?;
            points.push(simulation(name, seconds, apart(&found, &best), false));
        }
        let folded = Observations::folded(&best);
        let rule = |fineness| -> Result<(f64, [Vec<f64>; 3]), ParetoError> {
            let started = Instant::now();
            let found = Forward::new(&folded, fineness).map_err(FitError::from)?.predict(brdf.as_ref());
            Ok((started.elapsed().as_secs_f64(), found))
        };
        let (_, exact) = rule(Fineness { radial: 96, around: 192 })?;
        let fineness = [("polar 16", 16, 32), ("polar 32", 32, 64), ("polar 48", 48, 96)];
        for (name, radial, around) in fineness {
            let (seconds, found) = rule(Fineness { radial, around })?;
            points.push(simulation(name, seconds, differ(&found, &exact, folded.terms.len()), false));
        }
        let started = Instant::now();
        let basis = Harmonics::zonal(zone, ORDER).map_err(FitError::from)?;
        let mut plain: [Vec<f64>; 3] = Default::default();
        let mut values = vec![0.0; basis.len()];
        for station in &folded.stations {
            let wo = station.wo(&folded.grid);
            let mut sums = vec![[0.0; 3]; folded.terms.len()];
            let inside = polar_about_mirror(&wo, 96, 128, zone.theta_max());
            for (wi, w) in inside.into_iter().filter(|(wi, _): &(Direction, f64)| zone.contains(wi.theta())) {
                basis.eval_direction_into(&wi, &mut values);
                let f = brdf.eval_cos(&wi, &wo);
                for (sum, &k) in sums.iter_mut().zip(&folded.terms) {
                    sum.iter_mut().zip(f).for_each(|(s, f)| *s += w * values[k] * f);
                }
            }
            (0..3).for_each(|c| plain[c].extend(sums.iter().map(|s| s[c])));
        }
        let seconds = started.elapsed().as_secs_f64();
        points.push(simulation("midpoints", seconds, differ(&plain, &exact, folded.terms.len()), true));
        Ok(points)
    }
}

fn simulation(method: &str, seconds: f64, error: f64, baseline: bool) -> ComputePoint {
    ComputePoint { stage: Stage::Simulation, method: method.into(), seconds, error, baseline }
}

/// RMS difference over RMS z_00.
fn apart(a: &Coefficients, b: &Coefficients) -> f64 {
    let squares = a.values.iter().zip(&b.values).map(|(x, y)| f64::from(x - y).powi(2)).filter(|s| s.is_finite());
    (squares.sum::<f64>() / a.values.len() as f64).sqrt() / b.dc()
}

/// The same of predictions by channel, `station * terms + term`.
fn differ(a: &[Vec<f64>; 3], b: &[Vec<f64>; 3], terms: usize) -> f64 {
    let mean = |values: Vec<f64>| values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64;
    let off = a.iter().flatten().zip(b.iter().flatten()).map(|(x, y)| x - y).collect();
    let constant = b.iter().flat_map(|z| z.iter().step_by(terms).copied()).collect();
    (mean(off) / mean(constant)).sqrt()
}

fn published(runs: &[Vec<Run>]) -> Vec<SeedPoint> {
    let error = |order: usize| -> Vec<f64> {
        let own = |r: &&Run| r.order == order && r.method == FitMethod::Thesis;
        runs.iter().filter_map(|of| of.iter().find(own)).map(|r| r.error).collect()
    };
    let points = PUBLISHED.map(|(order, rig_s)| (order, rig_s, error(order)));
    let known = points.into_iter().filter(|(.., errors)| !errors.is_empty());
    known.map(|(order, rig_s, errors)| SeedPoint { order, rig_s, error: median(errors) }).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A run waits for a thread that reduces with rayon: in rayon's own threads all could wait for each other.
    #[test]
    fn tasks_run_beside_rayon_and_answer_in_order() {
        let found = side_by_side(9, |i| Ok::<_, usize>((i, rayon::current_thread_index())));
        assert_eq!(found, Ok((0..9).map(|i| (i, None)).collect()));
        assert_eq!(side_by_side(9, |i| if i == 4 { Err(i) } else { Ok(i) }), Err(4));
    }
}
