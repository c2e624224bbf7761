//! The prior against measured materials that it has not learned from: neural fits of the other half of the materials, and
//! the nine RGL files.
#![cfg(feature = "corpus")]

mod common;

use std::sync::Arc;

use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use zonal::basis::{Family, Harmonics, Method, Projection, Rule};
use zonal::convert::{PriorTable, Trial, population, ring};
use zonal::geometry::Zone;
use zonal::reflectance::{Brdf, EXITANT_DEG, NeuralBrdf, ZoneErrors, abc_materials, open};

const ORDERS: [usize; 5] = [2, 4, 6, 8, 10];
/// Noise of every coefficient, of z_00.
const NOISE: f64 = 0.01;
/// Draws of the noise that errors are averaged over.
const DRAWS: u64 = 3;
/// Errors outside the built zone, relative to the RMS over the hemisphere: medians, and the RGL files' 90th percentile.
const NEURAL: f64 = 0.085;
const RGL: f64 = 0.16;
const RGL_P90: f64 = 0.45;
/// Share of directions outside the zone that 68% intervals hold, all tested materials together.
const COVERAGE: std::ops::RangeInclusive<f64> = 0.60..=0.80;

/// The materials tested and how many of them are neural fits; `learned`: of the half that was learned from.
fn tested(learned: bool) -> (Vec<Arc<dyn Brdf>>, usize) {
    let table = PriorTable::built_in();
    let file = common::corpus().join("merl/nbrdf_merl_f32le.bin");
    let rows = abc_materials().iter().enumerate().filter(|(_, m)| table.materials.contains(&m.name) == learned);
    let mut all: Vec<Arc<dyn Brdf>> =
        rows.map(|(row, _)| Arc::new(NeuralBrdf::read(&file, row).unwrap()) as Arc<dyn Brdf>).collect();
    let neural = all.len();
    let mut files: Vec<_> =
        std::fs::read_dir(common::corpus().join("rgl")).unwrap().map(|f| f.unwrap().path()).collect();
    files.sort();
    all.extend(files.iter().map(|f| open(f.to_str().unwrap()).unwrap()));
    (all, neural)
}

/// Linear between the values on both sides.
fn quantile(mut values: Vec<f64>, q: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (values.len() - 1) as f64 * q;
    let (low, high) = (values[place.floor() as usize], values[place.ceil() as usize]);
    low + (high - low) * place.fract()
}

/// Mean over draws, material by material.
fn mean(draws: &[Vec<ZoneErrors>]) -> Vec<ZoneErrors> {
    let of =
        |i: usize, part: fn(&ZoneErrors) -> f64| draws.iter().map(|d| part(&d[i])).sum::<f64>() / draws.len() as f64;
    (0..draws[0].len()).map(|i| ZoneErrors { inside: of(i, |e| e.inside), outside: of(i, |e| e.outside) }).collect()
}

#[test]
fn materials_never_seen_are_found_outside_the_zone() {
    let table = PriorTable::built_in();
    let (materials, neural) = tested(false);
    let brdfs: Vec<&dyn Brdf> = materials.iter().map(|b| &**b).collect();
    let thetas = EXITANT_DEG.map(f64::to_radians);
    for (theta_max, built) in [(57.0, true), (90.0, false)] {
        let zone = Zone::from_degrees(9.0, theta_max).unwrap();
        let trial = Trial::new(zone, 10, &brdfs).unwrap();
        for order in ORDERS {
            let population = population(&table, zone, order, &thetas).unwrap();
            let (mut by_prior, mut by_truncated) = (Vec::new(), Vec::new());
            for seed in 0..DRAWS {
                let mut rng = Xoshiro256PlusPlus::seed_from_u64(100 * seed + order as u64);
                let spectra = trial.spectra(order, NOISE, &mut rng);
                by_prior.push(trial.prior(&population, &table.learned(), &spectra).unwrap());
                by_truncated.push(trial.linear(Method::Truncated, order, &spectra, Some(Rule::Auto)).unwrap());
            }
            let (prior, truncated) = (mean(&by_prior), mean(&by_truncated));
            let outside = |r: std::ops::Range<usize>, q| quantile(prior[r].iter().map(|e| e.outside).collect(), q);
            let inside =
                |e: &[ZoneErrors], r: std::ops::Range<usize>| quantile(e[r].iter().map(|e| e.inside).collect(), 0.5);
            let (rgl, all) = (neural..prior.len(), 0..neural);
            let (of_neural, of_rgl, p90) =
                (outside(all.clone(), 0.5), outside(rgl.clone(), 0.5), outside(rgl.clone(), 0.9));
            eprintln!(
                "9..{theta_max}, order {order}: outside, neural {of_neural:.3}, RGL {of_rgl:.3} (p90 {p90:.3}); inside, neural {:.3} \
                 (truncated {:.3}), RGL {:.3} ({:.3})",
                inside(&prior, all.clone()),
                inside(&truncated, all.clone()),
                inside(&prior, rgl.clone()),
                inside(&truncated, rgl.clone()),
            );
            for part in [all, rgl] {
                assert!(inside(&prior, part.clone()) <= inside(&truncated, part), "order {order}");
            }
            if built {
                assert!(of_neural <= NEURAL && of_rgl <= RGL && p90 <= RGL_P90, "order {order}");
            }
        }
    }
}

/// Intervals are of what the harmonics can hold. The factor in the table was found on the half that was learned from.
#[test]
fn error_bars_hold_the_truth_outside_the_zone() {
    let table = PriorTable::built_in();
    let zone = Zone::from_degrees(9.0, 57.0).unwrap();
    let thetas = EXITANT_DEG.map(f64::to_radians);
    for learned in [true, false] {
        let (materials, neural) = tested(learned);
        let brdfs: Vec<&dyn Brdf> = materials.iter().map(|b| &**b).collect();
        let trial = Trial::new(zone, 10, &brdfs).unwrap();
        let sh = Family::Odd.harmonics(table.sh_order).unwrap();
        let projection = Projection::new(zone, table.sh_order, table.zone_weight).unwrap();
        let any_order = Harmonics::zonal(zone, 0).unwrap();
        let truths: Vec<_> =
            thetas.iter().map(|t| ring(&brdfs, &any_order, &sh, &projection, table.zone_weight, *t).1).collect();
        let terms = projection.terms();
        for order in ORDERS {
            let population = population(&table, zone, order, &thetas).unwrap();
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(order as u64);
            let spectra = trial.spectra(order, NOISE, &mut rng);
            let covered = |truth| trial.coverage(&population, &table.learned(), &spectra, truth).unwrap();
            let mean = |c: &[[f64; 2]], part: usize| c.iter().map(|c| c[part]).sum::<f64>() / c.len() as f64;
            let held = covered(Some((&terms[..], &truths[..])));
            let of_f_cos = covered(None);
            let of_all = mean(&held, 1);
            eprintln!(
                "order {order}, {} half: outside {of_all:.3} (neural {:.3}, RGL {:.3}), inside {:.3}; of f_cos itself outside {:.3}",
                if learned { "learned" } else { "other" },
                mean(&held[..neural], 1),
                mean(&held[neural..], 1),
                mean(&held, 0),
                mean(&of_f_cos, 1),
            );
            assert!(COVERAGE.contains(&of_all), "order {order}: {of_all}");
        }
    }
}
