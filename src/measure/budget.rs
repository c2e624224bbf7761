//! The uncertainty budget of a run: how far the albedo of the measured zone may be off, and why.
//!
//! Integrated over the incident zone, f_cos is sqrt(|Z|) z_00 exactly, because Z_00 = 1 / sqrt(|Z|). What scales z_00 scales
//! all coefficients of a channel; how much an error of the zone or of the lit pattern scales it follows from how f_cos
//! varies over the zone (z_10, z_20), compared with the gray card, whose own z_00 takes the same error out again.

use std::f64::consts::TAU;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{CaptureRecord, MeasureError, RunRecord};
use crate::basis::index;
use crate::calibrate::{CalibrationSet, GrayCardCheck, gray_card_coefficients};
use crate::geometry::Zone;
use crate::optics::Rig;
use crate::reduce::Coefficients;
use crate::store;

/// Standard errors on either side of 95% of a normal distribution.
const COVERAGE_95: f64 = 1.959_964;
/// Highest degree l of f_cos at the zone's edges: higher ones ring there.
const EDGE_DEGREE: usize = 2;

/// What a budget takes for granted, as standard uncertainties: section `[budget]` of the file given by `--budget`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Assumptions {
    /// Albedo of the gray card, relative; a photographic card is sold to about 1%.
    pub card_rel: f64,
    /// Where the card's albedo comes from, e.g. the number of a certificate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub card_source: Option<String>,
    /// Light of the lamp from the gray card's measurement to the run, relative: each is measured against its own start.
    pub lamp_rel: f64,
    /// Bound of the stray light that calibration leaves in z_00, relative: what a black trap still shows, or a guess without one.
    pub stray_rel: f64,
    /// Each limit of the zone in which lobes are shown, and of the camera's polar angle, degrees.
    pub edge_deg: f64,
    /// Tilt of a sample when mounted, about each axis, degrees.
    pub tilt_deg: f64,
    /// Height of a sample when mounted, mm.
    pub height_mm: f64,
    /// Scatter of remounts of this sample, relative, where repeated runs have shown it; it replaces `height_mm`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remount_rel: Option<f64>,
}

impl Default for Assumptions {
    fn default() -> Self {
        Self {
            card_rel: 0.01,
            card_source: None,
            lamp_rel: 0.002,
            stray_rel: 0.002,
            edge_deg: 0.05,
            tilt_deg: 0.1,
            height_mm: 0.1,
            remount_rel: None,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AssumptionsFile {
    budget: Assumptions,
}

impl Assumptions {
    /// Reads the section `[budget]`; keys that are missing keep their defaults.
    ///
    /// # Errors
    /// [`MeasureError::Assumptions`] for other keys, and for uncertainties outside 0..=0.5 (relative) or 0..=5 (deg, mm).
    pub fn from_toml(text: &str) -> Result<Self, MeasureError> {
        let file: AssumptionsFile = toml::from_str(text).map_err(|e| MeasureError::Assumptions(e.to_string()))?;
        let a = file.budget;
        let checked = [
            ("card_rel", a.card_rel, 0.5),
            ("lamp_rel", a.lamp_rel, 0.5),
            ("stray_rel", a.stray_rel, 0.5),
            ("remount_rel", a.remount_rel.unwrap_or(0.0), 0.5),
            ("edge_deg", a.edge_deg, 5.0),
            ("tilt_deg", a.tilt_deg, 5.0),
            ("height_mm", a.height_mm, 5.0),
        ];
        match checked.into_iter().find(|(_, value, most)| !(0.0..=*most).contains(value)) {
            Some((key, value, most)) => {
                Err(MeasureError::Assumptions(format!("{key} = {value} is out of range: choose 0..={most}")))
            }
            None => Ok(a),
        }
    }
}

/// What a component's error has in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Every coefficient its own: the planes `sigma_*` hold it.
    Random,
    /// One for each direction, which changes sign half way around the normal: means over azimuth are free of it.
    Azimuthal,
    /// One factor for each channel.
    Channel,
    /// One factor for all.
    Common,
}

/// One reason why a run may be off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Component {
    /// What it is.
    pub name: String,
    /// What its error has in common.
    pub kind: Kind,
    /// Relative standard uncertainty of the zone's mean albedo, red, green, blue; of a single direction's z_00 if azimuthal.
    pub relative: [f64; 3],
    /// Where it comes from.
    pub source: String,
}

/// An albedo of the zone: integral of f_cos over its incident directions, linear RGB.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Albedo {
    /// Its value.
    pub value: [f64; 3],
    /// Its standard uncertainty: all components, azimuthal ones left out.
    pub standard_uncertainty: [f64; 3],
    /// Limits that hold the truth with a probability of 95%, each channel.
    pub interval_95: [[f64; 2]; 3],
}

