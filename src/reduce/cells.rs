//! Which sensor pixels make up which exitant direction.

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::{ChannelScale, ReduceError};
use crate::capture::{Crop, ResponseImage};
use crate::geometry::ExitantGrid;
use crate::optics::{OpticalMap, Rig};

/// Response and variance of every exitant cell, one colour channel after the other: index `channel * cells + cell`.
#[derive(Debug, Clone, PartialEq)]
pub struct CellResponse {
    /// Electrons per second at the cell's centre; NaN where most of its pixels saturated.
    pub rate: Vec<f64>,
    /// Variance, (electrons per second)^2.
    pub variance: Vec<f64>,
}

/// A sparse linear map from the pixels of a crop to the centres of the cells of an exitant grid.
///
/// The pixels of a colour inside a cell get weights of least norm that reproduce linear functions, so that a lopsided
/// handful of Bayer pixels still stands for the cell's *centre*; what the mean over the cell's area then differs from the
/// value at its centre is half its second moments times the curvature, taken from neighbouring cells and removed.
#[derive(Debug, Clone)]
pub struct CellMap {
    grid: ExitantGrid,
    cells: Vec<Cell>,
}

#[derive(Debug, Clone)]
struct Cell {
    pixels: Vec<(u32, f64)>,
    /// Half of the second moment about the centre over the squared spacing of the grid, in theta and phi.
    curvature: [f64; 2],
}

/// A pixel as a cell sees it.
#[derive(Clone, Copy)]
struct Pixel {
    index: u32,
    theta: f64,
    phi: f64,
    /// Variances of theta and phi over the pixel's own area.
    spread: [f64; 2],
}

/// Windows tried, in units of a cell along theta and phi, until enough pixels support the weights.
const WINDOWS: [[f64; 2]; 4] = [[1.0, 1.0], [1.5, 1.5], [2.0, 2.0], [3.0, 3.0]];
/// Share of the first and of the last ring, about its centre, that their cells look at where pixels are enough. The zone's edge cuts
/// the lobe about the mirror direction: over the whole ring one narrower than that would lose 1 to 3% of z_00, ten times the noise
/// of a ring.
pub const EDGE_RING: f64 = 0.5;
const EDGE_WINDOWS: [[f64; 2]; 6] = [[EDGE_RING, 1.0], [0.75, 1.0], [1.0, 1.0], [1.5, 1.5], [2.0, 2.0], [3.0, 3.0]];

/// A window will do if its answer has at most this share of one pixel's variance...
const WORST_NOISE: f64 = 0.6;
/// ... and at most this many times that of a plain mean.
const WORST_LOPSIDEDNESS: f64 = 3.0;

const CHANNELS: [&str; 3] = ["red", "green", "blue"];

