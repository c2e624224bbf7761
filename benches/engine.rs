//! The engine against the clock: order 4 in real time at 15 frames a second, over the least time the devices allow, and what
//! the engine itself takes for a frame.
//!
//! `cargo bench --bench engine`

use std::time::Instant;

use zonal::calibrate::CalibrationSet;
use zonal::capture::{Bench, Control, RunFolder};
use zonal::measure::{Provenance, Request, measure};
use zonal::optics::Rig;
use zonal::patterns::{Plan, Timing};
use zonal::reflectance::open;
use zonal::twin::{TwinBench, TwinConfig};

/// Wall time over the floor, at most.
const TRIGGERED: f64 = 1.15;
const FREE_RUNNING: f64 = 2.2;

fn main() {
    let mut rig = Rig::from_toml(include_str!("../optics/ghosh-2007-built.toml")).expect("a rig of ours");
    // The built rig's camera delivers during the next exposure; a triggered one often cannot.
    rig.camera.readout_s = 0.005;
    let config = TwinConfig::pinhole(1);
    let twin = || TwinBench::new(&rig, config.clone(), open("red-plastic").expect("built in"));
    let calibration =
        CalibrationSet::make(&rig, &mut twin(), None, &mut |_, _| ()).expect("the twin can be calibrated");
    let plan = Plan::of_order(4);
    let floor_s = plan.rig_time(&Timing::of(&rig)).total_s();
    let provenance = Provenance { sample: "red-plastic".into(), ..Provenance::default() };
    let control = Control::default();
    let request = Request {
        rig: &rig,
        plan: &plan,
        calibration: &calibration,
        provenance: &provenance,
        control: &control,
        adviser: None,
    };
    println!("order 4, {} frames, floor {floor_s:.1} s", plan.frames());
    // In its own time first: what mirrors and sample do to the plan's light is then known and takes no time.
    let mut known = twin();
    measure(&request, &mut known, None, &mut |_, _| ()).expect("no faults");
    let triggered = known.paced();
    let mut slow = false;
    let mut run = |name: &str, mut bench: TwinBench, most: f64| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let run = RunFolder::create(&folder.path().join("run"), false).expect("an empty folder");
        let started = Instant::now();
        let measured = measure(&request, &mut bench as &mut dyn Bench, Some(&run), &mut |_, _| ()).expect("no faults");
        // Computing the sensor's noise is the simulation's, not the engine's.
        let (late_s, wall_s) = (bench.late_s(), started.elapsed().as_secs_f64() - bench.late_s());
        let capture = &measured.record.capture;
        println!(
            "{name:>12}: {wall_s:.2} s, {:.3} of the floor (at most {most}); engine {:.3} ms per frame, {} skipped, {} taken again, {:.2} s after the last frame; frames came {late_s:.2} s late, taken off",
            wall_s / floor_s,
            1e3 * capture.engine_s_per_frame,
            capture.skipped,
            capture.rejected,
            measured.record.post_s,
        );
        slow |= wall_s / floor_s > most;
        bench
    };
    let bench = run("triggered", triggered, TRIGGERED);
    run("free-running", bench.free_running(), FREE_RUNNING);
    assert!(!slow, "slower than it may be");
}
