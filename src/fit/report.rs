//! What a fit tells of itself, and the file that keeps it.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::uncertainty::Covariance;
use super::{CalibrationUncertainty, FitMethod, Fitted, Observations, Selection, Termination};
use crate::geometry::{Direction, Zone};
use crate::radiometry::ColourSpace;
use crate::reflectance::{Brdf, Model};
use crate::store::{self, StoreError};

/// Version of the file.
const FORMAT: u32 = 1;
/// Polar angles of the albedos that are reported, degrees.
const ALBEDO_DEG: [f64; 4] = [10.0, 45.0, 70.0, 80.0];
/// Parameters above this count are listed without their correlations.
const CORRELATED: usize = 16;

/// A fitted model with all that is known about how well it fits: the file `zonal fit` writes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FitReport {
    /// Version of this file.
    pub format: u32,
    /// Program and version.
    pub software: String,
    /// The family of the model.
    pub model: FitMethod,
    /// What was asked for.
    pub requested: FitMethod,
    /// The model itself.
    pub brdf: Model,
    /// Its parameters by name; albedos and weights have no unit, angles are in radians, colours end in `_r|_g|_b`.
    pub parameters: BTreeMap<String, f64>,
    /// Standard errors: noise, misfit and calibration; null where a parameter lies on a bound or nothing tells its error.
    pub standard_errors: BTreeMap<String, Option<f64>>,
    /// Names of the rows of `correlations`.
    pub correlated: Vec<String>,
    /// Correlation matrix of the parameters; empty for models of many parameters.
    pub correlations: Vec<Vec<f64>>,
    /// Root of chi squared over degrees of freedom: 1 if noise is all that the model leaves.
    pub chi: f64,
    /// RMS residual over RMS z_00.
    pub misfit_rel: f64,
    /// RMS standard error of the data over RMS z_00.
    pub noise_rel: f64,
    /// RMS deviation from isotropy over its standard error; 1 for an isotropic sample.
    pub isotropy_chi: f64,
    /// Why the search ended.
    pub termination: Termination,
    /// Whether the model may be used.
    pub successful: bool,
    /// Sets of shape parameters that were tried.
    pub evaluations: usize,
    /// Time from coefficients to model.
    pub fit_s: f64,
    /// Zonal order of the data.
    pub order: usize,
    /// Limits of the measured zone.
    pub zone_deg: [f64; 2],
    /// How well the rig was taken to be known.
    pub calibration: CalibrationUncertainty,
    /// Where the model misses.
    pub residuals: ResidualMap,
    /// Whether it can be a reflectance.
    pub plausibility: Plausibility,
    /// How `auto` chose.
    pub selection: Option<Selection>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// Units of the model.
    pub units: String,
    /// Colour space of the model.
    pub colour_space: String,
    /// What was measured, with what.
    pub history: String,
}

/// RMS residuals over RMS z_00.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResidualMap {
    /// Exitant polar angles of the rows.
    pub theta_o_deg: Vec<f64>,
    /// By exitant ring and degree l: `[ring][l]`, mean of channels and of m.
    pub by_ring_and_degree: Vec<Vec<f64>>,
}

/// Physical plausibility.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plausibility {
    /// Exitant polar angles of the albedos.
    pub theta_o_deg: Vec<f64>,
    /// Directional albedo at those, linear RGB.
    pub albedo: Vec<[f64; 3]>,
    /// Whether none exceeds 1.
    pub conserves_energy: bool,
    /// Largest relative change of f when light and camera change places.
    pub reciprocity_error: f64,
    /// Smallest f, 1/sr, over a grid of directions.
    pub smallest: f64,
}

impl Plausibility {
    /// Checks a model; closed forms are reciprocal and positive by construction, and this shows it.
    pub fn of(brdf: &dyn Brdf) -> Self {
        let theta_o_deg = ALBEDO_DEG.to_vec();
        let albedo: Vec<[f64; 3]> =
            theta_o_deg.iter().map(|t| brdf.albedo(&Direction::from_angles(t.to_radians(), 0.0))).collect();
        let angles = [5.0f64, 25.0, 45.0, 65.0, 80.0].map(f64::to_radians);
        let (mut reciprocity_error, mut smallest) = (0.0f64, f64::INFINITY);
        for theta_i in angles {
            for theta_o in angles {
                for phi in [0.0, 1.1, 2.2, std::f64::consts::PI] {
                    let (wi, wo) = (Direction::from_angles(theta_i, phi), Direction::from_angles(theta_o, 0.0));
                    for (f, g) in brdf.eval(&wi, &wo).into_iter().zip(brdf.eval(&wo, &wi)) {
                        smallest = smallest.min(f);
                        if f.max(g) > 0.0 {
                            reciprocity_error = reciprocity_error.max((f - g).abs() / f.max(g));
                        }
                    }
                }
            }
        }
        // What quadrature and a gray card leave uncertain is no violation.
        let conserves_energy = albedo.iter().flatten().all(|a| *a <= 1.005);
        Self { theta_o_deg, albedo, conserves_energy, reciprocity_error, smallest }
    }
}

/// What the pieces of a report come from.
pub(super) struct Parts<'a> {
    pub fitted: &'a Fitted,
    pub requested: FitMethod,
    pub covariance: &'a Covariance,
    pub observations: &'a Observations,
    pub predictions: [Vec<f64>; 3],
    pub data: usize,
    pub calibration: CalibrationUncertainty,
    pub selection: Option<Selection>,
    pub fit_s: f64,
    pub history: String,
}

