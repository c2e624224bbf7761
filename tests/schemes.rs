//! Schemes of patterns on the simulated rig: the same information in fewer frames, what noise that costs, and where a scheme
//! fails. Black level, leakage and ambient light of the default devices are on.

mod common;

use std::sync::{Arc, LazyLock};

use zonal::basis::size;
use zonal::calibrate::{CalibrationSet, GRAY_CARD_ALBEDO, gray_card_coefficients};
use zonal::fit::ANISOTROPIC;
use zonal::forecast::NoiseModel;
use zonal::measure::{MeasureError, Measurement};
use zonal::optics::Rig;
use zonal::patterns::{Exitant, ExposureBracket, Plan, Scheme};
use zonal::reduce::{Coefficients, ReduceError};
use zonal::reflectance::{Brdf, open};
use zonal::twin::{TwinBench, TwinConfig};

static COARSE: LazyLock<Rig> = LazyLock::new(|| common::coarse(common::rig("ghosh-2007-built"), 2));
static CALIBRATION: LazyLock<CalibrationSet> = LazyLock::new(|| common::calibrated(&COARSE, &TwinConfig::pinhole(1)));

fn plan(order: usize, scheme: Scheme) -> Plan {
    Plan { exitant: Exitant { rings: 16, sectors: 32 }, ..Plan::of_order(order).by(scheme) }
}

fn run(plan: &Plan, config: &TwinConfig, sample: &str) -> Measurement {
    common::run(&COARSE, plan, config, &CALIBRATION, open(sample).unwrap())
}

/// RMS over all coefficients, cells and channels of the difference, over RMS z_00.
fn apart(a: &Coefficients, b: &Coefficients) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for (x, y) in a.values.iter().zip(&b.values) {
        let difference = f64::from(x - y);
        if difference.is_finite() {
            (sum, n) = (sum + difference * difference, n + 1.0);
        }
    }
    f64::sqrt(sum / n) / a.dc()
}

/// Of z_00: what pixels of twice the width and quantisation leave of a gray card without noise; most where a small function sits on
/// much light.
const CARD: f64 = 3e-3;

#[test]
fn every_scheme_measures_the_gray_card() {
    let zone = COARSE.zone();
    let want = gray_card_coefficients(zone, 4, GRAY_CARD_ALBEDO);
    for scheme in Scheme::ALL {
        let measured = run(&plan(4, scheme), &TwinConfig::pinhole(3).noiseless(), "gray-card").coefficients;
        let cells = measured.grid.len();
        for (k, want) in want.iter().enumerate().take(size(4)) {
            for channel in 0..3 {
                let plane = measured.plane(k, channel);
                let mean = plane.iter().map(|&z| f64::from(z)).sum::<f64>() / cells as f64;
                let off = (mean - want) / gray_card_coefficients(zone, 0, GRAY_CARD_ALBEDO)[0];
                assert!(off.abs() < CARD, "{scheme}, k = {k}: {off}");
            }
        }
    }
}

/// Noise-free coefficients of a glossy sample, of z_00: quantised patterns, and cells between which a lobe changes.
const SAME: f64 = 4e-3;

#[test]
fn all_schemes_tell_the_same() {
    let config = TwinConfig::pinhole(4).noiseless();
    let pairs = run(&plan(4, Scheme::Pairs), &config, "red-plastic").coefficients;
    for scheme in [Scheme::Offset, Scheme::Multiplexed, Scheme::Isotropic] {
        let other = run(&plan(4, scheme), &config, "red-plastic");
        let off = apart(&pairs, &other.coefficients);
        println!("{scheme}: {} frames, {:.3}% of z_00 from pairs", other.record.frames, 100.0 * off);
        assert!(off < SAME, "{scheme}: {off}");
    }
}

/// The lamp at which the camera's own noise prevails over that of the light, of the default.
const DIM: f64 = 1.0 / 64.0;
/// Predicted noise over measured: channels differ in sensitivity, the lamp falls off to the corners, ambient light adds.
const PREDICTED: f64 = 1.4;

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn flat_mixtures_need_six_tenths_of_the_frames_where_the_camera_limits() {
    let mut config = TwinConfig::pinhole(5);
    config.half_well_exposure_s /= DIM;
    // In the default light: frames that are dark and without noise are all alike.
    let quiet = TwinConfig::pinhole(5).noiseless();
    let pairs = plan(6, Scheme::Pairs);
    let mixed = Plan { repeats: 4, ..plan(6, Scheme::Isotropic) };
    let [first, second] = [&pairs, &mixed].map(|plan| {
        let noisy = run(plan, &config, "gray-card");
        let exact = run(plan, &quiet, "gray-card").coefficients;
        let predicted =
            NoiseModel::new(&COARSE, plan).unwrap().with_lamp(DIM).noise_rel(plan, GRAY_CARD_ALBEDO).unwrap();
        let stated = noisy.record.noise_rel;
        assert!(stated / predicted > 1.0 / PREDICTED && stated / predicted < PREDICTED, "{stated} {predicted}");
        // Rings of mixtures hold one error for all their cells: the mean over a ring is what fits see.
        let folded = |c: &Coefficients| zonal::fit::Observations::folded(c);
        let (a, b) = (folded(&noisy.coefficients), folded(&exact));
        let squares = a.stations.iter().zip(&b.stations).flat_map(|(s, t)| {
            s.z.iter().flatten().zip(t.z.iter().flatten()).map(|(x, y)| (x / DIM - y).powi(2)).collect::<Vec<_>>()
        });
        let error = (squares.sum::<f64>() / (3 * a.len()) as f64).sqrt() / b.dc();
        println!(
            "{}: {} frames, noise {stated:.4} (predicted {predicted:.4}), error of rings {error:.5}",
            plan.name, noisy.record.frames
        );
        (noisy.record.frames as f64, error)
    });
    assert!(second.0 <= 0.6 * first.0, "{} of {} frames", second.0, first.0);
    assert!(second.1 <= first.1, "{} against {}", second.1, first.1);
}

