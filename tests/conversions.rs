//! Conversions at their limits: order 0, thin zones, lost ranks, refusals, functions they must return unchanged.

mod common;

use std::f64::consts::{FRAC_PI_2, PI};

use common::gray;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use zonal::basis::{
    Conversion, ConversionError, Family, Harmonics, Method, Population, Projection, RingMean, Strength, index, size,
};
use zonal::convert::{PriorTable, members, population, ring, ring_mean};
use zonal::geometry::quadrature::{polar_about_mirror, zone_mu_angular, zone_product};
use zonal::geometry::{Direction, Zone};
use zonal::reflectance::{Brdf, EXITANT_DEG, Lambert, abc_materials};

/// Integrals of products of functions of order 14 and sums of as many terms.
const ROUNDING: f64 = 1e-11;
/// What the population's quadrature promises for rings inside the zone, of all coefficients together.
const QUADRATURE: f64 = 1e-3;
/// The same for a mirror direction on the very edge, where half of the sharpest lobe falls to a rule that does not follow it.
const ON_THE_EDGE: f64 = 4e-3;
/// Rounding in least squares grows with the root of the Gram matrix's condition; this many units of it are allowed.
const UNITS: f64 = 50.0;
/// A weak lambda, and what it costs where the zone hardly sees a function: lambda (l (l + 1))^2 over the least eigenvalue.
const WEAK: f64 = 1e-13;
const HELD_BACK: f64 = 1e-6;
/// Standard errors within which the prior must know Lambert, which none of its members is.
const SIGMAS: f64 = 2.0;

fn zone(theta_min: f64, theta_max: f64) -> Zone {
    Zone::from_degrees(theta_min, theta_max).unwrap()
}

fn zones() -> [Zone; 2] {
    [zone(9.0, 57.0), zone(9.0, 90.0)]
}

