//! How far a model is from a material: relative, logarithmic and albedo errors, inside and outside a zone.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;
use thiserror::Error;

use super::Brdf;
use crate::geometry::quadrature::polar_about_mirror;
use crate::geometry::{Direction, Sample, Zone};

/// Polar angles of the exitant directions of [`Metric`], degrees.
pub const METRIC_EXITANT_DEG: [f64; 6] = [5.0, 20.0, 35.0, 50.0, 65.0, 78.0];
/// Polar angles at which [`Metric`] compares directional albedos, degrees.
pub const ALBEDO_DEG: [f64; 3] = [10.0, 45.0, 70.0];

/// Nodes away from the mirror direction, and around it: twice as many change the errors by less than 2%.
pub(super) const NODES: [usize; 2] = [96, 128];
/// Azimuths of the exitant directions, degrees; isotropic truths need the first alone.
const PHI_O_DEG: [f64; 2] = [0.0, 90.0];
/// Incident directions nearer to the horizon are left out: models and tables mean little there.
const THETA_I_MAX_DEG: f64 = 85.0;
/// Added to f under the logarithm, 1/sr: darker than this, differences count for nothing.
const LOG_FLOOR: f64 = 1e-3;
/// RMS of a truth's negative part over its own RMS, towards one `wo`. Readers of measured files clamp, so that these and
/// closed forms have none; reconstructions have 0.006 (`red-plastic`, order 4) to 0.4 (`ggx-0.1`, order 2).
const NEGATIVE_PART: f64 = 1e-3;

/// The error of a model of a material, over the zone that was measured and over the rest.
///
/// For each `wo` of [`METRIC_EXITANT_DEG`] at phi_o = 0 (and at 90 deg too if the truth is anisotropic), `wi` runs over
/// nodes in polar coordinates about the mirror direction with theta_i <= 85 deg. A pair is *in* if `wi` and `wo` both lie
/// in the zone, and *out* otherwise. Errors are means over those `wo` that have pairs of the kind asked for.
///
/// This judges models, at every pair of directions. [`super::ZoneErrors`] judges a conversion over incident directions
/// alone, for `wo` inside of the zone, and is blind to dark parts.
///
/// ```
/// use zonal::geometry::Zone;
/// use zonal::reflectance::{Lambert, Metric};
///
/// let metric = Metric::new(Zone::from_degrees(9.0, 57.0)?);
/// let errors = metric.errors(&Lambert::gray(0.5), &Lambert::gray(0.6))?;
/// assert!((errors.mean.albedo_error[0] - 0.2).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Metric {
    exitants: Vec<Exitant>,
}

/// All nodes for one `wo`.
#[derive(Debug, Clone)]
struct Exitant {
    wo: Direction<Sample>,
    nodes: Vec<Node>,
}

#[derive(Debug, Clone)]
struct Node {
    wi: Direction<Sample>,
    solid_angle: f64,
    inside: bool,
}

/// A truth evaluated once, to compare many models with.
#[derive(Debug, Clone)]
pub struct Reference<'m> {
    /// Those of the metric that this truth needs.
    exitants: &'m [Exitant],
    /// f_cos at each node of each exitant direction.
    f_cos: Vec<Vec<[f64; 3]>>,
    albedo: [[f64; 3]; 3],
}

/// What [`Metric`] says about one model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MetricErrors {
    /// Of the mean of the channels: the figures to quote.
    #[serde(flatten)]
    pub mean: ChannelErrors,
    /// Of each channel, RGB.
    pub per_channel: [ChannelErrors; 3],
}

/// Errors of one channel, or of the mean of all; none has a unit, 0 is best.
///
/// NaN where there is nothing to compare: the zone leaves no pairs of that kind (0..90 deg has no outside), or the
/// truth is black in this channel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ChannelErrors {
    /// RMS difference of f_cos over solid angle inside, over the RMS of the truth at all nodes.
    pub rel_in: f64,
    /// The same outside.
    pub rel_out: f64,
    /// RMS over projected solid angle of ln((f_model + 1e-3) / (f_truth + 1e-3)) inside, f in 1/sr.
    pub log_in: f64,
    /// The same outside.
    pub log_out: f64,
    /// Directional albedo of the model over that of the truth, less 1, at [`ALBEDO_DEG`]; a positive one is too bright.
    /// Albedos of anisotropic truths are means over both azimuths.
    pub albedo_error: [f64; 3],
}

