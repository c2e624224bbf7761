//! The simulated rig with finite pupils: what each effect does, what the design rule of footprints is worth, and whole
//! measurements through all of it. Shares, blur and cut pencils are held against exact tracing in `twin::finite`.

mod common;

use std::process::Command;
use std::sync::LazyLock;

use zonal::basis::{Harmonics, size};
use zonal::calibrate::{CalibrationSet, Devices, GRAY_CARD_ALBEDO, GrayCardCheck, Origin, gray_card_plan};
use zonal::geometry::{Direction, Zone};
use zonal::optics::{Device, Misaligned, Misalignment, Rig};
use zonal::patterns::Plan;
use zonal::reflectance::{Brdf, open};
use zonal::twin::{Accuracy, FiniteOptics, InverseMap, PatternLight, Pupils, ResponseField, TwinConfig};

/// Enough for order 2: 1% of z_00 for the worst coefficient and direction.
const QUICK: Accuracy = Accuracy { dome_nodes: 987, lobe_nodes: 987, sectors: 32, rings_per_lobe: 1.0 };

const NONE: FiniteOptics = FiniteOptics { footprints: false, blur: false, vignetting: false };

/// Pixels four times as wide, calibrated on the rig of pinholes: where figures do not count.
static COARSE: LazyLock<(Rig, CalibrationSet)> = LazyLock::new(|| {
    let rig = common::coarse(recommended(), 4);
    let calibration = common::calibrated(&rig, &TwinConfig::pinhole(1));
    (rig, calibration)
});

fn recommended() -> Rig {
    common::rig("ghosh-2007-built")
}

fn seed_like() -> Rig {
    common::rig("ghosh-2007-seed-projector")
}

/// The recommended rig with pupils of the same size.
fn equal_pupils() -> Rig {
    let mut rig = recommended();
    rig.projector.f_number = rig.projector.focal_length_mm / 2.0 / rig.camera.pupil_mm();
    rig
}

/// An aligned rig with a sample `height_mm` too high.
fn aligned(finite: FiniteOptics, height_mm: f64) -> TwinConfig {
    let perturbation = Misalignment { sample_height_mm: height_mm, ..Misalignment::none() };
    TwinConfig { perturbation, finite: Some(finite), ..TwinConfig::pinhole(0) }
}

fn deg(theta: f64, phi: f64) -> Direction {
    Direction::from_angles(theta.to_radians(), phi.to_radians())
}

/// Coefficients (`k * 3 + channel`) towards exitant directions as a projector of fine codes and a camera without error see
/// them; the panel shows the functions themselves.
fn coefficients(
    rig: &Rig,
    config: &TwinConfig,
    brdf: &dyn Brdf,
    order: usize,
    exitant: &[Direction],
    accuracy: &Accuracy,
) -> Vec<Vec<f64>> {
    let (p, map, zone) = (&rig.projector, rig.projector_map(), rig.zone());
    let basis = Harmonics::zonal(zone, order).unwrap();
    let radius = map.radius_px(rig.dome.theta_max_deg.to_radians()).unwrap() + 4.0;
    let origin = [p.width_px as f64 / 2.0 - radius, p.height_px as f64 / 2.0 - radius].map(|x| x as usize);
    let side = (2.0 * radius) as usize + 1;
    let mut values = vec![0.0; size(order)];
    let mut table = vec![0.0f32; side * side * size(order)];
    // The zone's edge runs through pixels: means over 4 x 4 points.
    for (pixel, row) in table.chunks_exact_mut(size(order)).enumerate() {
        let corner = [origin[0] + pixel % side, origin[1] + pixel / side].map(|x| x as f64);
        for i in 0..16 {
            let (u, v) = (corner[0] + (f64::from(i % 4) + 0.5) / 4.0, corner[1] + (f64::from(i / 4) + 0.5) / 4.0);
            let Some(wi) = map.direction(u, v).filter(|wi| zone.contains(wi.theta())) else { continue };
            basis.eval_direction_into(&wi, &mut values);
            row.iter_mut().zip(&values).for_each(|(sum, value)| *sum += *value as f32 / 16.0);
        }
    }
    let light = PatternLight::new(origin, [side, side], size(order), |k, column, row| {
        table[((row - origin[1]) * side + column - origin[0]) * size(order) + k]
    });
    let theta_max = rig.dome.theta_max_deg.to_radians();
    let inverse = InverseMap::new(&Misaligned::new(rig, &config.of_chief_rays(), Device::Projector), theta_max);
    let dome = Zone::new(rig.mirrors().shadow(rig.paraboloid_radius_mm()), theta_max).unwrap();
    let pupils = Pupils::new(rig, config);
    let field = ResponseField::through(brdf, &light, &inverse, pupils.as_ref(), dome, accuracy);
    let towards = |wo: &Direction| {
        let mut z = vec![0.0; 3 * size(order)];
        for channel in 0..3 {
            let mut row = vec![0.0f32; size(order)];
            field.add_radiance(wo, channel, 1.0, &mut row);
            let seen = pupils.as_ref().map_or(1.0, |pupils| pupils.transmitted(wo));
            row.iter().enumerate().for_each(|(k, value)| z[k * 3 + channel] = seen * f64::from(*value));
        }
        z
    };
    exitant.iter().map(towards).collect()
}

