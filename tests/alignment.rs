//! Alignment and maps of misaligned simulated rigs: what is out of place is found, and measurements then are right.

mod common;

use std::sync::{Arc, LazyLock};

use zonal::calibrate::{AxisAlignment, CalibrationSet, RigMap, align, map};
use zonal::fit::{FitMethod, FitOptions, fit};
use zonal::optics::{Device, Misaligned, Misalignment, Mosaic, Rig};
use zonal::patterns::Plan;
use zonal::radiometry::Response;
use zonal::reflectance::{Ggx, open};
use zonal::twin::{TwinBench, TwinConfig};

static BUILT: LazyLock<Rig> = LazyLock::new(|| common::rig("ghosh-2007-built"));

fn bench(rig: &Rig, m: Misalignment, seed: u64) -> TwinBench {
    let config = TwinConfig { perturbation: m, ..TwinConfig::pinhole(seed) };
    TwinBench::new(rig, config, open("gray-card").unwrap())
}

/// The twin's own response: what `calibrate response` finds to 0.1%.
fn response() -> Response {
    let twin = TwinConfig::pinhole(0);
    Response::from_levels((0..=255).map(|c| twin.response(c)).collect(), twin.contrast).unwrap()
}

/// 0.5 mm in some direction, 0.2 deg about some axis.
fn displaced(azimuth_deg: f64) -> [f64; 2] {
    let (s, c) = azimuth_deg.to_radians().sin_cos();
    [0.5 * c, 0.5 * s]
}

fn turned(azimuth_deg: f64) -> [f64; 2] {
    displaced(azimuth_deg).map(|x| 0.4 * x)
}

fn default_rig() -> Misalignment {
    TwinConfig::pinhole(0).perturbation
}

fn everything() -> Misalignment {
    Misalignment {
        paraboloid_offset_mm: displaced(140.0),
        camera_displacement_mm: displaced(10.0),
        projector_displacement_mm: displaced(-110.0),
        camera_turn_deg: turned(70.0),
        projector_turn_deg: turned(-30.0),
        sample_tilt_deg: turned(200.0),
        ..default_rig()
    }
}

/// What an alignment must tell: a tenth of what may be off.
const ALIGN_MM: f64 = 0.05;
const ALIGN_DEG: f64 = 0.02;

