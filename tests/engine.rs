//! The engine on simulated devices: in time, out of order, and with all that goes wrong.

mod common;

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, LazyLock};

use zonal::calibrate::CalibrationSet;
use zonal::capture::{
    Bench, Camera, CameraFactory, CameraLimits, CaptureError, Clock, Control, Frame, Placement, ProjectorFactory,
    RunFolder,
};
use zonal::measure::{MeasureError, Measurement, RunRecord, resume};
use zonal::optics::Rig;
use zonal::patterns::{Exitant, ExposureBracket, Plan};
use zonal::reflectance::open;
use zonal::twin::{Faults, TwinBench, TwinConfig};

static COARSE: LazyLock<Rig> = LazyLock::new(|| common::coarse(common::rig("ghosh-2007-built"), 4));
static CALIBRATION: LazyLock<CalibrationSet> = LazyLock::new(|| common::calibrated(&COARSE, &TwinConfig::pinhole(1)));

/// Cells that a sixteenth of the pixels can fill.
fn plan(order: usize) -> Plan {
    Plan { exitant: Exitant { rings: 6, sectors: 12 }, ..Plan::of_order(order) }
}

fn bench(config: TwinConfig) -> TwinBench {
    TwinBench::new(&COARSE, config, open("red-plastic").unwrap())
}

fn bits(measured: &Measurement) -> Vec<u32> {
    measured.coefficients.values.iter().chain(&measured.coefficients.sigma).map(|x| x.to_bits()).collect()
}

#[test]
fn every_frame_is_proved_and_the_latency_known() {
    let measured = common::measured(&COARSE, &plan(2), &mut bench(TwinConfig::pinhole(3)), &CALIBRATION, None).unwrap();
    let capture = &measured.record.capture;
    assert!(capture.tagged && capture.rejected == 0 && measured.record.frames == 54, "{capture:?}");
    // The simulated projector takes 1.3 refresh periods and the wait for the next; a period is added for the phase.
    let refreshes = capture.latency_s * COARSE.projector.refresh_hz;
    assert!((2.3..3.4).contains(&refreshes), "{refreshes}");
    assert!((capture.lamp[0] - 1.0).abs() < 2e-3 && (capture.lamp[1] - 1.0).abs() < 2e-3, "{:?}", capture.lamp);
}

/// Without camera noise a frame taken again is the same to the last bit, so faults may not leave a trace. (A camera marks
/// frames with noise: the same bits twice would be taken for a repeated frame.)
#[test]
fn faults_cost_time_and_nothing_else() {
    let quiet = || TwinConfig::pinhole(3).noiseless();
    let plan = plan(1);
    let undisturbed = bits(&common::measured(&COARSE, &plan, &mut bench(quiet()), &CALIBRATION, None).unwrap());
    let some = Faults { seed: 5, ..Faults::default() };
    let cases = [
        ("drop", Faults { drop: 0.2, ..some }),
        ("duplicate", Faults { duplicate: 0.2, ..some }),
        ("repeat", Faults { repeat: 0.2, ..some }),
        ("reorder", Faults { reorder: 0.2, ..some }),
        ("flag", Faults { flag: 0.2, ..some }),
        ("late", Faults { late: 0.3, late_s: 0.2, ..some }),
    ];
    for (name, faults) in cases {
        let config = if name == "flag" { TwinConfig::pinhole(3) } else { quiet() };
        let measured =
            common::measured(&COARSE, &plan, &mut bench(config).failing(faults), &CALIBRATION, None).unwrap();
        let rejected = measured.record.capture.rejected;
        eprintln!("{name}: {rejected} frames taken again");
        // A latency that was met while it was measured is waited for.
        assert!(rejected > 0 || name == "late", "{name}: nothing happened");
        assert!(name == "flag" || bits(&measured) == undisturbed, "{name}");
    }
}

fn resumed(path: &Path, config: &TwinConfig) -> Measurement {
    let make = |rig: &Rig, _: &RunRecord| -> Result<Box<dyn Bench>, MeasureError> {
        Ok(Box::new(TwinBench::new(rig, config.clone(), open("red-plastic").unwrap())))
    };
    resume(path, &Control::default(), None, make, &mut |_, _| ()).unwrap()
}