impl FitReport {
    pub(super) fn new(parts: Parts<'_>) -> Self {
        let Parts { fitted, covariance, observations, .. } = parts;
        let minimum = &fitted.minimum;
        let shapes = fitted.family.shape();
        let mut names: Vec<String> = shapes.iter().map(|p| p.name.to_owned()).collect();
        let mut values = minimum.theta.clone();
        for (name, x) in fitted.family.linear().iter().zip(&minimum.solution.x) {
            names.extend(["r", "g", "b"].map(|c| format!("{name}_{c}")));
            values.extend(x);
        }
        let brdf = fitted.model.clone();
        let free = covariance.free.iter().filter(|f| **f).count();
        let chi = (minimum.solution.chi2 / parts.data.saturating_sub(free).max(1) as f64).sqrt();
        let correlated = names.len() <= CORRELATED;
        let residuals = ResidualMap::new(observations, &parts.predictions);
        let plausibility = Plausibility::of(&brdf);
        let mut report = Self {
            format: FORMAT,
            software: concat!("zonal ", env!("CARGO_PKG_VERSION")).into(),
            model: fitted.method,
            requested: parts.requested,
            standard_errors: names
                .iter()
                .cloned()
                .enumerate()
                .map(|(j, n)| (n, covariance.standard_error(j)))
                .collect(),
            correlations: if correlated {
                let row = |i: usize| (0..names.len()).map(|j| covariance.correlation(i, j)).collect();
                (0..names.len()).map(row).collect()
            } else {
                Vec::new()
            },
            correlated: if correlated { names.clone() } else { Vec::new() },
            parameters: names.into_iter().zip(values).collect(),
            chi,
            misfit_rel: observations.misfit(&parts.predictions),
            noise_rel: observations.noise_rel(),
            isotropy_chi: observations.isotropy_chi,
            termination: minimum.termination,
            successful: minimum.termination.was_successful(),
            evaluations: minimum.evaluations,
            fit_s: parts.fit_s,
            order: observations.order,
            zone_deg: [observations.grid.zone().theta_min(), observations.grid.zone().theta_max()].map(f64::to_degrees),
            calibration: parts.calibration,
            residuals,
            plausibility,
            selection: parts.selection,
            warnings: Vec::new(),
            units: "f in 1/sr; f_cos = f cos(theta_i)".into(),
            colour_space: format!("linear {}", ColourSpace::of_history(&parts.history).label()),
            history: parts.history,
            brdf,
        };
        report.warnings = report.warn(observations);
        report
    }

    fn warn(&self, observations: &Observations) -> Vec<String> {
        let percent = |x: f64| format!("{:.1}%", 100.0 * x);
        let mut warnings = Vec::new();
        if !self.successful {
            warnings.push(format!("the search ended with {:?}: the parameters are no minimum", self.termination));
        }
        if let Some(share) = observations.backscatter_share().filter(|s| *s > RETRO) {
            warnings.push(format!(
                "the sample sends light back to its source ({share:.1} times what it mirrors): families of half vectors cannot \
                 describe it; {} misses by {} of z_00",
                self.model,
                percent(self.misfit_rel)
            ));
        } else if self.misfit_rel > MISFIT {
            warnings.push(format!(
                "the model misses the measured coefficients by {} of z_00: the family does not describe this sample",
                percent(self.misfit_rel)
            ));
        }
        if !self.plausibility.conserves_energy {
            let most = self.plausibility.albedo.iter().flatten().copied().fold(0.0, f64::max);
            warnings.push(format!(
                "the albedo reaches {most:.2} outside of what was measured: do not use the model near grazing angles"
            ));
        }
        warnings
    }

    /// Writes it as JSON.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write(&self, path: &Path) -> Result<(), StoreError> {
        store::write_json(path, self)
    }

    /// Reads what [`FitReport::write`] wrote.
    ///
    /// # Errors
    /// [`StoreError`]; [`StoreError::Invalid`] too for parameters that no reflectance has.
    pub fn read(path: &Path) -> Result<Self, StoreError> {
        let report: Self = store::read_versioned(path, FORMAT)?;
        let invalid = |what: String| StoreError::invalid(path, format!("{what}: fit the run again"));
        report.brdf.check().map_err(|e| invalid(e.to_string()))?;
        Zone::from_degrees(report.zone_deg[0], report.zone_deg[1]).map_err(|e| invalid(e.to_string()))?;
        Ok(report)
    }

    /// The measured zone.
    pub fn zone(&self) -> Zone {
        Zone::from_degrees(self.zone_deg[0], self.zone_deg[1]).expect("checked when it was read, or a rig's")
    }
}

/// Reflection back to the source over mirror reflection above which a sample counts as retro-reflective.
const RETRO: f64 = 1.5;
/// Residuals above this share of z_00 mean that the family is wrong.
const MISFIT: f64 = 0.1;

impl ResidualMap {
    fn new(observations: &Observations, predictions: &[Vec<f64>; 3]) -> Self {
        let grid = observations.grid;
        let dc = observations.dc();
        let degrees = observations.order + 1;
        let mut sums = vec![vec![(0.0, 0usize); degrees]; grid.rings()];
        let data =
            observations.stations.iter().flat_map(|s| observations.terms.iter().zip(&s.z).map(move |d| (s.ring, d)));
        for (i, (ring, (&k, z))) in data.enumerate() {
            let cell = &mut sums[ring][crate::basis::lm(k).0];
            for c in 0..3 {
                cell.0 += (z[c] - predictions[c][i]).powi(2);
                cell.1 += 1;
            }
        }
        let measured: Vec<usize> = (0..grid.rings()).filter(|&r| sums[r][0].1 > 0).collect();
        let row = |&r: &usize| sums[r].iter().map(|(s, n)| (s / (*n).max(1) as f64).sqrt() / dc).collect();
        Self {
            theta_o_deg: measured.iter().map(|&r| grid.theta(r).to_degrees()).collect(),
            by_ring_and_degree: measured.iter().map(row).collect(),
        }
    }
}