/// z_k of the function with the coefficients `y` of `functions`.
fn forward(zone: &Zone, order: usize, functions: &Harmonics, y: &[f64]) -> Vec<f64> {
    let zonal = Harmonics::zonal(*zone, order).unwrap();
    let mut z = vec![0.0; size(order)];
    for (d, w) in zone_product(zone, 160, 48) {
        let f: f64 = functions.eval(&d).iter().zip(y).map(|(f, y)| f * y).sum();
        for (z, value) in z.iter_mut().zip(zonal.eval(&d)) {
            *z += w * f * value;
        }
    }
    z
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// A table of the prior with every `step`-th material of the built-in one.
fn thinned(step: usize) -> PriorTable {
    let mut table = PriorTable::built_in();
    table.materials = table.materials.into_iter().step_by(step).collect();
    table
}

/// Rings of one function of the same coefficients towards all of them.
fn rings(population: &Population, count: usize, z: &[f64], noise_rel: f64) -> Vec<RingMean> {
    vec![ring_mean(population, z, &vec![(noise_rel * z[0]).powi(2); z.len()]); count]
}

fn assert_finite(c: &Conversion) {
    let name = format!("{} at order {}", c.method.name(), c.order);
    assert!(c.blocks.iter().all(|b| b.matrix.iter().all(|x| x.is_finite())), "{name}");
    assert!(c.noise_gain_in.is_finite() && c.noise_gain_in > 0.0, "{name}: {}", c.noise_gain_in);
    assert!(c.noise_gain_out.is_finite() && c.noise_gain_out >= 0.0, "{name}: {}", c.noise_gain_out);
    assert!(c.data_share().iter().all(|s| (0.0..=1.0).contains(s)), "{name}");
    let z = vec![1.0; size(c.order)];
    let estimate = c.estimate(&z, &z).unwrap();
    assert!(estimate.y.iter().chain(&estimate.sigma).all(|x| x.is_finite()), "{name}");
}

#[test]
fn every_method_works_at_order_zero_and_in_a_thin_zone() {
    for zone in [zones()[0], zones()[1], zone(20.0, 20.1), zone(0.0, 0.1), zone(89.9, 90.0)] {
        for method in Method::ALL {
            assert_finite(&Conversion::new(method, zone, 0).unwrap());
        }
    }
    // What holds back cannot lose its rank.
    for method in [Method::Truncated, Method::Slepian, Method::Tikhonov] {
        for order in 1..=10 {
            assert_finite(&Conversion::new(method, zone(20.0, 20.1), order).unwrap());
        }
    }
}

#[test]
fn the_prior_works_at_order_zero_and_in_a_thin_zone() {
    let table = thinned(8);
    for (zone, thetas) in [
        (zone(20.0, 20.1), vec![20.0, 20.03, 20.1]),
        (zone(0.0, 0.1), vec![0.0, 0.05]),
        (zone(89.9, 90.0), vec![89.95]),
        (zone(9.0, 57.0), vec![9.0, 30.0, 57.0]),
    ] {
        let thetas: Vec<f64> = thetas.into_iter().map(f64::to_radians).collect();
        for order in [0, 2, 4] {
            let population = population(&table, zone, order, &thetas).unwrap();
            let y = [0.0, 0.0, 1.0, 0.0];
            let z = forward(&zone, order, &Family::Odd.harmonics(1).unwrap(), &y);
            let rings = rings(&population, thetas.len(), &z, 0.01);
            for map in population.maps(&rings, &table.learned()).unwrap() {
                let estimate = map.estimate(&z, &vec![1e-4 * z[0] * z[0]; z.len()], 0.5).unwrap();
                let all = estimate.y.iter().chain(&estimate.sigma).chain(&estimate.data_share);
                assert!(all.clone().all(|x| x.is_finite()), "{zone:?} {order}");
                assert!(map.surprise.is_finite());
                // A Lambert surface is among those that are known.
                // From the zone of a rig a white surface is known; a thread of directions says little.
                let share = estimate.y[2] / y[2];
                let bounds = if zone == zones()[0] { 0.95..1.05 } else { 0.01..3.0 };
                assert!(bounds.contains(&share), "{zone:?} {order}: {share}");
            }
        }
    }
}

/// Lambert to rounding, the sharpest lobes to what the population's quadrature promises, wherever the mirror direction lies.
#[test]
fn populations_are_integrated_right_in_every_zone() {
    let table = PriorTable::built_in();
    let sharp = abc_materials().iter().find(|m| m.name == "chrome").unwrap();
    let lambert = Lambert::gray(1.0);
    let brdfs: [&dyn Brdf; 2] = [&lambert, &sharp.brdf];
    let sh = Family::Odd.harmonics(table.sh_order).unwrap();
    for (zone, thetas) in [
        (zone(9.0, 57.0), vec![9.0, 10.0, 30.0, 57.0]),
        (zone(9.0, 90.0), vec![9.5, 40.0, 88.0]),
        (zone(20.0, 20.1), vec![20.0, 20.05, 20.1]),
        (zone(30.0, 60.0), vec![30.0, 31.0, 59.0]),
        (zone(60.0, 90.0), vec![61.0, 75.0]),
        (zone(0.0, 40.0), vec![0.0, 3.0, 39.0]),
    ] {
        let zonal = Harmonics::zonal(zone, 4).unwrap();
        // With the zone counted in full it is the projection over the hemisphere.
        let projection = Projection::new(zone, table.sh_order, 1.0).unwrap();
        for theta in thetas {
            let wo = Direction::from_angles(f64::to_radians(theta), 0.0);
            let (z, y) = ring(&brdfs, &zonal, &sh, &projection, 1.0, wo.theta());
            let terms = projection.terms();
            let mut want = vec![0.0; sh.len()];
            for (wi, w) in polar_about_mirror(&wo, 384, 512, FRAC_PI_2) {
                let f = gray(&sharp.brdf.eval_cos(&wi, &wo))[0];
                want.iter_mut().zip(sh.eval(&wi)).for_each(|(sum, y)| *sum += 2.0 * w * f * y);
            }
            let scale = want.iter().map(|y| y * y).sum::<f64>().sqrt();
            let mut worst = [0.0f64; 2];
            for (i, &k) in terms.iter().enumerate() {
                let flat = if k == index(1, 0) { (4.0 * PI / 3.0f64).sqrt() / PI } else { 0.0 };
                worst[0] = worst[0].max((y[(0, i)] - flat).abs());
                worst[1] = worst[1].max((y[(1, i)] - want[k]).abs() / scale);
            }
            let dc = zone.projected_solid_angle() / PI / zone.solid_angle().sqrt();
            let z_error = (z[(0, 0)] / dc - 1.0).abs();
            eprintln!(
                "{:.1}..{:.1} theta_o {theta}: Lambert {:.1e}, z_00 {z_error:.1e}, chrome {:.1e}",
                zone.theta_min().to_degrees(),
                zone.theta_max().to_degrees(),
                worst[0],
                worst[1]
            );
            let distance = (theta - zone.theta_min().to_degrees()).min(zone.theta_max().to_degrees() - theta);
            let at_most = if distance < 0.1 { ON_THE_EDGE } else { QUADRATURE };
            assert!(worst.iter().chain([&z_error]).all(|e| *e < at_most), "{worst:?} {z_error} {at_most}");
        }
    }
}

#[test]
fn lost_ranks_are_told() {
    let cases = [
        (Method::Thesis, zones()[0], 20),
        (Method::Thesis, zone(20.0, 20.1), 5),
        (Method::Hsh, zone(20.0, 20.1), 6),
        (Method::Parity, zone(20.0, 20.1), 12),
    ];
    for (method, zone, order) in cases {
        let error = Conversion::new(method, zone, order).unwrap_err();
        let text = error.to_string();
        eprintln!("{text}");
        let ConversionError::RankDeficient { m, rank, functions, .. } = error else { panic!("{text}") };
        assert!(rank < functions);
        for word in [method.name(), &format!("m = {m}"), &format!("only {rank}"), "--order", "prior", "truncated"] {
            assert!(text.contains(word), "{word}: {text}");
        }
        // What it says to do can be done.
        assert!((0..order).rev().any(|order| Conversion::new(method, zone, order).is_ok()));
        assert_finite(&Conversion::new(Method::Truncated, zone, order).unwrap());
    }
}

#[test]
fn what_is_not_finite_is_refused() {
    let order = 2;
    let table = thinned(8);
    let population = population(&table, zones()[0], order, &[0.4, 0.7]).unwrap();
    let good = vec![1.0; size(order)];
    let healthy = rings(&population, 2, &good, 0.01);
    let maps = population.maps(&healthy, &table.learned()).unwrap();
    let broken = |values: &[f64], value: f64| {
        let mut values = values.to_vec();
        values[3] = value;
        values
    };
    let refused = |e: Result<(), ConversionError>, what: &str| {
        assert!(matches!(e, Err(ConversionError::NotFinite { .. })), "{what}: {e:?}");
    };
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let z = broken(&good, value);
        for method in Method::ALL {
            let c = Conversion::new(method, zones()[0], order).unwrap();
            refused(c.estimate(&z, &good).map(|_| ()), "z");
        }
        refused(maps[0].estimate(&z, &good, 0.1).map(|_| ()), "z of a map");
        let mut rings = healthy.clone();
        rings[1].z[3] = value;
        refused(population.maps(&rings, &table.learned()).map(|_| ()), "z of a ring");
    }
    for value in [f64::NAN, f64::INFINITY, -1e-9] {
        let variance = broken(&good, value);
        for method in Method::ALL {
            let c = Conversion::new(method, zones()[0], order).unwrap();
            refused(c.estimate(&good, &variance).map(|_| ()), "variance");
        }
        refused(maps[0].estimate(&good, &variance, 0.1).map(|_| ()), "variance of a map");
        let mut rings = healthy.clone();
        rings[1].variance[3] = value;
        refused(population.maps(&rings, &table.learned()).map(|_| ()), "variance of a ring");
        let mut rings = healthy.clone();
        rings[1].direction_variance[3] = value;
        refused(population.maps(&rings, &table.learned()).map(|_| ()), "variance of a direction");
    }
    for value in [0.0, -1.0] {
        let mut rings = healthy.clone();
        rings[0].z[0] = value;
        refused(population.maps(&rings, &table.learned()).map(|_| ()), "no light");
    }
}

