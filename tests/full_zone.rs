//! On the full zone no method does worse than the literal dual; on the built one the prior never does worse than a cut dual.

mod common;

use common::median;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use zonal::basis::{Conversion, Evidence, Method, Rule, Strength, size};
use zonal::convert::{PriorTable, Spectra, Trial, population};
use zonal::geometry::Zone;
use zonal::reflectance::{Brdf, EXITANT_DEG, ZoneErrors, abc_materials};

const ORDERS: [usize; 5] = [2, 4, 6, 8, 10];
/// Noise of every coefficient, of z_00.
const NOISE: f64 = 0.01;
const SEEDS: u64 = 2;
/// Rounding where two methods are one.
const SAME: f64 = 1e-9;

fn zone(theta_max: f64) -> Zone {
    Zone::from_degrees(9.0, theta_max).unwrap()
}

fn draws(trial: &Trial, order: usize) -> Vec<Spectra> {
    (0..SEEDS).map(|seed| trial.spectra(order, NOISE, &mut Xoshiro256PlusPlus::seed_from_u64(seed))).collect()
}

/// Means over draws, one per material: in the zone and outside.
fn means(draws: &[Spectra], errors: impl Fn(&Spectra) -> Vec<ZoneErrors>) -> Vec<[f64; 2]> {
    let mut sums = Vec::new();
    for spectra in draws {
        let errors = errors(spectra);
        sums.resize(errors.len(), [0.0; 2]);
        for (sum, e) in sums.iter_mut().zip(&errors) {
            sum[0] += e.inside / draws.len() as f64;
            sum[1] += e.outside / draws.len() as f64;
        }
    }
    sums
}

/// Medians over materials in the zone and outside.
fn medians(errors: &[[f64; 2]]) -> [f64; 2] {
    [0, 1].map(|part| median(errors.iter().map(|e| e[part]).collect()))
}

fn linear(trial: &Trial, method: Method, order: usize, draws: &[Spectra]) -> Vec<[f64; 2]> {
    means(draws, |spectra| trial.linear(method, order, spectra, Some(Rule::Auto)).unwrap())
}

/// Materials the prior has not learned from.
fn unknown(table: &PriorTable) -> Vec<&'static dyn Brdf> {
    let unknown = abc_materials().iter().filter(|m| !table.materials.contains(&m.name));
    unknown.map(|m| &m.brdf as &dyn Brdf).collect()
}

/// Where a zone says enough nothing is held back, so that six methods are three.
#[test]
fn on_the_full_zone_methods_fall_together() {
    for order in ORDERS {
        for (method, like) in
            [(Method::Truncated, Method::Thesis), (Method::Slepian, Method::Parity), (Method::Tikhonov, Method::Parity)]
        {
            let mut evidence = Evidence::new(method, zone(90.0), order).unwrap();
            evidence.add(&vec![1.0; size(order)], &vec![1e-4; size(order)]);
            let strength = evidence.strength(Rule::Auto);
            assert!(method != Method::Truncated || strength == Strength::Exact);
            let a = Conversion::with_strength(method, zone(90.0), order, strength).unwrap();
            let b = Conversion::new(like, zone(90.0), order).unwrap();
            assert_eq!(a.sh_order, b.sh_order);
            for (a, b) in a.blocks.iter().zip(&b.blocks) {
                let off = (&a.matrix - &b.matrix).amax() / b.matrix.amax();
                assert!(off < SAME, "{} order {order} m {}: {off:e}", method.name(), a.m);
            }
        }
    }
}

#[test]
fn on_the_full_zone_no_linear_method_is_worse_than_the_literal_dual() {
    let brdfs: Vec<&dyn Brdf> = abc_materials().iter().map(|m| &m.brdf as &dyn Brdf).collect();
    let trial = Trial::new(zone(90.0), 10, &brdfs).unwrap();
    for order in ORDERS {
        let draws = draws(&trial, order);
        let thesis = medians(&linear(&trial, Method::Thesis, order, &draws));
        for method in [Method::Parity, Method::Hsh] {
            let got = medians(&linear(&trial, method, order, &draws));
            let [inside, outside] = [0, 1].map(|part| got[part] / thesis[part]);
            println!(
                "full zone, order {order}, {}: {:.4} in the zone, {:.4} in the hole; of thesis' {inside:.3} and {outside:.3}",
                method.name(),
                got[0],
                got[1]
            );
            assert!(inside <= 1.0 && outside <= 1.0, "{inside} {outside}");
        }
    }
}

#[test]
fn the_prior_is_the_best_of_all() {
    let table = PriorTable::built_in();
    let thetas = EXITANT_DEG.map(f64::to_radians);
    for (theta_max, every) in [(90.0, 2), (57.0, 1)] {
        let materials: Vec<_> = unknown(&table).into_iter().step_by(every).collect();
        let trial = Trial::new(zone(theta_max), 10, &materials).unwrap();
        // The one that must not be beaten: the literal dual where it holds, a cut one where it does not.
        let other = if theta_max == 90.0 { Method::Thesis } else { Method::Truncated };
        for order in ORDERS {
            let draws = draws(&trial, order);
            let population = population(&table, zone(theta_max), order, &thetas).unwrap();
            let one = &draws[..1];
            let prior = means(one, |spectra| trial.prior(&population, &table.learned(), spectra).unwrap());
            let theirs = linear(&trial, other, order, one);
            let (a, b) = (medians(&prior), medians(&theirs));
            let worse = [0, 1].map(|part| prior.iter().zip(&theirs).filter(|(p, t)| p[part] > t[part]).count());
            println!(
                "9..{theta_max} deg, order {order}, prior: {:.3} in the zone, {:.3} outside; of {}'s {:.3} and {:.3}; worse with {} and {} of {} materials",
                a[0],
                a[1],
                other.name(),
                a[0] / b[0],
                a[1] / b[1],
                worse[0],
                worse[1],
                prior.len()
            );
            assert!(a[0] <= b[0] && a[1] <= b[1]);
            // On the built zone of no material at all.
            assert!(theta_max == 90.0 || worse[0] == 0, "{worse:?}");
        }
    }
}
