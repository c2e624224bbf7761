//! V4L2 cameras, on a machine that has vivid's (`bash tests/vm/run.sh device_v4l` starts one): one test at a time.
#![cfg(feature = "v4l")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::thread::sleep;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use zonal::capture::{
    AllSteps, Bench, Bracket, Camera, CameraFactory, CaptureError, Clock, Control, Crop, Engine, Frame, Placement,
    Projector, ProjectorFactory, ProjectorLimits, Run, RunFolder, Triggering, capture_frames,
};
use zonal::devices::{DeviceBench, DevicesFile, MonotonicClock, Operator, PixelFormat};
use zonal::optics::Rig;
use zonal::patterns::Pattern;
use zonal::store::{self, StoreError};

const CAMERA: &str = "/dev/video0";
/// Exposure time that vivid is said to have.
const FIXED_S: f64 = 1.0 / 60.0;
/// Changes of pattern, unless ZONAL_VM_CHANGES asks for more.
const CHANGES: usize = 60;
/// From a file in place to a frame of it at vivid's output: four buffers of 33 ms, on a slow machine.
const LATENCY_S: f64 = 0.5;
/// The device makes 30 frames a second; the machine is emulated.
const LEAST_HZ: f64 = 24.0;
/// Frames of this many seconds are waited for.
const WAIT_S: f64 = 5.0;