/// A method is never named that would be refused too.
#[test]
fn refusals_name_a_way_out() {
    let mut refusals = 0;
    for zone in zones() {
        for method in Method::ALL {
            for order in 0..=10 {
                let Ok(c) = Conversion::new(method, zone, order) else { continue };
                for noise_rel in [1e-3, 1e-2, 1e-1] {
                    let Err(error) = c.check(noise_rel) else { continue };
                    refusals += 1;
                    let text = error.to_string();
                    assert!(text.contains(&format!("noise_gain_out = {:.3e}", c.noise_gain_out)), "{text}");
                    // The prior is never refused.
                    assert!(text.contains("--method prior") && text.contains("--force"), "{text}");
                    let passes = |method, order| {
                        Conversion::new(method, zone, order).is_ok_and(|c: Conversion| c.check(noise_rel).is_ok())
                    };
                    for other in Method::ALL {
                        if text.contains(&format!("--method {}", other.name())) {
                            assert!(passes(other, order), "{text}");
                        }
                    }
                    if text.contains("--order") {
                        assert!((0..order).any(|order| passes(method, order)), "{text}");
                    }
                }
            }
        }
    }
    assert!(refusals > 20, "{refusals}");
}

/// f_cos of a white Lambert surface is cos(theta) / pi, exactly Y_10.
#[test]
fn a_white_surface_is_found_in_every_zone() {
    let want = (4.0 * PI / 3.0f64).sqrt() / PI;
    let lambert = [0.0, 0.0, want, 0.0];
    let functions = Family::Odd.harmonics(1).unwrap();
    let mut worst = 0.0f64;
    for zone in [zones()[0], zones()[1], zone(20.0, 30.0), zone(0.0, 40.0)] {
        for order in 1..=10 {
            let z = forward(&zone, order, &functions, &lambert);
            let mut conversions = vec![Conversion::new(Method::Parity, zone, order).unwrap()];
            // No Slepian function left out; held back by next to nothing.
            conversions.push(Conversion::with_strength(Method::Slepian, zone, order, Strength::Exact).unwrap());
            if zones().contains(&zone) {
                let weak = Strength::Curvature(WEAK);
                conversions.push(Conversion::with_strength(Method::Tikhonov, zone, order, weak).unwrap());
            }
            for c in conversions {
                let y = c.apply(&z);
                let flat: Vec<f64> = (0..y.len()).map(|k| if k == index(1, 0) { want } else { 0.0 }).collect();
                let error = largest_difference(&y, &flat);
                let held_back = if c.method == Method::Tikhonov { HELD_BACK } else { 0.0 };
                let at_most = held_back + ROUNDING.max(UNITS * f64::EPSILON * c.condition.sqrt());
                worst = worst.max(if c.method == Method::Tikhonov { error } else { 0.0 });
                assert!(error < at_most, "{} {order} {zone:?}: {error:e} of {at_most:e}", c.method.name());
            }
        }
    }
    eprintln!("Lambert by `tikhonov`, lambda {WEAK:e}: {worst:.1e}");
    for zone in zones() {
        let c = Conversion::new(Method::Slepian, zone, 4).unwrap();
        let y = c.apply(&forward(&zone, 4, &functions, &lambert));
        assert!((y[2] - want).abs() < ROUNDING, "{zone:?}: {}", y[2] - want);
    }
}