/// Directions over the zone.
fn directions() -> Vec<Direction> {
    (0..60).map(|i| deg(9.4 + 47.2 * f64::from(i) / 59.0, 137.5 * f64::from(i))).collect()
}

/// Largest difference of any coefficient, of z_00, over directions.
fn worst(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    let off = a.iter().zip(b).map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / b[0]);
    off.fold(0.0, f64::max)
}

/// RMS difference over the RMS of all coefficients.
fn relative(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    let (mut difference, mut all) = (0.0, 0.0);
    for (a, b) in a.iter().flatten().zip(b.iter().flatten()) {
        difference += (a - b).powi(2);
        all += b * b;
    }
    f64::sqrt(difference / all)
}

/// The published figures of a projector with the camera's pupil: the gray card seen at 55 deg keeps 61%, one pair 40%.
#[test]
fn equal_pupils_lose_what_is_not_lit() {
    let rig = equal_pupils();
    let only = |footprints| aligned(FiniteOptics { footprints, ..NONE }, 0.0);
    let pupils = Pupils::new(&rig, &only(true)).unwrap();
    let pair = pupils.lit_share(&deg(9.0, 180.0), &deg(57.0, 0.0));
    let card = open("gray-card").unwrap();
    let seen =
        |config: &TwinConfig| coefficients(&rig, config, card.as_ref(), 0, &[deg(55.0, 10.0), deg(9.5, 0.0)], &QUICK);
    let (lit, all) = (seen(&only(true)), seen(&only(false)));
    let [kept, near] = [0, 1].map(|i| lit[i][1] / all[i][1]);
    println!("wi 9, wo 57 deg keep {pair:.3}; the gray card keeps {kept:.3} at 55 deg, {near:.3} at 9.5 deg");
    assert!((pair - 0.40).abs() < 0.01 && (kept - 0.61).abs() < 0.01, "{pair} {kept}");
    assert!(near > kept, "the camera's footprint is smallest there: {near}");
}

/// Of z_00: what footprints may lose where the rule says that they lose nothing.
const NOTHING_LOST: f64 = 2e-4;

/// The rule .0363 r_p - .0748 r_c >= 1.70 dz: 0.2 mm with the recommended projector, 0.05 mm with one like the seed's.
#[test]
fn raised_samples_are_lit_as_far_as_the_rule_says() {
    let (card, glossy) = (open("gray-card").unwrap(), open("ggx-0.1").unwrap());
    let exitant = directions();
    for (rig, holds_to, loses_from) in [(recommended(), 0.2, 0.3), (seed_like(), 0.05, 0.1)] {
        let seen = |config: &TwinConfig, brdf: &dyn Brdf| coefficients(&rig, config, brdf, 2, &exitant, &QUICK);
        let pinhole = [seen(&aligned(NONE, 0.0), card.as_ref()), seen(&aligned(NONE, 0.0), glossy.as_ref())];
        println!("{}\n  dz, mm   gray card    unlit   ggx-0.1", rig.name);
        for height in [0.05, 0.1, 0.2, 0.3] {
            let finite = aligned(FiniteOptics::all(), height);
            let all_lit = aligned(FiniteOptics { footprints: false, ..FiniteOptics::all() }, height);
            let (z, lit) = (seen(&finite, card.as_ref()), seen(&all_lit, card.as_ref()));
            let (error, unlit) = (worst(&z, &pinhole[0]), worst(&z, &lit));
            let shiny = relative(&seen(&finite, glossy.as_ref()), &pinhole[1]);
            println!("  {height:6} {:10.3}% {:7.3}% {:8.3}%", 100.0 * error, 100.0 * unlit, 100.0 * shiny);
            assert!(height > holds_to || unlit < NOTHING_LOST, "{} at {height} mm: {unlit}", rig.name);
            assert!(height < loses_from || unlit > 10.0 * NOTHING_LOST, "{} at {height} mm: {unlit}", rig.name);
        }
    }
}

