//! Time per point of many directions at once, beside sphericart, in one run: 10^5 directions into an array that exists.
//!
//! `ZONAL_PYTHON=target/venv/bin/python cargo bench --features peers --bench evaluation`; `bash tests/run.sh --no-run` makes
//! that Python. `fill` is what writing the array costs and nothing else: no program can be faster.
#![allow(missing_docs)]

#[path = "../tests/speed/mod.rs"]
mod speed;

use std::hint::black_box;

use speed::{ORDERS, POINTS, Peer, against, rounds, time};
use zonal::basis::Harmonics;

fn least(order: usize, mut call: impl FnMut()) -> f64 {
    (0..rounds(order)).map(|_| time(&mut call)).fold(f64::INFINITY, f64::min)
}

fn main() {
    let mut peer = Peer::start();
    println!("ns per point, the least of 15 calls and more; f64 on one core unless said otherwise");
    println!(
        "{:>5} {:>8} {:>10} {:>6} {:>8} {:>8} {:>9}",
        "order", "ours", "sphericart", "ratio", "fill", "f32", "all cores"
    );
    for order in ORDERS {
        let ([ours, theirs], mut out) = against(&mut peer, order);
        let sh = Harmonics::spherical(order).unwrap();
        let fill = least(order, || black_box(&mut out).fill(black_box(2.0)));
        let all = least(order, || sh.par_eval_many_into(&peer.directions, black_box(&mut out)));
        drop(out);
        let narrow: Vec<[f32; 3]> = peer.directions.iter().map(|d| d.vector().map(|c| c as f32).into()).collect();
        let mut out = vec![1.0f32; POINTS * sh.len()];
        let f32 = match sh.eval_many_f32_into(&narrow, &mut out) {
            Ok(()) => format!("{:.1}", least(order, || sh.eval_many_f32_into(&narrow, black_box(&mut out)).unwrap())),
            Err(_) => "refused".into(),
        };
        let ratio = ours / theirs;
        println!("{order:>5} {ours:>8.1} {theirs:>10.1} {ratio:>6.2} {fill:>8.1} {f32:>8} {all:>9.1}");
    }
}
