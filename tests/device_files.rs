//! A run with a camera and a projector that are other programs: here both are played by the simulated rig.

mod common;
#[allow(dead_code)]
mod program;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::thread;
use std::time::{Duration, Instant};

use tempfile::TempDir;
use zonal::calibrate::{CalibrationSet, Devices, Origin};
use zonal::capture::Bench;
use zonal::devices::{DeviceBench, DevicesFile, Operator, first_light};
use zonal::optics::Rig;
use zonal::patterns::{Exitant, Pattern, Plan, Primary};
use zonal::reduce::Coefficients;
use zonal::reflectance::open;
use zonal::twin::{TwinBench, TwinConfig};

const MATERIAL: &str = "red-plastic";
/// The same frames through other noise: means over a plane agree to this share of the constant's.
const AGREEMENT: f64 = 0.01;

/// The simulated rig computes its first frame for seconds where other tests run as well.
const TIMEOUT_S: f64 = 15.0;

static CALIBRATION: OnceLock<CalibrationSet> = OnceLock::new();

/// A reduced rig with calibrations, plan and devices file.
struct Place {
    folder: TempDir,
    rig: Rig,
    plan: Plan,
    config: TwinConfig,
}

impl Place {
    fn new(order: usize) -> Self {
        let rig = common::coarse(common::rig("ghosh-2007-built"), 4);
        let plan = Plan { exitant: Exitant { rings: 6, sectors: 12 }, ..Plan::of_order(order) };
        let config = TwinConfig::named("pinhole", 3).unwrap();
        let place = Self { folder: tempfile::tempdir().unwrap(), rig, plan, config };
        fs::write(place.path("rig.toml"), place.rig.to_toml()).unwrap();
        fs::write(place.path("plan.toml"), place.plan.to_toml()).unwrap();
        fs::write(place.path("devices.toml"), place.devices(TIMEOUT_S)).unwrap();
        // As if they had been made on these devices.
        let origin = Origin { date: jiff::Timestamp::now(), devices: Devices::Real };
        let set = CALIBRATION.get_or_init(|| common::calibrated(&place.rig, &place.config)).clone();
        set.made(&place.rig, &origin).write(&place.path("cal"), &place.rig).unwrap();
        place
    }

    fn devices(&self, timeout_s: f64) -> String {
        let (c, p) = (&self.rig.camera, &self.rig.projector);
        format!(
            "format = 1\n[camera]\ndriver = \"files\"\nfolder = {:?}\nwidth_px = {}\nheight_px = {}\ntimeout_s = {timeout_s}\n\
             [projector]\ndriver = \"files\"\nfolder = {:?}\nwidth_px = {}\nheight_px = {}\nrefresh_hz = {}\nsettle_s = 0.0\n",
            self.path("frames"),
            c.width_px,
            c.height_px,
            self.path("patterns"),
            p.width_px,
            p.height_px,
            p.refresh_hz
        )
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn measure(&self, out: &str, more: &[&str]) -> Child {
        let mut command = Command::new(env!("CARGO_BIN_EXE_zonal"));
        command.arg("measure").args([self.path("rig.toml"), self.path("plan.toml")]);
        command.arg("--out").arg(self.path(out)).arg("--yes").args(more);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    }
}

/// The camera's and the projector's program.
struct Player {
    bench: TwinBench,
    frames: PathBuf,
    patterns: PathBuf,
    /// Lines of the request file that are done.
    done: usize,
    /// Files saved in all.
    saved: usize,
}

impl Player {
    fn new(place: &Place) -> Self {
        let bench = TwinBench::new(&place.rig, place.config.clone(), open(MATERIAL).unwrap());
        // What an earlier program asked for is no concern of this one; the next must not have asked yet.
        let (frames, patterns) = (place.path("frames"), place.path("patterns"));
        let _ = fs::remove_file(frames.join("shots.csv"));
        let saved = fs::read_dir(&frames).map_or(0, |entries| entries.count());
        Self { bench, frames, patterns, done: 0, saved }
    }

