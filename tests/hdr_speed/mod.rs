//! Time of an HDR merge beside OpenCV's MergeRobertson, call by call, so that what else the machine does hits both.

use std::hint::black_box;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Instant;

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::json;
use zonal::radiometry::{ExposedRows, PixelMaps, Sensor};

pub const WIDTH: usize = 1024;
pub const HEIGHT: usize = 1024;
/// Colours of a pixel, side by side in a row.
pub const CHANNELS: usize = 3;
pub const EXPOSURES_S: [f64; 5] = [1.0 / 2000.0, 4.0 / 2000.0, 16.0 / 2000.0, 64.0 / 2000.0, 256.0 / 2000.0];
pub const SENSOR: Sensor = Sensor { gain_dn_per_e: 0.28, dark_noise_e: 10.9, black_level_dn: 14.7, limit_dn: 3850.0 };
/// Least and greatest rate of the scene, e-/s, even in the logarithm.
const RATES: [f64; 2] = [1e2, 5e6];

/// Frames of the same scene for both: 12 bits for us, the same shifted to 8 for the peer.
pub struct Scene {
    pub frames: [Vec<u16>; 5],
}

impl Scene {
    pub fn new(seed: u64) -> Self {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let decades = (RATES[1] / RATES[0]).ln();
        let rates: Vec<f64> =
            (0..WIDTH * HEIGHT * CHANNELS).map(|_| RATES[0] * (decades * rng.random::<f64>()).exp()).collect();
        let frames = EXPOSURES_S.map(|t| {
            let mut sample = |rate: &f64| {
                let noise = (12.0f64).sqrt() * (rng.random::<f64>() - 0.5) * (rate * t + 119.0).sqrt();
                (14.7 + 0.28 * (rate * t + noise)).round().clamp(0.0, 4095.0) as u16
            };
            rates.iter().map(&mut sample).collect()
        });
        Self { frames }
    }

    /// Milliseconds of one merge into arrays that exist.
    pub fn time(&self, rate: &mut [f32], variance: &mut [f32]) -> f64 {
        let width = WIDTH * CHANNELS;
        let frames: Vec<_> =
            self.frames.iter().zip(EXPOSURES_S).map(|(f, t)| ExposedRows::steady(f, width, t)).collect();
        let start = Instant::now();
        SENSOR.merge_into(width, black_box(&frames), &PixelMaps::default(), black_box(rate), black_box(variance));
        start.elapsed().as_secs_f64() * 1e3
    }
}

/// OpenCV in a process of its own, waiting for orders.
pub struct Peer {
    child: Child,
    orders: ChildStdin,
    answers: BufReader<ChildStdout>,
    _folder: tempfile::TempDir,
}

impl Peer {
    pub fn start(scene: &Scene) -> Self {
        let python = std::env::var_os("ZONAL_PYTHON").expect(
            "set ZONAL_PYTHON to a Python with tests/python/requirements.txt installed: `bash tests/run.sh` does",
        );
        let folder = tempfile::tempdir().unwrap();
        let (file, raw) = (folder.path().join("cases.json"), folder.path().join("frames.raw"));
        let bytes: Vec<u8> = scene.frames.iter().flatten().map(|dn| (dn >> 4) as u8).collect();
        std::fs::write(&raw, bytes).unwrap();
        let case = json!({ "exposures_s": EXPOSURES_S, "frames": raw, "width": WIDTH, "height": HEIGHT });
        std::fs::write(&file, case.to_string()).unwrap();
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/bench_merge.py");
        let mut child = Command::new(python)
            .arg("-B")
            .args([&script, &file])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("ZONAL_PYTHON starts");
        let (orders, answers) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
        Self { child, orders, answers, _folder: folder }
    }

    /// Milliseconds of one merge.
    pub fn time(&mut self) -> f64 {
        writeln!(self.orders, "go").expect("the peer listens");
        let mut answer = String::new();
        self.answers.read_line(&mut answer).unwrap();
        answer.trim().parse().expect("what the peer says instead of a time is above")
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// Median milliseconds of us and of the peer over `rounds` calls in turn.
pub fn against(scene: &Scene, peer: &mut Peer, rounds: usize) -> [f64; 2] {
    let pixels = WIDTH * HEIGHT * CHANNELS;
    let (mut rate, mut variance) = (vec![1.0; pixels], vec![1.0; pixels]);
    scene.time(&mut rate, &mut variance);
    let mut times = [vec![], vec![]];
    for _ in 0..rounds {
        times[0].push(scene.time(&mut rate, &mut variance));
        times[1].push(peer.time());
    }
    times.map(|mut t| {
        t.sort_by(f64::total_cmp);
        t[t.len() / 2]
    })
}
