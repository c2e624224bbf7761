//! `zonal design` and `zonal chart optics` as their users run them.

mod program;

use std::fs;
use std::path::{Path, PathBuf};

const FULL: &str = "optics/ghosh-2007-full.toml";
const BUILT: &str = "optics/ghosh-2007-built.toml";

/// A rig file with one line changed.
fn changed(folder: &Path, from: &str, to: &str) -> String {
    let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(BUILT)).unwrap();
    let path = folder.join("rig.toml");
    assert!(text.contains(from), "{from}");
    fs::write(&path, text.replacen(from, to, 1)).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn the_thesis_dome_comes_out_with_its_dimensions_and_files() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("dome");
    let json = program::json(&["design", FULL, "--out", out.to_str().unwrap()]);
    let number = |key: &str| json[key].as_f64().unwrap_or_else(|| panic!("{key}: {json}"));
    assert!((number("shadow_deg") - 9.15).abs() < 0.05 && (number("undercut_deg") - 64.8).abs() < 0.1);
    assert!((number("diameter_mm") - 279.8).abs() < 1.3 && number("min_px_per_deg") > 1.0);
    let angles = json["angles"].as_array().unwrap();
    let at_57 = angles.iter().find(|a| a["theta_deg"] == 57.0).unwrap();
    assert!((at_57["draft_deg"].as_f64().unwrap() - 8.1).abs() < 0.2);
    for key in
        ["theta_min_deg", "theta_max_deg", "height_mm", "draft_deg", "footprint_margin_mm", "footprint_up_to_deg"]
    {
        number(key);
    }
    let binds: Vec<_> = json["limits"].as_array().unwrap().iter().filter(|l| l["binds"] == true).collect();
    assert_eq!(binds.len(), 2, "{binds:?}");
    let files = ["index.html", "profile.csv", "dome.dxf", "mandrel.stl", "section.svg", "angles.png", "rig.toml"];
    assert!(files.iter().all(|f| fs::metadata(out.join(f)).unwrap().len() > 500));
    let page = fs::read_to_string(out.join("index.html")).unwrap();
    assert!(page.contains("undercut of the mandrel") && page.contains("<svg"));
    // The profile handed over is the profile: read back, nothing departs.
    let csv = out.join("profile.csv");
    let json = program::json(&["design", FULL, "--profile", csv.to_str().unwrap()]);
    assert!(json["measured_profile"]["departure_mm"].as_f64().unwrap() < 1e-6, "{}", json["measured_profile"]);
}

#[test]
fn rigs_that_cannot_be_are_refused_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let rig = |from: &str, to: &str| changed(folder.path(), from, to);
    let misses = rig("rim_radius_mm = 126.5", "rim_radius_mm = 0.5");
    program::refused(&["design", &misses], &["rim", "lengthen"]);
    let focus = rig("focus_mm = 280.0\nf_number = 2.0", "focus_mm = 49.0\nf_number = 2.0");
    program::refused(&["design", &focus], &["projector.focus_mm", "farther than the focal length"]);
    let pupil = rig("f_number = 2.0", "f_number = 0.05");
    program::refused(&["design", &pupil], &["projector", "f_number"]);
    let tolerance = rig("[zone]", "[tolerances]\ndome_tilt_deg = -1.0\n\n[zone]");
    program::refused(&["design", &tolerance], &["dome_tilt_deg", "[tolerances]"]);
    let unknown = rig("[zone]", "[tolerances]\ndome_tilt_rad = 0.1\n\n[zone]");
    program::refused(&["design", &unknown], &["dome_tilt_rad"]);
    program::refused(&["design", BUILT, "--search"], &["--out"]);
    let out = folder.path().join("front");
    program::refused(&["design", BUILT, "--search", "--out", out.to_str().unwrap()], &["[search]"]);
    assert!(!out.exists());
}

#[test]
fn measured_profiles_that_say_nothing_are_refused_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: String| -> PathBuf {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path
    };
    let out = folder.path().join("dome");
    program::json(&["design", BUILT, "--out", out.to_str().unwrap()]);
    let good = fs::read_to_string(out.join("profile.csv")).unwrap();
    let lines: Vec<&str> = good.lines().collect();
    let head = lines.iter().position(|l| l.starts_with("theta_deg")).unwrap();
    let (top, rows) = lines.split_at(head + 1);
    let with = |rows: Vec<&str>| [top.to_vec(), rows].concat().join("\n");
    let mut swapped = rows.to_vec();
    swapped.swap(50, 51);
    let gap: Vec<&str> = rows.iter().enumerate().filter(|(i, _)| !(100..160).contains(i)).map(|(_, r)| *r).collect();
    let cases = [
        ("unsorted.csv", with(swapped), "line"),
        ("gap.csv", with(gap), "line"),
        ("short.csv", with(rows[..rows.len() / 2].to_vec()), "measure all of the dome"),
        ("column.csv", good.replace("r_mm", "radius"), "r_mm"),
    ];
    for (name, text, said) in cases {
        let path = file(name, text);
        program::refused(&["design", BUILT, "--profile", path.to_str().unwrap()], &[name, said]);
    }
}

#[test]
fn the_chart_of_optics_has_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("optics");
    let json = program::json(&["chart", "optics", "--out", out.to_str().unwrap()]);
    let profiles = json["profiles"].as_array().unwrap();
    let worst = |method: &str| {
        let of = profiles.iter().filter(|p| p["method"] == method).map(|p| p["distance_mm"].as_f64().unwrap());
        of.fold(0.0, f64::max)
    };
    assert!(worst("closed form") < 1e-9 && worst("Euler") > 1.0, "{profiles:?}");
    assert_eq!(json["heights"].as_array().unwrap().len(), 4);
    assert!(["index.html", "optics.png", "optics.svg", "optics.csv"].iter().all(|f| out.join(f).exists()));
}
