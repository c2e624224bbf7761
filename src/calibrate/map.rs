//! The map of both devices as they really stand, from what the camera sees of fringes in a mirror and on its border.

use std::collections::BTreeMap;

use nalgebra::DMatrix;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::least_squares::{Minimum, minimise};
use super::pairs::{Pair, Pairs, Scale, look};
use super::{AxisAlignment, CalibrateError};
use crate::capture::Bench;
use crate::optics::{Device, MapCorrection, Misaligned, Misalignment, OpticalMap, Rig};
use crate::radiometry::Response;

/// Fewer pairs in the mirror are no map.
const LEAST_PAIRS: usize = 100;
/// Pairs farther from the model than this many standard deviations are left out.
const OUTLIER: f64 = 5.0;
/// What is not determined is taken to be this near to nominal: displacements in mm, turns and tilts in degrees.
const NEAR_MM: f64 = 0.5;
const NEAR_DEG: f64 = 0.2;
/// Standard errors below these are not believed of an alignment.
const LEAST_MM: f64 = 2e-3;
const LEAST_DEG: f64 = 1e-3;
/// Azimuths at which the zone's edges are looked up.
const AZIMUTHS: usize = 64;

/// `map.json` without its header: where everything stands and what that is worth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigMap {
    /// The misalignment found. A shift of a device's axis in pixels is told as its turn.
    pub misalignment: Misalignment,
    /// Standard error of each of its numbers.
    pub standard_error: Misalignment,
    /// Share of the variance before, as known from `align` or assumed, that the fringes took away from each part's (x, y):
    /// near 0 nothing new was learned, near 1 all.
    pub determined: BTreeMap<String, [f64; 2]>,
    /// Pairs used: by way of the mirrors, and on the border.
    pub pairs: [usize; 2],
    /// RMS of what the fit leaves of them, projector pixels.
    pub residual_px: [f64; 2],
    /// Standard error of directions over the zone, RMS: camera, projector.
    pub direction_error_deg: [f64; 2],
    /// Polar angles that both devices see at every azimuth.
    pub zone_deg: [f64; 2],
    /// Standard errors of these.
    pub zone_error_deg: [f64; 2],
    /// Share of the camera's pixels in that zone that saw fringes: near 1 unless something else hides or hurts the mirrors.
    pub seen_share: f64,
}

impl RigMap {
    /// The camera's map.
    pub fn camera_map(&self, rig: &Rig) -> OpticalMap {
        corrected(rig, &self.misalignment, rig.camera_map(), Device::Camera)
    }

    /// The projector's map.
    pub fn projector_map(&self, rig: &Rig) -> OpticalMap {
        corrected(rig, &self.misalignment, rig.projector_map(), Device::Projector)
    }

    /// Checks that the rig's zone lies within what the map allows, to the error of its edges.
    ///
    /// # Errors
    /// [`CalibrateError::ZoneBeyondMap`], with the zone to ask for.
    pub fn check_zone(&self, rig: &Rig) -> Result<(), CalibrateError> {
        let (asked, allowed, error) =
            ([rig.zone.theta_min_deg, rig.zone.theta_max_deg], self.zone_deg, self.zone_error_deg);
        if asked[0] >= allowed[0] - error[0] && asked[1] <= allowed[1] + error[1] {
            return Ok(());
        }
        Err(CalibrateError::ZoneBeyondMap { asked_deg: asked, allowed_deg: allowed })
    }
}

fn corrected(rig: &Rig, m: &Misalignment, nominal: OpticalMap, device: Device) -> OpticalMap {
    let correction = MapCorrection::new(&nominal, &Misaligned::new(rig, m, device));
    nominal.corrected(correction)
}

/// Maps of a rig's devices: calibrated, or nominal.
#[derive(Debug, Clone)]
pub struct Maps {
    /// The camera's.
    pub camera: OpticalMap,
    /// The projector's.
    pub projector: OpticalMap,
}

