//! Standard errors are true: over many draws of noise, one of them holds the value without noise 68% of the time.

mod common;

use nalgebra::DMatrix;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use zonal::basis::{Conversion, Family, Harmonics, Method, size};
use zonal::convert::{PriorTable, Trial, population, ring_mean};
use zonal::geometry::quadrature::zone_product;
use zonal::geometry::{Direction, Zone};
use zonal::reflectance::{Brdf, EXITANT_DEG, abc_materials};

/// 68.3%, and three standard errors of a share over 1,000 draws as they add up over 5 materials and many directions.
const COVERAGE: std::ops::Range<f64> = 0.66..0.70;
const DRAWS: u64 = 1000;
/// The prior learns anew from each of these draws.
const DRAWS_ANEW: u64 = 24;
/// From mirror-like to matte.
const MATERIALS: [&str; 5] = ["chrome", "violet-acrylic", "alum-bronze", "gold-metallic-paint", "beige-fabric"];
/// Noise of a coefficient, of z_00, times 0.5 to 1.5.
const NOISE: f64 = 0.01;
/// 25 deg among the exitant directions of a trial.
const EXITANT: usize = 1;

/// Exact spectra of the materials, with variances that differ between coefficients.
fn spectra(zone: Zone, order: usize) -> Vec<(Vec<f64>, Vec<f64>)> {
    let brdf = |name: &&str| &abc_materials().iter().find(|m| m.name == **name).unwrap().brdf as &dyn Brdf;
    let trial = Trial::new(zone, order, &MATERIALS.iter().map(brdf).collect::<Vec<_>>()).unwrap();
    let exact = trial.spectra(order, 0.0, &mut Xoshiro256PlusPlus::seed_from_u64(0));
    let with_variance = |(z, _): &(Vec<f64>, Vec<f64>)| {
        let sigma = |k: usize| NOISE * z[0] * (0.5 + (k * 7 % 11) as f64 / 10.0);
        (z.clone(), (0..z.len()).map(|k| sigma(k).powi(2)).collect())
    };
    exact[EXITANT].iter().map(with_variance).collect()
}

fn noisy(z: &[f64], variance: &[f64], seed: u64) -> Vec<f64> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut unit = || -> f64 { StandardNormal.sample(&mut rng) };
    z.iter().zip(variance).map(|(z, v)| z + v.sqrt() * unit()).collect()
}

/// Counts of values held and of all.
#[derive(Default, Clone, Copy)]
struct Count([u64; 2]);

impl Count {
    fn add(&mut self, off: f64, sigma: f64) {
        self.0[0] += u64::from(off.abs() <= sigma);
        self.0[1] += 1;
    }
    fn plus(self, other: Self) -> Self {
        Self([self.0[0] + other.0[0], self.0[1] + other.0[1]])
    }
    fn share(self) -> f64 {
        self.0[0] as f64 / self.0[1] as f64
    }
    fn check(self, what: &str) {
        println!("{what}: {:.2}%", 100.0 * self.share());
        assert!(COVERAGE.contains(&self.share()), "{what}: {}", self.share());
    }
}

/// Sums over materials and draws.
fn count<const N: usize>(
    spectra: &[(Vec<f64>, Vec<f64>)],
    draws: u64,
    one: impl Fn(&mut [Count; N], usize, &[f64]) + Sync,
) -> [Count; N] {
    (0..spectra.len() as u64 * draws)
        .into_par_iter()
        .fold(
            || [Count::default(); N],
            |mut counts, i| {
                let material = (i / draws) as usize;
                let (z, variance) = &spectra[material];
                one(&mut counts, material, &noisy(z, variance, i));
                counts
            },
        )
        .reduce(|| [Count::default(); N], |a, b| std::array::from_fn(|i| a[i].plus(b[i])))
}

/// Directions in the zone and the values of `functions` there: a row for each.
fn table(zone: &Zone, functions: &Harmonics) -> (Vec<Direction>, DMatrix<f64>) {
    let directions: Vec<Direction> =
        zone_product(zone, 5, 8).into_iter().map(|(d, _)| Direction::from_angles(d.theta(), d.phi())).collect();
    let rows: Vec<_> = directions.iter().map(|d| nalgebra::RowDVector::from_vec(functions.eval(d))).collect();
    (directions, DMatrix::from_rows(&rows))
}

fn times(table: &DMatrix<f64>, y: &[f64]) -> Vec<f64> {
    (table * nalgebra::DVector::from_column_slice(y)).as_slice().to_vec()
}

/// Standard error of each row of `gains` z.
fn sigmas(gains: &DMatrix<f64>, variance: &[f64]) -> Vec<f64> {
    let squares = gains.map(|g| g * g);
    times(&squares, variance).into_iter().map(f64::sqrt).collect()
}

