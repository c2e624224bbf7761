//! `zonal calibrate align` and `map` from outside: the files and keys, what a misaligned rig is told, and that bad requests
//! end with status 2.

mod program;

use std::fs;
use std::path::Path;

use program::{json, refused};
use zonal::optics::{Mosaic, Rig};

/// A camera of a fourth of the pixels: what is tested here are files and words.
fn desk(misalignment: &str) -> tempfile::TempDir {
    let mut rig = Rig::from_toml(include_str!("../optics/ghosh-2007-built.toml")).unwrap();
    rig.camera.pitch_um *= 2.0;
    (rig.camera.width_px, rig.camera.height_px) = (rig.camera.width_px / 2, rig.camera.height_px / 2);
    rig.camera.mosaic = Mosaic::Mono;
    let desk = tempfile::tempdir().unwrap();
    fs::write(desk.path().join("rig.toml"), rig.to_toml()).unwrap();
    fs::write(desk.path().join("off.json"), misalignment).unwrap();
    desk
}

/// The arguments of `zonal calibrate KIND` on a desk.
fn calibrate(kind: &str, desk: &Path) -> Vec<String> {
    let path = |name: &str| desk.join(name).to_str().unwrap().to_owned();
    ["calibrate", kind, &path("rig.toml"), "--out", &path("cal"), "--simulate", "--misalign", &path("off.json")]
        .map(str::to_owned)
        .to_vec()
}

fn words(arguments: &[String]) -> Vec<&str> {
    arguments.iter().map(String::as_str).collect()
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn a_decentred_paraboloid_is_refused_with_the_zone_it_allows() {
    let desk = desk(r#"{ "paraboloid_offset_mm": [0.5, 0.0], "camera_displacement_mm": [0.3, 0.0] }"#);
    let [align, map, response, flat] =
        ["align", "map", "response", "flat-field"].map(|kind| calibrate(kind, desk.path()));
    refused(&words(&map), &["calibrate response", "same --out"]);
    json(&words(&response));
    let said = json(&words(&align));
    assert!(said["instructions"][0].as_str().unwrap().starts_with("move the camera 0.3"), "{said}");
    let file: serde_json::Value =
        serde_json::from_slice(&fs::read(desk.path().join("cal/align.json")).unwrap()).unwrap();
    for device in ["camera", "projector"] {
        assert_eq!(file[device], said["alignment"][device]);
    }
    refused(&words(&map), &["zone 9.00..57.00 deg", "9.6", "set zone.theta_min_deg"]);
    assert!(!desk.path().join("cal/map.json").exists());

    let rig = desk.path().join("rig.toml");
    let narrower = fs::read_to_string(&rig).unwrap().replace("theta_min_deg = 9.0", "theta_min_deg = 9.8");
    fs::write(&rig, narrower).unwrap();
    // The zone is a figure of the rig: files of the wider one are of another rig.
    refused(&words(&map), &["response.json", "fingerprint", "calibrate again"]);
    json(&words(&response));
    json(&words(&align));
    let said = json(&words(&map));
    assert!(said["map"]["zone_deg"][0].as_f64().unwrap() > 9.0, "{said}");
    json(&words(&flat));
}

#[test]
fn misalignments_that_are_none_are_refused() {
    let desk = desk(r#"{ "camera_turn_mm": [1, 2] }"#);
    refused(&words(&calibrate("align", desk.path())), &["off.json", "camera_turn_mm"]);
}
