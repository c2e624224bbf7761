//! Tensors over both sides of closed-form materials, all of them reciprocal: symmetry, noise, files, reconstruction.

mod common;

use std::sync::Arc;

use common::{exact_coefficients, noisy};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use zonal::basis::{Conversion, ExitantRule, Method, Tensor, TensorError, about_normal, reciprocity, size};
use zonal::export::{ShMaterial, TensorMaterial, both_sides};
use zonal::fit::{CalibrationUncertainty, Fineness, Forward, Observations, Station};
use zonal::geometry::{Direction, ExitantGrid, Zone};
use zonal::reduce::Coefficients;
use zonal::reflectance::{Brdf, Metric, ZoneErrors, abc_materials, open};

/// Noise of every coefficient, of DC.
const NOISE: f64 = 0.01;

fn zone() -> Zone {
    common::rig("ghosh-2007-built").zone()
}

fn tensors(coefficients: &Coefficients, isotropic: bool) -> [Tensor; 3] {
    both_sides(coefficients, coefficients.order, isotropic, &CalibrationUncertainty::default()).unwrap()
}

/// ||T - T^T|| / ||T|| of one channel.
fn asymmetry(tensor: &Tensor) -> f64 {
    let sum = |of: &dyn Fn(&nalgebra::DMatrix<f64>) -> f64| -> f64 {
        tensor.blocks.iter().map(|b| b.copies as f64 * of(&b.values)).sum()
    };
    (sum(&|v| (v - v.transpose()).norm_squared()) / sum(&|v| v.norm_squared())).sqrt()
}

/// Exact coefficients of an anisotropic material.
fn exact_anisotropic(brdf: &dyn Brdf, grid: ExitantGrid, order: usize) -> Coefficients {
    let n = size(order) * 3 * grid.len();
    let mut coefficients =
        Coefficients { grid, order, values: vec![0.0; n], sigma: vec![0.0; n], history: String::new() };
    let stations = (0..grid.len()).map(|cell| Station {
        ring: cell / grid.sectors(),
        phi_o: grid.phi(cell % grid.sectors()),
        z: vec![[1.0; 3]; size(order)],
        sigma: vec![[1.0; 3]; size(order)],
    });
    let observations = Observations {
        grid,
        order,
        terms: (0..size(order)).collect(),
        stations: stations.collect(),
        folded: false,
        isotropy_chi: 1.0,
        anisotropy: 1.0,
    };
    let forward = Forward::new(&observations, Fineness { radial: 32, around: 48 }).unwrap();
    for (c, predicted) in forward.predict(brdf).iter().enumerate() {
        for (cell, z) in predicted.chunks_exact(size(order)).enumerate() {
            for (k, z) in about_normal(z, grid.phi(cell % grid.sectors())).into_iter().enumerate() {
                coefficients.values[(k * 3 + c) * grid.len() + cell] = z as f32;
            }
        }
    }
    coefficients
}

/// Exact data of 32 and 64 rings: what the rule over the rings leaves, 6e-8 being the rounding of stored floats. The rule takes
/// the cells at the zone's edges, which are averages over half a ring, as values at their centres.
#[test]
fn exact_data_are_symmetric() {
    let at_most = [
        ("gray-card", [1e-7, 1e-7]),
        ("ggx-0.4", [5e-6, 5e-7]),
        ("ggx-0.1", [2e-4, 5e-6]),
        ("ggx-0.05", [2e-4, 5e-6]),
        ("red-plastic", [3e-5, 3e-5]),
        ("chrome", [3e-3, 3e-4]),
    ];
    for (name, bounds) in at_most {
        let brdf = open(name).unwrap();
        for (rings, bound) in [32, 64].into_iter().zip(bounds) {
            let exact = exact_coefficients(brdf.as_ref(), ExitantGrid::new(zone(), rings, 2 * rings), 4, zone());
            let got = tensors(&exact, true).iter().map(asymmetry).fold(0.0, f64::max);
            eprintln!("{name}, {rings} rings: asymmetry {got:.1e}");
            assert!(got < bound, "{name}, {rings}: {got:e}");
        }
    }
}