impl CellMap {
    /// The cells as a rig's camera sees them by `map`, nominal or calibrated.
    ///
    /// # Errors
    /// [`ReduceError::EmptyCell`] if the grid is too fine for the camera.
    pub fn new(rig: &Rig, map: &OpticalMap, crop: Crop, grid: ExitantGrid) -> Result<Self, ReduceError> {
        let pixels: Vec<Option<Pixel>> = (0..crop.len()).into_par_iter().map(|p| pixel(map, &grid, &crop, p)).collect();
        let mut buckets: Vec<Vec<Pixel>> = vec![Vec::new(); 3 * grid.len()];
        for pixel in pixels.into_iter().flatten() {
            let (column, row) = crop.sensor_pixel(pixel.index as usize);
            if let Some((ring, sector)) = grid.cell(pixel.theta, pixel.phi) {
                for &channel in rig.camera.mosaic.channels(column, row) {
                    buckets[channel * grid.len() + ring * grid.sectors() + sector].push(pixel);
                }
            }
        }
        let cells = (0..3 * grid.len())
            .into_par_iter()
            .map(|i| {
                let (channel, index) = (i / grid.len(), i % grid.len());
                let (ring, sector) = (index / grid.sectors(), index % grid.sectors());
                let around = neighbourhood(&grid, &buckets[channel * grid.len()..][..grid.len()], ring, sector);
                let edge = ring == 0 || ring + 1 == grid.rings();
                let windows: &[_] = if edge { &EDGE_WINDOWS } else { &WINDOWS };
                windows
                    .iter()
                    .find_map(|&window| cell(&grid, &around, ring, sector, window))
                    .ok_or(ReduceError::EmptyCell { ring, sector, channel: CHANNELS[channel] })
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { grid, cells })
    }

    /// The grid.
    pub fn grid(&self) -> ExitantGrid {
        self.grid
    }

    /// Response at the centre of every cell.
    pub fn apply(&self, response: &ResponseImage) -> CellResponse {
        let means: Vec<(f64, f64)> =
            self.cells.par_iter().with_min_len(64).map(|cell| weighted(cell, response)).collect();
        let n = self.grid.len();
        let (rate, variance) =
            (0..3 * n).map(|i| self.sharpen(&means[i / n * n..][..n], i % n, self.cells[i].curvature)).unzip();
        CellResponse { rate, variance }
    }

    /// What the variance of each pixel of the crop counts for in the mean, over cells and channels, of the squared standard
    /// error of a response times `scale`.
    pub fn noise_weights(&self, scale: &ChannelScale) -> Vec<f64> {
        let n = self.grid.len();
        let mut of_mean = vec![0.0; self.cells.len()];
        for (i, cell) in self.cells.iter().enumerate() {
            let theta_o = self.grid.theta(i % n / self.grid.sectors());
            let factor = scale.at(&self.grid.zone(), theta_o, i / n).powi(2) / self.cells.len() as f64;
            for (tap, weight) in self.taps(i % n, cell.curvature) {
                of_mean[i / n * n + tap] += factor * weight * weight;
            }
        }
        let pixels = self.cells.iter().flat_map(|c| &c.pixels).map(|&(p, _)| p as usize + 1).max().unwrap_or(0);
        let mut weights = vec![0.0; pixels];
        for (cell, factor) in self.cells.iter().zip(of_mean) {
            for &(p, weight) in &cell.pixels {
                weights[p as usize] += factor * weight * weight;
            }
        }
        weights
    }

    /// Removes the blur of the cell's own area: b - curvature_theta d2b/dring2 - curvature_phi d2b/dsector2.
    fn sharpen(&self, means: &[(f64, f64)], index: usize, curvature: [f64; 2]) -> (f64, f64) {
        let (mut rate, mut variance) = (0.0, 0.0);
        for (tap, weight) in self.taps(index, curvature) {
            let (value, own) = means[tap];
            rate += weight * value;
            variance += weight * weight * own;
        }
        // A saturated neighbour must not take this cell with it.
        if rate.is_nan() { means[index] } else { (rate, variance) }
    }

    /// The cells a sharpened cell is made of, each once, with their weights.
    fn taps(&self, index: usize, curvature: [f64; 2]) -> Vec<(usize, f64)> {
        let (rings, sectors) = (self.grid.rings(), self.grid.sectors());
        let (ring, sector) = (index / sectors, index % sectors);
        let middle = ring.clamp(1, rings - 2);
        let along_theta = [middle - 1, middle, middle + 1].map(|r| r * sectors + sector);
        let along_phi = [sector + sectors - 1, sector, sector + 1].map(|s| ring * sectors + s % sectors);
        let mut taps = [(index, 1.0); 7];
        for (i, (weight, (t, p))) in
            [1.0, -2.0, 1.0].into_iter().zip(along_theta.into_iter().zip(along_phi)).enumerate()
        {
            taps[1 + i] = (t, -curvature[0] * weight);
            taps[4 + i] = (p, -curvature[1] * weight);
        }
        // The variance needs the total weight of each distinct cell.
        taps.sort_unstable_by_key(|t| t.0);
        taps.chunk_by(|a, b| a.0 == b.0).map(|same| (same[0].0, same.iter().map(|t| t.1).sum())).collect()
    }
}

fn weighted(cell: &Cell, response: &ResponseImage) -> (f64, f64) {
    let (mut rate, mut variance, mut used) = (0.0, 0.0, 0.0);
    for &(p, w) in &cell.pixels {
        let value = f64::from(response.rate[p as usize]);
        if !value.is_nan() {
            rate += w * value;
            variance += w * w * f64::from(response.variance[p as usize]);
            used += w;
        }
    }
    if used > 0.5 { (rate / used, variance / (used * used)) } else { (f64::NAN, f64::NAN) }
}

/// A pixel that lies in the zone as a whole.
fn pixel(map: &OpticalMap, grid: &ExitantGrid, crop: &Crop, p: usize) -> Option<Pixel> {
    let (column, row) = crop.sensor_pixel(p);
    let (u, v) = (column as f64, row as f64);
    let centre = map.direction(u + 0.5, v + 0.5)?;
    let corner = |du: f64, dv: f64| map.direction(u + du, v + dv).filter(|d| grid.zone().contains(d.theta()));
    let corners = [corner(0.0, 0.0)?, corner(1.0, 0.0)?, corner(0.0, 1.0)?, corner(1.0, 1.0)?];
    let (theta, phi) = (centre.theta(), centre.phi());
    let spread = |value: &dyn Fn(usize) -> f64| {
        let du = 0.5 * (value(1) + value(3) - value(0) - value(2));
        let dv = 0.5 * (value(2) + value(3) - value(0) - value(1));
        (du * du + dv * dv) / 12.0
    };
    let spread = [spread(&|i| corners[i].theta() - theta), spread(&|i| wrapped(corners[i].phi() - phi))];
    Some(Pixel { index: p as u32, theta, phi, spread })
}

/// The pixels of a cell and of those around it.
fn neighbourhood(grid: &ExitantGrid, buckets: &[Vec<Pixel>], ring: usize, sector: usize) -> Vec<Pixel> {
    let (rings, sectors) = (grid.rings(), grid.sectors());
    let mut around = Vec::new();
    for r in ring.saturating_sub(1)..(ring + 2).min(rings) {
        for s in [sector + sectors - 1, sector, sector + 1] {
            around.extend_from_slice(&buckets[r * sectors + s % sectors]);
        }
    }
    around
}

/// Weights of least norm over a window that reproduce 1, theta and phi at the centre; `None` if too few pixels do.
fn cell(grid: &ExitantGrid, around: &[Pixel], ring: usize, sector: usize, window: [f64; 2]) -> Option<Cell> {
    let (theta, phi) = (grid.theta(ring), grid.phi(sector));
    let (width, height) = (grid.ring_width(), grid.sector_width());
    let inside: Vec<(Pixel, Vector3<f64>)> = around
        .iter()
        .map(|p| (*p, Vector3::new(1.0, (p.theta - theta) / width, wrapped(p.phi - phi) / height)))
        .filter(|(_, x)| 2.0 * x.y.abs() <= window[0] && 2.0 * x.z.abs() <= window[1])
        .collect();
    let moments: Matrix3<f64> = inside.iter().map(|(_, x)| x * x.transpose()).sum();
    let solution = moments.try_inverse()? * Vector3::x();
    let pixels: Vec<(u32, f64)> = inside.iter().map(|(p, x)| (p.index, solution.dot(x))).collect();
    let noise: f64 = pixels.iter().map(|(_, w)| w * w).sum();
    // A nearly singular inverse gives weights that reproduce nothing.
    let reproduced: Vector3<f64> = inside.iter().zip(&pixels).map(|((_, x), (_, w))| x * *w).sum();
    // Written so that NaN fails.
    if !(noise <= WORST_NOISE
        && noise * inside.len() as f64 <= WORST_LOPSIDEDNESS
        && (reproduced - Vector3::x()).amax() <= 1e-9)
    {
        return None;
    }
    let second = |axis: usize| {
        let spacing = if axis == 0 { width } else { height };
        let own = |p: &Pixel| p.spread[axis] / (spacing * spacing);
        0.5 * inside.iter().zip(&pixels).map(|((p, x), (_, w))| w * (x[axis + 1] * x[axis + 1] + own(p))).sum::<f64>()
    };
    Some(Cell { curvature: [second(0), second(1)], pixels })
}

/// An angle difference in [-pi, pi).
fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig() -> Rig {
        Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap()
    }

