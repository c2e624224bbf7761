//! `zonal compare` from outside: its keys, and that bad requests end with status 2 and a remedy.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn compare(folder: &Path, arguments: &str) -> Output {
    let arguments = ["compare"].into_iter().chain(arguments.split(' '));
    Command::new(env!("CARGO_BIN_EXE_zonal")).current_dir(folder).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The command ends well and prints one JSON object.
fn json(arguments: &str) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let output = compare(folder.path(), &format!("{arguments} --json"));
    assert!(output.status.success(), "{arguments}: {}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON value and nothing else")
}

fn refused(folder: &Path, arguments: &str, words: &[&str]) {
    let output = compare(folder, arguments);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments}: {:?}\n{said}", output.status);
    assert!(output.stdout.is_empty() && said.starts_with("error: "), "{arguments}: {said}");
    for word in words {
        assert!(said.contains(word), "{arguments}: no `{word}` in\n{said}");
    }
}

#[test]
fn the_keys_other_programs_read_are_there() {
    let said = json("ggx-0.1 --truth ggx-0.2");
    for key in ["rel_in", "rel_out", "log_in", "log_out", "render_difference"] {
        assert!(said[key].as_f64().is_some_and(|v| v > 0.0), "{key}: {said}");
        if key != "render_difference" {
            assert!(said["per_channel"][2][key].as_f64().is_some_and(|v| v > 0.0), "{key}: {said}");
        }
    }
    assert_eq!(said["albedo_error"].as_array().unwrap().len(), 3);
    assert_eq!(said["per_channel"].as_array().unwrap().len(), 3);
    let zone: Vec<i64> =
        said["zone_deg"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap().round() as i64).collect();
    assert_eq!(zone, [9, 57]);
}

#[test]
fn a_brighter_diffuser_differs_by_its_scale() {
    // Albedo 0.99 for 0.18; images are f32, albedos by the library's rule.
    const ROUNDING: f64 = 1e-5;
    let said = json("white --truth gray-card --zone 0,90");
    for value in
        [&said["rel_in"], &said["albedo_error"][1], &said["render_difference"], &said["per_channel"][0]["rel_in"]]
    {
        assert!((value.as_f64().unwrap() / 4.5 - 1.0).abs() < ROUNDING, "{said}");
    }
    assert!(said["rel_out"].is_null() && said["log_out"].is_null(), "{said}");
}

#[test]
fn people_read_a_table() {
    let folder = tempfile::tempdir().unwrap();
    let output = compare(folder.path(), "white --truth gray-card");
    let said = text(&output.stdout);
    for words in ["white against gray-card", "9..57 deg", "450.0%", "albedo at 70 deg", "spheres, probe studio"] {
        assert!(said.contains(words), "no `{words}` in\n{said}");
    }
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |arguments: &str, words: &[&str]| refused(folder.path(), arguments, words);
    refused("red-plastik --truth red-plastic", &["red-plastik", "did you mean red-plastic"]);
    refused("red-plastic --truth gray-crad", &["gray-crad", "gray-card"]);
    refused("red-plastic --truth gone.bsdf", &["gone.bsdf", "check that it exists"]);
    refused("red-plastic --truth gray-card --probe gone.hdr", &["gone.hdr"]);
    refused("red-plastic --truth gray-card --probe studioo", &["studioo", ".hdr"]);
    for zone in ["57,9", "9", "9,x", "-5,57", "9,91", "nan,57", "9,57,60", "9,inf"] {
        refused(&format!("red-plastic --truth gray-card --zone {zone}"), &["--zone"]);
    }
    refused("red-plastic", &["--truth"]);
    std::fs::write(folder.path().join("bad.dat"), "#DIM 3 1\n0.1 0.2\n").unwrap();
    refused("bad.dat --truth gray-card", &["bad.dat: line 2", "PARAM_IN"]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is written");
}

/// A converted run of a sharp lobe rings: as a truth it would excuse every model that does not.
#[test]
fn a_reconstruction_is_no_truth() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &str| {
        let zonal =
            Command::new(env!("CARGO_BIN_EXE_zonal")).current_dir(folder.path()).args(arguments.split(' ')).output();
        let output = zonal.unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
    };
    std::fs::write(folder.path().join("rig.toml"), include_str!("../optics/ghosh-2007-built.toml")).unwrap();
    let plan = "format = 1\nname = \"small\"\norder = 2\nrepeats = 1\n[exposure]\ncount = 2\nshortest_refreshes = 2\n\
                spacing = 8\n[exitant]\nrings = 8\nsectors = 12\n";
    std::fs::write(folder.path().join("plan.toml"), plan).unwrap();
    run("measure rig.toml plan.toml --out run --simulate ggx-0.1");
    run("convert run --method parity --out sh.exr");
    refused(folder.path(), "ggx-0.1 --truth sh.exr", &["negative", "wi (", "wo (", "a reconstruction is no truth"]);
    let output = compare(folder.path(), "sh.exr --truth ggx-0.1 --json");
    let said: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(said["rel_in"].as_f64().unwrap() < 2.0 && said["log_in"].as_f64().unwrap() > 0.0, "{said}");
}
