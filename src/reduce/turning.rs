//! A measurement as if the sample had been mounted at another angle.

use std::f64::consts::PI;

use super::Coefficients;
use crate::basis::{about_normal, about_normal_variance};

/// Angles this near to whole sectors are whole sectors.
const WHOLE: f64 = 1e-6;

impl Coefficients {
    /// The coefficients of a sample whose grain lies at `angle` radians from +x, counter-clockwise, in the frame of its grain.
    ///
    /// Along a ring, sectors move; between sectors the ring's Fourier series tells, or the line between two neighbours where
    /// a cell of the ring has no value. Standard errors follow; those of neighbours are then correlated.
    pub fn turned_to_grain(&self, angle: f64) -> Self {
        let taps = taps(angle / self.grid.sector_width(), self.grid.sectors());
        let (n, functions) = (self.grid.len(), self.values.len() / (3 * self.grid.len()));
        let mut turned = self.clone();
        for (values, sigma) in
            turned.values.chunks_exact_mut(self.grid.sectors()).zip(turned.sigma.chunks_exact_mut(self.grid.sectors()))
        {
            moved(values, sigma, &taps);
        }
        for at in 0..3 * n {
            let gather =
                |planes: &[f32]| -> Vec<f64> { (0..functions).map(|k| f64::from(planes[k * 3 * n + at])).collect() };
            let values = about_normal(&gather(&turned.values), -angle);
            let variances: Vec<f64> = gather(&turned.sigma).iter().map(|s| s * s).collect();
            let variances = about_normal_variance(&variances, -angle);
            for k in 0..functions {
                turned.values[k * 3 * n + at] = values[k] as f32;
                turned.sigma[k * 3 * n + at] = variances[k].sqrt() as f32;
            }
        }
        turned
    }
}

/// What a cell is made of after a turn by so many sectors: by distance from the cell, the weight along a whole ring, and that
/// between two neighbours.
struct Taps {
    whole: Vec<f64>,
    linear: [(usize, f64); 2],
}

fn taps(sectors: f64, n: usize) -> Taps {
    let steps = sectors.rem_euclid(n as f64);
    let near = steps.round();
    let steps = if (steps - near).abs() < WHOLE { near } else { steps };
    let (first, share) = (steps.floor() as usize, steps.fract());
    let whole = (0..n).map(|j| dirichlet(steps - j as f64, n)).collect();
    Taps { whole, linear: [(first % n, 1.0 - share), ((first + 1) % n, share)] }
}

/// Periodic sinc: the value at `x` of the series of least frequencies through 1 at 0 and 0 at all other of `n` samples.
fn dirichlet(x: f64, n: usize) -> f64 {
    let x = x.rem_euclid(n as f64);
    if x == x.floor() {
        return if x == 0.0 { 1.0 } else { 0.0 };
    }
    let half = PI * x / n as f64;
    // Of an even number of samples the highest frequency counts half.
    let ratio = (PI * x).sin() / (n as f64 * half.sin());
    if n.is_multiple_of(2) { ratio * half.cos() } else { ratio }
}

fn moved(values: &mut [f32], sigma: &mut [f32], taps: &Taps) {
    let n = values.len();
    let whole = values.iter().all(|v| v.is_finite());
    let weights: Vec<(usize, f64)> = match whole {
        true => taps.whole.iter().copied().enumerate().filter(|t| t.1 != 0.0).collect(),
        false => taps.linear.iter().copied().filter(|t| t.1 != 0.0).collect(),
    };
    let cell = |s: usize| {
        weights.iter().fold((0.0, 0.0), |(value, variance), &(j, w)| {
            let at = (s + j) % n;
            (value + w * f64::from(values[at]), variance + (w * f64::from(sigma[at])).powi(2))
        })
    };
    let made: Vec<(f64, f64)> = (0..n).map(cell).collect();
    for (i, (value, variance)) in made.into_iter().enumerate() {
        (values[i], sigma[i]) = (value as f32, variance.sqrt() as f32);
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::geometry::{ExitantGrid, Zone};

    /// Storage in single precision.
    const SINGLE: f64 = 1e-5;

    /// z_11 and z_1-1 of a function with two lobes along the grain, seen with the grain at `angle`.
    fn grained(angle: f64) -> Coefficients {
        let grid = ExitantGrid::new(Zone::from_degrees(9.0, 57.0).unwrap(), 2, 12);
        let n = 3 * grid.len();
        let mut c =
            Coefficients { grid, order: 1, values: vec![0.0; 4 * n], sigma: vec![0.1; 4 * n], history: String::new() };
        for i in 0..n {
            let phi = grid.phi(i % grid.sectors()) - angle;
            let (incident, size) = (angle + 0.3, 1.0 + 0.4 * (2.0 * phi).cos() + 0.2 * (3.0 * phi).sin());
            c.values[i] = size as f32;
            c.values[n + i] = (size * incident.sin()) as f32;
            c.values[3 * n + i] = (size * incident.cos()) as f32;
        }
        c
    }

    #[test]
    fn a_turned_sample_is_the_sample() {
        let straight = grained(0.0);
        for angle in [TAU / 12.0, TAU / 4.0, 0.1, -1.234, 7.0] {
            let back = grained(angle).turned_to_grain(angle);
            let worst =
                back.values.iter().zip(&straight.values).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
            assert!(worst < SINGLE, "{angle}: {worst}");
            // The ring's series passes on all variance but half of that at the highest frequency.
            assert!(back.sigma.iter().all(|s| (0.09..0.1001).contains(s)), "{angle}");
        }
    }

    #[test]
    fn a_hole_takes_its_neighbours_alone() {
        let mut holed = grained(0.0);
        holed.values[3] = f32::NAN;
        let turned = holed.turned_to_grain(0.5 * TAU / 12.0);
        let lost: Vec<usize> = (0..24).filter(|&i| turned.values[i].is_nan()).collect();
        assert_eq!(lost, [2, 3]);
    }
}