#[test]
fn lost_devices_leave_a_run_that_can_be_resumed() {
    let config = TwinConfig::pinhole(4);
    let plan = plan(1);
    let undisturbed = common::measured(&COARSE, &plan, &mut bench(config.clone()), &CALIBRATION, None).unwrap();
    let dir = tempfile::tempdir().unwrap();
    // Some twenty frames and fifteen changes go before a run.
    let cases = [
        ("lost", Faults { lost_after: Some(30), ..Faults::default() }, "its cable"),
        ("stuck", Faults { stuck_after: Some(18), ..Faults::default() }, "frozen"),
        ("dead", Faults { drop: 1.0, ..Faults::default() }, "missing"),
    ];
    for (name, faults, remedy) in cases {
        let path = dir.path().join(name);
        let folder = RunFolder::create(&path, false).unwrap();
        let mut failing = bench(config.clone()).failing(faults);
        let error = common::measured(&COARSE, &plan, &mut failing, &CALIBRATION, Some(&folder)).err().unwrap();
        let said = error.to_string();
        assert!(said.contains(remedy) && said.contains("resume"), "{name}: {said}");
        assert_eq!(RunRecord::read(&path).unwrap().status, "failed");
        if name != "dead" {
            assert!(matches!(error, MeasureError::Capture(CaptureError::At { .. })), "{said}");
        }
        let measured = resumed(&path, &config);
        assert_eq!(measured.record.capture.sessions, 2);
        assert!(name == "stuck" || bits(&measured) == bits(&undisturbed), "{name}");
        assert!(matches!(
            resume(&path, &Control::default(), None, |_, _| Err::<Box<dyn Bench>, _>(unreachable()), &mut |_, _| ()),
            Err(MeasureError::Complete { .. })
        ));
    }
}

fn unreachable() -> MeasureError {
    unreachable!("nothing is opened for a run that is complete")
}

#[test]
fn a_run_can_be_paused_stopped_and_resumed() {
    let config = TwinConfig::pinhole(6);
    let plan = plan(1);
    let undisturbed = common::measured(&COARSE, &plan, &mut bench(config.clone()), &CALIBRATION, None).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run");
    let folder = RunFolder::create(&path, false).unwrap();
    let control = Control::default();
    let steer = control.clone();
    let provenance =
        zonal::measure::Provenance { sample: "red-plastic".into(), simulation: None, ..Default::default() };
    let request = zonal::measure::Request {
        rig: &COARSE,
        plan: &plan,
        calibration: &CALIBRATION,
        provenance: &provenance,
        control: &control,
        adviser: None,
    };
    let mut pauser = None;
    let stopped = zonal::measure::measure(&request, &mut bench(config.clone()), Some(&folder), &mut |done, _| {
        if done == 3 {
            steer.pause();
            let steer = steer.clone();
            pauser = Some(std::thread::spawn(move || {
                std::thread::sleep(std::time::Duration::from_millis(100));
                steer.resume();
            }));
        }
        if done == 7 {
            steer.abort();
        }
    });
    pauser.unwrap().join().unwrap();
    let said = stopped.err().unwrap().to_string();
    assert!(said.contains("after 7 of 24 frames"), "{said}");
    assert_eq!(RunRecord::read(&path).unwrap().status, "stopped");
    let journal = std::fs::read_to_string(path.join("journal.jsonl")).unwrap();
    assert!(journal.contains("paused") && journal.contains("resumed") && journal.contains("stopped"));
    assert_eq!(bits(&resumed(&path, &config)), bits(&undisturbed));
}

/// Share of another pattern's light that a frame may hold unseen: five standard errors of a patch of a sixteenth of the pixels,
/// read in an exposure of two refresh periods.
const UNSEEN: f64 = 0.005;

/// The simulated rig with a camera that is opened in another way.
struct OtherCamera(TwinBench, fn(&TwinBench) -> Result<Box<dyn Camera>, CaptureError>);