/// Total variance of 200 draws of noise before and after, against (entries) / (independent entries).
#[test]
fn reciprocity_takes_out_the_variance_it_can() {
    const DRAWS: u64 = 200;
    let grid = ExitantGrid::new(zone(), 32, 64);
    for (order, ideal) in [(2, 1.357), (4, 1.545), (6, 1.65), (10, 1.76)] {
        let rule = ExitantRule::new(grid, order).unwrap();
        let draw = |seed: u64| {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
            let planes: Vec<Vec<f64>> =
                (0..size(order)).map(|_| (0..grid.len()).map(|_| StandardNormal.sample(&mut rng)).collect()).collect();
            let plane = |k: usize| planes[k].clone();
            let mut tensor = Tensor::project(&rule, order, true, plane, |_| vec![1.0; grid.len()]).unwrap();
            let power =
                |t: &Tensor| -> f64 { t.blocks.iter().map(|b| b.copies as f64 * b.estimate().norm_squared()).sum() };
            let before = power(&tensor);
            let said = tensor.impose_reciprocity();
            (before, power(&tensor), said)
        };
        let draws: Vec<_> = (0..DRAWS).into_par_iter().map(draw).collect();
        let sum = |of: fn(&(f64, f64, f64)) -> f64| draws.iter().map(of).sum::<f64>();
        let (seen, said) = (sum(|d| d.0) / sum(|d| d.1), draws[0].2);
        eprintln!("order {order}: variance falls {seen:.3} times (said {said:.3}), ideal {ideal}");
        assert!(seen > 0.9 * ideal, "{order}: {seen}");
        assert!((seen / said - 1.0).abs() < 0.05, "{order}: {seen} {said}");
    }
}

/// Closed-form materials, narrow coats among them, pass the test of reciprocity at 1% noise.
#[test]
fn reciprocal_materials_pass() {
    const SEEDS: u64 = 10;
    let grid = ExitantGrid::new(zone(), 32, 64);
    let named = ["gray-card", "ggx-0.05", "ggx-0.1", "ggx-0.4"].map(|n| (n.to_owned(), open(n).unwrap()));
    let abc = abc_materials().iter().step_by(7).map(|m| (m.name.to_string(), Arc::new(m.brdf) as Arc<dyn Brdf>));
    let (mut passed, mut all) = (0, 0);
    for (name, brdf) in named.into_iter().chain(abc) {
        let exact = exact_coefficients(brdf.as_ref(), grid, 4, zone());
        let tests: Vec<bool> = (0..SEEDS)
            .into_par_iter()
            .map(|seed| reciprocity(&tensors(&noisy(&exact, NOISE, seed), true)).unwrap().holds())
            .collect();
        let good = tests.iter().filter(|t| **t).count();
        assert!(good >= 9, "{name}: {good} of {SEEDS}");
        (passed, all) = (passed + good, all + tests.len());
    }
    eprintln!("{passed} of {all} pass at {NOISE} noise");
    assert!(passed * 100 >= 95 * all);
}

/// What the rig could not have done by itself is seen: a slope over theta_o. Narrow lobes hide it best: there theta_o is theta_i.
#[test]
fn small_violations_are_seen() {
    let grid = ExitantGrid::new(zone(), 32, 64);
    for (name, slope) in [("gray-card", 0.03), ("ggx-0.4", 0.05), ("ggx-0.1", 0.15)] {
        let mut bent = noisy(&exact_coefficients(open(name).unwrap().as_ref(), grid, 4, zone()), NOISE, 3);
        for (i, z) in bent.values.iter_mut().enumerate() {
            let ring = i % grid.len() / grid.sectors();
            *z *= 1.0 + slope * ((ring as f32 + 0.5) / 32.0 - 0.5);
        }
        let test = reciprocity(&tensors(&bent, true)).unwrap();
        eprintln!("{name}: violation {:.4}, expected {:.4}, p {:.1e}", test.violation, test.expected, test.p);
        assert!(!test.holds());
        let error = test.check().unwrap_err();
        assert!(matches!(error, TensorError::NotReciprocal { .. }) && error.to_string().contains("--force"));
    }
}

/// Anisotropic, all m: symmetric, found anisotropic, and the tensor knows the grain where the zone does.
#[test]
fn anisotropic_materials_keep_all_m() {
    let brdf = open("ggx-0.1-0.4").unwrap();
    let exact = exact_anisotropic(brdf.as_ref(), ExitantGrid::new(zone(), 32, 64), 4);
    let asymmetries = tensors(&exact, false).map(|t| asymmetry(&t));
    eprintln!("asymmetry, exact: {:.1e}", asymmetries[1]);
    assert!(asymmetries.iter().all(|a| *a < 1e-3));
    let noisy = noisy(&exact, NOISE, 4);
    assert!(!Observations::of(&noisy).folded);
    let mut tensors = tensors(&noisy, false);
    let test = reciprocity(&tensors).unwrap();
    assert!(test.holds(), "{test:?}");
    tensors.iter_mut().for_each(|t| {
        t.impose_reciprocity();
    });
    let conversion = Conversion::new(Method::Parity, zone(), 4).unwrap();
    let tensor = TensorMaterial::new(&tensors, &conversion, &conversion, zone(), "a test".into()).unwrap();
    let one_sided = ShMaterial::new(&noisy, &conversion);
    let error = |m: &dyn Brdf| ZoneErrors::new(m, brdf.as_ref(), zone()).inside;
    let (of_tensor, of_sh) = (error(&tensor), error(&one_sided));
    eprintln!("ggx-0.1-0.4: error inside {of_tensor:.3}, with incident directions alone {of_sh:.3}");
    assert!(of_tensor < 1.3 * of_sh);
    assert!(!tensor.is_isotropic());
    round_trip(&tensor);
}

