//! Whole measurements on the simulated rig: the gray card against its analytic coefficients, other materials against
//! converged integrals. Measured materials follow in `corpus_measure.rs`.

mod common;

use std::sync::{Arc, LazyLock};

use zonal::calibrate::{CalibrationSet, GRAY_CARD_ALBEDO, GrayCardCheck, gray_card_coefficients};
use zonal::optics::{Mosaic, Rig};
use zonal::patterns::Plan;
use zonal::reduce::Coefficients;
use zonal::reflectance::{Brdf, Lambert, open};
use zonal::twin::TwinConfig;

static BUILT: LazyLock<Rig> = LazyLock::new(|| common::rig("ghosh-2007-built"));
static QUIET: LazyLock<CalibrationSet> = LazyLock::new(|| common::calibrated(&BUILT, &quiet()));

fn quiet() -> TwinConfig {
    TwinConfig::pinhole(1).noiseless()
}

fn gray_card() -> Arc<dyn Brdf> {
    Arc::new(Lambert { albedo: [GRAY_CARD_ALBEDO; 3] })
}

/// Of z_00, for the mean over directions of any coefficient in any channel; the thesis was off by 2% (z_10) and 10% (z_20).
const GRAY_CARD_WITHOUT_NOISE: f64 = 2e-3;
const GRAY_CARD_WITH_NOISE: f64 = 5e-3;

#[test]
fn gray_card_of_order_2_matches_its_analytic_values() {
    let noisy = TwinConfig::pinhole(1);
    let noisy_calibration = common::calibrated(&BUILT, &noisy);
    let cases = [(quiet(), &*QUIET, GRAY_CARD_WITHOUT_NOISE), (noisy, &noisy_calibration, GRAY_CARD_WITH_NOISE)];
    for (config, calibration, tolerance) in cases {
        // Other noise than the calibration had.
        let again = TwinConfig { seed: 2, ..config };
        let measured = common::run(&BUILT, &Plan::of_order(2), &again, calibration, gray_card());
        let check = GrayCardCheck::new(&measured.coefficients, GRAY_CARD_ALBEDO);
        eprintln!("noise {:.2}% of DC: {check:?}", 100.0 * measured.record.noise_rel);
        assert!(check.worst_error < tolerance, "{check:?}");
        assert_eq!(measured.record.saturated_fraction, 0.0);
        if !again.noise {
            assert_single_directions(&measured.coefficients);
        }
    }
}

/// Of z_00, without noise, over single directions: cells of a handful of pixels feel the projector's pixels and codes.
const GRAY_CARD_RMS: f64 = 1.5e-3;
const GRAY_CARD_WORST_DIRECTION: f64 = 5e-3;

fn assert_single_directions(measured: &Coefficients) {
    let want = gray_card_coefficients(measured.grid.zone(), measured.order, GRAY_CARD_ALBEDO);
    let n = 3 * measured.grid.len();
    let errors = measured.values.iter().enumerate().map(|(i, &z)| (f64::from(z) - want[i / n]).abs() / want[0]);
    let rms = (errors.clone().map(|e| e * e).sum::<f64>() / measured.values.len() as f64).sqrt();
    let worst = errors.fold(0.0, f64::max);
    eprintln!("single directions: RMS {:.3}%, worst {:.3}% of z_00", 100.0 * rms, 100.0 * worst);
    assert!(rms < GRAY_CARD_RMS && worst < GRAY_CARD_WORST_DIRECTION, "{rms} {worst}");
}

/// Standard errors are true: deviations of the gray card from its mean spread as they say, here within 5%.
#[test]
fn standard_errors_are_the_spread_of_the_noise() {
    let config = TwinConfig { seed: 3, ..TwinConfig::pinhole(1) };
    let measured = common::run(&BUILT, &Plan::of_order(1), &config, &QUIET, gray_card()).coefficients;
    let exact = common::run(&BUILT, &Plan::of_order(1), &quiet(), &QUIET, gray_card()).coefficients;
    let pulls =
        measured.values.iter().zip(&exact.values).zip(&measured.sigma).map(|((z, e), s)| f64::from((z - e) / s));
    let (sum, n) = pulls.fold((0.0, 0), |(sum, n), p| (sum + p * p, n + 1));
    let spread = (sum / f64::from(n)).sqrt();
    assert!((spread - 1.0).abs() < 0.05, "{spread} over {n} coefficients");
}

/// Of DC, RMS over functions and directions.
const AGAINST_INTEGRALS: f64 = 0.01;

fn assert_measured(rig: &Rig, calibration: &CalibrationSet, material: &str, order: usize) {
    let brdf = open(material).unwrap();
    let measured = common::run(rig, &Plan::of_order(order), &quiet(), calibration, brdf.clone()).coefficients;
    let grid = measured.grid;
    let (mut sum, mut dc, mut n) = (0.0, 0.0, 0.0);
    for ring in (0..grid.rings()).step_by(7) {
        for sector in [2 + ring % 5, grid.sectors() / 2 + ring % 7] {
            let cell = ring * grid.sectors() + sector;
            let truth = common::true_coefficients(brdf.as_ref(), grid.zone(), order, &grid.direction(cell));
            for c in 0..3 {
                for (k, z) in measured.spectrum(c, cell).into_iter().enumerate() {
                    sum += (z - truth[k * 3 + c]).powi(2);
                    n += 1.0;
                }
                dc += truth[c].powi(2) * measured.spectrum(c, cell).len() as f64;
            }
        }
    }
    let error = (sum / dc).sqrt();
    eprintln!("{material} on {}: {:.3}% of DC over {n} coefficients", rig.name, 100.0 * error);
    assert!(error < AGAINST_INTEGRALS, "{material}: {error}");
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn isotropic_and_anisotropic_materials_are_measured() {
    for material in ["red-plastic", "ggx-0.1-0.4"] {
        assert_measured(&BUILT, &QUIET, material, 3);
    }
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn the_full_zone_and_a_monochrome_camera_are_measured() {
    let mut rig = common::rig("ghosh-2007-full");
    rig.camera.mosaic = Mosaic::Mono;
    let calibration = common::calibrated(&rig, &quiet());
    assert!((calibration.check.white_balance[0] - 1.0).abs() < 1e-9, "one channel serves as three");
    assert_measured(&rig, &calibration, "ggx-0.4", 2);
}