#[test]
fn mixtures_of_a_brushed_sample_say_that_it_is_not_isotropic() {
    let brushed = run(&plan(2, Scheme::Isotropic), &TwinConfig::pinhole(6), "ggx-0.1-0.4").record;
    assert!(brushed.anisotropy > ANISOTROPIC, "{}", brushed.anisotropy);
    let plastic = run(&plan(2, Scheme::Isotropic), &TwinConfig::pinhole(6), "red-plastic").record;
    assert!(plastic.anisotropy < ANISOTROPIC / 4.0, "{}", plastic.anisotropy);
}

/// A lamp that nothing watches drifts by this much in a minute.
const DRIFT_PER_MIN: f64 = 0.1;

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn a_drifting_lamp_spoils_lifted_functions_most() {
    let mut blind = COARSE.clone();
    blind.projector.tag = false;
    let calibration = common::calibrated(&blind, &TwinConfig::pinhole(1));
    let steady = TwinConfig::pinhole(7).noiseless();
    let mut drifting = steady.clone();
    drifting.lamp_drift_per_min = DRIFT_PER_MIN;
    let off = |scheme: Scheme, rig: &Rig, calibration: &CalibrationSet| {
        let plan = plan(4, scheme);
        let sample = || -> Arc<dyn Brdf> { open("red-plastic").unwrap() };
        let a = common::run(rig, &plan, &steady, calibration, sample()).coefficients;
        let b = common::run(rig, &plan, &drifting, calibration, sample()).coefficients;
        // What is left once the scale, which the budget accounts for, is taken out.
        let scale = |c: &Coefficients| c.plane(0, 1).iter().map(|&z| f64::from(z)).sum::<f64>();
        let factor = (scale(&a) / scale(&b)) as f32;
        let b = Coefficients { values: b.values.iter().map(|z| z * factor).collect(), ..b };
        apart(&a, &b)
    };
    let [pairs, offset, isotropic] =
        [Scheme::Pairs, Scheme::Offset, Scheme::Isotropic].map(|scheme| off(scheme, &blind, &calibration));
    println!("unwatched drift: pairs {pairs:.5}, offset {offset:.5}, isotropic {isotropic:.5} of z_00");
    assert!(offset > 3.0 * pairs, "{offset} {pairs}");
    let watched = off(Scheme::Offset, &COARSE, &CALIBRATION);
    println!("watched: offset {watched:.5}");
    assert!(watched < offset / 3.0, "{watched} {offset}");
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn saturation_costs_mixtures_whole_rings_and_pairs_their_constant() {
    let measured = |scheme, refreshes| {
        let long = ExposureBracket { count: 1, shortest_refreshes: refreshes, spacing: 4 };
        let plan = Plan { exposure: Some(long), ..plan(4, scheme) };
        let mut bench = TwinBench::new(&COARSE, TwinConfig::pinhole(8), open("ggx-0.1").unwrap());
        common::measured(&COARSE, &plan, &mut bench, &CALIBRATION, None).map(|m| m.coefficients)
    };
    let share = |c: &Coefficients| c.values.iter().filter(|z| z.is_finite()).count() as f64 / c.values.len() as f64;
    // White saturates first: some cells of the constant are lost, then nothing can be said at all.
    let pairs = measured(Scheme::Pairs, 8).unwrap();
    assert!(share(&pairs) < 1.0 && pairs.plane(2, 0).iter().all(|z| z.is_finite()));
    assert!(matches!(measured(Scheme::Pairs, 20), Err(MeasureError::Reduce(ReduceError::NoSignal { .. }))));
    // No mixture is that bright, but what one of its frames loses all functions of the ring lose.
    assert_eq!(share(&measured(Scheme::Isotropic, 8).unwrap()), 1.0);
    let mixed = measured(Scheme::Isotropic, 20).unwrap();
    println!("one long exposure of polished metal: {:.1}% of the rings are left", 100.0 * share(&mixed));
    assert!(share(&mixed) < 0.9);
    let sectors = mixed.grid.sectors();
    for k in 0..size(4) {
        for (ring, constant) in mixed.plane(k, 1).chunks(sectors).zip(mixed.plane(0, 1).chunks(sectors)) {
            assert!(ring.iter().all(|z| z.is_finite() == constant[0].is_finite()));
        }
    }
}