fn assert_aligned(found: &AxisAlignment, truth: &Misalignment) {
    let off = |got: [f64; 2], want: [f64; 2]| (got[0] - want[0]).abs().max((got[1] - want[1]).abs());
    let wrong = [
        off(found.camera.displacement_mm, truth.camera_displacement_mm),
        off(found.camera.turn_deg, truth.camera_turn_deg),
        off(found.projector.displacement_mm, truth.projector_displacement_mm),
        off(found.projector.turn_deg, truth.projector_turn_deg),
    ];
    println!(
        "camera off by {:.4} mm, {:.4} deg, projector by {:.4} mm, {:.4} deg",
        wrong[0], wrong[1], wrong[2], wrong[3]
    );
    assert!(wrong[0] < ALIGN_MM && wrong[2] < ALIGN_MM, "{wrong:?} {found:?}");
    assert!(wrong[1] < ALIGN_DEG && wrong[3] < ALIGN_DEG, "{wrong:?} {found:?}");
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn crosses_tell_where_devices_stand() {
    // Other directions than `everything` has.
    let m = Misalignment {
        camera_displacement_mm: displaced(-90.0),
        camera_turn_deg: turned(0.0),
        projector_displacement_mm: displaced(60.0),
        projector_turn_deg: turned(160.0),
        ..Misalignment::none()
    };
    let found = align(&BUILT, &mut bench(&BUILT, m, 1)).unwrap();
    assert_aligned(&found, &m);
    let said = found.camera.instruction("camera");
    assert!(said.contains("move the camera 0.50 mm towards +y; turn the camera 0.20 deg about x"), "{said}");
}

/// RMS over the zone, and the zone's ends.
const MAP_DEG: f64 = 0.05;

/// Share of the zone that must show fringes if its edges are right: a pixel too many all around would be 1.5%.
const SEEN: f64 = 0.995;

/// RMS angle between a map and the truth over the zone of one device, and of the nominal map.
fn map_error_deg(rig: &Rig, truth: &Misalignment, found: &RigMap, device: Device) -> [f64; 2] {
    let traced = Misaligned::new(rig, truth, device);
    let (maps, panel) = match device {
        Device::Camera => ([found.camera_map(rig), rig.camera_map()], (rig.camera.width_px, rig.camera.height_px)),
        Device::Projector => {
            ([found.projector_map(rig), rig.projector_map()], (rig.projector.width_px, rig.projector.height_px))
        }
    };
    let [mut sums, mut n] = [[0.0; 2], [0.0; 2]];
    for p in (0..panel.0 * panel.1).step_by(7) {
        let (u, v) = ((p % panel.0) as f64 + 0.5, (p / panel.0) as f64 + 0.5);
        let Some(want) = traced.direction(u, v).filter(|d| rig.zone().contains(d.theta())) else { continue };
        for (i, map) in maps.iter().enumerate() {
            if let Some(got) = map.direction(u, v) {
                sums[i] += (got.vector() - want.vector()).norm_squared();
                n[i] += 1.0;
            }
        }
    }
    assert!(n[0] > 1000.0);
    [0, 1].map(|i| f64::sqrt(sums[i] / n[i]).to_degrees())
}

fn assert_mapped(m: Misalignment, seed: u64) {
    let mut bench = bench(&BUILT, m, seed);
    let known = align(&BUILT, &mut bench).unwrap();
    assert_aligned(&known, &m);
    let found = map(&BUILT, &mut bench, &response(), Some(&known)).unwrap();
    let ends = [Device::Camera, Device::Projector].map(|d| Misaligned::new(&BUILT, &m, d).edges(512).usable());
    let ends = [ends[0][0].max(ends[1][0]), ends[0][1].min(ends[1][1])].map(f64::to_degrees);
    println!(
        "{} + {} pairs, residuals {:.4?} px, errors said {:.4?}",
        found.pairs[0], found.pairs[1], found.residual_px, found.direction_error_deg
    );
    println!("zone {:.3?} +- {:.3?}, true {ends:.3?}", found.zone_deg, found.zone_error_deg);
    println!("fringes in {:.2}% of it", 100.0 * found.seen_share);
    assert!(found.seen_share > SEEN);
    for device in [Device::Camera, Device::Projector] {
        let [with, without] = map_error_deg(&BUILT, &m, &found, device);
        println!("{device:?}: {with:.4} deg RMS with the map, {without:.3} without");
        assert!(with < MAP_DEG, "{device:?}: {with} deg");
    }
    for (got, want) in found.zone_deg.iter().zip(ends) {
        assert!((got - want).abs() < MAP_DEG, "{:?} {ends:?}", found.zone_deg);
    }
}

#[test]
fn the_default_rig_is_mapped() {
    assert_mapped(default_rig(), 1);
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn a_rig_with_everything_out_of_place_is_mapped() {
    assert_mapped(everything(), 2);
}

/// A camera of half the resolution without colour filters: as many pixels for each colour, a fourth of the work.
fn coarse() -> Rig {
    let mut rig = BUILT.clone();
    rig.camera.pitch_um *= 2.0;
    (rig.camera.width_px, rig.camera.height_px) = (rig.camera.width_px / 2, rig.camera.height_px / 2);
    rig.camera.mosaic = Mosaic::Mono;
    rig
}

/// Of alpha: what the calibrated maps must leave.
const ALPHA: f64 = 0.01;

/// Sharp lobes at a low order live from the zone's edges: without its map a misaligned rig gets them wrong.
#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn a_misaligned_rig_with_its_map_measures_sharp_lobes() {
    let mut rig = coarse();
    let config = TwinConfig { perturbation: everything(), ..TwinConfig::pinhole(3) };
    let mut bench = TwinBench::new(&rig, config.clone(), open("gray-card").unwrap());
    let known = align(&rig, &mut bench).unwrap();
    let found = map(&rig, &mut bench, &response(), Some(&known)).unwrap();
    // The decentred paraboloid shadows the nominal zone: told, with what to ask for instead.
    let refused = found.check_zone(&rig).unwrap_err().to_string();
    assert!(refused.contains("9.00..57.00 deg") && refused.contains("zone.theta_min_deg"), "{refused}");
    rig.zone.theta_min_deg = 9.7;
    found.check_zone(&rig).unwrap();

    let mut bench = TwinBench::new(&rig, config.clone(), open("gray-card").unwrap());
    let quiet = TwinConfig { seed: 4, ..config }.noiseless();
    let glossy = Ggx::isotropic(0.05, [0.5; 3]).on_lambert(0.8, [0.2; 3]);
    let [with, without] = [Some(found), None].map(|map| {
        let calibration = CalibrationSet::make(&rig, &mut bench, map, &mut |_, _| ()).unwrap();
        let measured = common::run(&rig, &Plan::of_order(2), &quiet, &calibration, Arc::new(glossy.clone()));
        let report = fit(&measured.coefficients, FitMethod::Ggx, &FitOptions::default()).unwrap();
        println!("chi {:.2}, {:?}", report.chi, report.parameters);
        // Without a map the sample may look brushed.
        let alpha = report.parameters.get("alpha").or(report.parameters.get("alpha_x")).unwrap();
        alpha / 0.05 - 1.0
    });
    println!("alpha is off by {:.2}% with the map, {:.1}% without", 100.0 * with, 100.0 * without);
    assert!(with.abs() < ALPHA && without.abs() > 5.0 * ALPHA, "{with} {without}");
}
