//! Camera pixels and the projector pixels that light what they see, from fringes in a mirror and on its border.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::CalibrateError;
use crate::capture::{Bench, Crop, Placement, ResponseImage, capture_sequence};
use crate::geometry::Direction;
use crate::geometry::quadrature::tangents;
use crate::optics::{OpticalMap, Rig};
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
/// A camera point and the projector point that lights what it sees.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    pub camera: [f64; 2],
    pub projector: [f64; 2],
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
pub(super) struct Pairs {
    pub mirrored: Vec<(Pair, Scale)>,
    pub direct: Vec<Pair>,
    /// Whether each pixel of the sensor saw fringes in the mirror.
    decoded: Vec<bool>,
}

/// Projector pixels for a small change of direction near that of a projector point: rows u and v, from the nominal map.
pub(super) type Scale = [Vector3<f64>; 2];

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

/// Photographs the fringes and decodes them.
pub(super) fn look(rig: &Rig, bench: &mut dyn Bench, response: &Response) -> Result<Pairs, CalibrateError> {
    let fringes = Fringes::new(rig.projector.width_px, rig.projector.height_px);
    let refresh = Timing::of(rig).refresh_s;
    let crop = Crop::whole(rig);
    bench.place(Placement::Mirror)?;
    let exposures = EXPOSURES_REFRESHES.map(|n| n * refresh);
    let images = capture_sequence(rig, bench, &fringes.patterns(response), &exposures, crop)?;
    let pixels = in_mirror(rig, &fringes, &images);
    let decoded = pixels.iter().map(Option::is_some).collect();
    Ok(Pairs { decoded, ..Pairs::new(rig, blocks(rig, &pixels), on_border(rig, &fringes, &images)) })
}

impl Pairs {
    pub fn new(rig: &Rig, mirrored: Vec<Pair>, direct: Vec<Pair>) -> Self {
        let map = rig.projector_map();
        let scaled = thinned(mirrored).into_iter().filter_map(|pair| Some((pair, pixel_scale(&map, &pair)?)));
        Self { mirrored: scaled.collect(), direct: thinned(direct), decoded: Vec::new() }
    }

    /// Share of the pixels between two polar angles (degrees) by the camera's map that saw fringes: what a fit says of the
    /// zone's edges, held against the photographs themselves.
    pub fn seen_share(&self, rig: &Rig, camera: &OpticalMap, zone_deg: [f64; 2]) -> f64 {
        let width = rig.camera.width_px;
        let on_paraboloid = on_paraboloid(rig);
        let inside = |p: &usize| {
            let (u, v) = ((p % width) as f64 + 0.5, (p / width) as f64 + 0.5);
            let within = |d: Direction| (zone_deg[0]..=zone_deg[1]).contains(&d.theta().to_degrees());
            on_paraboloid(u, v) && camera.direction(u, v).is_some_and(within)
        };
        let seen = |p: usize| [1, usize::from(self.decoded[p])];
        let sum = |a: [usize; 2], b: [usize; 2]| [a[0] + b[0], a[1] + b[1]];
        let [all, seen] = (0..self.decoded.len()).into_par_iter().filter(inside).map(seen).reduce(|| [0; 2], sum);
        seen as f64 / all.max(1) as f64
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
    (rho / (rig.centre_height_mm - mirrors.convex().height(rho)) * lens.focal_px, BETWEEN * lens.focal_px)
}

/// Whether a camera point certainly sees the paraboloid.
fn on_paraboloid(rig: &Rig) -> impl Fn(f64, f64) -> bool + Sync {
    let (lens, (edge, between)) = (rig.camera.lens(), paraboloid_px(rig));
    move |u, v| (u - lens.centre_u).hypot(v - lens.centre_v) < edge - between
}

/// Every pixel that sees fringes in the mirror.
fn in_mirror(rig: &Rig, fringes: &Fringes, images: &[ResponseImage]) -> Vec<Option<Pair>> {
    let width = rig.camera.width_px;
    let on_paraboloid = on_paraboloid(rig);
    let decode = |p: usize| {
        let (u, v) = ((p % width) as f64 + 0.5, (p / width) as f64 + 0.5);
        if !on_paraboloid(u, v) {
            return None;
        }
        let rates: Vec<f64> = images.iter().map(|i| f64::from(i.rate[p])).collect();
        let variances: Vec<f64> = images.iter().map(|i| f64::from(i.variance[p])).collect();
        let [column, row] = fringes.decode(&rates, &variances, fringes.levels())?;
        Some(Pair { camera: [u, v], projector: [column.px, row.px] })
    };
    (0..width * rig.camera.height_px).into_par_iter().map(decode).collect()
}

/// Blocks of pixels that see the mirror, all their neighbours too: at the edges of shadows pixels see part of a point's light.
fn blocks(rig: &Rig, pixels: &[Option<Pair>]) -> Vec<Pair> {
    let (width, height) = (rig.camera.width_px, rig.camera.height_px);
    let inner = inner(pixels, width);
    let (columns, rows) = (width / BLOCK, height / BLOCK);
    let block = |b: usize| {
        let corner = b / columns * BLOCK * width + b % columns * BLOCK;
        let pairs: Option<Vec<Pair>> =
            (0..BLOCK * BLOCK).map(|i| inner[corner + i / BLOCK * width + i % BLOCK]).collect();
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