/// The albedo towards one ring of exitant directions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AlbedoAt {
    /// Polar angle of the camera, degrees.
    pub theta_o_deg: f64,
    /// Mean over its azimuths.
    pub albedo: Albedo,
}

/// The budget of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Budget {
    /// What was taken for granted.
    pub assumed: Assumptions,
    /// All components.
    pub components: Vec<Component>,
    /// What a scale common to all coefficients of a channel adds, relative: the root of the squares of components that
    /// are common or a channel's. A coefficient's total variance is `sigma^2 + (systematic_rel z)^2`.
    pub systematic_rel: [f64; 3],
    /// Mean over exitant directions by cos(theta_o), the light scattered from the zone into the zone.
    pub albedo: Albedo,
    /// By ring.
    pub rings: Vec<AlbedoAt>,
}

/// What is known of a run besides its coefficients.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// What the gray card said of the rig.
    pub check: GrayCardCheck,
    /// Standard error of the lamp's light in a frame, relative; none where it was not watched.
    pub lamp_sigma: Option<f64>,
    /// From the sample to the middle of the dome, mm.
    pub dome_mm: f64,
}

impl Evidence {
    /// The evidence of a run on a rig.
    pub fn new(rig: &Rig, check: &GrayCardCheck, capture: &CaptureRecord) -> Self {
        let mirrors = rig.mirrors();
        let middle = mirrors.profile(0.5 * mirrors.edge_radius());
        Self {
            check: check.clone(),
            lamp_sigma: capture.tagged.then_some(capture.lamp_sigma),
            dome_mm: middle.map_or(f64::INFINITY, |p| p.coords.norm()),
        }
    }
}

impl Budget {
    /// The budget of coefficients. Pure.
    pub fn new(coefficients: &Coefficients, evidence: &Evidence, assumed: &Assumptions) -> Self {
        let grid = coefficients.grid;
        let weight = |ring: usize| grid.theta(ring).sin() * grid.theta(ring).cos();
        let all = View::new(coefficients, &weight);
        let components = all.components(evidence, assumed);
        let albedo = |view: &View, components: &[Component]| {
            let value = [0, 1, 2].map(|c| grid.zone().solid_angle().sqrt() * view.z[c][0]);
            let standard_uncertainty = [0, 1, 2].map(|c| value[c].abs() * sum(components, c, |k| k != Kind::Azimuthal));
            let interval_95 =
                [0, 1, 2].map(|c| [-1.0, 1.0].map(|s| value[c] + s * COVERAGE_95 * standard_uncertainty[c]));
            Albedo { value, standard_uncertainty, interval_95 }
        };
        let rings = (0..grid.rings()).map(|ring| {
            let view = View::new(coefficients, &|r| if r == ring { 1.0 } else { 0.0 });
            let albedo = albedo(&view, &view.components(evidence, assumed));
            AlbedoAt { theta_o_deg: grid.theta(ring).to_degrees(), albedo }
        });
        Self {
            assumed: assumed.clone(),
            systematic_rel: [0, 1, 2].map(|c| sum(&components, c, |k| matches!(k, Kind::Channel | Kind::Common))),
            albedo: albedo(&all, &components),
            // A ring without data has no albedo.
            rings: rings.filter(|r| r.albedo.value.iter().all(|v| v.is_finite())).collect(),
            components,
        }
    }

    /// The root of the sum of squares of all components but the zone's edges, which fits account for themselves: their
    /// `scale_rel`. The largest of the channels.
    pub fn scale_rel(&self) -> f64 {
        let scales: Vec<_> = self.components.iter().filter(|c| c.name != ZONE_EDGES).cloned().collect();
        (0..3).map(|c| sum(&scales, c, |k| matches!(k, Kind::Channel | Kind::Common))).fold(0.0, f64::max)
    }
}

const ZONE_EDGES: &str = "zone edges";

fn sum(components: &[Component], channel: usize, counts: impl Fn(Kind) -> bool) -> f64 {
    let squares = components.iter().filter(|c| counts(c.kind)).map(|c| c.relative[channel].powi(2));
    squares.sum::<f64>().sqrt()
}

/// A weighted mean over rings, by channel: what the components of the albedo depend on.
struct View {
    zone: Zone,
    /// z_l0 for l = 0..=order.
    z: [Vec<f64>; 3],
    /// Standard error of z_00.
    sigma: [f64; 3],
    /// d z_00 / d theta_o, and the same times sin(theta_o).
    slope: [[f64; 2]; 3],
    /// Root mean square of d z_00 / d theta_o over directions.
    steepness: [f64; 3],
}