#[test]
fn the_prior_knows_a_white_surface_within_its_error_bars() {
    let table = PriorTable::built_in();
    let want = (4.0 * PI / 3.0f64).sqrt() / PI;
    let thetas = EXITANT_DEG.map(f64::to_radians);
    for zone in zones() {
        for order in [2, 4, 8] {
            let population = population(&table, zone, order, &thetas).unwrap();
            let z = forward(&zone, order, &Family::Odd.harmonics(1).unwrap(), &[0.0, 0.0, want, 0.0]);
            for noise_rel in [1e-2, 1e-3] {
                let variance = vec![(noise_rel * z[0]).powi(2); z.len()];
                let maps = population.maps(&rings(&population, 4, &z, noise_rel), &table.learned()).unwrap();
                let mut worst = 0.0f64;
                let mut error = 0.0f64;
                for map in maps {
                    let estimate = map.estimate(&z, &variance, 0.0).unwrap();
                    for (k, (y, sigma)) in estimate.y.iter().zip(&estimate.sigma).enumerate() {
                        let off = (y - if k == index(1, 0) { want } else { 0.0 }).abs();
                        error = error.max(off / want);
                        if *sigma > 0.0 || off > ROUNDING {
                            worst = worst.max(off / sigma);
                        }
                    }
                }
                eprintln!(
                    "Lambert by the prior, {:.0} deg, order {order}, noise {noise_rel}: {error:.4} of Y_10, {worst:.2} sigma",
                    zone.theta_max().to_degrees()
                );
                assert!(worst < SIGMAS, "{worst}");
            }
        }
    }
}

/// Functions without azimuth are polynomials in mu for both bases: nothing of them is lost on the way.
#[test]
fn there_and_back_is_the_identity() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(3);
    for zone in zones() {
        for (method, orders) in [(Method::Parity, &[2, 4, 6, 8, 10][..]), (Method::Thesis, &[2, 4, 6])] {
            for &order in orders {
                let c = Conversion::with_strength(method, zone, order, Strength::Exact).unwrap();
                let mut y = vec![0.0; size(c.sh_order)];
                for l in method.family().degrees(order, 0) {
                    y[index(l, 0)] = rng.random_range(-1.0..1.0);
                }
                let error = largest_difference(&c.apply(&forward(&zone, order, &c.harmonics(), &y)), &y);
                let at_most = ROUNDING.max(UNITS * f64::EPSILON * c.condition.sqrt());
                assert!(error < at_most, "{} {order} {zone:?}: {error:e} of {at_most:e}", method.name());
                let shares = c.data_share();
                for l in method.family().degrees(order, 0) {
                    assert!(
                        (shares[index(l, 0)] - 1.0).abs() < at_most,
                        "{}: {l}: {}",
                        method.name(),
                        shares[index(l, 0)]
                    );
                }
            }
        }
    }
    // With azimuth it takes a zone without inner edges, where the zonal functions are the method's own.
    for (method, zone) in [(Method::Thesis, Zone::sphere()), (Method::Hsh, Zone::hemisphere())] {
        let c = Conversion::new(method, zone, 6).unwrap();
        let y: Vec<f64> = (0..size(6)).map(|_| rng.random_range(-1.0..1.0)).collect();
        let error = largest_difference(&c.apply(&forward(&zone, 6, &c.harmonics(), &y)), &y);
        assert!(error < ROUNDING, "{}: {error:e}", method.name());
        assert!(c.data_share().iter().all(|s| (s - 1.0).abs() < ROUNDING));
    }
}