    /// A smooth function imaged by area-integrating pixels is found at the centres of the cells.
    #[test]
    fn smooth_functions_are_reproduced_at_cell_centres() {
        let rig = rig();
        let grid = ExitantGrid::new(rig.zone(), 32, 64);
        let crop = Crop::of_zone(&rig);
        let cells = CellMap::new(&rig, &rig.camera_map(), crop, grid).unwrap();
        let map = rig.camera_map();
        let f = |theta: f64, phi: f64| 1.0 + (6.0 * theta).sin() * (4.0 * phi).cos();
        let rate = (0..crop.len())
            .map(|p| {
                let (u, v) = crop.sensor_pixel(p);
                map.direction(u as f64 + 0.5, v as f64 + 0.5).map_or(0.0, |d| f(d.theta(), d.phi())) as f32
            })
            .collect();
        let image = ResponseImage { crop, rate, variance: vec![1.0; crop.len()] };
        let got = cells.apply(&image);
        let mut worst = 0.0f64;
        for (i, value) in got.rate.iter().enumerate() {
            let d = grid.direction(i % grid.len());
            worst = worst.max((value - f(d.theta(), d.phi())).abs());
        }
        // Order 4 in phi over 64 sectors: a plain mean would err by 0.6%.
        assert!(worst < 4e-3, "{worst}");
        assert!(got.variance.iter().all(|&v| v > 0.0 && v < 1.0));
    }