impl ChannelErrors {
    /// One figure for all: the geometric mean of the four errors, those that are NaN left out. Each counts alike whatever its
    /// scale, so that neither a lobe's height nor what lies in the dark decides alone.
    pub fn overall(&self) -> f64 {
        let known = [self.rel_in, self.rel_out, self.log_in, self.log_out].into_iter().filter(|e| !e.is_nan());
        let (sum, n) = known.fold((0.0, 0), |(sum, n), e| (sum + e.ln(), n + 1));
        (sum / f64::from(n)).exp()
    }
}

/// Who has a value that cannot be compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The material.
    Truth,
    /// The model of it.
    Model,
}

impl fmt::Display for Side {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Truth => "truth",
            Self::Model => "model",
        })
    }
}

/// Angles of a pair of directions, degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairDeg {
    /// theta_i and phi_i.
    pub wi: [f64; 2],
    /// theta_o and phi_o.
    pub wo: [f64; 2],
}

impl PairDeg {
    fn new(wi: &Direction<Sample>, wo: &Direction<Sample>) -> Self {
        let degrees = |d: &Direction<Sample>| [d.theta(), d.phi()].map(f64::to_degrees);
        Self { wi: degrees(wi), wo: degrees(wo) }
    }
}

impl fmt::Display for PairDeg {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { wi, wo } = self;
        write!(f, "wi ({:.1}, {:.1}) deg, wo ({:.1}, {:.1}) deg (theta, phi)", wi[0], wi[1], wo[0], wo[1])
    }
}

/// Why a comparison has no meaning.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum MetricError {
    /// The truth is negative by more than rounding.
    #[error(
        "the truth is negative: f_cos = {f_cos:.3e} 1/sr at {at}, and its negative part is {share:.1e} of its RMS \
         towards this wo: a reconstruction is no truth; give a measured file or a name from `zonal materials`"
    )]
    Negative {
        /// Its most negative value towards that `wo`, 1/sr.
        f_cos: f64,
        /// Where that is.
        at: PairDeg,
        /// RMS of the negative part over the RMS.
        share: f64,
    },
    /// A value is infinite or no number.
    #[error("the {side} is {f_cos} at {at}: repair the parameters or the file it comes from")]
    NotFinite {
        /// Whose value it is.
        side: Side,
        /// The value of f_cos, 1/sr.
        f_cos: f64,
        /// Where it is.
        at: PairDeg,
    },
    /// The albedo is infinite or no number, though f is finite at all nodes.
    #[error("the {side} has albedo {albedo} at theta_o = {theta_o_deg} deg: look for what diverges near the horizon")]
    AlbedoNotFinite {
        /// Whose albedo it is.
        side: Side,
        /// The albedo.
        albedo: f64,
        /// Where, degrees.
        theta_o_deg: f64,
    },
    /// The truth reflects nothing.
    #[error(
        "the truth is black towards theta_o = {theta_o_deg} deg, so that no error can be relative to it: \
         give a material that reflects"
    )]
    Black {
        /// Towards where, degrees.
        theta_o_deg: f64,
    },
}

impl Metric {
    /// The metric over the pairs inside and outside of `zone`.
    pub fn new(zone: Zone) -> Self {
        Self::with_nodes(zone, NODES)
    }

    fn with_nodes(zone: Zone, [radial, around]: [usize; 2]) -> Self {
        let exitant = |theta_o_deg: f64, phi_o_deg: f64| {
            let theta_o = theta_o_deg.to_radians();
            let wo = Direction::from_angles(theta_o, phi_o_deg.to_radians());
            let nodes = polar_about_mirror(&wo, radial, around, THETA_I_MAX_DEG.to_radians())
                .into_iter()
                .map(|(wi, solid_angle)| {
                    let inside = zone.contains(theta_o) && zone.contains(wi.theta());
                    Node { wi, solid_angle, inside }
                })
                .collect();
            Exitant { wo, nodes }
        };
        let exitants = PHI_O_DEG.iter().flat_map(|&phi| METRIC_EXITANT_DEG.map(|theta| exitant(theta, phi))).collect();
        Self { exitants }
    }