    /// Takes what is asked for until `ended` says so.
    fn play(&mut self, mut ended: impl FnMut() -> bool) {
        let (mut camera, mut projector) = (self.bench.camera().open().unwrap(), self.bench.projector().open().unwrap());
        camera.start(0).unwrap();
        let mut sequence = Vec::new();
        while !ended() {
            let text = fs::read_to_string(self.frames.join("shots.csv")).unwrap_or_default();
            let asked: Vec<&str> = text.split_inclusive('\n').filter(|l| l.ends_with('\n')).skip(1).collect();
            let Some(line) = asked.get(self.done) else {
                if asked.len() < self.done {
                    self.done = 0;
                }
                thread::sleep(Duration::from_millis(1));
                continue;
            };
            self.done += 1;
            let exposure_s: f64 = line.split(',').nth(1).unwrap().parse().unwrap();
            let shown = pattern(&self.patterns.join("current.png"));
            if !sequence.contains(&shown) {
                sequence = (0..)
                    .map(|i| self.patterns.join(format!("frame-{i:05}.png")))
                    .take_while(|p| p.exists())
                    .map(|p| pattern(&p))
                    .collect();
                projector.load(&sequence).unwrap();
            }
            let index = sequence.iter().position(|p| *p == shown).unwrap();
            camera.set_exposure(exposure_s).unwrap();
            let clock = self.bench.clock();
            let lit_s = projector.show(index).unwrap() + 1.0;
            clock.sleep_until_s(lit_s);
            camera.trigger().unwrap();
            let frame = camera.receive(10.0).unwrap().unwrap();
            self.save(&frame.samples, frame.width, frame.height);
        }
    }

