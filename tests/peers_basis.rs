//! The basis against SciPy and against 50-digit arithmetic: `bash tests/run.sh`, which sets ZONAL_PYTHON.
//!
//! Each test writes what the library computes as JSON; a script in tests/python recomputes and compares it.
#![cfg(feature = "peers")]

mod common;

use std::f64::consts::PI;

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::{Value, json};
use zonal::basis::{Conversion, Harmonics, MAX_ORDER, Method, Strength};
use zonal::geometry::quadrature::zone_mu_angular;
use zonal::geometry::{Direction, Sample, Zone};

/// Two f64 programs, values up to 2, sines and cosines of 20 phi.
const SCIPY: f64 = 1e-12;
/// The library's promise up to the largest order, relative to each function's maximum over the zone, at the same f64 mu.
const ZONAL: f64 = 1e-13;
/// Quadrature and the solve of a block of small condition, relative to the block's largest entry.
const CONVERSION: f64 = 1e-12;
/// Rounding in a solve grows with the condition of the Gram matrix; this many units of it are allowed.
const UNITS: f64 = 8.0;
/// Nodes of the library's own rule.
const NODES: usize = 160;

fn zones() -> [(&'static str, Zone); 2] {
    [("9..57", Zone::from_degrees(9.0, 57.0).unwrap()), ("9..90", Zone::from_degrees(9.0, 90.0).unwrap())]
}

#[test]
fn spherical_harmonics_are_those_of_scipy() {
    let order = 20;
    let sh = Harmonics::spherical(order).unwrap();
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(20);
    let mut directions: Vec<Direction<Sample>> =
        (0..200).map(|_| Direction::from_mu_phi(rng.random_range(-1.0..1.0), rng.random_range(-PI..PI))).collect();
    for near in [0.0, 1e-9, 1e-6, 1e-3, 0.03] {
        let phi = rng.random_range(-PI..PI);
        directions.extend([Direction::from_angles(near, phi), Direction::from_angles(PI - near, phi)]);
    }
    // Both programs start from the same f64 mu: within 1e-8 of a pole theta itself has digits that mu has not.
    let mu: Vec<f64> = directions.iter().map(Direction::cos_theta).collect();
    let phi: Vec<f64> = directions.iter().map(Direction::phi).collect();
    let values: Vec<Vec<f64>> = directions.iter().map(|d| sh.eval(d)).collect();
    common::ask(
        "peer_harmonics.py",
        &json!({ "order": order, "mu": mu, "phi": phi, "values": values, "tolerance": SCIPY }),
    );
}

/// Polar parts of all m at one mu.
fn all_parts(basis: &Harmonics, mu: f64) -> Vec<Vec<f64>> {
    (0..=basis.order())
        .map(|m| {
            let mut parts = Vec::new();
            basis.polar_parts(m, mu, &mut parts);
            parts
        })
        .collect()
}

/// Each function's maximum over the zone, from a grid fine enough for 50 half waves, and both ends.
fn largest(basis: &Harmonics) -> Vec<Vec<f64>> {
    let zone = basis.zone();
    let mut largest = all_parts(basis, zone.cos_min());
    let grid = zone_mu_angular(1000, &zone).into_iter().map(|(mu, _)| all_parts(basis, mu));
    for parts in grid.chain([all_parts(basis, zone.cos_max())]) {
        for (most, value) in largest.iter_mut().flatten().zip(parts.iter().flatten()) {
            *most = most.abs().max(value.abs());
        }
    }
    largest
}

/// Cosines of polar angles inside the zone and its ends, and others just within the ends.
fn cosines(zone: Zone, rng: &mut Xoshiro256PlusPlus) -> [(&'static str, Vec<f64>); 2] {
    let (a, b) = (zone.cos_min(), zone.cos_max());
    let mut inside = vec![a, b, (a + b) / 2.0];
    inside.extend((0..7).map(|_| rng.random_range(b..a)));
    let mut ends = vec![a.next_down(), b.next_up()];
    for _ in 0..7 {
        let near = 10f64.powf(rng.random_range(-16.0..-2.0));
        ends.extend([a - near, b + near]);
    }
    [("inside", inside), ("near the ends", ends)]
}

fn zones_and_sphere() -> [(&'static str, Zone); 3] {
    let [built, full] = zones();
    [built, full, ("0..180", Zone::sphere())]
}

#[test]
fn zonal_functions_keep_thirteen_digits_up_to_the_largest_order() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(50);
    let mut cases = Vec::new();
    for (name, zone) in zones_and_sphere() {
        let basis = Harmonics::zonal(zone, MAX_ORDER).unwrap();
        let largest = largest(&basis);
        for (place, mu) in cosines(zone, &mut rng) {
            let parts: Vec<_> = mu.iter().map(|&mu| all_parts(&basis, mu)).collect();
            let name = format!("zone {name} {place}");
            cases.push(json!({
                "name": name, "a": zone.cos_min(), "b": zone.cos_max(), "mu": mu, "parts": parts, "largest": largest,
                "tolerance": ZONAL,
            }));
        }
    }
    common::ask("peer_zonal.py", &json!(cases));
}

/// Whole functions of many directions at once, azimuth included, for the same f64 components; each number of functions
/// takes another way through memory.
#[test]
fn batches_keep_thirteen_digits_up_to_the_largest_order() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(51);
    let mut cases = Vec::new();
    for (name, zone) in zones_and_sphere() {
        for order in [6, 10, 20, MAX_ORDER] {
            let basis = Harmonics::zonal(zone, order).unwrap();
            let largest = largest(&basis);
            for (place, mu) in cosines(zone, &mut rng) {
                let azimuths = [0.0, PI].into_iter().chain(std::iter::from_fn(|| Some(rng.random_range(-PI..PI))));
                let directions: Vec<Direction<Sample>> =
                    mu.into_iter().zip(azimuths).map(|(mu, phi)| Direction::from_mu_phi(mu, phi)).collect();
                let mut out = vec![0.0; directions.len() * basis.len()];
                basis.eval_many_into(&directions, &mut out);
                let vectors: Vec<[f64; 3]> = directions.iter().map(|d| d.vector().into()).collect();
                let rows: Vec<&[f64]> = out.chunks_exact(basis.len()).collect();
                cases.push(json!({
                    "name": format!("zone {name} {place}, order {order}"), "a": zone.cos_min(), "b": zone.cos_max(),
                    "vectors": vectors, "rows": rows, "largest": largest, "tolerance": ZONAL,
                }));
            }
        }
    }
    common::ask("peer_batch.py", &json!(cases));
}

/// 2 pi integral P_k Q_j dmu by the library's rule.
fn products(
    rule: &[(f64, f64)],
    m: usize,
    left: (&Harmonics, &[usize]),
    right: (&Harmonics, &[usize]),
) -> Vec<Vec<f64>> {
    let mut sums = vec![vec![0.0; right.1.len()]; left.1.len()];
    for &(mu, w) in rule {
        let (mut p, mut q) = (Vec::new(), Vec::new());
        left.0.polar_parts(m, mu, &mut p);
        right.0.polar_parts(m, mu, &mut q);
        for (row, &k) in sums.iter_mut().zip(left.1) {
            for (sum, &j) in row.iter_mut().zip(right.1) {
                *sum += 2.0 * PI * w * p[k - m] * q[j - m];
            }
        }
    }
    sums
}

fn conversion_case(method: Method, name: &str, zone: Zone, order: usize) -> Value {
    let conversion = Conversion::new(method, zone, order).unwrap();
    let (sh, zonal) = (Harmonics::spherical(conversion.sh_order).unwrap(), Harmonics::zonal(zone, order).unwrap());
    let rule = zone_mu_angular(NODES, &zone);
    let blocks: Vec<Value> = conversion
        .blocks
        .iter()
        .map(|block| {
            let columns: Vec<usize> = (block.m..=order).collect();
            let (rows, columns) = ((&sh, &block.degrees[..]), (&zonal, &columns[..]));
            let matrix: Vec<Vec<f64>> = block.matrix.row_iter().map(|r| r.iter().copied().collect()).collect();
            json!({
                "m": block.m,
                "degrees": block.degrees,
                "matrix": matrix,
                "gram": products(&rule, block.m, rows, rows),
                "mixed": products(&rule, block.m, rows, columns),
            })
        })
        .collect();
    let matrix = match method {
        Method::Parity | Method::Tikhonov => CONVERSION,
        _ => UNITS * conversion.condition * f64::EPSILON,
    };
    let lambda = match conversion.strength {
        Strength::Curvature(lambda) => lambda,
        Strength::Exact => 0.0,
        strength => panic!("{strength:?} has no peer"),
    };
    json!({
        "name": format!("{} {name} order {order}", method.name()),
        "lambda": lambda,
        "a": zone.cos_min(),
        "b": zone.cos_max(),
        "order": order,
        "condition": conversion.condition,
        "blocks": blocks,
        "tolerance": { "gram": CONVERSION, "mixed": CONVERSION, "matrix": matrix },
    })
}

#[test]
fn parity_and_tikhonov_conversions_agree_with_fifty_digits() {
    let mut cases = Vec::new();
    for method in [Method::Parity, Method::Tikhonov] {
        for (name, zone) in zones() {
            cases.extend([4, 8].map(|order| conversion_case(method, name, zone, order)));
        }
    }
    common::ask("peer_conversion.py", &json!(cases));
}

/// Where the literal dual is well conditioned, its digits are lost to the condition number and to nothing else.
#[test]
fn literal_duals_of_the_full_zone_agree_as_far_as_their_condition_allows() {
    let (name, full) = zones()[1];
    let cases = [2, 3, 4].map(|order| conversion_case(Method::Thesis, name, full, order));
    common::ask("peer_conversion.py", &json!(cases));
}