#[test]
fn each_effect_does_what_it_should() {
    let (card, sharp) = (open("gray-card").unwrap(), open("ggx-0.02").unwrap());
    let rig = equal_pupils();
    let exitant = [deg(8.93, 20.0), deg(30.0, 20.0), deg(56.0, 20.0)];
    let seen =
        |finite: FiniteOptics, brdf: &dyn Brdf| coefficients(&rig, &aligned(finite, 0.0), brdf, 2, &exitant, &QUICK);
    let plain = seen(NONE, card.as_ref());
    let shaded = seen(FiniteOptics { footprints: true, ..NONE }, card.as_ref());
    let kept = [0, 1, 2].map(|i| shaded[i][0] / plain[i][0]);
    assert!(kept[0] < 1.005 && kept[1] < 0.99 && kept[2] < 0.7, "unlit footprints only take light away: {kept:?}");
    let cut = seen(FiniteOptics { vignetting: true, ..NONE }, card.as_ref());
    let kept = [0, 1].map(|i| cut[i][0] / plain[i][0]);
    assert!(kept[0] < 0.97 && (kept[1] - 1.0).abs() < 0.01, "pencils are cut at the shadow's end: {kept:?}");
    let blurred = seen(FiniteOptics { blur: true, ..NONE }, card.as_ref());
    assert!(worst(&blurred, &plain) < 0.02, "blur hardly changes a diffuser: {}", worst(&blurred, &plain));

    // A camera of f/2, whose blur a series of order 6 feels.
    let mut wide = recommended();
    wide.camera.f_number = 2.0;
    let accuracy = Accuracy { sectors: 96, ..QUICK };
    let [plain, blurred] = [false, true].map(|blur| {
        let config = aligned(FiniteOptics { blur, ..NONE }, 0.0);
        coefficients(&wide, &config, sharp.as_ref(), 6, &directions(), &accuracy)
    });
    let fine = |z: &[Vec<f64>]| z.iter().flat_map(|z| &z[3 * size(4)..]).map(|z| z * z).sum::<f64>();
    let left = fine(&blurred) / fine(&plain);
    println!("{:.3} of the light at the shadow's end; blur leaves {left:.4} of a sharp lobe's fine detail", kept[0]);
    assert!((0.9..0.9995).contains(&left), "blur takes fine detail away: {left}");
}

/// One sample of the pupil for each node of a lattice: against twice of everything, RMS of DC.
#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn pupils_are_sampled_finely_enough() {
    let (rig, height) = (recommended(), 0.05);
    let brdf = open("gray-card").unwrap();
    let config = aligned(FiniteOptics::all(), height);
    let seen = |accuracy| coefficients(&rig, &config, brdf.as_ref(), 2, &directions(), &accuracy);
    let (usual, doubled) = (seen(Accuracy::default()), seen(Accuracy::doubled()));
    let dc = doubled.iter().map(|z| z[0] * z[0]).sum::<f64>() / doubled.len() as f64;
    let squares = usual.iter().flatten().zip(doubled.iter().flatten()).map(|(a, b)| (a - b).powi(2));
    let n = usual.iter().map(Vec::len).sum::<usize>() as f64;
    let change = (squares.sum::<f64>() / n / dc).sqrt();
    println!("gray card on {} at {height} mm: {:.3}% of DC when doubled", rig.name, 100.0 * change);
    assert!(change < 2e-3, "{change}");
}

/// Without its effects the rig is the one of pinholes to the last bit; with them it is another.
#[test]
fn finite_without_its_effects_is_pinhole() {
    let (rig, calibration) = &*COARSE;
    let pinhole = TwinConfig::pinhole(3);
    let plan = Plan { exitant: gray_card_plan(rig).exitant, ..Plan::of_order(1) };
    let seen =
        |config: &TwinConfig| common::run(rig, &plan, config, calibration, open("ggx-0.2").unwrap()).coefficients;
    let plain = seen(&pinhole);
    assert_eq!(seen(&TwinConfig { finite: Some(NONE), ..pinhole.clone() }), plain);
    assert_ne!(seen(&TwinConfig { finite: Some(FiniteOptics::all()), ..pinhole.clone() }), plain);

    // Records say which it was, and those of pinholes have the keys they always had.
    let json = serde_json::to_value(&pinhole).unwrap();
    assert!(json["twin"] == "pinhole" && json.get("finite").is_none(), "{json}");
    let json = serde_json::to_value(TwinConfig::finite(3)).unwrap();
    assert!(json["twin"] == "finite" && json["finite"]["blur"] == true, "{json}");
    assert_eq!(serde_json::from_value::<TwinConfig>(json).unwrap(), TwinConfig::finite(3));
}