impl View {
    fn new(coefficients: &Coefficients, weight: &dyn Fn(usize) -> f64) -> Self {
        let grid = coefficients.grid;
        let (rings, sectors) = (grid.rings(), grid.sectors());
        let order = coefficients.complete_order();
        let mut view = Self {
            zone: grid.zone(),
            z: std::array::from_fn(|_| vec![0.0; order + 1]),
            sigma: [0.0; 3],
            slope: [[0.0; 2]; 3],
            steepness: [0.0; 3],
        };
        for c in 0..3 {
            let means: Vec<Vec<f64>> = (0..=order)
                .map(|l| {
                    (0..rings).map(|r| mean(&coefficients.plane(index(l, 0), c)[r * sectors..][..sectors])).collect()
                })
                .collect();
            let sigma = &coefficients.sigma[c * grid.len()..][..grid.len()];
            let mut total = 0.0;
            for ring in (0..rings).filter(|&r| means.iter().all(|m| m[r].is_finite())) {
                let w = weight(ring);
                total += w;
                view.z[c].iter_mut().zip(&means).for_each(|(z, m)| *z += w * m[ring]);
                let squares = sigma[ring * sectors..][..sectors].iter().filter(|s| s.is_finite());
                let (sum, n) = squares.fold((0.0, 0.0), |(sum, n), &s| (sum + f64::from(s).powi(2), n + 1.0));
                view.sigma[c] += w * w * sum / (n * n);
                let (before, after) = (ring.saturating_sub(1), (ring + 1).min(rings - 1));
                let slope = (means[0][after] - means[0][before]) / ((after - before).max(1) as f64 * grid.ring_width());
                let slope = if slope.is_finite() { slope } else { 0.0 };
                view.slope[c][0] += w * slope;
                view.slope[c][1] += w * slope * grid.theta(ring).sin();
                view.steepness[c] += w * slope * slope;
            }
            view.z[c].iter_mut().chain(&mut view.slope[c]).for_each(|v| *v /= total);
            view.sigma[c] = view.sigma[c].sqrt() / total;
            view.steepness[c] = (view.steepness[c] / total).sqrt();
        }
        view
    }

    /// d ln z_00 / d theta at both edges of the lit zone, 1/rad.
    fn edges(&self, channel: usize) -> [f64; 2] {
        let (zone, z) = (&self.zone, &self.z[channel]);
        let value = |x: f64| {
            let terms = z.iter().take(EDGE_DEGREE + 1).enumerate();
            terms.map(|(l, z)| z * ((2 * l + 1) as f64 / zone.solid_angle()).sqrt() * x.powi(l as i32)).sum::<f64>()
        };
        let whole = zone.solid_angle().sqrt() * z[0];
        [-TAU * zone.theta_min().sin() * value(1.0) / whole, TAU * zone.theta_max().sin() * value(-1.0) / whole]
    }

    fn components(&self, evidence: &Evidence, assumed: &Assumptions) -> Vec<Component> {
        let zone = &self.zone;
        let sines = [zone.theta_min().sin(), zone.theta_max().sin()];
        let card = {
            let edge = |theta: f64| TAU * theta.sin() * theta.cos() / zone.projected_solid_angle();
            [-edge(zone.theta_min()), edge(zone.theta_max())]
        };
        let card_shape = {
            let z = gray_card_coefficients(*zone, 2, 1.0);
            [z[2] / z[0], 0.0]
        };
        let edge = assumed.edge_deg.to_radians();
        let height = assumed.height_mm / evidence.dome_mm;
        let check = &evidence.check;
        let part = |name: &str, kind, source: String, relative: &dyn Fn(usize) -> f64| {
            let relative = [0, 1, 2].map(|c| relative(c).abs());
            Component { name: name.into(), kind, relative, source }
        };
        let drift = match evidence.lamp_sigma {
            Some(_) => "light read from the coded patch, of this run and the card's",
            None => "not watched, of this run and the card's: assumed, as lamp_rel",
        };
        let remounted = |c: usize| {
            let slope = self.slope[c][1] / self.z[c][0];
            let sample: f64 = self.edges(c).iter().zip(sines).map(|(d, sin)| d * sin).sum::<f64>() + slope;
            let card: f64 = card.iter().zip(sines).map(|(d, sin)| d * sin).sum();
            height * sample.hypot(card)
        };
        vec![
            part("noise", Kind::Random, "shot and dark noise: planes sigma_*".into(), &|c| {
                self.sigma[c] / self.z[c][0]
            }),
            part("lamp drift", Kind::Common, drift.into(), &|_| {
                // The card's run was no better.
                2f64.sqrt() * evidence.lamp_sigma.unwrap_or(assumed.lamp_rel)
            }),
            part("lamp since calibration", Kind::Common, "assumed: lamp_rel".into(), &|_| assumed.lamp_rel),
            part(
                "gray card, albedo",
                Kind::Common,
                assumed.card_source.clone().unwrap_or_else(|| "assumed: card_rel".into()),
                &|_| assumed.card_rel,
            ),
            part("gray card, noise", Kind::Channel, "noise of the card's z_00".into(), &|c| check.scale_sigma_rel[c]),
            part(
                "response and flat field",
                Kind::Common,
                "the card's z_10 and z_20 against their analytic values".into(),
                &|c| {
                    let shape = |l: usize| self.z[c].get(l).map_or(0.0, |z| z / self.z[c][0]);
                    (check.z_10_error * (shape(1) - card_shape[0])).hypot(check.z_20_error * (shape(2) - card_shape[1]))
                },
            ),
            part("stray light", Kind::Common, "assumed: stray_rel, a bound".into(), &|_| {
                assumed.stray_rel / 3f64.sqrt()
            }),
            part(ZONE_EDGES, Kind::Common, "assumed: edge_deg; change of z_00 against the card's".into(), &|c| {
                let own = self.edges(c);
                edge * (own[0] - card[0]).hypot(own[1] - card[1])
            }),
            part("camera map", Kind::Common, "assumed: edge_deg; change of z_00 over theta_o".into(), &|c| {
                edge * self.slope[c][0] / self.z[c][0]
            }),
            match assumed.remount_rel {
                Some(seen) => part("remounting", Kind::Common, "scatter of repeated runs".into(), &|_| seen),
                None => part(
                    "remounting, height",
                    Kind::Common,
                    "assumed: height_mm, of sample and card".into(),
                    &remounted,
                ),
            },
            part("remounting, tilt", Kind::Azimuthal, "assumed: tilt_deg; change of z_00 over theta_o".into(), &|c| {
                assumed.tilt_deg.to_radians() * self.steepness[c] / self.z[c][0]
            }),
        ]
    }
}