    /// Whatever the grid, a constant stays a constant or the grid is refused.
    #[test]
    fn no_grid_gives_silent_gaps() {
        let rig = rig();
        let crop = Crop::of_zone(&rig);
        let image = ResponseImage { crop, rate: vec![5.0; crop.len()], variance: vec![1.0; crop.len()] };
        for rings in (33..=60).step_by(3).chain([50]) {
            match CellMap::new(&rig, &rig.camera_map(), crop, ExitantGrid::new(rig.zone(), rings, 64)) {
                Ok(cells) => assert!(cells.apply(&image).rate.iter().all(|r| (r - 5.0).abs() < 1e-6), "{rings} rings"),
                Err(e) => assert!(matches!(e, ReduceError::EmptyCell { .. })),
            }
        }
    }

    #[test]
    fn grids_finer_than_the_camera_are_refused() {
        let rig = rig();
        let grid = ExitantGrid::new(rig.zone(), 400, 900);
        assert!(matches!(
            CellMap::new(&rig, &rig.camera_map(), Crop::of_zone(&rig), grid),
            Err(ReduceError::EmptyCell { .. })
        ));
    }

    #[test]
    fn saturated_pixels_are_left_out_and_saturated_cells_are_nan() {
        let rig = rig();
        let grid = ExitantGrid::new(rig.zone(), 16, 32);
        let crop = Crop::of_zone(&rig);
        let cells = CellMap::new(&rig, &rig.camera_map(), crop, grid).unwrap();
        let mut image = ResponseImage { crop, rate: vec![5.0; crop.len()], variance: vec![1.0; crop.len()] };
        image.rate.iter_mut().step_by(7).for_each(|r| *r = f32::NAN);
        assert!(cells.apply(&image).rate.iter().all(|r| (r - 5.0).abs() < 1e-9));
        image.rate.fill(f32::NAN);
        assert!(cells.apply(&image).rate.iter().all(|r| r.is_nan()));
    }
}
