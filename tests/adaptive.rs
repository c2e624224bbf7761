//! Adaptive acquisitions on the simulated rig: no more than a sample needs, and the same after an interruption.

mod common;

use std::path::Path;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

use zonal::calibrate::CalibrationSet;
use zonal::capture::{Control, RunFolder};
use zonal::fit::{FitMethod, FitOptions, fit};
use zonal::forecast::FitAdviser;
use zonal::measure::{
    Advice, Adviser, Decision, MeasureError, Measurement, Provenance, Request, SoFar, measure, reduce_run, resume,
};
use zonal::optics::Rig;
use zonal::patterns::{Adaptive, Exitant, Plan};
use zonal::reduce::Coefficients;
use zonal::reflectance::{Brdf, Ggx, GgxLobe, Lambert, Metric, open, sgd_materials};
use zonal::twin::{TwinBench, TwinConfig};

static COARSE: LazyLock<Rig> = LazyLock::new(|| common::coarse(common::rig("ghosh-2007-built"), 2));
static CALIBRATION: LazyLock<CalibrationSet> = LazyLock::new(|| common::calibrated(&COARSE, &TwinConfig::pinhole(1)));

fn plan(order: usize) -> Plan {
    let exitant = Exitant { rings: 16, sectors: 32 };
    Plan { exitant, ..Plan::of_order(order) }.adapted(Adaptive::default())
}

fn run(plan: &Plan, seed: u64, sample: Arc<dyn Brdf>) -> Measurement {
    common::run(&COARSE, plan, &TwinConfig::pinhole(seed), &CALIBRATION, sample)
}

fn sgd(name: &str) -> Arc<dyn Brdf> {
    let all = sgd_materials();
    Arc::new(all.iter().find(|m| m.name == name).unwrap_or_else(|| panic!("no {name}")).brdf)
}