    /// Compares one model with a truth.
    ///
    /// # Errors
    /// As [`Metric::reference`] and [`Reference::errors`].
    pub fn errors(&self, truth: &dyn Brdf, model: &dyn Brdf) -> Result<MetricErrors, MetricError> {
        self.reference(truth)?.errors(model)
    }

    /// Evaluates a truth, to compare models with. Small negative values count as 0.
    ///
    /// # Errors
    /// [`MetricError`] where the truth is black, not finite, or negative by more than 1e-3 of its RMS towards one `wo`.
    pub fn reference(&self, truth: &dyn Brdf) -> Result<Reference<'_>, MetricError> {
        let needed = if truth.is_isotropic() { METRIC_EXITANT_DEG.len() } else { self.exitants.len() };
        let exitants = &self.exitants[..needed];
        let mut f_cos = evaluate(truth, exitants, Side::Truth)?;
        for (exitant, f_cos) in exitants.iter().zip(&mut f_cos) {
            exitant.check_truth(f_cos)?;
        }
        Ok(Reference { exitants, f_cos, albedo: albedo(truth, exitants, Side::Truth)? })
    }
}

impl Reference<'_> {
    /// Compares a model with the truth.
    ///
    /// # Errors
    /// [`MetricError`] where the model is not finite.
    pub fn errors(&self, model: &dyn Brdf) -> Result<MetricErrors, MetricError> {
        let model_f_cos = evaluate(model, self.exitants, Side::Model)?;
        let model_albedo = albedo(model, self.exitants, Side::Model)?;
        let pairs = self.f_cos.iter().zip(&model_f_cos).map(|(t, m)| t.iter().zip(m));
        let errors = |channel: &dyn Fn(&[f64; 3]) -> f64| {
            let mut means = [Mean::default(); 4];
            for (exitant, pairs) in self.exitants.iter().zip(pairs.clone()) {
                let values = pairs.map(|(truth, model)| (channel(truth).max(0.0), channel(model)));
                for (mean, error) in means.iter_mut().zip(exitant.errors(values)) {
                    mean.add(error);
                }
            }
            let [rel_in, rel_out, log_in, log_out] = means.map(|m| m.value());
            let ratio = |k: usize| channel(&model_albedo[k]) / not_zero(channel(&self.albedo[k])) - 1.0;
            ChannelErrors { rel_in, rel_out, log_in, log_out, albedo_error: [0, 1, 2].map(ratio) }
        };
        Ok(MetricErrors { mean: errors(&mean), per_channel: [0, 1, 2].map(|c| errors(&|rgb: &[f64; 3]| rgb[c])) })
    }
}

impl Exitant {
    /// The truth must reflect and must not be negative.
    fn check_truth(&self, f_cos: &[[f64; 3]]) -> Result<(), MetricError> {
        let (mut power, mut negative) = (0.0, [0.0; 3]);
        let mut lowest = (0.0, &self.nodes[0].wi);
        for (node, f_cos) in self.nodes.iter().zip(f_cos) {
            power += node.solid_angle * mean(f_cos).powi(2);
            for (c, &f) in f_cos.iter().enumerate() {
                negative[c] += node.solid_angle * f.min(0.0).powi(2);
                if f < lowest.0 {
                    lowest = (f, &node.wi);
                }
            }
        }
        if power == 0.0 {
            return Err(MetricError::Black { theta_o_deg: self.wo.theta().to_degrees() });
        }
        let share = (negative.into_iter().fold(0.0, f64::max) / power).sqrt();
        if share > NEGATIVE_PART {
            return Err(MetricError::Negative { f_cos: lowest.0, at: PairDeg::new(lowest.1, &self.wo), share });
        }
        Ok(())
    }