#[test]
fn those_of_zonal_series_and_linear_methods() {
    let zone = Zone::from_degrees(9.0, 57.0).unwrap();
    for order in [4, 8] {
        let spectra = spectra(zone, order);
        let (_, zonal) = table(&zone, &Harmonics::zonal(zone, order).unwrap());
        let of_zonal: Vec<_> = spectra.iter().map(|(z, v)| (times(&zonal, z), sigmas(&zonal, v))).collect();
        let [counted] = count(&spectra, DRAWS, |[counts], material, z| {
            let (want, sigma) = &of_zonal[material];
            times(&zonal, z).iter().zip(want).zip(sigma).for_each(|((f, w), s)| counts.add(f - w, *s));
        });
        counted.check(&format!("order {order}, zonal series"));
        for method in Method::ALL {
            let c = Conversion::new(method, zone, order).unwrap();
            let (_, functions) = table(&zone, &c.harmonics());
            // Columns of C from unit vectors.
            let columns: Vec<_> = (0..size(order))
                .map(|k| {
                    let unit: Vec<f64> = (0..size(order)).map(|i| f64::from(u8::from(i == k))).collect();
                    nalgebra::DVector::from_vec(c.apply(&unit))
                })
                .collect();
            let gains = &functions * DMatrix::from_columns(&columns);
            let of_method: Vec<_> =
                spectra.iter().map(|(z, v)| (c.estimate(z, v).unwrap(), times(&gains, z), sigmas(&gains, v))).collect();
            let counted = count(&spectra, DRAWS, |[coefficients, values], material, z| {
                let (exact, f, f_sigma) = &of_method[material];
                let estimate = c.estimate(z, &spectra[material].1).unwrap();
                for ((y, want), sigma) in estimate.y.iter().zip(&exact.y).zip(&estimate.sigma) {
                    if *sigma > 0.0 {
                        coefficients.add(y - want, *sigma);
                    }
                }
                times(&functions, &estimate.y).iter().zip(f).zip(f_sigma).for_each(|((f, w), s)| values.add(f - w, *s));
            });
            counted[0].check(&format!("order {order}, {}, coefficients", method.name()));
            counted[1].check(&format!("order {order}, {}, f_cos in the zone", method.name()));
        }
    }
}

/// The noise's part of the prior's error, with the map held; printed too with the map learned anew from each draw, where the
/// mixture of members moves with the noise and the model's part has to hold that as well.
#[test]
fn the_noise_part_of_the_prior() {
    let zone = Zone::from_degrees(9.0, 57.0).unwrap();
    let table_of_prior = PriorTable::built_in();
    let learned = table_of_prior.learned();
    let (_, functions) = table(&zone, &Family::Odd.harmonics(table_of_prior.sh_order).unwrap());
    for order in [4, 8] {
        let spectra = spectra(zone, order);
        let population = population(&table_of_prior, zone, order, &[EXITANT_DEG[EXITANT].to_radians()]).unwrap();
        let learn =
            |z: &[f64], v: &[f64]| population.maps(&[ring_mean(&population, z, v)], &learned).unwrap().remove(0);
        let maps: Vec<_> = spectra.iter().map(|(z, v)| learn(z, v)).collect();
        let sigmas_of = |map: &zonal::basis::RingMap, v: &[f64]| -> Vec<[f64; 2]> {
            let row = |r: nalgebra::RowDVector<f64>| map.variance_at(r.as_slice(), v);
            functions
                .row_iter()
                .map(|r| row(r.into_owned()))
                .map(|[model, noise]| [noise.sqrt(), (model + noise).sqrt()])
                .collect()
        };
        let exact: Vec<_> = maps
            .iter()
            .zip(&spectra)
            .map(|(map, (z, v))| (times(&functions, &map.estimate(z, v, 0.0).unwrap().y), sigmas_of(map, v)))
            .collect();
        let [held] = count(&spectra, DRAWS, |[held], material, z| {
            let (want, sigma) = &exact[material];
            let f = times(&functions, &maps[material].estimate(z, &spectra[material].1, 0.0).unwrap().y);
            f.iter().zip(want).zip(sigma).for_each(|((f, w), s)| held.add(f - w, s[0]));
        });
        held.check(&format!("order {order}, prior with its map held, f_cos in the zone"));
        let [noise, all] = count(&spectra, DRAWS_ANEW, |[noise, all], material, z| {
            let (want, _) = &exact[material];
            let v = &spectra[material].1;
            let map = learn(z, v);
            let f = times(&functions, &map.estimate(z, v, 0.0).unwrap().y);
            for ((f, w), s) in f.iter().zip(want).zip(sigmas_of(&map, v)) {
                noise.add(f - w, s[0]);
                all.add(f - w, s[1]);
            }
        });
        println!(
            "order {order}, prior learned anew: {:.1}% by the noise's part alone, {:.1}% with the model's",
            100.0 * noise.share(),
            100.0 * all.share()
        );
    }
}
