//! What errors of parts cost in what is measured: linear sensitivities, and all of them drawn at once.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::Serialize;
use thiserror::Error;

use super::seen::{Blur, Seen, Shift};
use crate::basis::{OrderError, about_normal, size};
use crate::fit::{Fineness, FitError, FitMethod, FitOptions, Forward, Observations, fit};
use crate::geometry::ExitantGrid;
use crate::optics::{Device, Misaligned, Misalignment, PupilMap, Rig, Tolerances};
use crate::reduce::Coefficients;
use crate::reflectance::Brdf;

/// Exitant directions: rings and sectors.
const GRID: [usize; 2] = [6, 8];
/// Nodes of the integrals over incident directions.
const FINENESS: Fineness = Fineness { radial: 20, around: 32 };
/// Standard error that fits are told, over z_00.
const NOISE_REL: f64 = 0.01;
/// Multiples of the tolerances that are drawn.
pub const SCALES: [f64; 4] = [0.5, 1.0, 2.0, 4.0];
/// A second-order term of this share of the first ends what is linear.
const NOT_LINEAR: f64 = 0.1;

/// Why tolerances could not be analysed.
#[derive(Debug, Error)]
pub enum ToleranceError {
    /// The order is out of range.
    #[error(transparent)]
    Order(#[from] OrderError),
    /// The material cannot be fitted.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// A part may be so far off that rays miss.
    #[error("with {key} off by {value} rays miss a mirror: make it smaller in [tolerances]")]
    Misses {
        /// The key.
        key: &'static str,
        /// The error that was tried.
        value: f64,
    },
}

/// One source of error.
struct Source {
    key: &'static str,
    part: &'static str,
    /// Standard deviation, in the unit of the key.
    sigma: f64,
    /// Independent errors that have it.
    axes: usize,
    set: fn(&mut Errors, usize, f64),
}

/// All that is off.
#[derive(Debug, Clone, Default)]
struct Errors {
    misalignment: Misalignment,
    convex_slope_mrad: f64,
    dome_slope_mrad: f64,
    /// Whether the pupil of a device is finite.
    pupils: [bool; 2],
}

/// What one source costs at one standard deviation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Key of the tolerance.
    pub key: &'static str,
    /// Part to hold tighter.
    pub part: &'static str,
    /// Standard deviation, in the key's unit.
    pub sigma: f64,
    /// RMS error of directions over the zone, degrees: camera, projector.
    pub direction_deg: [f64; 2],
    /// RMS error of all zonal coefficients over RMS z_00.
    pub coefficients_rel: f64,
    /// Multiple of the standard deviation at which the second order is a tenth of the first; none for what only blurs.
    pub linear_up_to: Option<f64>,
    /// Change of each parameter of the fitted model; in quadrature over the errors that have this tolerance.
    pub parameters: Vec<f64>,
}

/// All sources at once, at a multiple of their tolerances.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Drawn {
    /// The multiple.
    pub scale: f64,
    /// RMS error of the coefficients over RMS z_00: sum of squares of the linear terms.
    pub linear_rel: f64,
    /// The same, RMS over draws.
    pub monte_carlo_rel: f64,
    /// Standard error of the last.
    pub standard_error: f64,
}

/// The analysis of a rig and a material.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ToleranceTable {
    /// Zonal order of the coefficients.
    pub order: usize,
    /// Family of the model that is fitted.
    pub family: String,
    /// Names of its parameters, and what they are without errors.
    pub parameters: Vec<(String, f64)>,
    /// Sources, the costliest first.
    pub rows: Vec<Row>,
    /// All at once.
    pub drawn: Vec<Drawn>,
    /// Number of draws.
    pub draws: usize,
}

const MISALIGNMENTS: usize = 17;

