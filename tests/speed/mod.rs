//! Time per point beside sphericart, round by round, so that what else the machine does hits both.

use std::hint::black_box;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Instant;

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::json;
use zonal::basis::{Harmonics, MAX_ORDER, size};
use zonal::geometry::{Direction, Sample};

pub const ORDERS: [usize; 4] = [6, 10, 20, 50];
/// Directions of one call.
pub const POINTS: usize = 100_000;
/// Two f64 programs, relative to the largest function in a direction.
const SAME: f64 = 1e-12;
/// Every so many directions values are compared.
const STRIDE: usize = 997;

/// sphericart in a process of its own, waiting for orders.
pub struct Peer {
    pub directions: Vec<Direction<Sample>>,
    child: Child,
    orders: ChildStdin,
    answers: BufReader<ChildStdout>,
    _folder: tempfile::TempDir,
}

impl Peer {
    /// Starts the peer with random directions of a fixed seed and our values in some of them.
    pub fn start() -> Self {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(6);
        let directions: Vec<Direction<Sample>> = (0..POINTS)
            .map(|_| Direction::from_mu_phi(rng.random_range(-1.0..1.0), rng.random_range(-3.0..3.0)))
            .collect();
        let values = ORDERS.map(|order| {
            let sh = Harmonics::spherical(order).unwrap();
            let some: Vec<_> = directions.iter().copied().step_by(STRIDE).collect();
            let mut out = vec![0.0; some.len() * sh.len()];
            sh.eval_many_into(&some, &mut out);
            let rows = out.chunks_exact(sh.len()).enumerate().map(|(i, row)| json!([i * STRIDE, row]));
            (order.to_string(), rows.collect::<Vec<_>>().into())
        });
        let values: serde_json::Map<_, _> = values.into_iter().collect();
        let vectors: Vec<[f64; 3]> = directions.iter().map(|d| d.vector().into()).collect();
        let python = std::env::var_os("ZONAL_PYTHON").expect(
            "set ZONAL_PYTHON to a Python with tests/python/requirements.txt installed: `bash tests/run.sh` does",
        );
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("cases.json");
        std::fs::write(&file, json!({ "directions": vectors, "values": values, "tolerance": SAME }).to_string())
            .unwrap();
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/bench_sphericart.py");
        let mut child = Command::new(python)
            .arg("-B")
            .args([&script, &file])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("ZONAL_PYTHON starts");
        let (orders, answers) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
        Self { directions, child, orders, answers, _folder: folder }
    }

    /// Nanoseconds per point of one call of the peer.
    pub fn time(&mut self, order: usize) -> f64 {
        writeln!(self.orders, "{order}").expect("the peer listens");
        let mut answer = String::new();
        self.answers.read_line(&mut answer).unwrap();
        answer.trim().parse().expect("the peer's values are ours: what it says is above")
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// Nanoseconds per point of one call.
pub fn time(call: impl FnOnce()) -> f64 {
    let start = Instant::now();
    call();
    start.elapsed().as_secs_f64() * 1e9 / POINTS as f64
}

/// Calls of one order: more of the short ones, which a busy machine disturbs most.
pub fn rounds(order: usize) -> usize {
    (15 * size(MAX_ORDER) / size(order)).min(200)
}

/// The least nanoseconds per point of us and of the peer over some rounds in turn, and our array.
pub fn against(peer: &mut Peer, order: usize) -> ([f64; 2], Vec<f64>) {
    let sh = Harmonics::spherical(order).unwrap();
    let mut out = vec![1.0; POINTS * sh.len()];
    let mut least = [f64::INFINITY; 2];
    for _ in 0..rounds(order) {
        least[0] = least[0].min(time(|| sh.eval_many_into(&peer.directions, black_box(&mut out))));
        least[1] = least[1].min(peer.time(order));
    }
    (least, out)
}