/// Both sides against incident directions alone, for theta_o inside and outside the zone.
#[test]
fn both_sides_are_about_as_good_inside_and_know_more_outside() {
    let grid = ExitantGrid::new(zone(), 32, 64);
    let conversion = Conversion::new(Method::Parity, zone(), 4).unwrap();
    for name in ["gray-card", "ggx-0.4", "red-plastic", "green-latex", "nylon"] {
        let brdf = open(name).unwrap();
        let noisy = noisy(&exact_coefficients(brdf.as_ref(), grid, 4, zone()), NOISE, 5);
        let mut tensors = tensors(&noisy, true);
        assert!(reciprocity(&tensors).unwrap().holds());
        tensors.iter_mut().for_each(|t| {
            t.impose_reciprocity();
        });
        let tensor = TensorMaterial::new(&tensors, &conversion, &conversion, zone(), "a test".into()).unwrap();
        let one_sided = ShMaterial::new(&noisy, &conversion);
        let metric = Metric::new(zone());
        let errors = |m: &dyn Brdf| metric.errors(brdf.as_ref(), m).unwrap().mean;
        let (of_tensor, of_sh) = (errors(&tensor), errors(&one_sided));
        eprintln!(
            "{name}: inside {:.3} (incident alone {:.3}), outside {:.3} ({:.3})",
            of_tensor.rel_in, of_sh.rel_in, of_tensor.rel_out, of_sh.rel_out
        );
        assert!(of_tensor.rel_in < 2.0 * of_sh.rel_in);
        assert!(of_tensor.rel_out < 1.2 * of_sh.rel_out);
        assert!(tensor.is_isotropic() && tensor.reciprocal);
        // Reciprocal, also where nothing was measured.
        let (wi, wo) = (Direction::from_angles(1.3, 0.4), Direction::from_angles(0.6, 2.0));
        let (f, swapped) = (tensor.eval(&wi, &wo), tensor.eval(&wo, &wi));
        assert!((0..3).all(|c| (f[c] - swapped[c]).abs() < 1e-12 * f[c].abs().max(1.0)));
        round_trip(&tensor);
    }
}

/// The file keeps floats; everything else comes back as it was.
fn round_trip(material: &TensorMaterial) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tensor.exr");
    material.write(&path).unwrap();
    assert!(TensorMaterial::is_in(&path).unwrap());
    assert!(ShMaterial::read(&path).is_err());
    let back = TensorMaterial::read(&path).unwrap();
    assert_eq!(
        (back.isotropic, back.reciprocal, back.orders()),
        (material.isotropic, material.reciprocal, material.orders())
    );
    assert_eq!(
        (&back.method, back.zonal_orders, &back.history),
        (&material.method, material.zonal_orders, &material.history)
    );
    for (a, b) in back.channels.iter().zip(&material.channels) {
        for (a, b) in a.values.iter().chain(&a.sigma).zip(b.values.iter().chain(&b.sigma)) {
            assert_eq!(*a, b.map(|v| f64::from(v as f32)));
        }
    }
    let (wi, wo) = (Direction::from_angles(0.7, 0.4), Direction::from_angles(0.5, 3.0));
    let (f, again) = (material.eval(&wi, &wo), back.eval(&wi, &wo));
    assert!((0..3).all(|c| (f[c] - again[c]).abs() < 1e-5 * f[c].abs().max(1e-3)));
}

#[test]
fn cells_without_data_are_counted() {
    let grid = ExitantGrid::new(zone(), 8, 12);
    let mut holes = exact_coefficients(open("gray-card").unwrap().as_ref(), grid, 2, zone());
    holes.values[4 * grid.len() + 15] = f32::NAN;
    holes.sigma[30] = f32::NAN;
    let error = both_sides(&holes, 2, true, &CalibrationUncertainty::default()).unwrap_err();
    assert_eq!(error, TensorError::Missing { missing: 2, cells: 96, ring: 1, sector: 3 });
    assert!(error.to_string().contains("2 of 96") && error.to_string().contains("incident directions alone"));
}