fn sources(t: &Tolerances) -> Vec<Source> {
    macro_rules! source {
        ($part:literal, $key:ident, 2) => {
            Source {
                key: stringify!($key),
                part: $part,
                sigma: t.$key,
                axes: 2,
                set: |e, i, x| e.misalignment.$key[i] = x,
            }
        };
        ($part:literal, $key:ident, 1) => {
            Source {
                key: stringify!($key),
                part: $part,
                sigma: t.$key,
                axes: 1,
                set: |e, _, x| e.misalignment.$key = x,
            }
        };
    }
    vec![
        source!("camera", camera_displacement_mm, 2),
        source!("camera", camera_turn_deg, 2),
        source!("camera", camera_height_mm, 1),
        source!("camera", camera_scale_rel, 1),
        source!("projector", projector_displacement_mm, 2),
        source!("projector", projector_turn_deg, 2),
        source!("projector", projector_height_mm, 1),
        source!("projector", projector_scale_rel, 1),
        source!("paraboloid", paraboloid_offset_mm, 2),
        source!("paraboloid", paraboloid_tilt_deg, 2),
        source!("paraboloid", paraboloid_height_mm, 1),
        source!("dome", dome_offset_mm, 2),
        source!("dome", dome_tilt_deg, 2),
        source!("dome", dome_height_mm, 1),
        Source {
            key: "dome_figure_mm",
            part: "dome",
            sigma: t.dome_figure_mm,
            axes: 4,
            set: |e, i, x| e.misalignment.dome_figure_mm[i] = x,
        },
        source!("sample", sample_height_mm, 1),
        source!("sample", sample_tilt_deg, 2),
        // From here on, what blurs and shifts nothing.
        Source {
            key: "camera_focus_mm",
            part: "camera",
            sigma: t.camera_focus_mm,
            axes: 1,
            set: |e, _, x| (e.misalignment.camera_focus_mm, e.pupils[0]) = (x, true),
        },
        Source {
            key: "projector_focus_mm",
            part: "projector",
            sigma: t.projector_focus_mm,
            axes: 1,
            set: |e, _, x| (e.misalignment.projector_focus_mm, e.pupils[1]) = (x, true),
        },
        Source {
            key: "paraboloid_slope_mrad",
            part: "paraboloid",
            sigma: t.paraboloid_slope_mrad,
            axes: 1,
            set: |e, _, x| e.convex_slope_mrad = x.abs(),
        },
        Source {
            key: "dome_slope_mrad",
            part: "dome",
            sigma: t.dome_slope_mrad,
            axes: 1,
            set: |e, _, x| e.dome_slope_mrad = x.abs(),
        },
    ]
}

/// Measures a material in a rig with errors, by integrals without noise.
struct Bench<'a> {
    rig: &'a Rig,
    brdf: &'a dyn Brdf,
    blank: Coefficients,
    observations: Observations,
    forward: Forward,
    /// Way from the convex mirror to the dome over that from the dome to the sample, mean over the zone.
    lever: f64,
}

impl<'a> Bench<'a> {
    fn new(rig: &'a Rig, brdf: &'a dyn Brdf, order: usize) -> Result<Self, OrderError> {
        let grid = ExitantGrid::new(rig.zone(), GRID[0], GRID[1]);
        let n = 3 * grid.len() * size(order);
        let history = "integrals without noise".to_owned();
        let blank = Coefficients { grid, order, values: vec![0.0; n], sigma: vec![1.0; n], history };
        let observations = Observations::anisotropic(&blank);
        let forward = Forward::new(&observations, FINENESS)?;
        let mirrors = rig.mirrors();
        let lever = |i: usize| {
            let theta =
                rig.zone().theta_min() + (i as f64 + 0.5) / 16.0 * (rig.zone().theta_max() - rig.zone().theta_min());
            let rho = mirrors.rho_of(theta, mirrors.edge_radius()).expect("the zone is reached");
            let (p, d) = (mirrors.convex().point(rho), mirrors.profile(rho).expect("the zone is reached"));
            (d - p).norm() / d.coords.norm()
        };
        let lever = (0..16).map(lever).sum::<f64>() / 16.0;
        Ok(Self { rig, brdf, blank, observations, forward, lever })
    }

    fn shifts(&self, errors: &Errors) -> Option<[Shift; 2]> {
        let shift = |device| Shift::new(self.rig, &errors.misalignment, device);
        Some([shift(Device::Camera)?, shift(Device::Projector)?])
    }

    /// Coefficients in the frame of each station: `[channel][station * terms + term]`.
    fn measure(&self, errors: &Errors) -> Option<[Vec<f64>; 3]> {
        let [camera, projector] = self.shifts(errors)?;
        // A slope error turns a ray by twice as much; at the convex mirror it is seen from the sample over the lever.
        let rough = 2e-3 * errors.dome_slope_mrad.hypot(self.lever * errors.convex_slope_mrad);
        let zone = self.rig.zone();
        let blur = |device: Device, finite: bool, pupil_mm: f64| {
            let traced = Misaligned::new(self.rig, &errors.misalignment, device);
            let pupil = if finite {
                Some((PupilMap::new(&traced, zone.theta_min(), zone.theta_max())?, pupil_mm))
            } else {
                None
            };
            Some(Blur { pupil, rough })
        };
        let seen = Seen {
            brdf: self.brdf,
            projector,
            camera,
            camera_blur: blur(Device::Camera, errors.pupils[0], self.rig.camera.pupil_mm())?,
            projector_blur: blur(Device::Projector, errors.pupils[1], self.rig.projector.pupil_mm())?,
            lit: None,
        };
        Some(self.forward.predict(&seen))
    }