impl Maps {
    /// The maps a calibration gives, or the nominal ones.
    pub fn of(rig: &Rig, map: Option<&RigMap>) -> Self {
        match map {
            Some(map) => Self { camera: map.camera_map(rig), projector: map.projector_map(rig) },
            None => Self { camera: rig.camera_map(), projector: rig.projector_map() },
        }
    }
}

/// Shows fringes on a mirror in the sample's place and fits the misalignment that explains what the camera sees.
///
/// `known` is what `align` found of the devices; without it they are taken to stand near their nominal places.
///
/// # Errors
/// [`CalibrateError::NoFringes`] and what capturing says.
pub fn map(
    rig: &Rig,
    bench: &mut dyn Bench,
    response: &Response,
    known: Option<&AxisAlignment>,
) -> Result<RigMap, CalibrateError> {
    let pairs = look(rig, bench, response)?;
    let unclear = || CalibrateError::NoFringes { pairs: pairs.mirrored.len() };
    if pairs.mirrored.len() < LEAST_PAIRS {
        return Err(unclear());
    }
    fit(rig, &pairs, known).ok_or_else(unclear)
}

/// Parameters: displacement and turn of the camera, of the projector, decentre of paraboloid and dome, tilt of the sample.
const PARAMETERS: usize = 2 * PARTS.len();
const PARTS: [&str; 7] = [
    "camera_displacement",
    "camera_turn",
    "projector_displacement",
    "projector_turn",
    "paraboloid_offset",
    "dome_offset",
    "sample_tilt",
];

/// Expected values and standard deviations of the parameters before any fringe was seen, in mm and degrees.
struct Prior {
    mean: [f64; PARAMETERS],
    sigma: [f64; PARAMETERS],
}

impl Prior {
    fn new(known: Option<&AxisAlignment>) -> Self {
        let mut prior = Self { mean: [0.0; PARAMETERS], sigma: [NEAR_MM; PARAMETERS] };
        for i in [2, 3, 6, 7, 12, 13] {
            prior.sigma[i] = NEAR_DEG;
        }
        if let Some(known) = known {
            for (first, device) in [(0, &known.camera), (4, &known.projector)] {
                for axis in 0..2 {
                    prior.mean[first + axis] = device.displacement_mm[axis];
                    prior.sigma[first + axis] = device.displacement_error_mm[axis].max(LEAST_MM);
                    prior.mean[first + 2 + axis] = device.turn_deg[axis];
                    prior.sigma[first + 2 + axis] = device.turn_error_deg[axis].max(LEAST_DEG);
                }
            }
        }
        prior
    }

    /// The misalignment at `x` prior standard deviations from what is expected.
    fn at(&self, x: &[f64]) -> Misalignment {
        misalignment(|i| self.mean[i] + self.sigma[i] * x[i])
    }
}

fn misalignment(value: impl Fn(usize) -> f64) -> Misalignment {
    let pair = |i: usize| [value(i), value(i + 1)];
    Misalignment {
        camera_displacement_mm: pair(0),
        camera_turn_deg: pair(2),
        projector_displacement_mm: pair(4),
        projector_turn_deg: pair(6),
        paraboloid_offset_mm: pair(8),
        dome_offset_mm: pair(10),
        sample_tilt_deg: pair(12),
        ..Misalignment::none()
    }
}

/// What both kinds of pairs leave unexplained, projector pixels; pairs whose rays miss a mirror leave NaN.
fn unexplained(rig: &Rig, m: &Misalignment, pairs: &Pairs) -> (Vec<f64>, Vec<f64>) {
    let (camera, projector) = (Misaligned::new(rig, m, Device::Camera), Misaligned::new(rig, m, Device::Projector));
    let mirrored = |(pair, scale): &(Pair, Scale)| {
        let wo = camera.direction_beyond(pair.camera[0], pair.camera[1]);
        let wi = projector.direction_beyond(pair.projector[0], pair.projector[1]);
        let off = wo.zip(wi).map(|(wo, wi)| wo.mirrored().vector() - wi.vector());
        scale.map(|axis| off.map_or(f64::NAN, |off| axis.dot(&off)))
    };
    let direct = |pair: &Pair| {
        let (p, q) = projector.image(&camera.on_plane(pair.camera[0], pair.camera[1], 0.0));
        [p - pair.projector[0], q - pair.projector[1]]
    };
    (pairs.mirrored.iter().flat_map(mirrored).collect(), pairs.direct.iter().flat_map(direct).collect())
}

