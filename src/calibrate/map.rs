//! The map of both devices as they really stand, from what the camera sees of fringes in a mirror and on its border.

use nalgebra::{DMatrix, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::least_squares::{Minimum, minimise};
use super::{AxisAlignment, CalibrateError};
use crate::capture::{Bench, Crop, Placement, ResponseImage, capture_sequence};
use crate::geometry::Direction;
use crate::geometry::quadrature::tangents;
use crate::optics::{Device, MapCorrection, Misaligned, Misalignment, OpticalMap, Rig};
use crate::patterns::{Fringes, Timing};
use crate::radiometry::Response;

/// Exposures in refresh periods: the border, lit directly, is a thousand times darker than the mirror.
const EXPOSURES_REFRESHES: [f64; 3] = [64.0, 4.0, 1.0];
/// Camera pixels along each side of a sample of the border: whole cells of a Bayer mosaic.
const BIN: usize = 8;
/// Pixels along each side of what is averaged in the mirror: the map is straight over so little, its noise is not.
const BLOCK: usize = 6;
/// Distance from the image of the paraboloid's edge, in slope, within which mirror and border are not told apart.
const BETWEEN: f64 = 7.5e-3;
/// Pairs of each kind that are used.
const PAIRS: usize = 3000;
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
    /// Share of each number's prior variance that the fringes took away: near 0 it is an assumption, near 1 a measurement.
    pub determined: Misalignment,
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
}

impl RigMap {
    /// The camera's map.
    pub fn camera_map(&self, rig: &Rig) -> OpticalMap {
        self.corrected(rig, rig.camera_map(), Device::Camera)
    }

    /// The projector's map.
    pub fn projector_map(&self, rig: &Rig) -> OpticalMap {
        self.corrected(rig, rig.projector_map(), Device::Projector)
    }

    fn corrected(&self, rig: &Rig, nominal: OpticalMap, device: Device) -> OpticalMap {
        let device = Misaligned::new(rig, &self.misalignment, device);
        let correction = MapCorrection::new(&nominal, &device);
        nominal.corrected(correction)
    }

