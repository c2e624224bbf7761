//! Slepian functions against 50-digit arithmetic: `bash tests/run.sh`, which sets ZONAL_PYTHON.
#![cfg(feature = "peers")]

mod common;

use std::time::Instant;

use serde_json::{Value, json};
use zonal::basis::{Family, Slepian};
use zonal::geometry::Zone;

/// Eigenvalues are shares of energy, 0..=1; a decomposition of at most 21 columns rounds them by some units of 1e-16.
const EIGENVALUES: f64 = 1e-12;
/// Smaller eigenvalues have no relative accuracy that anyone could use.
const ABOVE: f64 = 1e-10;
/// The largest order compared.
const TOP: usize = 20;

fn zones() -> [(&'static str, Zone); 2] {
    [("9..57", Zone::from_degrees(9.0, 57.0).unwrap()), ("9..90", Zone::from_degrees(9.0, 90.0).unwrap())]
}

#[test]
fn eigenvalues_agree_with_fifty_digits() {
    let mut cases = Vec::new();
    for (name, zone) in zones() {
        for (family, scale) in [(Family::All, 1.0), (Family::Odd, 2.0)] {
            for order in 1..=TOP {
                let blocks: Vec<Value> = Slepian::new(zone, family, order)
                    .unwrap()
                    .blocks
                    .iter()
                    .map(|b| json!({ "m": b.m, "degrees": b.degrees, "eigenvalues": b.eigenvalues.as_slice() }))
                    .collect();
                cases.push(json!({
                    "name": format!("{name} {family:?} L = {order}"),
                    "a": zone.cos_min(),
                    "b": zone.cos_max(),
                    "top": TOP,
                    "scale": scale,
                    "blocks": blocks,
                    "tolerance": EIGENVALUES,
                    "above": ABOVE,
                }));
            }
        }
    }
    common::ask("peer_slepian.py", &json!(cases));
}

/// Printed, not bounded: the machine may be slow.
#[test]
fn what_order_ten_takes() {
    for (name, zone) in zones() {
        let once = || {
            let start = Instant::now();
            Slepian::new(zone, Family::All, 10).unwrap();
            start.elapsed().as_secs_f64()
        };
        let best = (0..20).map(|_| once()).fold(f64::INFINITY, f64::min);
        println!(
            "Slepian functions of {name} at L = 10: {:.2} ms (pyshtools by a mask: 1.0 s, error 6e-3)",
            1e3 * best
        );
    }
}