/// Mean of the values that are no NaN.
fn mean(values: &[f32]) -> f64 {
    let (sum, n) = values.iter().filter(|v| v.is_finite()).fold((0.0, 0.0), |(s, n), &v| (s + f64::from(v), n + 1.0));
    sum / n
}

/// How the albedos of repeated runs of one sample scatter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Remounts {
    /// Number of runs.
    pub runs: usize,
    /// Standard deviation of the zone's mean albedo, relative, by channel.
    pub scatter_rel: [f64; 3],
    /// What of that is noise.
    pub noise_rel: [f64; 3],
    /// What remains for remounting, root mean square of the channels; its own relative uncertainty is
    /// 1 / sqrt(2 (runs - 1)).
    pub remount_rel: f64,
}

/// Compares runs of one sample, each mounted anew.
///
/// # Errors
/// [`MeasureError::TooFew`] for less than two.
pub fn remounts(budgets: &[Budget]) -> Result<Remounts, MeasureError> {
    let runs = budgets.len();
    if runs < 2 {
        return Err(MeasureError::TooFew { found: runs, least: 2, purpose: "see how remounts scatter" });
    }
    let n = runs as f64;
    let over = |value: &dyn Fn(&Budget) -> f64| budgets.iter().map(value).sum::<f64>() / n;
    let noise_rel = [0, 1, 2].map(|c| {
        let noise = |b: &Budget| sum(&b.components, c, |k| k == Kind::Random).powi(2);
        over(&noise).sqrt()
    });
    let scatter_rel = [0, 1, 2].map(|c| {
        let mean = over(&|b| b.albedo.value[c]);
        (over(&|b| (b.albedo.value[c] / mean - 1.0).powi(2)) * n / (n - 1.0)).sqrt()
    });
    let beyond = (0..3).map(|c| scatter_rel[c].powi(2) - noise_rel[c].powi(2)).sum::<f64>() / 3.0;
    Ok(Remounts { runs, scatter_rel, noise_rel, remount_rel: beyond.max(0.0).sqrt() })
}

/// The budget of a stored run, with other assumptions than its own if some are given.
///
/// # Errors
/// [`MeasureError`].
pub fn budget_of(run: &Path, assumed: Option<&Assumptions>) -> Result<(RunRecord, Budget), MeasureError> {
    let record = RunRecord::read_complete(run)?;
    let coefficients = Coefficients::read(&run.join("coefficients.exr"))?;
    let rig = Rig::from_toml(&store::read_text(&run.join("rig.toml"))?)?;
    let calibration = CalibrationSet::read(&run.join("calibration"), &rig)?;
    let evidence = Evidence::new(&rig, &calibration.check, &record.capture);
    let budget = Budget::new(&coefficients, &evidence, assumed.unwrap_or(&record.provenance.assumed));
    Ok((record, budget))
}
