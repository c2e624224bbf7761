//! Tensors of known reflectances, and what noise does to them.

use std::f64::consts::PI;

use nalgebra::DMatrix;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::*;
use crate::basis::{Conversion, Harmonics, Method};
use crate::geometry::{Direction, ExitantGrid, Zone};

const ORDER: usize = 3;

fn zone() -> Zone {
    Zone::from_degrees(9.0, 57.0).unwrap()
}

fn rule(order: usize) -> ExitantRule {
    ExitantRule::new(ExitantGrid::new(zone(), 24, 16), order).unwrap()
}

/// z_k of Lambert: (albedo / pi) times the integral of Z_k cos(theta); all but two vanish.
fn lambert(k: usize, albedo: f64) -> f64 {
    let (a, b) = (zone().cos_min(), zone().cos_max());
    match k {
        0 => albedo * (a + b) * ((a - b) / (2.0 * PI)).sqrt(),
        2 => albedo * (a - b).powf(1.5) / (6.0 * PI).sqrt(),
        _ => 0.0,
    }
}

/// Noise that differs between functions and cells.
fn variance(k: usize, cells: usize) -> Vec<f64> {
    (0..cells).map(|c| 1e-6 * (1.0 + 0.3 * k as f64) * (1.0 + (c as f64 * 0.37).sin().powi(2))).collect()
}

fn noise(order: usize, cells: usize, rng: &mut Xoshiro256PlusPlus) -> Vec<Vec<f64>> {
    let mut draw = |v: f64| {
        let e: f64 = StandardNormal.sample(rng);
        v.sqrt() * e
    };
    (0..size(order)).map(|k| variance(k, cells).into_iter().map(&mut draw).collect()).collect()
}

fn tensor(isotropic: bool, planes: &[Vec<f64>]) -> Tensor {
    let rule = rule(ORDER);
    let cells = rule.grid().len();
    Tensor::project(&rule, ORDER, isotropic, |k| planes[k].clone(), |k| variance(k, cells)).unwrap()
}

#[test]
fn lambert_has_a_tensor_in_closed_form() {
    for isotropic in [true, false] {
        let planes: Vec<_> = (0..size(ORDER)).map(|k| vec![lambert(k, 0.18); 24 * 16]).collect();
        let tensor = tensor(isotropic, &planes);
        for block in &tensor.blocks {
            for (row, &k) in block.incident.iter().enumerate() {
                for (column, &j) in block.exitant.iter().enumerate() {
                    let want = PI / 0.18 * lambert(k, 0.18) * lambert(j, 0.18);
                    assert!((block.values[(row, column)] - want).abs() < 1e-14, "{k} {j}");
                }
            }
        }
        // Lambert is f = albedo / pi, and F = f cos cos couples Y_10 with itself alone.
        let conversion = Conversion::new(Method::Parity, zone(), ORDER).unwrap();
        let y = tensor.to_harmonics(&conversion, &conversion).unwrap();
        let want = 0.18 / PI * 4.0 * PI / 3.0;
        let at = if isotropic { (1, 1) } else { (2, 2) };
        assert!((y.values[0][at] - want).abs() < 1e-12);
        let rest: f64 = y.values.iter().map(|b| b.norm_squared()).sum::<f64>() - y.values[0][at].powi(2);
        assert!(rest.abs().sqrt() < 1e-7, "{rest:e}");
    }
}

/// Turned coefficients of an anisotropic F are found again: f = Z_k(wi) Z_j(wo) / cos(theta_o) for chosen functions.
#[test]
fn full_tensors_hold_what_was_put_in() {
    let rule = rule(ORDER);
    let basis = Harmonics::zonal(zone(), ORDER).unwrap();
    let want = DMatrix::from_fn(16, 16, |k, j| ((3 * k + 5 * j) as f64).sin());
    let planes: Vec<Vec<f64>> = (0..16)
        .map(|k| {
            let cell = |c: usize| {
                let wo: Direction = rule.grid().direction(c);
                basis.eval(&wo).iter().enumerate().map(|(j, z)| want[(k, j)] * z).sum::<f64>() / wo.cos_theta()
            };
            (0..rule.grid().len()).map(cell).collect()
        })
        .collect();
    let got = tensor(false, &planes);
    // Products of zonal functions are rough for 24 rings; those of odd m end in square roots, which no reflectance does.
    let off = |odd: bool| {
        let of = |k: usize, j: usize| (got.blocks[0].values[(k, j)] - want[(k, j)]).abs();
        let columns: Vec<usize> = (0..16).filter(|&j| (crate::basis::lm(j).1 % 2 != 0) == odd).collect();
        columns.iter().flat_map(|&j| (0..16).map(move |k| of(k, j))).fold(0.0, f64::max)
    };
    assert!(off(false) < 1e-3 && off(true) < 1e-2, "{:e} {:e}", off(false), off(true));
}

