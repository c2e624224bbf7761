//! Calibrations on the simulated rig: what they find against what the twin was given.

mod common;

use std::sync::{Arc, LazyLock};

use zonal::calibrate::{
    Acceptance, CalibrationSet, CameraFigures, Devices, GRAY_CARD_ALBEDO, GrayCardCheck, Known, Origin, Reference,
    ResponseMethod, black_trap, camera_codes, colour, fingerprint, gray_card, gray_card_plan, noise,
};
use zonal::optics::Rig;
use zonal::patterns::Plan;
use zonal::radiometry::ColourSpace;
use zonal::reflectance::{Ggx, Lambert, open};
use zonal::twin::{SensorTruth, TwinBench, TwinConfig};

/// Pixels four times as wide: what does not depend on their number is tested faster.
static COARSE: LazyLock<Rig> = LazyLock::new(|| common::coarse(common::rig("ghosh-2007-built"), 4));
/// Twice as wide: figures of a camera come from many pixels.
static FINER: LazyLock<Rig> = LazyLock::new(|| common::coarse(common::rig("ghosh-2007-built"), 2));

static QUIET: LazyLock<CalibrationSet> = LazyLock::new(|| common::calibrated(&COARSE, &quiet()));

fn quiet() -> TwinConfig {
    TwinConfig::pinhole(1).noiseless()
}

fn bench(config: &TwinConfig) -> TwinBench {
    TwinBench::new(&COARSE, config.clone(), open("gray-card").unwrap())
}

fn known(set: &CalibrationSet) -> Known<'_> {
    let (trap, map) = (set.black_trap.as_ref(), set.map.as_ref());
    Known { response: &set.response, flat: &set.flat, sensor: set.sensor.as_ref(), trap, map }
}

/// Of z_00, with stray light of 1% taken off; the rest is what the twin leaves without stray light.
const WITH_TRAP: f64 = 5e-3;

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn stray_light_is_taken_off() {
    let config = TwinConfig { stray_share: 0.01, ..TwinConfig::pinhole(3) };
    let mut set = common::calibrated(&FINER, &config);
    let plan = gray_card_plan(&FINER);
    let worst = |set: &CalibrationSet| {
        let again = TwinConfig { seed: 4, ..config.clone() };
        let measured = common::run(&FINER, &plan, &again, set, open("gray-card").unwrap());
        GrayCardCheck::new(&measured.coefficients, GRAY_CARD_ALBEDO).worst_error
    };
    let without = worst(&set);
    let mut bench = TwinBench::new(&FINER, config.clone(), open("gray-card").unwrap());
    let trap = black_trap(&FINER, &mut bench, &plan, known(&set), &mut |_, _| ()).unwrap();
    set.black_trap = Some(trap);
    let card = gray_card(&FINER, &mut bench, &plan, known(&set), &Reference::default(), &mut |_, _| ()).unwrap();
    (set.scale, set.check) = card;
    let with = worst(&set);
    eprintln!("worst error of the gray card: {:.3}% without, {:.3}% with the trap", 100.0 * without, 100.0 * with);
    assert!(with < WITH_TRAP && without > 1.5 * with, "{without} {with}");

    let finer = Plan { order: 3, ..plan };
    let refused = common::measured(&FINER, &finer, &mut bench, &set, None).err().unwrap();
    let said = refused.to_string();
    assert!(said.contains("--plan") && said.contains("order 3"), "{said}");
}