fn rms(x: &[f64]) -> f64 {
    (x.iter().map(|x| x * x).sum::<f64>() / x.len().max(1) as f64).sqrt()
}

/// The most likely misalignment: least squares with the prior, standard errors of both kinds of pairs from their residuals.
fn fit(rig: &Rig, pairs: &Pairs, known: Option<&AxisAlignment>) -> Option<RigMap> {
    let prior = Prior::new(known);
    let mut pairs = pairs.clone();
    let mut start = vec![0.0; PARAMETERS];
    // Of unknown size at first: small enough that the pairs decide, not the prior.
    let mut sigma = [0.1, 0.5];
    let mut found: Option<Minimum> = None;
    for _ in 0..3 {
        let residuals = |x: &[f64]| {
            let (mirrored, direct) = unexplained(rig, &prior.at(x), &pairs);
            let scaled = mirrored.iter().map(|r| r / sigma[0]).chain(direct.iter().map(|r| r / sigma[1]));
            scaled.chain(x.iter().copied()).collect()
        };
        let minimum = minimise(start, &residuals)?;
        start = minimum.x.as_slice().to_vec();
        let (mirrored, direct) = unexplained(rig, &prior.at(&start), &pairs);
        sigma = [&mirrored, &direct].map(|r| robust_deviation(r).max(1e-4));
        let near = |r: &[f64], sigma: f64| r.iter().all(|r| r.abs() < OUTLIER * sigma);
        let (mut first, mut second) = (mirrored.chunks(2), direct.chunks(2));
        pairs.mirrored.retain(|_| first.next().is_some_and(|r| near(r, sigma[0])));
        pairs.direct.retain(|_| second.next().is_some_and(|r| near(r, sigma[1])));
        found = Some(minimum);
    }
    let Minimum { x, covariance, .. } = found?;
    let m = prior.at(x.as_slice());
    let (mirrored, direct) = unexplained(rig, &m, &pairs);
    let determined = |part: usize| [2 * part, 2 * part + 1].map(|i| (1.0 - covariance[(i, i)]).clamp(0.0, 1.0));
    let (edges, edge_error) = edges(rig, &prior, x.as_slice(), &covariance);
    Some(RigMap {
        misalignment: m,
        standard_error: misalignment(|i| prior.sigma[i] * covariance[(i, i)].sqrt()),
        determined: PARTS.iter().enumerate().map(|(part, name)| (name.to_string(), determined(part))).collect(),
        pairs: [pairs.mirrored.len(), pairs.direct.len()],
        residual_px: [rms(&mirrored), rms(&direct)],
        direction_error_deg: [Device::Camera, Device::Projector]
            .map(|device| direction_error_deg(rig, device, &prior, x.as_slice(), &covariance)),
        zone_deg: edges,
        zone_error_deg: edge_error,
        seen_share: pairs.seen_share(rig, &corrected(rig, &m, rig.camera_map(), Device::Camera), edges),
    })
}

/// Standard deviation of most of the values, whatever the rest.
fn robust_deviation(values: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = values.iter().map(|r| r.abs()).filter(|r| r.is_finite()).collect();
    sizes.sort_unstable_by(f64::total_cmp);
    sizes.get(sizes.len() / 2).map_or(0.0, |middle| middle / 0.6745)
}

/// Standard deviation of several quantities: change of each with each parameter, carried through the covariance.
fn errors(x: &[f64], covariance: &DMatrix<f64>, value: impl Fn(&[f64]) -> Vec<f64> + Sync) -> Vec<f64> {
    const STEP: f64 = 1e-2;
    let columns: Vec<Vec<f64>> = (0..x.len())
        .into_par_iter()
        .map(|i| {
            let at = |step: f64| {
                let mut x = x.to_vec();
                x[i] += step;
                value(&x)
            };
            at(STEP).iter().zip(at(-STEP)).map(|(a, b)| (a - b) / (2.0 * STEP)).collect()
        })
        .collect();
    let variance = |k: usize| {
        let terms = (0..x.len()).flat_map(|i| (0..x.len()).map(move |j| (i, j)));
        terms.map(|(i, j)| columns[i][k] * covariance[(i, j)] * columns[j][k]).sum::<f64>()
    };
    (0..columns[0].len()).map(|k| variance(k).max(0.0).sqrt()).collect()
}

