//! Strengths of regularization: what is held back, how data choose it, and where a rule errs.

mod common;

use common::median;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use zonal::basis::{Conversion, Evidence, Method, Rule, Strength, size};
use zonal::convert::Trial;
use zonal::geometry::Zone;
use zonal::reflectance::{Brdf, abc_materials};

/// That of the built dome, and one up to the horizon.
fn zones() -> [Zone; 2] {
    [57.0, 90.0].map(|theta_max| Zone::from_degrees(9.0, theta_max).unwrap())
}

fn some_materials() -> Vec<&'static dyn Brdf> {
    abc_materials().iter().step_by(10).map(|m| &m.brdf as &dyn Brdf).collect()
}

fn amount(strength: Strength) -> f64 {
    match strength {
        Strength::Exact => 0.0,
        Strength::Cut(s) | Strength::Concentration(s) | Strength::Curvature(s) => s,
    }
}

/// What is held back is no data: the sum of all shares falls with the strength.
#[test]
fn shares_of_data_fall_where_functions_are_held_back() {
    let sum = |method, zone, strength| {
        let c = Conversion::with_strength(method, zone, 6, strength).unwrap();
        c.blocks.iter().flat_map(|b| &b.data_share).sum::<f64>()
    };
    for zone in zones() {
        for (method, strength) in [
            (Method::Truncated, Strength::Cut as fn(f64) -> Strength),
            (Method::Tikhonov, Strength::Curvature),
            (Method::Slepian, Strength::Concentration),
        ] {
            let strengths = [1e-8, 1e-4, 1e-2, 0.1, 0.5];
            let sums: Vec<f64> = strengths.iter().map(|s| sum(method, zone, strength(*s))).collect();
            assert!(sums.windows(2).all(|s| s[1] <= s[0] + 1e-9), "{}: {sums:?}", method.name());
            assert!(sums[4] > 0.0, "{}: {sums:?}", method.name());
            // All functions of `slepian` have most of their energy in the full zone.
            assert!(sums[4] < 0.9 * sums[0] || zone == zones()[1] && method == Method::Slepian, "{sums:?}");
        }
    }
}

#[test]
fn cleaner_data_are_held_back_less() {
    let trial = Trial::new(zones()[0], 6, &some_materials()).unwrap();
    for method in [Method::Truncated, Method::Tikhonov] {
        for rule in [Rule::Gcv, Rule::Discrepancy] {
            let order = 6;
            let noises = [1e2, 1.0, 0.1, 1e-2, 1e-3, 1e-4];
            let strengths = noises.map(|noise| {
                let mut evidence = Evidence::new(method, trial.zone(), order).unwrap();
                let mut rng = Xoshiro256PlusPlus::seed_from_u64(5);
                for (z, variance) in trial.spectra(order, noise, &mut rng).iter().flatten() {
                    evidence.add(z, variance);
                }
                evidence.strength(rule)
            });
            eprintln!("{} {rule:?} order {order}: {:?}", method.name(), strengths.map(amount));
            let amounts = strengths.map(amount);
            assert!(amounts.windows(2).all(|s| s[1] <= s[0]) && amounts[5] < amounts[0], "{amounts:?}");
            let c = Conversion::with_strength(method, trial.zone(), order, strengths[0]).unwrap();
            let share = c.data_share().iter().sum::<f64>() / size(order) as f64;
            eprintln!("   of noise alone {share:.3} is taken for data");
            // The cut always leaves each block its best function, curvature the cosine of a Lambert surface.
            let cosine = 1.0 / size(order) as f64;
            let nothing_left = if method == Method::Truncated { amounts[0] > 0.99 } else { share < cosine + 0.01 };
            assert!(nothing_left, "{share}");
        }
    }
}

#[test]
fn no_data_are_asked_on_the_full_zone() {
    let trial = Trial::new(zones()[1], 10, &some_materials()).unwrap();
    for method in [Method::Truncated, Method::Tikhonov] {
        for order in [2, 4, 6, 8, 10] {
            for noise in [1e-3, 1e-2, 1e-1] {
                let mut evidence = Evidence::new(method, trial.zone(), order).unwrap();
                let mut rng = Xoshiro256PlusPlus::seed_from_u64(6);
                let spectra = trial.spectra(order, noise, &mut rng);
                spectra.iter().flatten().for_each(|(z, variance)| evidence.add(z, variance));
                let known = if method == Method::Truncated { Method::Thesis } else { Method::Parity };
                let known = Conversion::new(known, trial.zone(), order).unwrap().strength;
                assert_eq!(evidence.strength(Rule::Auto), known, "{} {order} {noise}", method.name());
                // The rule is about this zone, not about all.
                let built = Evidence::new(method, zones()[0], order).unwrap();
                assert_ne!(built.strength(Rule::Auto), Strength::Exact);
            }
        }
    }
}

/// The discrepancy principle counts noise alone; what a short series leaks into weak eigenvalues it takes for signal.
#[test]
fn the_discrepancy_principle_does_not_see_leakage() {
    let trial = Trial::new(zones()[0], 4, &some_materials()).unwrap();
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(7);
    let spectra = trial.spectra(4, 0.01, &mut rng);
    let outside = |rule| {
        let errors = trial.linear(Method::Truncated, 4, &spectra, Some(rule)).unwrap();
        median(errors.iter().map(|e| e.outside).collect())
    };
    let (discrepancy, gcv) = (outside(Rule::Discrepancy), outside(Rule::Gcv));
    eprintln!("truncated, built zone, order 4: error outside {discrepancy:.1} by discrepancy, {gcv:.2} by GCV");
    assert!(discrepancy > 5.0 && gcv < 0.5, "{discrepancy} {gcv}");
}
