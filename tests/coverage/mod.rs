//! Rigs, calibrations and mounts drawn from what a budget takes for granted, and how often its intervals hold the truth.

#[path = "../common/mod.rs"]
mod common;

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use zonal::calibrate::{CalibrationSet, Known, Reference, gray_card};
use zonal::capture::Control;
use zonal::geometry::{Direction, ExitantGrid};
use zonal::measure::{Assumptions, Budget, Provenance, Request, measure};
use zonal::optics::Rig;
use zonal::patterns::{Exitant, Plan};
use zonal::reflectance::{Brdf, open};
use zonal::twin::{Accuracy, TwinBench, TwinConfig};

/// A card with a certificate: at 1% it would hide all else.
fn assumed() -> Assumptions {
    Assumptions { card_rel: 0.002, card_source: Some("certificate".into()), stray_rel: 5e-4, ..Assumptions::default() }
}

/// Enough for 0.03% on materials without sharp lobes.
const ACCURACY: Accuracy = Accuracy { dome_nodes: 377, lobe_nodes: 233, sectors: 32, rings_per_lobe: 1.0 };

fn small(order: usize, count: u32) -> Plan {
    let mut plan = Plan { exitant: Exitant { rings: 6, sectors: 12 }, ..Plan::of_order(order) };
    let bracket = plan.exposure.as_mut().unwrap();
    (bracket.count, bracket.shortest_refreshes, bracket.spacing) = (count, 8, 2);
    plan
}

/// Standard normal numbers of one draw.
struct Normal(Xoshiro256PlusPlus);

impl Normal {
    fn next(&mut self, sigma: f64) -> f64 {
        let unit: f64 = StandardNormal.sample(&mut self.0);
        sigma * unit
    }
}

/// By how much the focal length must change to move the edge at theta_max by an angle, relative for 1 deg.
fn scale_per_deg(radius_px: impl Fn(f64) -> Option<f64>, theta_max: f64) -> f64 {
    let step = 0.1f64.to_radians();
    let r = |t: f64| radius_px(t).unwrap();
    let slope = (r(theta_max) - r(theta_max - step)) / step;
    slope * 1f64.to_radians() / r(theta_max)
}

/// A calibration whose response and flat field all draws share; each has a gray card of its own.
fn shared(rig: &Rig) -> CalibrationSet {
    let mut bench = TwinBench::with_accuracy(rig, TwinConfig::pinhole(1), open("gray-card").unwrap(), ACCURACY);
    CalibrationSet::make(rig, &mut bench, None, &mut |_, _| ()).unwrap()
}

/// A rig calibrated and used, everything drawn anew but the projector's response and flat field.
fn drawn(rig: &Rig, shared: &CalibrationSet, sample: &str, draw: u64, assumed: &Assumptions) -> Budget {
    let mut normal = Normal(Xoshiro256PlusPlus::seed_from_u64(1000 + draw));
    let theta_max = rig.zone().theta_max();
    let (projector, camera) = (rig.projector_map(), rig.camera_map());
    let mut aligned = TwinConfig::pinhole(3 * draw);
    let p = &mut aligned.perturbation;
    p.projector_scale_rel = normal.next(assumed.edge_deg * scale_per_deg(|t| projector.radius_px(t), theta_max));
    p.camera_scale_rel = normal.next(assumed.edge_deg * scale_per_deg(|t| camera.radius_px(t), theta_max));
    let px_per_deg = |radius: Option<f64>| radius.unwrap() / theta_max.to_degrees();
    let sigma = assumed.edge_deg * px_per_deg(projector.radius_px(theta_max));
    p.projector_offset_px = [normal.next(sigma), normal.next(sigma)];
    let mut mounted = |seed: u64| {
        let mut config = TwinConfig { seed, ..aligned.clone() };
        config.perturbation.sample_tilt_deg = [normal.next(assumed.tilt_deg), normal.next(assumed.tilt_deg)];
        config.perturbation.sample_height_mm = normal.next(assumed.height_mm);
        config.lamp_drift_per_min = normal.next(0.005);
        config.half_well_exposure_s *= 1.0 + normal.next(assumed.lamp_rel / 2f64.sqrt());
        config.card_albedo_error_rel = normal.next(assumed.card_rel);
        config
    };
    let bench = |config: TwinConfig| TwinBench::with_accuracy(rig, config, open(sample).unwrap(), ACCURACY);
    let mut card = bench(mounted(3 * draw + 1));
    let known = Known { response: &shared.response, flat: &shared.flat, sensor: None, trap: None, map: None };
    let (scale, check) = gray_card(rig, &mut card, &small(2, 1), known, &Reference::default(), &mut |_, _| ()).unwrap();
    let calibration = CalibrationSet { scale, check, ..shared.clone() };
    let provenance = Provenance { sample: sample.into(), assumed: assumed.clone(), ..Provenance::default() };
    let (plan, control) = (small(1, 1), Control::default());
    let request = Request {
        rig,
        plan: &plan,
        calibration: &calibration,
        provenance: &provenance,
        control: &control,
        adviser: None,
    };
    let measured = measure(&request, &mut bench(mounted(3 * draw + 2)), None, &mut |_, _| ()).unwrap();
    measured.record.budget.unwrap()
}