    /// Checks that the rig's zone lies within what the map allows, to the error of its edges.
    ///
    /// # Errors
    /// [`CalibrateError::ZoneBeyondMap`], with the zone to ask for.
    pub fn check_zone(&self, rig: &Rig) -> Result<(), CalibrateError> {
        let (asked, allowed, error) = ([rig.zone.theta_min_deg, rig.zone.theta_max_deg], self.zone_deg, self.zone_error_deg);
        if asked[0] >= allowed[0] - error[0] && asked[1] <= allowed[1] + error[1] {
            return Ok(());
        }
        Err(CalibrateError::ZoneBeyondMap { asked_deg: asked, allowed_deg: allowed })
    }
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

/// A camera point and the projector point that lights what it sees.
#[derive(Debug, Clone, Copy)]
struct Pair {
    camera: [f64; 2],
    projector: [f64; 2],
}

impl Pair {
    fn mean(pairs: &[Self]) -> Self {
        let mean = |at: fn(&Self) -> [f64; 2]| {
            [0, 1].map(|i| pairs.iter().map(|p| at(p)[i]).sum::<f64>() / pairs.len() as f64)
        };
        Self { camera: mean(|p| p.camera), projector: mean(|p| p.projector) }
    }
}

/// All pairs, by way of the mirrors and on the border.
#[derive(Debug, Clone, Default)]
struct Pairs {
    mirrored: Vec<(Pair, Scale)>,
    direct: Vec<Pair>,
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

fn look(rig: &Rig, bench: &mut dyn Bench, response: &Response) -> Result<Pairs, CalibrateError> {
    let fringes = Fringes::new(rig.projector.width_px, rig.projector.height_px);
    let refresh = Timing::of(rig).refresh_s;
    let crop = Crop::whole(rig);
    bench.place(Placement::Mirror)?;
    let exposures = EXPOSURES_REFRESHES.map(|n| n * refresh);
    let images = capture_sequence(rig, bench, &fringes.patterns(response), &exposures, crop)?;
    Ok(Pairs::new(rig, in_mirror(rig, &fringes, &images), on_border(rig, &fringes, &images)))
}

impl Pairs {
    fn new(rig: &Rig, mirrored: Vec<Pair>, direct: Vec<Pair>) -> Self {
        let map = rig.projector_map();
        let scaled = thinned(mirrored).into_iter().filter_map(|pair| Some((pair, pixel_scale(&map, &pair)?)));
        Self { mirrored: scaled.collect(), direct: thinned(direct) }
    }
}

/// At most `PAIRS` of them, spread evenly.
fn thinned(pairs: Vec<Pair>) -> Vec<Pair> {
    let n = pairs.len();
    if n <= PAIRS { pairs } else { (0..PAIRS).map(|i| pairs[i * n / PAIRS]).collect() }
}

/// Radius in pixels of the nominal image of the paraboloid's edge, and the width of what is neither mirror nor border.
fn paraboloid_px(rig: &Rig) -> (f64, f64) {
    let (rho, mirrors, lens) = (rig.paraboloid_radius_mm(), rig.mirrors(), rig.camera.lens());
    (rho / (rig.centre_height_mm - mirrors.paraboloid_height(rho)) * lens.focal_px, BETWEEN * lens.focal_px)
}

/// Blocks of pixels that see the mirror, all their neighbours too: at the edges of shadows pixels see part of a point's light.
fn in_mirror(rig: &Rig, fringes: &Fringes, images: &[ResponseImage]) -> Vec<Pair> {
    let (width, height) = (rig.camera.width_px, rig.camera.height_px);
    let lens = rig.camera.lens();
    let (edge, between) = paraboloid_px(rig);
    let decode = |p: usize| {
        let (u, v) = ((p % width) as f64 + 0.5, (p / width) as f64 + 0.5);
        if (u - lens.centre_u).hypot(v - lens.centre_v) > edge - between {
            return None;
        }
        let rates: Vec<f64> = images.iter().map(|i| f64::from(i.rate[p])).collect();
        let variances: Vec<f64> = images.iter().map(|i| f64::from(i.variance[p])).collect();
        let [column, row] = fringes.decode(&rates, &variances, fringes.levels())?;
        Some(Pair { camera: [u, v], projector: [column.px, row.px] })
    };
    let pixels: Vec<Option<Pair>> = (0..width * height).into_par_iter().map(decode).collect();
    let inner = inner(&pixels, width);
    let (columns, rows) = (width / BLOCK, height / BLOCK);
    let block = |b: usize| {
        let corner = b / columns * BLOCK * width + b % columns * BLOCK;
        let pairs: Option<Vec<Pair>> = (0..BLOCK * BLOCK).map(|i| inner[corner + i / BLOCK * width + i % BLOCK]).collect();
        pairs.map(|pairs| Pair::mean(&pairs))
    };
    (0..columns * rows).filter_map(block).collect()
}

/// Squares of pixels that see the border. It lies out of the projector's focus, where the finest fringes are gone.
fn on_border(rig: &Rig, fringes: &Fringes, images: &[ResponseImage]) -> Vec<Pair> {
    let (columns, rows) = (rig.camera.width_px / BIN, rig.camera.height_px / BIN);
    let lens = rig.camera.lens();
    let (edge, between) = paraboloid_px(rig);
    let decode = |b: usize| {
        let (u0, v0) = (b % columns * BIN, b / columns * BIN);
        let (u, v) = ((u0 + BIN / 2) as f64, (v0 + BIN / 2) as f64);
        if (u - lens.centre_u).hypot(v - lens.centre_v) < edge + between {
            return None;
        }
        let sum = |plane: &dyn Fn(&ResponseImage, usize) -> f32, image: &ResponseImage| {
            let at = |i: usize| (v0 + i / BIN) * rig.camera.width_px + u0 + i % BIN;
            (0..BIN * BIN).map(|i| f64::from(plane(image, at(i)))).sum::<f64>()
        };
        let rates: Vec<f64> = images.iter().map(|i| sum(&|i, p| i.rate[p], i)).collect();
        let variances: Vec<f64> = images.iter().map(|i| sum(&|i, p| i.variance[p], i)).collect();
        let [column, row] = fringes.decode(&rates, &variances, fringes.levels() - 1)?;
        Some(Pair { camera: [u, v], projector: [column.px, row.px] })
    };
    let squares: Vec<Option<Pair>> = (0..columns * rows).into_par_iter().map(decode).collect();
    inner(&squares, columns).into_iter().flatten().collect()
}

/// Those whose eight neighbours are there too.
fn inner(pairs: &[Option<Pair>], width: usize) -> Vec<Option<Pair>> {
    let there = |p: usize, du: isize, dv: isize| {
        let (u, v) = ((p % width) as isize + du, (p / width) as isize + dv);
        let inside = u >= 0 && v >= 0 && u < width as isize;
        inside && pairs.get((v * width as isize + u) as usize).is_some_and(Option::is_some)
    };
    let whole = |p: usize| (-1..=1).all(|du| (-1..=1).all(|dv| there(p, du, dv)));
    pairs.iter().enumerate().map(|(p, pair)| pair.filter(|_| whole(p))).collect()
}

/// Parameters: displacement and turn of the camera, of the projector, decentre of paraboloid and dome, tilt of the sample.
const PARAMETERS: usize = 14;

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

/// Projector pixels for a small change of direction near that of a projector point: rows u and v, from the nominal map.
type Scale = [Vector3<f64>; 2];

fn pixel_scale(map: &OpticalMap, pair: &Pair) -> Option<Scale> {
    const STEP: f64 = 1e-5;
    let d = map.direction(pair.projector[0], pair.projector[1])?.vector();
    let (t, b) = tangents(&d);
    let along = |axis: &Vector3<f64>| {
        let at = |step: f64| map.pixel_beyond(&Direction::new(d + axis * step));
        let ((pu, pv), (mu, mv)) = (at(STEP)?, at(-STEP)?);
        Some([(pu - mu) / (2.0 * STEP), (pv - mv) / (2.0 * STEP)])
    };
    let (t_px, b_px) = (along(&t)?, along(&b)?);
    Some([0, 1].map(|i| t * t_px[i] + b * b_px[i]))
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
    let (edges, edge_error) = edges(rig, &prior, x.as_slice(), &covariance);
    Some(RigMap {
        misalignment: m,
        standard_error: misalignment(|i| prior.sigma[i] * covariance[(i, i)].sqrt()),
        determined: misalignment(|i| (1.0 - covariance[(i, i)]).clamp(0.0, 1.0)),
        pairs: [pairs.mirrored.len(), pairs.direct.len()],
        residual_px: [rms(&mirrored), rms(&direct)],
        direction_error_deg: [Device::Camera, Device::Projector]
            .map(|device| direction_error_deg(rig, device, &prior, x.as_slice(), &covariance)),
        zone_deg: edges,
        zone_error_deg: edge_error,
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
        let device = |displacement_mm, turn_deg| super::super::DeviceAlignment {
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
            println!("{found:#?}");
            for device in [Device::Camera, Device::Projector] {
                println!("{device:?}: {:.4} deg", worst_direction_deg(&rig, &truth, &found.misalignment, device));
            }
        }
    }
}