    /// The same as a run would keep them.
    fn coefficients(&self, z: &[Vec<f64>; 3]) -> Coefficients {
        let mut made = self.blank.clone();
        let (cells, terms) = (made.grid.len(), self.observations.terms.len());
        let dc = self.dc(z);
        for (s, station) in self.observations.stations.iter().enumerate() {
            let cell = station.ring * made.grid.sectors()
                + (station.phi_o / std::f64::consts::TAU * made.grid.sectors() as f64).round() as usize
                    % made.grid.sectors();
            for (c, z) in z.iter().enumerate() {
                let turned = about_normal(&z[s * terms..][..terms], station.phi_o);
                for (k, z) in turned.iter().enumerate() {
                    made.values[(k * 3 + c) * cells + cell] = *z as f32;
                }
            }
        }
        made.sigma.fill((NOISE_REL * dc) as f32);
        made
    }

    /// RMS z_00.
    fn dc(&self, z: &[Vec<f64>; 3]) -> f64 {
        let terms = self.observations.terms.len();
        let squares: Vec<f64> = z.iter().flat_map(|z| z.iter().step_by(terms)).map(|z| z * z).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    }

    /// Root of the sum over functions of mean squares over directions and channels.
    fn norm(&self, z: &[Vec<f64>; 3]) -> f64 {
        let sum: f64 = z.iter().flatten().map(|z| z * z).sum();
        (sum / (3 * self.observations.stations.len()) as f64).sqrt()
    }
}

fn combined(a: &[Vec<f64>; 3], x: f64, b: &[Vec<f64>; 3], y: f64) -> [Vec<f64>; 3] {
    std::array::from_fn(|c| a[c].iter().zip(&b[c]).map(|(a, b)| x * a + y * b).collect())
}