/// Edges that both devices leave of the zone, and their standard errors, degrees.
fn edges(rig: &Rig, prior: &Prior, x: &[f64], covariance: &DMatrix<f64>) -> ([f64; 2], [f64; 2]) {
    let usable = |x: &[f64]| {
        let m = prior.at(x);
        let [a, b] =
            [Device::Camera, Device::Projector].map(|device| Misaligned::new(rig, &m, device).edges(AZIMUTHS).usable());
        vec![a[0].max(b[0]).to_degrees(), a[1].min(b[1]).to_degrees()]
    };
    let (value, error) = (usable(x), errors(x, covariance, usable));
    ([value[0], value[1]], [error[0], error[1]])
}

/// RMS over the zone of the standard error of a device's directions, degrees.
fn direction_error_deg(rig: &Rig, device: Device, prior: &Prior, x: &[f64], covariance: &DMatrix<f64>) -> f64 {
    const POINTS: usize = 64;
    let centre = Misaligned::new(rig, &prior.at(x), device).image_centre();
    let map = if device == Device::Camera { rig.camera_map() } else { rig.projector_map() };
    let reach = map.radius_px(rig.zone().theta_max()).expect("a checked rig shows its zone");
    let directions = |x: &[f64]| {
        let traced = Misaligned::new(rig, &prior.at(x), device);
        let at = |i: usize| {
            let (r, phi) = (reach * ((i as f64 + 0.5) / POINTS as f64).sqrt(), i as f64 * 2.399_963);
            let d = traced.direction_beyond(centre.0 + r * phi.cos(), centre.1 + r * phi.sin());
            d.map_or([0.0; 3], |d| d.vector().into())
        };
        (0..POINTS).flat_map(at).collect()
    };
    // Three components for each direction.
    rms(&errors(x, covariance, directions)).to_degrees() * 3f64.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::DeviceAlignment;

    fn rig() -> Rig {
        Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap()
    }

    /// Pairs of a misaligned rig without noise: camera points on a lattice, projector points by search along the model.
    fn exact(rig: &Rig, m: &Misalignment) -> Pairs {
        let (camera, projector) = (Misaligned::new(rig, m, Device::Camera), Misaligned::new(rig, m, Device::Projector));
        let nominal = rig.projector_map();
        let map = nominal.clone().corrected(MapCorrection::new(&nominal, &projector));
        let (c_u, c_v) = camera.image_centre();
        let (mut mirrored, mut direct) = (Vec::new(), Vec::new());
        for i in 0..800 {
            let phi = f64::from(i) * 2.399_963;
            let r = 221.0 * (f64::from(i) / 800.0).sqrt();
            let (u, v) = (c_u + r * phi.cos(), c_v + r * phi.sin());
            if let Some((p, q)) = camera.direction(u, v).and_then(|wo| map.pixel(&wo.mirrored())) {
                mirrored.push(Pair { camera: [u, v], projector: [p, q] });
            }
            let r = 411.0 + 100.0 * f64::from(i) / 800.0;
            let (u, v) = (c_u + r * phi.cos(), c_v + r * phi.sin());
            let (p, q) = projector.image(&camera.on_plane(u, v, 0.0));
            if p > 0.0 && q > 0.0 && p < 800.0 && q < 600.0 {
                direct.push(Pair { camera: [u, v], projector: [p, q] });
            }
        }
        Pairs::new(rig, mirrored, direct)
    }

    fn worst_direction_deg(rig: &Rig, a: &Misalignment, b: &Misalignment, device: Device) -> f64 {
        let (a, b) = (Misaligned::new(rig, a, device), Misaligned::new(rig, b, device));
        let (c_u, c_v) = a.image_centre();
        let scale = if device == Device::Camera { 1.0 } else { 0.754 };
        let mut worst = 0.0f64;
        for i in 40..400 {
            let (r, phi) = (scale * 221.0 * (f64::from(i) / 400.0).sqrt(), f64::from(i) * 2.399_963);
            let at = |d: &Misaligned| d.direction_beyond(c_u + r * phi.cos(), c_v + r * phi.sin()).unwrap().vector();
            worst = worst.max((at(&a) - at(&b)).norm().to_degrees());
        }
        worst
    }

    /// Of directions from exact pairs: what the priors pull.
    const EXACT_DEG: f64 = 1e-3;

    #[test]
    fn what_pairs_determine() {
        let rig = rig();
        let truth = Misalignment {
            camera_displacement_mm: [0.4, -0.3],
            camera_turn_deg: [-0.1, 0.15],
            projector_displacement_mm: [-0.3, 0.2],
            projector_turn_deg: [0.1, 0.1],
            paraboloid_offset_mm: [-0.3, 0.4],
            dome_offset_mm: [0.1, 0.2],
            sample_tilt_deg: [0.1, -0.15],
            ..Misalignment::none()
        };
        let pairs = exact(&rig, &truth);
        let device = |displacement_mm, turn_deg| DeviceAlignment {
            displacement_mm,
            displacement_error_mm: [0.01; 2],
            turn_deg,
            turn_error_deg: [0.002; 2],
        };
        let known = AxisAlignment {
            camera: device(truth.camera_displacement_mm, truth.camera_turn_deg),
            projector: device(truth.projector_displacement_mm, truth.projector_turn_deg),
        };
        for known in [None, Some(&known)] {
            let found = fit(&rig, &pairs, known).unwrap();
            for device in [Device::Camera, Device::Projector] {
                let off = worst_direction_deg(&rig, &truth, &found.misalignment, device);
                println!("{device:?}: {off:.1e} deg");
                assert!(off < EXACT_DEG, "{device:?}: {off}");
            }
            // All displaced alike is the same rig: half of the priors' width is left in what four parts share.
            let shared = found.determined["camera_displacement"][0];
            assert!((0.3..0.8).contains(&shared), "{shared}");
            assert!(found.determined["sample_tilt"].iter().all(|d| *d > 0.999));
            let moved = |m: &Misalignment| m.camera_displacement_mm[0] - m.paraboloid_offset_mm[0];
            assert!((moved(&found.misalignment) - moved(&truth)).abs() < 1e-3, "{:?}", found.misalignment);
        }
    }

    /// The rig that stands where it should is the hardest: its symmetry hides a camera that is displaced and turned the one
    /// way and a projector the other. Crosses on the axis tell.
    #[test]
    fn an_aligned_rig_needs_its_crosses() {
        let rig = rig();
        let truth = Misalignment { sample_tilt_deg: [0.02, 0.0], ..Misalignment::none() };
        let mut pairs = exact(&rig, &truth);
        // A tenth of a pixel of anything in the mirror, half a pixel on the border.
        let error = |i: usize| (i as f64 * 2.399_963).sin();
        pairs.mirrored.iter_mut().enumerate().for_each(|(i, (pair, _))| pair.projector[i % 2] += 0.1 * error(i));
        pairs.direct.iter_mut().enumerate().for_each(|(i, pair)| pair.projector[i % 2] += 0.5 * error(i));
        let device = DeviceAlignment {
            displacement_mm: [0.0; 2],
            displacement_error_mm: [0.012; 2],
            turn_deg: [0.0; 2],
            turn_error_deg: [0.002; 2],
        };
        let known = AxisAlignment { camera: device, projector: device };
        let [without, with] =
            [None, Some(&known)].map(|known| fit(&rig, &pairs, known).unwrap().direction_error_deg[0]);
        println!("{without} deg without crosses, {with} deg with them");
        assert!(without > 5.0 * with && with < 0.03, "{without} {with}");
    }
}