impl Bench for OtherCamera {
    fn camera(&self) -> &dyn CameraFactory {
        self
    }

    fn projector(&self) -> &dyn ProjectorFactory {
        self.0.projector()
    }

    fn clock(&self) -> Arc<dyn Clock> {
        self.0.clock()
    }

    fn place(&mut self, what: Placement) -> Result<(), CaptureError> {
        self.0.place(what)
    }
}

impl CameraFactory for OtherCamera {
    fn limits(&self) -> Result<CameraLimits, CaptureError> {
        self.0.camera().limits()
    }

    fn open(&self) -> Result<Box<dyn Camera>, CaptureError> {
        self.1(&self.0)
    }
}

/// Its trigger returns a while after the exposure has begun.
struct SlowCamera(Box<dyn Camera>, Arc<dyn Clock>);

impl Camera for SlowCamera {
    fn set_exposure(&mut self, exposure_s: f64) -> Result<f64, CaptureError> {
        self.0.set_exposure(exposure_s)
    }

    fn set_gain(&mut self, gain: f64) -> Result<f64, CaptureError> {
        self.0.set_gain(gain)
    }

    fn start(&mut self, first: u64) -> Result<(), CaptureError> {
        self.0.start(first)
    }

    fn trigger(&mut self) -> Result<(), CaptureError> {
        self.0.trigger()?;
        self.1.sleep_until_s(self.1.now_s() + 2e-3);
        Ok(())
    }

    fn receive(&mut self, timeout_s: f64) -> Result<Option<Frame>, CaptureError> {
        self.0.receive(timeout_s)
    }

    fn restore(&mut self) -> Result<(), CaptureError> {
        self.0.restore()
    }
}

/// As if another program took the camera between the check and the run.
#[test]
fn a_device_that_cannot_be_opened_leaves_no_folder() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run");
    let folder = RunFolder::create(&path, false).unwrap();
    let open = |_: &TwinBench| {
        Err(CaptureError::Device { device: "camera", step: "open".into(), reason: "another program has it".into() })
    };
    let mut taken = OtherCamera(bench(TwinConfig::pinhole(3)), open);
    let error = common::measured(&COARSE, &plan(0), &mut taken, &CALIBRATION, Some(&folder)).map(drop).unwrap_err();
    assert!(matches!(error, MeasureError::Capture(CaptureError::Unusable(_))), "{error}");
    assert!(error.to_string().contains("another program has it") && !path.exists(), "{error}");
}

/// Without a patch frames are judged by their time; one that begins with its trigger is not too early.
#[test]
fn a_slow_trigger_costs_no_frame() {
    let mut rig = COARSE.clone();
    rig.projector.tag = false;
    let calibration = common::calibrated(&rig, &TwinConfig::pinhole(1));
    let inner = TwinBench::new(&rig, TwinConfig::pinhole(3), open("red-plastic").unwrap());
    let open = |twin: &TwinBench| Ok(Box::new(SlowCamera(twin.camera().open()?, twin.clock())) as Box<dyn Camera>);
    let measured = common::measured(&rig, &plan(0), &mut OtherCamera(inner, open), &calibration, None).unwrap();
    let capture = &measured.record.capture;
    assert!(!capture.tagged && capture.rejected == 0, "{capture:?}");
}

/// Without a patch the clocks alone tell which frames are of which pattern: whatever the phase of camera and projector, the
/// frames of a triggered and of a free-running one are the same to the last bit.
#[test]
fn without_a_patch_frames_of_the_former_pattern_are_told_by_their_time() {
    let mut rig = COARSE.clone();
    rig.projector.tag = false;
    let calibration = common::calibrated(&rig, &TwinConfig::pinhole(1));
    let mut measured = |rate_hz: f64, free_running: bool| {
        rig.camera.max_frame_rate_hz = rate_hz;
        let bench = TwinBench::new(&rig, TwinConfig::pinhole(3).noiseless(), open("red-plastic").unwrap());
        let mut bench = if free_running { bench.free_running() } else { bench };
        let plan = Plan { exposure: Some(ExposureBracket { count: 1, shortest_refreshes: 2, spacing: 2 }), ..plan(1) };
        bits(&common::measured(&rig, &plan, &mut bench, &calibration, None).unwrap())
    };
    let undisturbed = measured(15.0, false);
    for (rate_hz, free_running) in [(20.0, true), (29.0, true), (29.0, false), (45.0, true), (90.0, true)] {
        assert!(measured(rate_hz, free_running) == undisturbed, "{rate_hz} Hz, free-running: {free_running}");
    }
}