impl ToleranceTable {
    /// Analyses a rig with its tolerances, for a material measured to an order; `draws` draws at each scale, from `seed`.
    ///
    /// Chief rays are followed through rigs with errors and taken for those of the nominal rig: no calibration has found the
    /// errors yet. What only blurs (focus, roughness) adds what its rays' second moments do; focus relative to pupils in focus.
    ///
    /// # Errors
    /// [`ToleranceError`].
    pub fn new(rig: &Rig, brdf: &dyn Brdf, order: usize, draws: usize, seed: u64) -> Result<Self, ToleranceError> {
        let bench = Bench::new(rig, brdf, order)?;
        let misses = |key, value| ToleranceError::Misses { key, value };
        let none = Errors::default();
        let ideal = bench.measure(&none).ok_or(misses("nothing", 0.0))?;
        let options = FitOptions::default();
        let fitted = fit(&bench.coefficients(&ideal), FitMethod::Auto, &options)?;
        let family = fitted.model;
        let names: Vec<String> = fitted.parameters.keys().cloned().collect();
        let parameters = |z: &[Vec<f64>; 3]| -> Result<Vec<f64>, FitError> {
            let fitted = fit(&bench.coefficients(z), family, &options)?;
            Ok(names.iter().map(|n| fitted.parameters.get(n).copied().unwrap_or(f64::NAN)).collect())
        };
        let dc = bench.dc(&ideal);
        let sources = sources(&rig.tolerances);
        let mut rows = Vec::new();
        for (i, source) in sources.iter().enumerate() {
            let blurs = i >= MISALIGNMENTS;
            let (mut first, mut second) = (0.0, 0.0);
            let mut directions = [0.0; 2];
            let mut changes = vec![0.0f64; names.len()];
            for axis in 0..source.axes {
                let with = |x: f64| {
                    let mut errors = none.clone();
                    (source.set)(&mut errors, axis, x);
                    errors
                };
                let measured = |x: f64| bench.measure(&with(x)).ok_or(misses(source.key, x));
                let plus = measured(source.sigma)?;
                // Blur is of second order about a rig in focus; of the two focus errors the worse counts.
                let (minus, centre) = (measured(-source.sigma)?, if blurs { measured(0.0)? } else { ideal.clone() });
                let (a, b) = (combined(&plus, 1.0, &centre, -1.0), combined(&minus, 1.0, &centre, -1.0));
                let linear = if blurs {
                    if bench.norm(&a) > bench.norm(&b) { a } else { b }
                } else {
                    second += bench.norm(&combined(&a, 0.5, &b, 0.5)).powi(2);
                    combined(&a, 0.5, &b, -0.5)
                };
                first += bench.norm(&linear).powi(2);
                if let Some(shifts) = bench.shifts(&with(source.sigma)) {
                    directions.iter_mut().zip(&shifts).for_each(|(d, s)| *d += s.rms().powi(2));
                }
                let (p, q) = (
                    parameters(&combined(&ideal, 1.0, &linear, 1.0))?,
                    parameters(&combined(&ideal, 1.0, &linear, -1.0))?,
                );
                changes.iter_mut().zip(p.iter().zip(&q)).for_each(|(c, (p, q))| *c += (0.5 * (p - q)).powi(2));
            }
            rows.push(Row {
                key: source.key,
                part: source.part,
                sigma: source.sigma,
                direction_deg: directions.map(|d| d.sqrt().to_degrees()),
                coefficients_rel: first.sqrt() / dc,
                linear_up_to: (!blurs && second > 0.0).then(|| NOT_LINEAR * (first / second).sqrt()),
                parameters: changes.into_iter().map(f64::sqrt).collect(),
            });
        }
        let linear = rows[..MISALIGNMENTS].iter().map(|r| r.coefficients_rel.powi(2)).sum::<f64>().sqrt();
        let drawn = SCALES.map(|scale| {
            // The same draws at every scale: what differs between scales is not chance.
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
            let mut squares = Vec::with_capacity(draws);
            for _ in 0..draws {
                let mut errors = none.clone();
                for source in &sources[..MISALIGNMENTS] {
                    for axis in 0..source.axes {
                        let unit: f64 = StandardNormal.sample(&mut rng);
                        (source.set)(&mut errors, axis, scale * source.sigma * unit);
                    }
                }
                let z = bench.measure(&errors).ok_or(misses("everything, in multiples of its tolerance,", scale))?;
                squares.push((bench.norm(&combined(&z, 1.0, &ideal, -1.0)) / dc).powi(2));
            }
            let n = draws as f64;
            let mean = squares.iter().sum::<f64>() / n;
            let variance = squares.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (n - 1.0);
            let monte_carlo_rel = mean.sqrt();
            Ok(Drawn {
                scale,
                linear_rel: scale * linear,
                monte_carlo_rel,
                standard_error: 0.5 * (variance / n).sqrt() / monte_carlo_rel,
            })
        });
        let drawn = drawn.into_iter().collect::<Result<Vec<_>, ToleranceError>>()?;
        rows.sort_by(|a, b| b.coefficients_rel.total_cmp(&a.coefficients_rel));
        let parameters = fitted.parameters.into_iter().collect();
        Ok(Self { order, family: family.to_string(), parameters, rows, drawn, draws })
    }

    /// Largest scale that was drawn at which linear terms foretell the draws to 10%; none if not even the smallest.
    pub fn linear_up_to(&self) -> Option<f64> {
        let good = |d: &&Drawn| (d.linear_rel / d.monte_carlo_rel - 1.0).abs() <= 0.1;
        self.drawn.iter().take_while(good).last().map(|d| d.scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::open;

    fn rig() -> Rig {
        Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap()
    }

    #[test]
    fn linear_terms_foretell_what_is_drawn() {
        let brdf = open("ggx-0.1").unwrap();
        let table = ToleranceTable::new(&rig(), brdf.as_ref(), 2, 16, 1).unwrap();
        let small = &table.drawn[0];
        let ratio = small.linear_rel / small.monte_carlo_rel;
        let chance = 3.0 * small.standard_error / small.monte_carlo_rel;
        assert!((ratio - 1.0).abs() < 0.1 + chance, "{ratio} {chance}");
        assert!(table.rows.is_sorted_by(|a, b| a.coefficients_rel >= b.coefficients_rel));
    }

    #[test]
    fn a_perfect_rig_measures_what_the_integrals_say() {
        let (rig, brdf) = (rig(), open("gray-card").unwrap());
        let bench = Bench::new(&rig, brdf.as_ref(), 2).unwrap();
        let z = bench.measure(&Errors::default()).unwrap();
        let want = bench.forward.predict(brdf.as_ref());
        assert!(bench.norm(&combined(&z, 1.0, &want, -1.0)) / bench.dc(&want) < 1e-6);
    }
}
