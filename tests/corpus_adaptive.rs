//! What an adviser makes of measured materials, from exact integrals with noise: how far it goes, what error that leaves beside
//! every fixed order, and how well it knows. On the simulated rig: `cargo bench --features corpus --bench adaptive_corpus`.
#![cfg(all(feature = "corpus", feature = "thorough"))]

mod common;

use zonal::fit::{FitMethod, FitOptions, fit};
use zonal::forecast::{Expected, FitAdviser, ideal_coefficients};
use zonal::measure::{Advice, Adviser, SoFar};
use zonal::patterns::Adaptive;
use zonal::reflectance::Metric;

/// Every so many of the 29 materials.
const EVERY: usize = 4;
/// Orders an adaptive run stops at.
const ORDERS: [usize; 4] = [2, 4, 6, 8];
/// Of a direction, over z_00: what mixtures under the default bracket have.
const NOISE: f64 = 0.009;
/// Geometric mean of errors over that of the best fixed order. Medians of ten materials jump from one to the next by a fifth.
const NEAR_BEST: f64 = 1.1;
/// Share of errors within a factor 2 of what was expected.
const FORETOLD: f64 = 0.7;

#[test]
fn measured_materials_are_followed_as_far_as_it_pays() {
    let zone = common::rig("ghosh-2007-built").zone();
    let metric = Metric::new(zone);
    let (mut fixed, mut adaptive) = (vec![Vec::new(); ORDERS.len()], Vec::new());
    let (mut near, mut orders) = (0, Vec::new());
    for (i, (name, truth)) in common::measured_materials().into_iter().enumerate().step_by(EVERY) {
        let reference = metric.reference(truth.as_ref()).unwrap();
        let data = ideal_coefficients(truth.as_ref(), zone, ORDERS[ORDERS.len() - 1], NOISE, i as u64).unwrap();
        for (errors, order) in fixed.iter_mut().zip(ORDERS) {
            let model = fit(&data.truncated(order), FitMethod::Auto, &FitOptions::default()).unwrap().brdf;
            errors.push(reference.errors(&model).unwrap().mean.overall());
        }
        let adviser = FitAdviser::default();
        let reached = ORDERS.iter().enumerate().find(|&(o, &order)| {
            let known = data.truncated(order);
            let so_far = SoFar {
                coefficients: &known,
                anisotropy: 0.0,
                isotropic: true,
                next_order: ORDERS.get(o + 1).copied(),
                target: Adaptive::default(),
            };
            adviser.advise(&so_far).0 == Advice::Stop
        });
        let (o, order) = reached.expect("the last order has none after it");
        let found = fixed[o][adaptive.len()];
        let expected = Expected::of(&data.truncated(*order)).unwrap().error;
        println!("{name}: order {order}, error {found:.3}, expected {expected:.3}");
        near += usize::from((found / expected).ln().abs() < 2f64.ln());
        adaptive.push(found);
        orders.push(*order);
    }
    let n = adaptive.len();
    let mean = |errors: &[f64]| (errors.iter().map(|e| e.ln()).sum::<f64>() / n as f64).exp();
    let best = fixed.iter().map(|errors| mean(errors)).fold(f64::INFINITY, f64::min);
    let adaptive = mean(&adaptive);
    println!("mean {adaptive:.4}, best fixed order {best:.4}; {near} of {n} within a factor 2; orders {orders:?}");
    assert!(adaptive < NEAR_BEST * best, "{adaptive} {best}");
    assert!(near as f64 > FORETOLD * n as f64, "{near} of {n}");
    assert!(orders.iter().any(|&o| o > 2), "somebody goes on");
}