/// Of z_00, for the mean over directions of any coefficient in any channel.
const GRAY_CARD: f64 = 5e-3;

/// The gray card measured through everything, calibrated on the same twin, with stray light and with what a black trap
/// leaves of it.
fn gray_card_errors(rig: &Rig) -> [f64; 2] {
    let config = TwinConfig::finite(1);
    let again = TwinConfig { seed: 2, ..config.clone() };
    let plan = gray_card_plan(rig);
    let error = |set: &CalibrationSet| {
        let measured = common::run(rig, &plan, &again, set, open("gray-card").unwrap());
        let check = GrayCardCheck::new(&measured.coefficients, GRAY_CARD_ALBEDO);
        println!("{check:?}");
        check.worst_error
    };
    let set = common::calibrated(rig, &config);
    let without = error(&set);
    let with = error(&common::with_black_trap(rig, &config, set, &plan));
    println!("{}: gray card off by {:.3}%, by {:.3}% with a black trap", rig.name, 100.0 * without, 100.0 * with);
    [without, with]
}

/// What finite optics alone do to the gray card after its z_00 has been scaled; most of it is the sample's 0.05 mm.
#[test]
fn finite_pupils_cost_the_gray_card_little() {
    let (rig, card) = (recommended(), open("gray-card").unwrap());
    let exitant: Vec<Direction> = (0..96).map(|i| deg(10.0 + 0.48 * f64::from(i), 137.5 * f64::from(i))).collect();
    let mean = |config: &TwinConfig| {
        let z = coefficients(&rig, config, card.as_ref(), 2, &exitant, &Accuracy::default());
        let sum = |k: usize| z.iter().map(|z| z[3 * k]).sum::<f64>() / z.len() as f64;
        (0..9).map(|k| sum(k) / sum(0)).collect::<Vec<_>>()
    };
    let pinhole = mean(&aligned(NONE, 0.0));
    for (name, config) in [("in its place", aligned(FiniteOptics::all(), 0.0)), ("everything", TwinConfig::finite(0))] {
        let off: Vec<f64> = mean(&config).iter().zip(&pinhole).map(|(z, p)| z - p).collect();
        let percent: Vec<f64> = off.iter().map(|z| 100.0 * z).collect();
        println!("{name}: {percent:+.3?}% of z_00");
        assert!(off.iter().all(|z| z.abs() < GRAY_CARD), "{name}: {off:?}");
    }
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn the_gray_card_is_right_on_the_rig_as_it_is() {
    let [without, with] = gray_card_errors(&recommended());
    assert!(without < GRAY_CARD && with < GRAY_CARD, "{without} {with}");
}

#[test]
fn the_command_line_takes_finite_and_nothing_unknown() {
    let folder = tempfile::tempdir().unwrap();
    let (rig, calibration) = &*COARSE;
    let origin = Origin { date: jiff::Timestamp::now(), devices: Devices::Simulated { seed: 1 } };
    calibration.clone().made(rig, &origin).write(&folder.path().join("made"), rig).unwrap();
    std::fs::write(folder.path().join("rig.toml"), rig.to_toml()).unwrap();
    let plan = Plan { exitant: gray_card_plan(rig).exitant, ..Plan::of_order(0) };
    std::fs::write(folder.path().join("plan.toml"), plan.to_toml()).unwrap();
    let zonal = |line: &str| {
        let words = line.split(' ').collect::<Vec<_>>();
        Command::new(env!("CARGO_BIN_EXE_zonal")).current_dir(folder.path()).args(words).output().unwrap()
    };
    let measure = "measure rig.toml plan.toml --simulate gray-card --calibration made --seed 5 --out run --twin";
    for line in [format!("{measure} finit"), "calibrate response rig.toml --simulate --out cal --twin finit".into()] {
        let refused = zonal(&line);
        let said = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{said}");
        assert!(said.contains("--twin finit") && said.contains("pinhole or finite"), "{said}");
    }
    assert!(!folder.path().join("run").exists() && !folder.path().join("cal").exists());
    let done = zonal(&format!("{measure} finite"));
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let record: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("run/run.json")).unwrap()).unwrap();
    let simulation = &record["provenance"]["simulation"];
    assert!(simulation["twin"] == "finite" && simulation["seed"] == 5, "{simulation}");
    let done = zonal("calibrate response rig.toml --simulate --out cal --twin finite");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
}