/// Delays, repeats, losses and late changes at random.
fn shuffled(frames: usize, free_running: bool) {
    let mut plan = Plan {
        exposure: Some(ExposureBracket { count: 4, shortest_refreshes: 2, spacing: 2 }),
        exitant: Exitant { rings: 3, sectors: 4 },
        ..Plan::of_order(4)
    };
    plan.repeats = frames.div_ceil(plan.frames());
    let faults = Faults {
        seed: 7,
        drop: 0.02,
        duplicate: 0.03,
        repeat: 0.03,
        reorder: 0.03,
        flag: 0.02,
        late: 0.2,
        late_s: 0.3,
        ..Faults::default()
    };
    let bench = bench(TwinConfig::pinhole(9)).failing(faults);
    let mut bench = if free_running { bench.free_running() } else { bench };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run");
    let folder = RunFolder::create(&path, false).unwrap();
    let measured = common::measured(&COARSE, &plan, &mut bench, &CALIBRATION, Some(&folder)).unwrap();

    let mut accepted: HashMap<u64, usize> = HashMap::new();
    let mut refused = Vec::new();
    for line in std::fs::read_to_string(path.join("journal.jsonl")).unwrap().lines() {
        let entry: serde_json::Value = serde_json::from_str(line).unwrap();
        match entry["event"].as_str() {
            Some("frame") => {
                let shown = 2 * entry["k"].as_u64().unwrap() + u64::from(entry["sign"] == "negative");
                accepted.insert(entry["sequence"].as_u64().unwrap(), shown as usize);
            }
            Some("rejected") => refused.push(entry["sequence"].as_u64()),
            _ => {}
        }
    }
    assert_eq!(accepted.len(), plan.frames());
    let truth = bench.truth();
    let (mut stale, mut used, mut worst) = (0, 0, 0.0f64);
    for frame in &truth {
        if let Some(wanted) = accepted.get(&frame.sequence).filter(|_| !frame.spoilt) {
            used += 1;
            worst = worst.max(1.0 - frame.share);
            stale += usize::from(frame.shown != Some(*wanted) || frame.share < 1.0 - UNSEEN);
        }
    }
    // A frame that shows one pattern all the time, once, undamaged, is only refused for showing the wrong one.
    eprintln!(
        "{}: {} delivered, {used} accepted, {} refused, {} skipped, {stale} stale; most light of another pattern {worst:.1e}",
        if free_running { "free-running" } else { "triggered" },
        truth.len(),
        refused.len(),
        measured.record.capture.skipped,
    );
    assert_eq!((used, stale), (accepted.len(), 0), "an accepted frame is spoilt or shows something else");
    for sequence in refused.into_iter().flatten() {
        let frame = truth.iter().find(|t| t.sequence == sequence && !t.spoilt);
        if let Some(frame) = frame.filter(|f| f.share == 1.0) {
            let later = accepted.iter().filter(|(s, _)| **s > sequence).min_by_key(|(s, _)| **s).map(|(_, k)| *k);
            assert_ne!(frame.shown, later, "frame {sequence} was good and refused");
        }
    }
}

/// All ten thousand with the other thorough tests, a tenth always.
const FRAMES: usize = if cfg!(feature = "thorough") { 10_000 } else { 1_000 };

#[test]
fn of_ten_thousand_shuffled_frames_none_is_stale() {
    shuffled(FRAMES, false);
}

#[test]
fn a_free_running_camera_is_as_trustworthy() {
    shuffled(FRAMES / 10, true);
}