/// The true albedo of the zone, mean over the rings of the grid as the budget takes it, by channel.
fn truth(brdf: &dyn Brdf, grid: ExitantGrid) -> [f64; 3] {
    let (mut sum, mut total) = ([0.0; 3], 0.0);
    for ring in 0..grid.rings() {
        let theta = grid.theta(ring);
        let weight = theta.sin() * theta.cos();
        let z = common::true_coefficients(brdf, grid.zone(), 0, &Direction::from_angles(theta, 0.0));
        (0..3).for_each(|c| sum[c] += weight * z[c] * grid.zone().solid_angle().sqrt());
        total += weight;
    }
    sum.map(|s| s / total)
}

/// All draws. Threads of their own: a measurement waits for its devices, whose pictures need rayon's.
fn all_drawn(draws: u64, draw: impl Fn(u64) -> Budget + Sync) -> Vec<Budget> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from) as u64;
    std::thread::scope(|scope| {
        let draw = &draw;
        let workers: Vec<_> = (0..threads)
            .map(|t| scope.spawn(move || (t..draws).step_by(threads as usize).map(draw).collect::<Vec<_>>()))
            .collect();
        workers.into_iter().flat_map(|w| w.join().unwrap()).collect()
    })
}

/// What came of many draws.
pub struct Coverage {
    /// Share of draws whose 95% interval holds the truth, by channel.
    pub share: [f64; 3],
    /// RMS of errors over their standard uncertainties, by channel.
    pub spread: [f64; 3],
}

/// Draws rigs, calibrations and mounts and compares each budget's albedo with the truth.
pub fn coverage(draws: u64) -> Coverage {
    const SAMPLE: &str = "ggx-0.4";
    let rig = common::coarse(common::rig("ghosh-2007-built"), 4);
    let shared = shared(&rig);
    let Exitant { rings, sectors } = small(1, 1).exitant;
    let want = truth(open(SAMPLE).unwrap().as_ref(), ExitantGrid::new(rig.zone(), rings, sectors));
    let budgets = all_drawn(draws, |draw| drawn(&rig, &shared, SAMPLE, draw, &assumed()));
    let over = |value: &dyn Fn(&Budget) -> f64| budgets.iter().map(value).sum::<f64>() / budgets.len() as f64;
    let inside = |c: usize| {
        over(&|b| {
            let [low, high] = b.albedo.interval_95[c];
            f64::from(u8::from((low..=high).contains(&want[c])))
        })
    };
    let pull = |b: &Budget, c: usize| (b.albedo.value[c] - want[c]) / b.albedo.standard_uncertainty[c];
    let found =
        Coverage { share: [0, 1, 2].map(inside), spread: [0, 1, 2].map(|c| over(&|b| pull(b, c).powi(2)).sqrt()) };
    for (c, want) in want.iter().enumerate() {
        let sigma = over(&|b| b.albedo.standard_uncertainty[c] / want);
        eprintln!(
            "channel {c}: 95% intervals hold {:.1}% of {draws} draws; errors spread {:.2} of the uncertainty, {:.3}%",
            100.0 * found.share[c],
            found.spread[c],
            100.0 * sigma
        );
    }
    found
}