    /// Saves by turns as PNG and PGM, in two pieces as slow programs do.
    fn save(&mut self, samples: &[u16], width: usize, height: usize) {
        self.saved += 1;
        let name = format!("IMG_{:05}", self.saved);
        let bytes = if self.saved.is_multiple_of(2) {
            let image = image::ImageBuffer::<image::Luma<u16>, _>::from_raw(width as u32, height as u32, samples);
            let mut bytes = std::io::Cursor::new(Vec::new());
            image.unwrap().write_to(&mut bytes, image::ImageFormat::Png).unwrap();
            bytes.into_inner()
        } else {
            let mut bytes = format!("P5\n{width} {height}\n65535\n").into_bytes();
            bytes.extend(samples.iter().flat_map(|s| s.to_be_bytes()));
            bytes
        };
        let path = self.frames.join(format!("{name}.{}", if self.saved.is_multiple_of(2) { "PNG" } else { "pgm" }));
        fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        fs::write(self.frames.join(format!("{name}.jpg")), "no frame").unwrap();
        fs::write(&path, &bytes).unwrap();
    }
}

fn pattern(path: &Path) -> Pattern {
    let image = image::open(path).unwrap().into_luma8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    Pattern { width, height, codes: image.into_raw().into(), light: Primary::White }
}

fn ended(child: &mut Child) -> bool {
    child.try_wait().unwrap().is_some()
}

fn means(run: &Path) -> Vec<f64> {
    let c = Coefficients::read(&run.join("coefficients.exr")).unwrap();
    c.values
        .chunks(c.grid.len())
        .map(|plane| plane.iter().map(|&x| f64::from(x)).sum::<f64>() / plane.len() as f64)
        .collect()
}

/// The run must be what the simulated rig measures when it is asked directly.
fn as_measured_directly(place: &Place, run: &Path) {
    let set = CalibrationSet::read(&place.path("cal"), &place.rig).unwrap();
    let direct = common::run(&place.rig, &place.plan, &place.config, &set, open(MATERIAL).unwrap());
    let c = &direct.coefficients;
    let expected = c.values.chunks(c.grid.len()).map(|p| p.iter().map(|&x| f64::from(x)).sum::<f64>() / p.len() as f64);
    let expected: Vec<f64> = expected.collect();
    let found = means(run);
    assert_eq!(found.len(), expected.len());
    for (k, (f, e)) in found.iter().zip(&expected).enumerate() {
        assert!((f - e).abs() <= AGREEMENT * expected[k % 3].abs(), "plane {k}: {f} instead of {e}");
    }
}

#[test]
fn a_tethered_camera_takes_a_whole_run() {
    let place = Place::new(2);
    let mut player = Player::new(&place);
    let mut child = place.measure(
        "run",
        &[
            "--devices",
            place.path("devices.toml").to_str().unwrap(),
            "--calibration",
            place.path("cal").to_str().unwrap(),
        ],
    );
    player.play(|| ended(&mut child));
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    as_measured_directly(&place, &place.path("run"));
    let kept = DevicesFile::read(&place.path("run/devices.toml")).unwrap();
    assert_eq!(kept, DevicesFile::read(&place.path("devices.toml")).unwrap());
    let record = fs::read_to_string(place.path("run/run.json")).unwrap();
    let record: serde_json::Value = serde_json::from_str(&record).unwrap();
    assert!(record["simulation"].is_null(), "{record}");
    let shown = fs::read_to_string(place.path("patterns/shown.csv")).unwrap();
    assert!(shown.starts_with("request,frame,file,asked_s\n1,0,frame-00000.png,"), "{shown}");
}

#[test]
fn a_camera_that_stops_answering_ends_the_run_which_goes_on_later() {
    let place = Place::new(0);
    let (devices, cal) = (place.path("devices.toml"), place.path("cal"));
    let mut player = Player::new(&place);
    let mut child =
        place.measure("run", &["--devices", devices.to_str().unwrap(), "--calibration", cal.to_str().unwrap()]);
    // All of making ready and a few frames.
    let journal = place.path("run/journal.jsonl");
    let frames = || fs::read_to_string(&journal).unwrap_or_default().matches("\"frame\"").count();
    player.play(|| frames() >= 2 || ended(&mut child));
    let output = child.wait_with_output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{error}");
    assert!(error.contains("no new .png or .pgm") && error.contains("resume"), "{error}");
    let mut player = Player::new(&place);
    let mut child = place.measure("run", &["--resume"]);
    player.play(|| ended(&mut child));
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    as_measured_directly(&place, &place.path("run"));
}

#[test]
fn frames_of_another_kind_are_refused() {
    let place = Place::new(0);
    for (bytes, said) in
        [(&b"\xFF\xD8\xFF"[..], "neither PNG nor binary PGM"), (b"P5 4 4 255\n0123456789abcdef", "delivers 4 x 4 px")]
    {
        let _ = fs::remove_dir_all(place.path("frames"));
        let _ = fs::remove_dir_all(place.path("run"));
        let (devices, cal) = (place.path("devices.toml"), place.path("cal"));
        let mut child =
            place.measure("run", &["--devices", devices.to_str().unwrap(), "--calibration", cal.to_str().unwrap()]);
        let begun = Instant::now();
        while !place.path("frames/shots.csv").exists() && begun.elapsed() < Duration::from_secs(60) {
            thread::sleep(Duration::from_millis(1));
            assert!(!ended(&mut child));
        }
        // Files from before the camera is opened are not frames: wait for the request.
        while !fs::read_to_string(place.path("frames/shots.csv")).unwrap_or_default().contains("\n1,") {
            thread::sleep(Duration::from_millis(1));
        }
        fs::write(place.path("frames/x.pgm"), bytes).unwrap();
        let output = child.wait_with_output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && error.contains(said), "{error}");
    }
}

#[test]
fn first_light_of_folders_says_what_they_do() {
    let place = Place::new(0);
    let file = DevicesFile::from_toml(&place.devices(TIMEOUT_S)).unwrap();
    let mut player = Player::new(&place);
    let found = thread::scope(|scope| {
        let tried = scope.spawn(|| {
            let bench = DeviceBench::new(&file, &place.rig, Operator::Gone).unwrap();
            first_light(&place.rig, &bench)
        });
        player.play(|| tried.is_finished());
        tried.join().unwrap()
    });
    assert!(found.is_good(), "{found}");
    let text = found.to_string();
    assert!(text.contains("proportional") && text.contains("black") && !text.contains("FAILS"), "{text}");
}