/// Relative, of figures found again: gain from some 30 levels of 8192 pixels; dark noise with the ambient light of one
/// refresh; ends of ranges with steps of 1.3%.
const GAIN: f64 = 0.02;
const DARK_NOISE: f64 = 0.1;
const RANGE: f64 = 0.02;

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn the_camera_is_found_again() {
    let truth = SensorTruth {
        gain: 1.12,
        dark_noise: 1.3,
        full_well: 0.8,
        black_level_dn: 5.0,
        hot_share: 5e-4,
        hot_e_s: 5e3,
        dsnu_e: 2.0,
        prnu_rel: 0.005,
        seed: 7,
        ..SensorTruth::default()
    };
    let config = TwinConfig { sensor: truth, ..TwinConfig::pinhole(5) };
    let mut bench = TwinBench::new(&FINER, config.clone(), open("gray-card").unwrap());
    let (figures, maps) = noise(&FINER, &mut bench).unwrap();
    let found = figures.of_rig(&FINER).camera;
    let c = &FINER.camera;
    let saturation = c.black_level_dn + 5.0 + c.gain_dn_per_e * 1.12 * c.full_well_e * 0.8;
    let measured = figures.noise.as_ref().unwrap();
    let off = |found: f64, true_: f64| (found / true_ - 1.0).abs();
    eprintln!("{figures:?}\nsaturation {saturation:.0} DN, limit {:.0} DN", found.linear_limit_dn);
    assert!(off(found.gain_dn_per_e, 1.12 * c.gain_dn_per_e) < GAIN, "{found:?}");
    assert!(off(found.dark_noise_e, 1.3 * c.dark_noise_e) < DARK_NOISE, "{found:?}");
    assert!((found.black_level_dn - c.black_level_dn - 5.0).abs() < 1.5, "{found:?}");
    assert!(off(measured.saturation_dn, saturation) < RANGE, "{measured:?}");
    assert!(off(found.linear_limit_dn, saturation) < RANGE && found.linear_limit_dn < saturation, "{found:?}");
    assert!(measured.transfer.linearity_error_rel < 0.005, "{measured:?}");

    let crop = zonal::capture::Crop::of_zone(&FINER);
    let hot = bench.hot_pixels();
    let zone: Vec<usize> =
        (0..crop.len()).map(|p| crop.sensor_pixel(p)).map(|(u, v)| v * FINER.camera.width_px + u).collect();
    let all = zone.iter().filter(|&&i| hot[i]).count();
    let masked = zone.iter().filter(|&&i| hot[i] && maps.bad[i]).count();
    let wrong = zone.iter().filter(|&&i| !hot[i] && maps.bad[i]).count();
    eprintln!("{masked} of {all} hot pixels found, {wrong} others");
    assert!(all > 20 && masked == all && wrong < 5, "{masked} of {all}, {wrong}");

    // Measured with its own figures, the camera sees the gray card as it is; with the file's, its range is overrun.
    let mut set = CalibrationSet::make(&figures.of_rig(&FINER), &mut bench, None, &mut |_, _| ()).unwrap();
    (set.camera, set.sensor) = (Some(figures), Some(maps));
    let measured = common::run(&FINER, &gray_card_plan(&FINER), &config, &set, open("gray-card").unwrap());
    let check = GrayCardCheck::new(&measured.coefficients, GRAY_CARD_ALBEDO);
    assert!(check.worst_error < WITH_TRAP, "{check:?}");
}

/// Relative, of what a code means, which is 0.9% of it at mid-gray; Robertson's curve is not smooth.
const CODE: f64 = 0.02;
const ROUGH_CODE: f64 = 0.06;
/// Of z_00: what is left of the curve's errors, and black levels of codes as coarse as noise.
const OF_CODES: f64 = 0.01;

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn a_camera_of_codes_is_made_linear() {
    let truth = SensorTruth { gamma: 2.2, ..SensorTruth::default() };
    let config = TwinConfig { sensor: truth, ..TwinConfig::pinhole(6) };
    let mut bench = TwinBench::new(&FINER, config.clone(), open("gray-card").unwrap());
    let c = &FINER.camera;
    let light = |code: usize| f64::from(c.white_dn()) * (code as f64 / 255.0).powf(2.2) - c.black_level_dn;
    for (method, most) in [(ResponseMethod::Robertson, ROUGH_CODE), (ResponseMethod::Debevec, CODE)] {
        let codes = camera_codes(&FINER, &mut bench, method).unwrap();
        let off = |z: usize| (codes[z] / codes[128] * light(128) / light(z) - 1.0).abs();
        let worst = (48..=240).map(off).fold(0.0, f64::max);
        eprintln!("{method:?}: codes 48..=240 off by {:.2}% at most", 100.0 * worst);
        assert!(worst < most, "{method:?}: {worst}");
        if method == ResponseMethod::Debevec {
            let figures = CameraFigures { codes: Some(codes), ..CameraFigures::default() };
            let (mut measured, sensor) = noise(&figures.of_rig(&FINER), &mut bench).unwrap();
            measured.codes = figures.codes;
            let mut set = CalibrationSet::make(&measured.of_rig(&FINER), &mut bench, None, &mut |_, _| ()).unwrap();
            (set.camera, set.sensor) = (Some(measured), Some(sensor));
            let run = common::run(&FINER, &gray_card_plan(&FINER), &config, &set, open("gray-card").unwrap());
            let check = GrayCardCheck::new(&run.coefficients, GRAY_CARD_ALBEDO);
            eprintln!("gray card off by {:.3}%", 100.0 * check.worst_error);
            assert!(check.worst_error < OF_CODES, "{check:?}");
        }
    }
    // One whose samples are linear is told so.
    let mut linear = TwinBench::new(&FINER, TwinConfig::pinhole(6), open("gray-card").unwrap());
    let told = camera_codes(&FINER, &mut linear, ResponseMethod::Debevec).unwrap_err().to_string();
    assert!(told.contains("zonal calibrate linearity"), "{told}");
}