/// Sets controls and formats; the tool is v4l-utils'.
fn v4l2_ctl(device: &str, arguments: &[&str]) {
    let output = Command::new("v4l2-ctl").args(["-d", device]).args(arguments).output().expect("v4l2-ctl is needed");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// vivid's webcam with a picture that does not move.
fn webcam() {
    v4l2_ctl(CAMERA, &["-i", "0"]);
    v4l2_ctl(CAMERA, &["-c", "osd_text_mode=2,test_pattern=3,horizontal_movement=3,vertical_movement=3"]);
    v4l2_ctl(CAMERA, &["-c", "percentage_of_dropped_buffers=0"]);
}

fn scratch() -> tempfile::TempDir {
    tempfile::tempdir_in(std::env::var_os("TMPDIR").map_or("/tmp".into(), PathBuf::from)).unwrap()
}

/// A bench with this camera, and a folder for a projector.
fn bench(camera: &str, folder: &Path) -> DeviceBench {
    let text = format!(
        "format = 1\n[camera]\ndriver = \"v4l\"\n{camera}\n[projector]\ndriver = \"files\"\nfolder = {folder:?}\n\
         width_px = 800\nheight_px = 600\nrefresh_hz = 60\nsettle_s = 0.0\n"
    );
    let file = DevicesFile::from_toml(&text).unwrap_or_else(|e| panic!("{e}\n{text}"));
    DeviceBench::new(&file, &rig(), Operator::Gone).unwrap()
}

fn rig() -> Rig {
    Rig::from_toml(include_str!("../optics/ghosh-2007-built.toml")).unwrap()
}

fn vivid(format: &str, width: u32, height: u32, more: &str) -> String {
    format!(
        "device = \"{CAMERA}\"\nformat = \"{format}\"\nwidth_px = {width}\nheight_px = {height}\n\
         fixed_exposure_s = {FIXED_S}\n{more}"
    )
}

fn open(camera: &str) -> Box<dyn Camera> {
    let folder = scratch();
    bench(camera, folder.path()).camera().open().unwrap()
}

fn next(camera: &mut dyn Camera) -> Frame {
    camera.receive(WAIT_S).unwrap().expect("a frame comes in time")
}

/// A program that goes on until this is dropped.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Plays a file of raw samples into vivid's HDMI input.
fn inject(frame: &Path, width: usize, height: usize, format: PixelFormat) -> Running {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/vm/inject.py");
    let fourcc = String::from_utf8(format.fourcc().to_vec()).unwrap();
    let mut command = Command::new("python3");
    command.args(["-B", script]).arg(frame).args([width.to_string(), height.to_string(), fourcc]);
    let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    let mut said = std::io::BufReader::new(child.stdout.take().unwrap());
    std::io::BufRead::read_line(&mut said, &mut line).unwrap();
    assert_eq!(line, "connected\n");
    Running(child)
}

/// Puts a frame into a file's place in one step.
fn put(path: &Path, bytes: &[u8]) {
    let part = path.with_extension("part");
    fs::write(&part, bytes).unwrap();
    fs::rename(&part, path).unwrap();
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn every_bit_of_injected_frames_arrives_in_every_format() {
    const EQUAL: usize = 3;
    let folder = scratch();
    let path = folder.path().join("frame.raw");
    let (width, height) = (1360, 1024);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    for format in PixelFormat::all() {
        let most = u16::MAX >> (16 - format.bits());
        let each = format.container_bits() as usize / 8;
        let bytes: Vec<u8> = (0..width * height)
            .flat_map(|_| (rng.random::<u16>() & most).to_le_bytes().into_iter().take(each))
            .collect();
        put(&path, &bytes);
        let player = inject(&path, width, height, format);
        let mut camera = open(&vivid(&format.to_string(), width as u32, height as u32, ""));
        camera.start(0).unwrap();
        let samples = expected(format, &bytes, width, height);
        let begun = Instant::now();
        // Until the player's first frame has arrived, the input shows noise.
        let mut equal = Vec::new();
        while equal.len() < EQUAL && begun.elapsed() < Duration::from_secs(20) {
            let frame = next(camera.as_mut());
            assert_eq!([frame.width, frame.height], format.delivered(width, height), "{format}");
            assert!(frame.flags.good(), "{format}");
            if frame.samples == samples {
                equal.push((frame.sequence, frame.timestamp_s));
            } else {
                equal.clear();
            }
        }
        assert_eq!(equal.len(), EQUAL, "{format}: frames differ from what was injected");
        let [(first, begun_s), .., (last, ended_s)] = equal[..] else { unreachable!() };
        let rate_hz = (last - first) as f64 / (ended_s - begun_s);
        println!("{format}: {rate_hz:.1} Hz");
        assert!(rate_hz > LEAST_HZ, "{format}: {rate_hz} Hz");
        camera.restore().unwrap();
        drop(player);
    }
}

/// The same by hand: low bits of 16, little end first; a mosaic from its first red pixel on.
fn expected(format: PixelFormat, bytes: &[u8], width: usize, height: usize) -> Vec<u16> {
    let each = format.container_bits() as usize / 8;
    assert_eq!(bytes.len(), width * height * each, "{format}");
    let name = format.to_string();
    let (left, top) = match name.as_str() {
        "BA81" | "BG10" | "BG12" | "BYR2" => (1, 1),
        "GBRG" | "GB10" | "GB12" | "GB16" => (0, 1),
        "GRBG" | "BA10" | "BA12" | "GR16" => (1, 0),
        _ => (0, 0),
    };
    let (columns, rows) = (width - 2 * left, height - 2 * top);
    let mut samples = Vec::new();
    for row in top..top + rows {
        for column in left..left + columns {
            let at = (row * width + column) * each;
            samples.push(if each == 1 { bytes[at].into() } else { u16::from_le_bytes([bytes[at], bytes[at + 1]]) });
        }
    }
    samples
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn old_frames_after_a_pause_say_that_they_are_old() {
    webcam();
    let mut camera = open(&vivid("GREY", 640, 360, ""));
    camera.start(100).unwrap();
    let first = next(camera.as_mut());
    assert_eq!((first.sequence, first.exposure_s), (100, FIXED_S));
    let clock = MonotonicClock;
    let resumed_s = clock.now_s() + 1.0;
    clock.sleep_until_s(resumed_s);
    let (mut old, mut last) = (0, first.sequence);
    loop {
        let frame = next(camera.as_mut());
        assert!(frame.timestamp_s <= clock.now_s() && frame.sequence > last);
        last = frame.sequence;
        if frame.timestamp_s >= resumed_s {
            break;
        }
        old += 1;
    }
    // As many as the kernel has buffers: they are what this is about.
    assert!((1..=5).contains(&old), "{old} old frames");
    camera.restore().unwrap();
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn a_camera_that_fell_silent_is_heard_again() {
    webcam();
    let mut camera = open(&vivid("GREY", 640, 360, ""));
    camera.start(0).unwrap();
    let before = next(camera.as_mut()).sequence;
    v4l2_ctl(CAMERA, &["-c", "percentage_of_dropped_buffers=100"]);
    // Frames that are ready already may come first.
    let silent = (0..10).any(|_| camera.receive(0.5).unwrap().is_none());
    assert!(silent);
    assert!(camera.receive(0.2).unwrap().is_none());
    v4l2_ctl(CAMERA, &["-c", "percentage_of_dropped_buffers=0"]);
    let after = next(camera.as_mut());
    assert!(after.sequence > before && after.flags.good(), "{} after {before}", after.sequence);
    camera.restore().unwrap();
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn a_damaged_frame_is_marked() {
    webcam();
    let mut camera = open(&vivid("GREY", 640, 360, ""));
    camera.start(0).unwrap();
    assert!(next(camera.as_mut()).flags.good());
    v4l2_ctl(CAMERA, &["-c", "inject_v4l2_buf_flag_error=1"]);
    let damaged = (0..20).filter(|_| next(camera.as_mut()).flags.corrupt).count();
    assert_eq!(damaged, 1);
    camera.restore().unwrap();
}

/// Frames that the engine takes of six patterns while the driver does this from the first one on.
fn taken_despite(fault: &str) -> Result<usize, CaptureError> {
    webcam();
    let folder = scratch();
    let mut rig = rig();
    (rig.camera.width_px, rig.camera.height_px, rig.projector.tag) = (640, 360, false);
    let mut bench = bench(&vivid("GREY", 640, 360, ""), folder.path());
    let patterns: Vec<Pattern> = (0..6).map(|code| Pattern::full(800, 600, 40 * code)).collect();
    let crop = Crop { u0: 0, v0: 0, width: 640, height: 2 };
    let mut taken = 0;
    capture_frames(&rig, &mut bench, &patterns, &[FIXED_S], crop, &mut |pattern, _, _| {
        assert_eq!(pattern, taken);
        if taken == 0 {
            v4l2_ctl(CAMERA, &["-c", fault]);
        }
        taken += 1;
    })?;
    Ok(taken)
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn the_engine_takes_again_what_the_driver_drops_or_damages() {
    for fault in ["percentage_of_dropped_buffers=60", "inject_v4l2_buf_flag_error=1"] {
        assert_eq!(taken_despite(fault).unwrap(), 6, "{fault}");
    }
    webcam();
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn a_camera_in_use_says_how_to_find_the_user() {
    webcam();
    let settings = vivid("GREY", 640, 360, "");
    let mut camera = open(&settings);
    camera.start(0).unwrap();
    next(camera.as_mut());
    let folder = scratch();
    let error = bench(&settings, folder.path()).camera().limits().unwrap_err().to_string();
    assert!(error.contains("used by another program") && error.contains("fuser -v /dev/video0"), "{error}");
    camera.restore().unwrap();
    bench(&settings, folder.path()).camera().limits().unwrap();
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn formats_sizes_and_gains_that_are_not_there_are_listed() {
    webcam();
    let folder = scratch();
    let said = |settings: &str| bench(settings, folder.path()).camera().limits().unwrap_err().to_string();
    let error = said(&vivid("Y16", 641, 360, ""));
    assert!(
        error.contains("no Y16 of 641 x 360") && error.contains("GREY (8 bits)") && error.contains("640 x 360"),
        "{error}"
    );
    let error = said(&vivid("Y16", 640, 360, "gain = 1000"));
    assert!(error.contains("gains 0..=255, not 1000"), "{error}");
    let fixed = format!("fixed_exposure_s = {FIXED_S}");
    let error = said(&vivid("Y16", 640, 360, "").replace(&fixed, ""));
    assert!(error.contains("exposure") && error.contains("fixed_exposure_s"), "{error}");
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn settings_are_taken_over_and_put_back() {
    webcam();
    v4l2_ctl(CAMERA, &["-c", "gain_automatic=1,horizontal_flip=1"]);
    v4l2_ctl(CAMERA, &["--set-fmt-video=width=1280,height=720,pixelformat=YUYV"]);
    let value = |name: &str| {
        let output = Command::new("v4l2-ctl").args(["-d", CAMERA, "-C", name]).output().unwrap();
        String::from_utf8(output.stdout).unwrap().trim().rsplit(' ').next().unwrap().to_owned()
    };
    let mut camera = open(&vivid("GREY", 640, 360, "gain = 77"));
    assert_eq!(["gain_automatic", "horizontal_flip", "gain"].map(value), ["0", "0", "77"]);
    camera.restore().unwrap();
    assert_eq!(["gain_automatic", "horizontal_flip"].map(value), ["1", "1"]);
    let output = Command::new("v4l2-ctl").args(["-d", CAMERA, "--get-fmt-video"]).output().unwrap();
    let format = String::from_utf8(output.stdout).unwrap();
    assert!(format.contains("1280/720") && format.contains("YUYV"), "{format}");
    v4l2_ctl(CAMERA, &["-c", "gain_automatic=0,horizontal_flip=0"]);
}

/// What is injected after so many changes: neighbours share no byte.
fn code(change: usize) -> u16 {
    (change * 257 % 65_536) as u16
}

/// The camera of vivid, and a projector whose light is what the player injects.
struct Injecting {
    devices: DeviceBench,
    projector: InjectedFrames,
}

/// A projector that puts a file in place for each frame.
#[derive(Clone)]
struct InjectedFrames {
    path: PathBuf,
    pixels: usize,
    changes: usize,
}

impl Bench for Injecting {
    fn camera(&self) -> &dyn CameraFactory {
        self.devices.camera()
    }

    fn projector(&self) -> &dyn ProjectorFactory {
        &self.projector
    }

    fn clock(&self) -> Arc<dyn Clock> {
        self.devices.clock()
    }

    fn place(&mut self, _: Placement) -> Result<(), CaptureError> {
        Ok(())
    }
}

impl ProjectorFactory for InjectedFrames {
    fn limits(&self) -> Result<ProjectorLimits, CaptureError> {
        Ok(ProjectorLimits { name: "player".into(), width: 8, height: 6, refresh_hz: 60.0, memory: None })
    }

    fn open(&self) -> Result<Box<dyn Projector>, CaptureError> {
        Ok(Box::new(self.clone()))
    }
}

impl Projector for InjectedFrames {
    fn load(&mut self, sequence: &[Pattern]) -> Result<(), CaptureError> {
        assert_eq!(sequence.len(), self.changes);
        Ok(())
    }

    fn show(&mut self, index: usize) -> Result<f64, CaptureError> {
        put(&self.path, &code(index).to_le_bytes().repeat(self.pixels));
        Ok(MonotonicClock.now_s() + LATENCY_S)
    }

    fn restore(&mut self) -> Result<(), CaptureError> {
        Ok(())
    }
}

/// The engine's own choice of frames from a camera that runs freely, with no patch to help: every sample of each must be of the
/// pattern it is taken for.
#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn the_engine_accepts_no_frame_of_before_a_change() {
    webcam();
    let folder = scratch();
    let path = folder.path().join("frame.raw");
    let (width, height) = (1280, 720);
    let changes = std::env::var("ZONAL_VM_CHANGES").map_or(CHANGES, |n| n.parse().unwrap());
    put(&path, &code(changes).to_le_bytes().repeat(width * height));
    let player = inject(&path, width, height, PixelFormat::of_fourcc(*b"Y16 ").unwrap());
    let devices = bench(&vivid("Y16", width as u32, height as u32, "timestamp = \"end\""), folder.path());
    let mut injecting = Injecting { devices, projector: InjectedFrames { path, pixels: width * height, changes } };
    let mut rig = rig();
    (rig.camera.width_px, rig.camera.height_px, rig.projector.tag) = (width, height, false);
    (rig.projector.width_px, rig.projector.height_px) = (8, 6);
    let crop = Crop { u0: 0, v0: 0, width, height };
    let patterns = vec![Pattern::full(8, 6, 0); changes];
    let (mut taken, mut stale) = (0, 0);
    capture_frames(&rig, &mut injecting, &patterns, &[FIXED_S], crop, &mut |change, _, frame| {
        assert_eq!(change, taken);
        taken += 1;
        stale += usize::from(frame.samples.iter().any(|&s| s != code(change)));
    })
    .unwrap();
    println!("{stale} of {taken} are stale");
    assert_eq!((taken, stale), (changes, 0));
    drop(player);
}

/// Plugs in a camera for the kernel's uvcvideo; its node.
fn uvc() -> (Running, String) {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/vm/uvc_camera.py");
    let child = Command::new("python3").args(["-B", script]).stdout(Stdio::null()).spawn().unwrap();
    let running = Running(child);
    let begun = Instant::now();
    loop {
        for i in 2..8 {
            let driver = fs::read_link(format!("/sys/class/video4linux/video{i}/device/driver"));
            let node = format!("/dev/video{i}");
            // Of its two nodes the first takes pictures.
            if driver.is_ok_and(|d| d.ends_with("uvcvideo")) && Path::new(&node).exists() {
                return (running, node);
            }
        }
        assert!(begun.elapsed() < Duration::from_secs(20), "the camera does not appear");
        sleep(Duration::from_millis(50));
    }
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn exposures_of_a_uvc_camera_are_proportional_and_make_a_bracket() {
    let (_running, node) = uvc();
    let folder = scratch();
    let settings = format!(
        "device = \"{node}\"\nformat = \"Y12\"\nwidth_px = 640\nheight_px = 480\nframe_rate_hz = 30\ngain = 16\n\
         slows_down = true\n"
    );
    let mut bench = bench(&settings, folder.path());
    let limits = bench.camera().limits().unwrap();
    assert_eq!((limits.triggering, limits.settling_frames), (Triggering::FreeRunning, 2));
    assert!((limits.exposure_step_s - 1e-4).abs() < 1e-12 && limits.longest_s > 0.9, "{limits:?}");
    let mut camera = bench.camera().open().unwrap();
    camera.start(0).unwrap();
    let mut rates = Vec::new();
    for wanted_s in [0.005, 0.01, 0.02, 0.04] {
        let set_s = camera.set_exposure(wanted_s).unwrap();
        assert!((set_s - wanted_s).abs() < 1e-9);
        let frame = loop {
            let frame = next(camera.as_mut());
            if frame.exposure_s == set_s {
                break frame;
            }
        };
        // Up to half of what saturates in the longest.
        let sum: f64 = frame.samples.chunks(640).flat_map(|row| &row[..200]).map(|&s| f64::from(s)).sum();
        rates.push(sum / set_s);
    }
    assert!(rates.iter().all(|r| (r / rates[0] - 1.0).abs() < 0.01), "{rates:?}");
    camera.restore().unwrap();
    drop(camera);

    let mut rig = rig();
    (rig.camera.width_px, rig.camera.height_px, rig.projector.tag) = (640, 480, false);
    let exposures_s = [1.0, 2.0, 4.0].map(|n| n / 60.0);
    let crop = Crop { u0: 0, v0: 0, width: 100, height: 2 };
    let mut seen = Vec::new();
    let pattern = Pattern::full(800, 600, 255);
    capture_frames(&rig, &mut bench, &[pattern.clone(), pattern], &exposures_s, crop, &mut |i, j, taken| {
        // Whole units of 0.1 ms, as nearly as they can be had.
        assert!((taken.exposure_s - exposures_s[j]).abs() <= 0.51e-4, "{} s", taken.exposure_s);
        for (column, &sample) in taken.samples.iter().take(100).enumerate() {
            let light = 2.0 * column as f64 * taken.exposure_s / 0.01;
            assert!((f64::from(sample) - light).abs() <= 1.0, "pattern {i}, column {column}: {sample}, not {light}");
        }
        seen.push((i, j));
    })
    .unwrap();
    seen.sort_unstable();
    assert_eq!(seen, [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)]);
}

fn bind_again() {
    for act in ["unbind", "bind"] {
        fs::write(format!("/sys/bus/platform/drivers/vivid/{act}"), "vivid.0").unwrap();
    }
}

/// The last by name: vivid is gone afterwards until it is bound again.
#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn when_it_is_unplugged_the_error_says_how_to_go_on() {
    webcam();
    let mut camera = open(&vivid("GREY", 640, 360, ""));
    camera.start(0).unwrap();
    next(camera.as_mut());
    v4l2_ctl(CAMERA, &["-c", "disconnect=1"]);
    let error = (0..20).find_map(|_| camera.receive(1.0).err()).expect("it is gone").to_string();
    assert!(error.contains("is gone") && error.contains("resume"), "{error}");
    assert!(camera.restore().is_err());
    drop(camera);
    bind_again();
    let folder = scratch();
    let path = folder.path().join("run");
    let run = RunFolder::create(&path, false).unwrap();
    let begin = || run.begin(|part| store::write(&part.join("run.json"), b"{}"));
    let error = stored(&run, &begin, Some(5)).unwrap_err().to_string();
    assert!(error.contains("is gone") && error.contains("resume"), "{error}");
    bind_again();
    webcam();
    // The pair that was whole when it was unplugged is not taken again.
    let frames = stored(&RunFolder::open(&path).unwrap(), &|| Ok(()), None).unwrap();
    assert!((1..8).contains(&frames), "{frames} taken anew");
    assert_eq!(fs::read_dir(path.join("responses")).unwrap().count(), 8);
    bind_again();
}

/// Frames that this session takes of a run of four pairs, the camera being unplugged after some.
fn stored(
    folder: &RunFolder,
    begin: &dyn Fn() -> Result<(), StoreError>,
    unplugged_after: Option<usize>,
) -> Result<usize, CaptureError> {
    let scratch = scratch();
    let mut rig = rig();
    (rig.camera.width_px, rig.camera.height_px, rig.projector.tag) = (640, 360, false);
    let mut bench = bench(&vivid("GREY", 640, 360, ""), scratch.path());
    let patterns: Vec<Pattern> = (0..8).map(|code| Pattern::full(800, 600, 30 * code)).collect();
    let run = Run {
        patterns: &patterns,
        mixed: false,
        director: &mut AllSteps::new(4),
        repeats: 1,
        exposer: &mut Bracket(vec![FIXED_S]),
        longest_s: FIXED_S,
        crop: Crop { u0: 0, v0: 0, width: 640, height: 2 },
        maps: None,
        folder: Some(folder),
        begin: &mut || begin(),
    };
    let mut progress = |done: usize, _: usize| {
        if Some(done) == unplugged_after {
            v4l2_ctl(CAMERA, &["-c", "disconnect=1"]);
        }
    };
    let taken = Engine::new(&rig, &mut bench, Control::default()).run(run, &mut progress, |_, _| ())?;
    Ok(taken.effort.frames)
}