#[test]
fn the_asymmetry_of_noise_has_the_chi2_of_its_freedom() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(5);
    for isotropic in [true, false] {
        const DRAWS: usize = 200;
        let (mut chi2, mut passed, mut freedom) = (0.0, 0, 0);
        for _ in 0..DRAWS {
            let planes = noise(ORDER, 24 * 16, &mut rng);
            let test = reciprocity(&[tensor(isotropic, &planes)]).unwrap();
            chi2 += test.chi2 / DRAWS as f64;
            freedom = test.freedom;
            passed += usize::from(test.holds());
        }
        assert_eq!(freedom, if isotropic { 6 + 3 + 1 } else { 16 * 15 / 2 });
        // Standard deviation of the mean: sqrt(2 freedom / draws), four of them.
        let off = (chi2 - freedom as f64).abs() / (2.0 * freedom as f64 / DRAWS as f64).sqrt();
        assert!(off < 4.0 && passed >= DRAWS * 96 / 100, "{chi2} of {freedom}, {passed} pass");
    }
}

/// Standard errors on both sides are the scatter of 400 draws, with and without reciprocity.
#[test]
fn standard_errors_of_harmonics_are_the_scatter() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(6);
    let conversion = Conversion::new(Method::Parity, zone(), ORDER).unwrap();
    for (isotropic, impose) in [(true, false), (true, true), (false, true)] {
        const DRAWS: usize = 400;
        let mut power: Vec<DMatrix<f64>> = Vec::new();
        let mut sigma = Vec::new();
        for _ in 0..DRAWS {
            let mut tensor = tensor(isotropic, &noise(ORDER, 24 * 16, &mut rng));
            if impose {
                tensor.impose_reciprocity();
                assert!(tensor.blocks.iter().all(|b| (b.estimate() - b.estimate().transpose()).amax() < 1e-18));
            }
            let y = tensor.to_harmonics(&conversion, &conversion).unwrap();
            let squares = y.values.iter().map(|v| v.component_mul(v) / DRAWS as f64);
            power = if power.is_empty() {
                squares.collect()
            } else {
                power.iter().zip(squares).map(|(p, s)| p + s).collect()
            };
            sigma = y.sigma;
        }
        let (mut ratio, mut count) = (0.0, 0.0);
        for (power, sigma) in power.iter().zip(&sigma) {
            for (p, s) in power.iter().zip(sigma.iter()).filter(|(_, s)| **s > 0.0) {
                let one = p / (s * s);
                assert!((0.6..1.6).contains(&one), "{one}");
                (ratio, count) = (ratio + one, count + 1.0);
            }
        }
        assert!((ratio / count - 1.0f64).abs() < 0.05, "{}", ratio / count);
    }
}

#[test]
fn what_cannot_be_is_refused() {
    let planes = vec![vec![0.1; 24 * 16]; size(ORDER)];
    let mut tensor = tensor(true, &planes);
    let low = Conversion::new(Method::Parity, zone(), 2).unwrap();
    let error = tensor.to_harmonics(&low, &low).unwrap_err();
    assert_eq!(error, TensorError::Orders { tensor: [3, 3], conversions: [2, 2] });
    for block in &mut tensor.blocks {
        block.covariance.iter_mut().for_each(|c| c.fill(0.0));
    }
    tensor.blocks.iter_mut().for_each(|b| b.values.fill(0.0));
    assert_eq!(reciprocity(&[tensor]).unwrap_err(), TensorError::NoNoise);
}

/// Sides of different orders: the square that both share can be symmetric.
#[test]
fn sides_may_differ_in_order() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(7);
    let planes = noise(ORDER, 24 * 16, &mut rng);
    let rule = rule(2);
    let mut tensor = Tensor::project(&rule, ORDER, false, |k| planes[k].clone(), |k| variance(k, 24 * 16)).unwrap();
    assert_eq!(tensor.blocks[0].values.shape(), (16, 9));
    assert_eq!(reciprocity(std::slice::from_ref(&tensor)).unwrap().freedom, 36);
    assert!(tensor.impose_reciprocity() > 1.0);
    let estimate = tensor.blocks[0].estimate();
    let square = estimate.view((0, 0), (9, 9));
    assert!((square - square.transpose()).amax() < 1e-18);
    let of = |order| Conversion::new(Method::Parity, zone(), order).unwrap();
    let y = tensor.to_harmonics(&of(3), &of(2)).unwrap();
    assert_eq!(y.values[0].shape(), (25, 16));
}