/// Decompositions are kept: those of other zones, orders and methods must not come back, nor rounded otherwise.
#[test]
fn kept_decompositions_are_the_right_ones() {
    let zones = [zone(9.0, 57.0), zone(9.0, 90.0), zone(9.0, 57.0_f64.next_up()), zone(10.0, 57.0), zone(20.0, 20.1)];
    let all = || {
        let mut all = Vec::new();
        for zone in zones {
            for order in 0..=6 {
                for method in Method::ALL {
                    if let Ok(c) = Conversion::new(method, zone, order) {
                        all.push((zone, c));
                    }
                }
            }
        }
        all
    };
    let first = all();
    for ((_, a), (_, b)) in first.iter().zip(&all()) {
        assert_eq!((a.method, a.order, a.sh_order, a.blocks.len()), (b.method, b.order, b.sh_order, b.blocks.len()));
        for (a, b) in a.blocks.iter().zip(&b.blocks) {
            assert_eq!((a.m, &a.degrees, &a.matrix, a.condition), (b.m, &b.degrees, &b.matrix, b.condition));
        }
    }
    // The normal equations by the zone's own rule: G C = B.
    let exact = |c: &Conversion| c.method == Method::Parity && c.strength == Strength::Exact;
    for (zone, c) in first.iter().filter(|(_, c)| exact(c)) {
        let (functions, zonal) = (c.harmonics(), Harmonics::zonal(*zone, c.order).unwrap());
        for block in &c.blocks {
            let (rows, columns) = (block.degrees.len(), c.order - block.m + 1);
            let mut gram = nalgebra::DMatrix::<f64>::zeros(rows, rows);
            let mut mixed = nalgebra::DMatrix::<f64>::zeros(rows, columns);
            for (mu, w) in zone_mu_angular(120, zone) {
                let (mut p, mut q) = (Vec::new(), Vec::new());
                functions.polar_parts(block.m, mu, &mut p);
                zonal.polar_parts(block.m, mu, &mut q);
                let p: Vec<f64> = block.degrees.iter().map(|l| p[l - block.m]).collect();
                for i in 0..rows {
                    (0..rows).for_each(|j| gram[(i, j)] += 2.0 * PI * w * p[i] * p[j]);
                    (0..columns).for_each(|j| mixed[(i, j)] += 2.0 * PI * w * p[i] * q[j]);
                }
            }
            let off = (&gram * &block.matrix - &mixed).amax() / mixed.amax();
            let at_most = ROUNDING.max(UNITS * f64::EPSILON * c.condition.sqrt());
            assert!(off < at_most, "{zone:?} order {} m {}: {off:e} of {at_most:e}", c.order, block.m);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        rng_seed: prop::test_runner::RngSeed::Fixed(11),
        failure_persistence: None,
        ..ProptestConfig::with_cases(96)
    })]

    #[test]
    fn any_zone_gives_finite_blocks_or_an_error(theta_min in 0.0..60.0f64, decades in 0.0..1.0f64, order in 0usize..=8) {
        let width = 0.1 * 900f64.powf(decades);
        let zone = Zone::from_degrees(theta_min, (theta_min + width).min(90.0)).unwrap();
        for method in Method::ALL {
            match Conversion::new(method, zone, order) {
                Ok(c) => assert_finite(&c),
                Err(error) => prop_assert!(matches!(error, ConversionError::RankDeficient { .. }), "{}", error),
            }
        }
    }
}

/// Both models of every material are there.
#[test]
fn a_thinned_table_has_both_models() {
    assert_eq!(members(&thinned(8)).len(), 2 * thinned(8).materials.len());
}
