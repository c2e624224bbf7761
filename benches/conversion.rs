//! How long a whole measurement takes to convert, with standard errors: 8,192 exitant directions, RGB, in memory.
//!
//! `cargo bench --bench conversion [-- ORDER]`: fastest of some rounds for each method, in milliseconds and over the time of
//! `parity`. Building the map is timed apart; a second map of the same zone and order finds its decompositions kept.
#![allow(missing_docs)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::time::Instant;

use zonal::basis::{Method, Rule};
use zonal::convert::{PriorTable, by_population, linear, population, tuned};
use zonal::fit::Observations;
use zonal::geometry::{ExitantGrid, Zone};
use zonal::reflectance::open;

const ROUNDS: usize = 7;

fn fastest(mut work: impl FnMut()) -> f64 {
    (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64() * 1e3
        })
        .fold(f64::INFINITY, f64::min)
}

fn main() {
    let order = std::env::args().filter_map(|a| a.parse().ok()).next().unwrap_or(10);
    let zone = Zone::from_degrees(9.0, 57.0).unwrap();
    let grid = ExitantGrid::new(zone, 64, 128);
    let brdf = open("red-plastic").unwrap();
    let measured = common::noisy(&common::exact_coefficients(&*brdf, grid, order, zone), 0.01, 1);
    println!("order {order}, {} exitant directions, RGB; fastest of {ROUNDS} rounds", grid.len());
    println!("{:>10} {:>14} {:>14} {:>10}", "method", "map ms", "conversion ms", "/ parity");
    let conversion = tuned(&measured, Method::Parity, Rule::Auto).unwrap();
    let parity = fastest(|| drop(linear(&measured, &conversion)));
    for method in Method::ALL {
        let strength = tuned(&measured, method, Rule::Gcv);
        let Ok(conversion) = strength else {
            println!("{:>10} {}", method.name(), strength.unwrap_err());
            continue;
        };
        let map = fastest(|| drop(tuned(&measured, method, Rule::Auto)));
        let apply = fastest(|| drop(linear(&measured, &conversion)));
        println!("{:>10} {map:>14.1} {apply:>14.1} {:>10.2}", method.name(), apply / parity);
    }
    let table = PriorTable::built_in();
    let thetas: Vec<f64> = (0..grid.rings()).map(|r| grid.theta(r)).collect();
    let map = fastest(|| drop(population(&table, zone, order, &thetas)));
    let population = population(&table, zone, order, &thetas).unwrap();
    let folded = Observations::folded(&measured);
    let apply = fastest(|| drop(by_population(&measured, &folded, &population, &table)));
    println!("{:>10} {map:>14.1} {apply:>14.1} {:>10.2}", "prior", apply / parity);
}
