//! GenICam cameras, on the fake GigE Vision camera that comes with Aravis (Debian: `aravis-tools`).
#![cfg(feature = "aravis")]

mod common;

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use zonal::calibrate::CalibrationSet;
use zonal::capture::{Bench, RunFolder, Triggering};
use zonal::devices::{DeviceBench, DevicesFile, Operator};
use zonal::optics::{Mosaic, Rig};
use zonal::patterns::{Exitant, ExposureBracket, Plan};
use zonal::twin::TwinConfig;

/// The fake camera listens here, and nobody else may at the same time.
const ADDRESS: &str = "127.0.0.1";
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// The fake camera, ended when this is dropped.
struct Fake {
    process: Child,
    _turn: MutexGuard<'static, ()>,
}

impl Fake {
    fn start() -> Self {
        let turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let mut command = Command::new("arv-fake-gv-camera-0.8");
        command.args(["-i", ADDRESS]).stdout(Stdio::null()).stderr(Stdio::null());
        let process = command.spawn().expect("arv-fake-gv-camera-0.8 is needed: apt install aravis-tools");
        let fake = Self { process, _turn: turn };
        let begun = Instant::now();
        while bench("Mono8", 64, 64, Path::new("out")).camera().limits().is_err() {
            assert!(begun.elapsed() < Duration::from_secs(20), "the fake camera does not answer");
            std::thread::sleep(Duration::from_millis(100));
        }
        fake
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn bench(format: &str, width: usize, height: usize, folder: &Path) -> DeviceBench {
    let text = format!(
        "format = 1\n[camera]\ndriver = \"aravis\"\ncamera = \"{ADDRESS}\"\npixel_format = \"{format}\"\n\
         width_px = {width}\nheight_px = {height}\n[projector]\ndriver = \"files\"\nfolder = {folder:?}\n\
         width_px = 200\nheight_px = 150\nrefresh_hz = 60\nsettle_s = 0.0\n"
    );
    DeviceBench::new(&DevicesFile::from_toml(&text).unwrap(), &rig(), Operator::Gone).unwrap()
}

/// A rig with pixels as large as the fake camera's frames are small, and no coded patch: its picture moves by itself.
fn rig() -> Rig {
    let mut rig = common::coarse(common::rig("ghosh-2007-built"), 4);
    rig.camera.mosaic = Mosaic::Mono;
    rig.projector.tag = false;
    rig.name += "-untagged";
    rig
}

#[test]
fn exposures_are_read_back_and_frames_hold_what_was_set() {
    let _fake = Fake::start();
    let bench = bench("Mono16", 128, 96, Path::new("out"));
    let limits = bench.camera().limits().unwrap();
    assert_eq!((limits.width, limits.height, limits.triggering), (128, 96, Triggering::Triggered));
    let mut camera = bench.camera().open().unwrap();
    for (i, exposure_s) in [0.02, 0.05, 0.01].into_iter().enumerate() {
        let set_s = camera.set_exposure(exposure_s).unwrap();
        assert!((set_s / exposure_s - 1.0).abs() < 1e-3, "{set_s} {exposure_s}");
        camera.start(100 * i as u64).unwrap();
        let before_s = bench.clock().now_s();
        camera.trigger().unwrap();
        let frame = camera.receive(2.0).unwrap().expect("a frame comes in time");
        assert_eq!((frame.width, frame.height, frame.sequence), (128, 96, 100 * i as u64));
        assert!(frame.flags.good() && frame.exposure_s == set_s);
        assert!(frame.timestamp_s >= before_s && frame.timestamp_s < bench.clock().now_s());
        // The fake picture is a ramp that grows with the logarithm of the exposure.
        assert!(frame.samples.iter().any(|&s| s > 255), "{:?}", &frame.samples[..8]);
    }
    camera.restore().unwrap();
}

#[test]
fn what_the_camera_cannot_do_is_said() {
    let _fake = Fake::start();
    let error = bench("Mono12Packed", 64, 64, Path::new("out")).camera().limits().unwrap_err().to_string();
    assert!(error.contains("none of Mono8"), "{error}");
    let error = bench("Mono12", 64, 64, Path::new("out")).camera().limits().unwrap_err().to_string();
    assert!(error.contains("has no Mono12, only") && error.contains("Mono8"), "{error}");
    let error = bench("Mono8", 3400, 2560, Path::new("out")).camera().limits().unwrap_err().to_string();
    assert!(error.contains("2048 x 2048") && error.contains("3400 x 2560"), "{error}");
    let text = "format = 1\n[camera]\ndriver = \"aravis\"\ncamera = \"127.0.0.9\"\npixel_format = \"Mono8\"\nwidth_px = 64\n\
                height_px = 64\n[projector]\ndriver = \"files\"\nfolder = \"out\"\nwidth_px = 4\nheight_px = 4\nrefresh_hz = 60\n";
    let missing = DeviceBench::new(&DevicesFile::from_toml(text).unwrap(), &rig(), Operator::Gone).unwrap();
    let error = missing.camera().limits().unwrap_err().to_string();
    assert!(error.contains("127.0.0.9") && error.contains("zonal devices"), "{error}");
}

#[test]
fn a_whole_plan_runs_on_the_fake_camera() {
    let _fake = Fake::start();
    let rig = rig();
    let folder = tempfile::tempdir().unwrap();
    let c = &rig.camera;
    let calibration: CalibrationSet = common::calibrated(&rig, &TwinConfig::pinhole(1));
    let bracket = ExposureBracket { count: 2, shortest_refreshes: 1, spacing: 4 };
    let plan = Plan { exposure: Some(bracket), exitant: Exitant { rings: 4, sectors: 8 }, ..Plan::of_order(1) };
    let mut bench = bench("Mono8", c.width_px, c.height_px, folder.path());
    let path = folder.path().join("run");
    let run = RunFolder::create(&path, false).unwrap();
    let measured = common::measured(&rig, &plan, &mut bench, &calibration, Some(&run)).unwrap();
    assert_eq!((measured.record.status.as_str(), measured.record.frames), ("complete", plan.frames()));
    // Without a patch, an exposure that began while its command was on the way counts once as one of before; from then on the
    // next pattern waits for the frame.
    let journal = std::fs::read_to_string(path.join("journal.jsonl")).unwrap();
    assert!(measured.record.capture.rejected <= 1, "{journal}");
}
