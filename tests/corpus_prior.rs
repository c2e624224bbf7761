//! The prior against measured materials it has not learned from.
#![cfg(feature = "corpus")]

mod common;

use std::sync::Arc;

use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use zonal::basis::{Method, Rule};
use zonal::convert::{PriorTable, Trial, population};
use zonal::geometry::Zone;
use zonal::reflectance::{Brdf, EXITANT_DEG, NeuralBrdf, ZoneErrors, abc_materials, open};

fn at(mut values: Vec<f64>, quantile: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * quantile).round() as usize]
}

#[test]
fn explore() {
    let table = PriorTable::built_in();
    let learned = table.learned();
    let mut tested: Vec<Arc<dyn Brdf>> = Vec::new();
    for (row, m) in abc_materials().iter().enumerate() {
        if table.materials.contains(&m.name) == std::env::var("HALF").is_ok() {
            tested.push(Arc::new(NeuralBrdf::read(common::corpus().join("merl/nbrdf_merl_f32le.bin"), row).unwrap()));
        }
    }
    let neural = tested.len();
    let mut files: Vec<_> =
        std::fs::read_dir(common::corpus().join("rgl")).unwrap().map(|f| f.unwrap().path()).collect();
    files.sort();
    tested.extend(files.iter().map(|f| open(f.to_str().unwrap()).unwrap()));
    let brdfs: Vec<&dyn Brdf> = tested.iter().map(|b| &**b).collect();
    for (theta_min, theta_max) in [(9.0, 57.0), (9.0, 90.0)] {
        let zone = Zone::from_degrees(theta_min, theta_max).unwrap();
        let t0 = std::time::Instant::now();
        let trial = Trial::new(zone, 10, &brdfs).unwrap();
        eprintln!("trial {:.2} s", t0.elapsed().as_secs_f64());
        for order in [2, 4, 6, 8, 10] {
            for method in Method::ALL {
                if let Ok(c) = zonal::basis::Conversion::new(method, zone, order) {
                    eprintln!(
                        "{theta_max} {order} {} sh {} gains {:.2e} {:.2e}",
                        method.name(),
                        c.sh_order,
                        c.noise_gain_in,
                        c.noise_gain_out
                    );
                }
            }
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(order as u64);
            let spectra = trial.spectra(order, 0.01, &mut rng);
            let say = |name: &str, e: Vec<ZoneErrors>| {
                let part = |r: std::ops::Range<usize>, out: bool, q| {
                    at(e[r].iter().map(|e| if out { e.outside } else { e.inside }).collect(), q)
                };
                let all = e.len();
                eprintln!(
                    "{theta_max} order {order} {name:>12}: neural out {:.3} p90 {:.3} in {:.3}; rgl out {:.3} p90 {:.3} in {:.3}",
                    part(0..neural, true, 0.5),
                    part(0..neural, true, 0.9),
                    part(0..neural, false, 0.5),
                    part(neural..all, true, 0.5),
                    part(neural..all, true, 0.9),
                    part(neural..all, false, 0.5)
                );
            };
            for method in Method::ALL {
                for rule in
                    if method.is_tuned() { &[Rule::Discrepancy, Rule::Gcv, Rule::Auto][..] } else { &[Rule::Gcv] }
                {
                    say(
                        &format!("{}-{rule:?}", method.name()),
                        trial.linear(method, order, &spectra, Some(*rule)).unwrap(),
                    );
                }
            }
            let t0 = std::time::Instant::now();
            let thetas = EXITANT_DEG.map(f64::to_radians);
            let population = population(&table, zone, order, &thetas).unwrap();
            let t1 = t0.elapsed().as_secs_f64();
            say("prior", trial.prior(&population, &learned, &spectra).unwrap());
            let sh = zonal::basis::Family::Odd.harmonics(table.sh_order).unwrap();
            let projection = zonal::basis::Projection::new(zone, table.sh_order, table.zone_weight).unwrap();
            let zonal = zonal::basis::Harmonics::zonal(zone, order).unwrap();
            let truths: Vec<_> = thetas
                .iter()
                .map(|t| zonal::convert::ring(&brdfs, &zonal, &sh, &projection, table.zone_weight, *t).1)
                .collect();
            for (name, p) in [("projected", Some((&projection.terms()[..], &truths[..]))), ("f_cos", None)] {
                let c = trial.coverage(&population, &learned, &spectra, p).unwrap();
                let mean = |r: std::ops::Range<usize>, o: usize| {
                    c[r.clone()].iter().map(|c| c[o]).sum::<f64>() / r.len() as f64
                };
                eprintln!(
                    "{theta_max} {order} coverage of {name}: neural out {:.3} in {:.3} rgl out {:.3} in {:.3}",
                    mean(0..neural, 1),
                    mean(0..neural, 0),
                    mean(neural..c.len(), 1),
                    mean(neural..c.len(), 0)
                );
            }
            eprintln!("{t1:.2} s population, {:.2} s all", t0.elapsed().as_secs_f64());
        }
    }
}