    /// rel_in, rel_out, log_in, log_out from f_cos of truth and model at each node; None for a part without nodes.
    fn errors(&self, values: impl Iterator<Item = (f64, f64)>) -> [Option<f64>; 4] {
        let mut parts = [Part::default(); 2];
        let (mut power, mut omega) = (0.0, 0.0);
        for (node, (truth, model)) in self.nodes.iter().zip(values) {
            let (w, cos) = (node.solid_angle, node.wi.cos_theta());
            let log = ((model.max(0.0) / cos + LOG_FLOOR) / (truth / cos + LOG_FLOOR)).ln();
            let part = &mut parts[usize::from(!node.inside)];
            part.difference += w * (model - truth).powi(2);
            part.omega += w;
            part.log += w * cos * log * log;
            part.omega_cos += w * cos;
            power += w * truth * truth;
            omega += w;
        }
        let rms = not_zero((power / omega).sqrt());
        let rel = |part: &Part| (part.omega > 0.0).then(|| (part.difference / part.omega).sqrt() / rms);
        let log = |part: &Part| (part.omega > 0.0).then(|| (part.log / part.omega_cos).sqrt());
        [rel(&parts[0]), rel(&parts[1]), log(&parts[0]), log(&parts[1])]
    }
}

/// Weighted sums over one part of the nodes.
#[derive(Debug, Clone, Copy, Default)]
struct Part {
    difference: f64,
    omega: f64,
    log: f64,
    omega_cos: f64,
}

/// Mean of the values there are; NaN of none.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    sum: f64,
    count: usize,
}

impl Mean {
    fn add(&mut self, value: Option<f64>) {
        if let Some(value) = value {
            self.sum += value;
            self.count += 1;
        }
    }

    fn value(self) -> f64 {
        self.sum / self.count as f64
    }
}

/// f_cos at each node of each exitant direction.
fn evaluate(brdf: &dyn Brdf, exitants: &[Exitant], side: Side) -> Result<Vec<Vec<[f64; 3]>>, MetricError> {
    let at = |exitant: &Exitant| {
        let f_cos_of = brdf.towards(&exitant.wo);
        let finite = |node: &Node| {
            let f_cos = f_cos_of(&node.wi);
            match f_cos.into_iter().find(|f| !f.is_finite()) {
                None => Ok(f_cos),
                Some(f_cos) => Err(MetricError::NotFinite { side, f_cos, at: PairDeg::new(&node.wi, &exitant.wo) }),
            }
        };
        exitant.nodes.iter().map(finite).collect::<Result<Vec<_>, _>>()
    };
    // First all, then the first error: which one is reported must not depend on the threads.
    exitants.par_iter().map(at).collect::<Vec<_>>().into_iter().collect()
}

/// Albedos at [`ALBEDO_DEG`], means over the azimuths of the exitant directions.
fn albedo(brdf: &dyn Brdf, exitants: &[Exitant], side: Side) -> Result<[[f64; 3]; 3], MetricError> {
    let azimuths = &PHI_O_DEG[..exitants.len() / METRIC_EXITANT_DEG.len()];
    let towards = |theta: f64| azimuths.iter().map(move |phi| (theta, *phi));
    let wo: Vec<_> = ALBEDO_DEG.into_iter().flat_map(towards).collect();
    let at = |&(theta, phi): &(f64, f64)| brdf.albedo(&Direction::from_angles(theta.to_radians(), phi.to_radians()));
    let all: Vec<[f64; 3]> = wo.par_iter().map(at).collect();
    let mut means = [[0.0; 3]; 3];
    for (k, albedos) in all.chunks(azimuths.len()).enumerate() {
        for albedo in albedos.iter().flat_map(|rgb| rgb.iter().enumerate()) {
            means[k][albedo.0] += albedo.1 / azimuths.len() as f64;
        }
        if let Some(&albedo) = means[k].iter().find(|a| !a.is_finite()) {
            return Err(MetricError::AlbedoNotFinite { side, albedo, theta_o_deg: ALBEDO_DEG[k] });
        }
    }
    Ok(means)
}

/// Mean of the colour channels.
pub(super) fn mean(rgb: &[f64; 3]) -> f64 {
    rgb.iter().sum::<f64>() / 3.0
}

/// NaN for zero: nothing is relative to it.
fn not_zero(value: f64) -> f64 {
    if value == 0.0 { f64::NAN } else { value }
}

#[cfg(test)]
mod tests;
