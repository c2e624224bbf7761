//! Time of an HDR merge of 5 exposures x 1 Mpx x 3 channels, beside OpenCV's MergeRobertson, in one run.
//!
//! `ZONAL_PYTHON=target/venv/bin/python cargo bench --features peers --bench hdr`; `bash tests/run.sh --no-run` makes that
//! Python.
#![allow(missing_docs)]

#[path = "../tests/hdr_speed/mod.rs"]
mod hdr_speed;

const ROUNDS: usize = 41;

fn main() {
    let scene = hdr_speed::Scene::new(7);
    let mut peer = hdr_speed::Peer::start(&scene);
    let [ours, theirs] = hdr_speed::against(&scene, &mut peer, ROUNDS);
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let pixels = hdr_speed::WIDTH * hdr_speed::HEIGHT * hdr_speed::CHANNELS;
    let (mut rate, mut variance) = (vec![1.0; pixels], vec![1.0; pixels]);
    let single = one.install(|| (0..9).map(|_| scene.time(&mut rate, &mut variance)).fold(f64::INFINITY, f64::min));
    println!("medians of {ROUNDS} calls in turn, ms, all cores; 15.7 million samples");
    println!("{:>8} {:>8} {:>6} {:>9}", "ours", "OpenCV", "ratio", "one core");
    println!("{ours:>8.1} {theirs:>8.1} {:>6.2} {single:>9.1}", ours / theirs);
}