/// Of the albedo, in the projector's colours.
const COLOURS: f64 = 0.01;

#[test]
fn colours_of_the_projector_come_back() {
    let crosstalk = [[0.85, 0.12, 0.03], [0.1, 0.8, 0.1], [0.02, 0.13, 0.85]];
    let config = TwinConfig { crosstalk, ..quiet() };
    let mut set = common::calibrated(&COARSE, &config);
    let matrix = colour(&COARSE, &mut bench(&config)).unwrap();
    for (found, want) in matrix.matrix.iter().flatten().zip(crosstalk.iter().flatten()) {
        assert!((found - want).abs() < 2e-3, "{matrix:?}");
    }
    let albedo = [0.6, 0.05, 0.02];
    let red = || Arc::new(Lambert { albedo });
    let plan = Plan { order: 0, ..gray_card_plan(&COARSE) };
    let refused =
        common::measured(&COARSE, &plan.clone().in_colours(ColourSpace::Projector), &mut bench(&config), &set, None);
    assert!(refused.err().unwrap().to_string().contains("zonal calibrate colour"));
    set.colour = Some(matrix);
    let seen = |space| {
        let measured = common::run(&COARSE, &plan.clone().in_colours(space), &config, &set, red()).coefficients;
        assert_eq!(measured.colour_space(), space);
        let n = measured.grid.len();
        let unit = zonal::calibrate::gray_card_coefficients(measured.grid.zone(), 0, 1.0)[0];
        let mean = |c: usize| measured.plane(0, c).iter().map(|&z| f64::from(z)).sum::<f64>() / n as f64 / unit;
        [0, 1, 2].map(mean)
    };
    let (camera, projector) = (seen(ColourSpace::Camera), seen(ColourSpace::Projector));
    eprintln!("camera {camera:?}, projector {projector:?}");
    for c in 0..3 {
        let mixed: f64 = (0..3).map(|p| crosstalk[c][p] * albedo[p]).sum();
        assert!((camera[c] / mixed - 1.0).abs() < COLOURS, "{c}: {} {mixed}", camera[c]);
        assert!((projector[c] / albedo[c] - 1.0).abs() < COLOURS, "{c}: {projector:?}");
    }
}

/// Of z_00: the midpoint rule of the reference, and the twin; single coefficients err four times as much on wide pixels.
const REFERENCE: f64 = 5e-3;

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn a_reference_that_shines_sets_the_same_scale() {
    let coated = Arc::new(Ggx::isotropic(0.4, [0.05; 3]).on_lambert(1.0, [0.18; 3]));
    let config = quiet();
    let set = &*QUIET;
    let mut bench = bench(&config).with_card(coated.clone());
    let plan = gray_card_plan(&COARSE);
    let reference = Reference::of("coated card", coated, 1.0);
    let mut worst = |reference: &Reference| {
        let (scale, check) = gray_card(&COARSE, &mut bench, &plan, known(set), reference, &mut |_, _| ()).unwrap();
        let zone = COARSE.zone();
        let at = |f: f64| zone.theta_min() + f * (zone.theta_max() - zone.theta_min());
        let off = |f: f64| (scale.at(&zone, at(f), 1) / set.scale.at(&zone, at(f), 1) - 1.0).abs();
        ([0.1, 0.5, 0.9].map(off).into_iter().fold(0.0, f64::max), check.worst_error)
    };
    let (known_off, known_error) = worst(&reference);
    let (ideal_off, ideal_error) = worst(&Reference::default());
    eprintln!("scale off by {:.3}% and {:.3}% if taken as ideal", 100.0 * known_off, 100.0 * ideal_off);
    assert!(known_off < REFERENCE && known_error < 4.0 * REFERENCE, "{known_off} {known_error}");
    assert!(ideal_off > 10.0 * REFERENCE && ideal_error > 2.0 * REFERENCE, "{ideal_off} {ideal_error}");
}

#[test]
fn sets_survive_their_files() {
    let rig = COARSE.clone();
    let origin = Origin { date: "2026-05-01T08:30:00Z".parse().unwrap(), devices: Devices::Simulated { seed: 9 } };
    let set = QUIET.clone().made(&rig, &origin);
    let folder = tempfile::tempdir().unwrap();
    set.write(folder.path(), &rig).unwrap();
    let accept = Acceptance { simulated: Some(true), freshness: None };
    assert_eq!(CalibrationSet::read_for(folder.path(), &rig, &accept).unwrap(), set);
    let text = std::fs::read_to_string(folder.path().join("response.json")).unwrap();
    assert!(text.contains(&fingerprint(&rig)) && text.contains("2026-05-01T08:30:00Z"), "{text}");
}