fn error(coefficients: &Coefficients, method: FitMethod, truth: &dyn Brdf) -> f64 {
    let model = fit(coefficients, method, &FitOptions::default()).unwrap().brdf;
    Metric::new(COARSE.zone()).errors(truth, &model).unwrap().mean.overall()
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn diffuse_and_satin_samples_stop_at_order_2_and_glossy_ones_go_on() {
    let order_2: [(&str, Arc<dyn Brdf>); 4] = [
        ("gray card", open("gray-card").unwrap()),
        ("black velvet", Arc::new(Lambert::gray(0.01))),
        ("satin", open("ggx-0.4").unwrap()),
        ("satin plastic", open("yellow-matte-plastic").unwrap()),
    ];
    for (name, sample) in order_2 {
        let record = run(&plan(10), 1, sample).record;
        println!("{name}: order {}, {} frames, {:?}", record.order, record.frames, record.decisions.last());
        assert_eq!(record.order, 2, "{name}");
        assert!(record.isotropic && record.images == 6, "{name}");
    }
    let mut further = 0;
    for name in ["maroon-plastic", "purple-paint", "pink-plastic"] {
        let record = run(&plan(10), 2, sgd(name)).record;
        println!("{name}: order {}, {} frames, {:.2} s", record.order, record.frames, record.rig_s);
        further += usize::from(record.order > 2);
    }
    assert!(further >= 2, "{further} of 3 glossy samples were followed beyond order 2");
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn a_limit_of_time_is_kept() {
    // A brushed sample is always followed, a glossy one if every change counts.
    let samples = [(open("ggx-0.1-0.4").unwrap(), 1.5), (sgd("blue-acrylic"), 4.0)];
    for (sample, limit_s) in samples {
        let adaptive = Adaptive { gain_rel: 1e-3, limit_s: Some(limit_s) };
        let record = run(&Plan { adaptive: Some(adaptive), ..plan(10) }, 2, sample).record;
        let last = record.decisions.last().expect("one at least");
        println!("{limit_s} s: order {}, {:.2} s, {}", record.order, record.rig_s, last.reason);
        assert!(last.reason.contains("beyond the limit"), "{}", last.reason);
        assert!(record.rig_s <= limit_s || record.order == 2, "{} s of {limit_s}", record.rig_s);
    }
}

/// A run that is kept in a folder, aborted after so many frames.
fn stored(
    path: &Path,
    plan: &Plan,
    adviser: &dyn Adviser,
    bench: &mut TwinBench,
    stop_after: Option<usize>,
) -> Result<Measurement, MeasureError> {
    let folder = RunFolder::create(path, false).unwrap();
    let provenance = Provenance { sample: "test".into(), ..Default::default() };
    let control = Control::default();
    let request = Request {
        rig: &COARSE,
        plan,
        calibration: &CALIBRATION,
        provenance: &provenance,
        control: &control,
        adviser: Some(adviser),
    };
    measure(&request, bench, Some(&folder), &mut |done, _| {
        if stop_after == Some(done) {
            control.abort();
        }
    })
}

/// Wants all there is, and takes so many seconds to say so.
struct Slow(f64);

impl Adviser for Slow {
    fn advise(&self, so_far: &SoFar<'_>) -> (Advice, Decision) {
        if so_far.next_order.is_some() {
            std::thread::sleep(Duration::from_secs_f64(self.0));
        }
        let decision = Decision {
            order: so_far.coefficients.order,
            images: 0,
            error: 1.0,
            saving: None,
            anisotropy: so_far.anisotropy,
            reason: "more".into(),
        };
        (so_far.next_order.map_or(Advice::Stop, |_| Advice::Further), decision)
    }
}

/// While somebody thinks the rig waits, and that counts. What was begun in time is not thought over by who resumes.
#[test]
fn time_to_decide_counts_against_the_limit() {
    // Order 4 takes 3 s.
    let limit_s = 5.0;
    let adaptive = Adaptive { limit_s: Some(limit_s), ..Adaptive::default() };
    let plan = Plan { adaptive: Some(adaptive), ..plan(4) };
    let folder = tempfile::tempdir().unwrap();
    let bench = || TwinBench::new(&COARSE, TwinConfig::pinhole(7), open("gray-card").unwrap());
    let taken = |name: &str, thought_s: f64, stop_after: Option<usize>| {
        stored(&folder.path().join(name), &plan, &Slow(thought_s), &mut bench(), stop_after)
    };
    let quick = taken("quick", 0.0, None).unwrap().record;
    let slow = taken("slow", limit_s, None).unwrap().record;
    println!("orders {} in {:.2} s, {} in {:.2} s", quick.order, quick.rig_s, slow.order, slow.rig_s);
    assert!((quick.order, slow.order) == (4, 2) && quick.rig_s <= limit_s && slow.rig_s <= limit_s);
    let begun = slow.frames + 1;
    assert!(taken("stopped", 0.0, Some(begun)).is_err());
    let again = |_: &Rig, _: &_| -> Result<Box<dyn zonal::capture::Bench>, MeasureError> { Ok(Box::new(bench())) };
    let resumed =
        resume(&folder.path().join("stopped"), &Control::default(), Some(&Slow(limit_s)), again, &mut |_, _| ());
    assert_eq!(resumed.unwrap().record.order, 4);
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn dark_samples_get_longer_exposures() {
    let exposure = |albedo: f64| {
        let record = run(&plan(2), 3, Arc::new(Lambert::gray(albedo))).record;
        record.rig_s_items.exposure_s / record.frames as f64
    };
    let [dark, white] = [exposure(0.02), exposure(0.8)];
    assert!(dark > 2.0 * white, "{dark} {white}");
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn brushed_samples_are_taken_direction_by_direction() {
    let truth = open("ggx-0.1-0.4").unwrap();
    let measured = run(&plan(6), 4, truth.clone());
    let record = &measured.record;
    println!("order {}, {} images, {:?}", record.order, record.images, record.decisions);
    assert!(!record.isotropic && record.decisions[0].reason.contains("isotropy"));
    // Pairs of order 2 at least, beside the three mixtures that told so.
    assert!(record.images >= 2 * (9 + 3));
    let off = error(&measured.coefficients, FitMethod::Auto, truth.as_ref());
    assert!(off < 0.02, "{off}");
}

/// Seconds on the rig that a foil-like sample may take, computing aside: that depends on the machine.
const FOIL_S: f64 = 15.0;

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn a_foil_is_better_known_in_seconds_than_by_the_published_way_in_minutes() {
    // Two lobes and a tail that no single family has.
    let lobe = |alpha: f64, f0: f64| GgxLobe { alpha: [alpha; 2], f0: [f0; 3], f90: [1.0; 3] };
    let foil = Ggx { kd: [0.01; 3], lobes: vec![lobe(0.06, 0.6), lobe(0.2, 0.25)] };
    let truth: Arc<dyn Brdf> = Arc::new(foil);
    let published = Plan { exitant: Exitant { rings: 16, sectors: 32 }, ..Plan::of_order(10) };
    let pairs = run(&published, 5, truth.clone());
    assert_eq!(pairs.record.frames, 726);
    let theirs = error(&pairs.coefficients, FitMethod::Thesis, truth.as_ref());
    let adaptive = run(&plan(10), 5, truth.clone());
    let ours = error(&adaptive.coefficients, FitMethod::Auto, truth.as_ref());
    let record = &adaptive.record;
    let total_s = record.rig_s + record.capture.preparation_s;
    println!(
        "{} frames, {total_s:.1} s ({:?}, making ready {:.1} s), error {ours:.4}; published: 726 frames, {:.0} s here, error {theirs:.4}",
        record.frames, record.rig_s_items, record.capture.preparation_s, pairs.record.rig_s
    );
    let frames_s = record.rig_s - record.rig_s_items.decision_s;
    assert!(ours < theirs && frames_s <= FOIL_S, "{ours} {theirs} {frames_s}");
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn an_interrupted_run_decides_alike_and_ends_in_the_same_bits() {
    let (rig, plan, config) = (&*COARSE, plan(6), TwinConfig::pinhole(6));
    let sample = || sgd("blue-acrylic");
    let folder = tempfile::tempdir().unwrap();
    let taken = |name: &str, stop_after: Option<usize>| {
        let path = folder.path().join(name);
        let mut bench = TwinBench::new(rig, config.clone(), sample());
        let outcome = stored(&path, &plan, &FitAdviser::default(), &mut bench, stop_after);
        (path, outcome)
    };
    let (whole_path, whole) = taken("whole", None);
    let whole = whole.unwrap();
    let bits = |c: &Coefficients| c.values.iter().map(|z| z.to_bits()).collect::<Vec<_>>();
    for stop_after in [5, 9] {
        let (path, outcome) = taken(&format!("stopped-{stop_after}"), Some(stop_after));
        assert!(matches!(outcome, Err(MeasureError::Capture(_))), "stopped after {stop_after} frames");
        let adviser = FitAdviser::default();
        let bench = |rig: &Rig, _: &_| -> Result<Box<dyn zonal::capture::Bench>, MeasureError> {
            Ok(Box::new(TwinBench::new(rig, config.clone(), sample())))
        };
        let resumed = resume(&path, &Control::default(), Some(&adviser), bench, &mut |_, _| ()).unwrap();
        let orders = |m: &Measurement| m.record.decisions.iter().map(|d| (d.order, d.images)).collect::<Vec<_>>();
        assert_eq!(orders(&resumed), orders(&whole));
        assert_eq!(resumed.record.frames, whole.record.frames);
        assert_eq!(bits(&resumed.coefficients), bits(&whole.coefficients), "stopped after {stop_after} frames");
    }
    let (again, record) = reduce_run(&whole_path, None, None).unwrap();
    assert_eq!(record.steps, whole.record.steps);
    assert_eq!(bits(&again), bits(&whole.coefficients));
}

#[test]
fn an_adaptive_plan_needs_an_adviser() {
    let provenance = Provenance::default();
    let (plan, control) = (plan(4), Control::default());
    let request = Request {
        rig: &COARSE,
        plan: &plan,
        calibration: &CALIBRATION,
        provenance: &provenance,
        control: &control,
        adviser: None,
    };
    let mut bench = TwinBench::new(&COARSE, TwinConfig::pinhole(1), open("gray-card").unwrap());
    let error = measure(&request, &mut bench, None, &mut |_, _| ()).err().unwrap();
    assert!(matches!(error, MeasureError::NoAdviser) && error.to_string().contains("--adaptive"));
}
