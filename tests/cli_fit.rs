//! `zonal fit` and what takes its files, run as a program.

mod program;

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use program::{json, refused};
use serde_json::Value;

/// One small run for all tests.
static RUN: LazyLock<(tempfile::TempDir, PathBuf)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let arguments = ["optics/ghosh-2007-built.toml", "patterns/order-2.toml", "--simulate", "red-plastic", "--out"];
    json(&[&["measure"], &arguments[..], &[run.to_str().unwrap()]].concat());
    (folder, run)
});

fn run() -> &'static str {
    RUN.1.to_str().unwrap()
}

fn copied(to: &Path) {
    std::fs::create_dir(to).unwrap();
    for file in ["run.json", "coefficients.exr"] {
        std::fs::copy(RUN.1.join(file), to.join(file)).unwrap();
    }
}

#[test]
fn a_fit_goes_from_run_to_renderer() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let fit = json(&["fit", run(), "--out", &at("fit.json")]);
    for key in ["model", "parameters", "standard_errors", "chi", "termination", "fit_s"] {
        assert!(!fit[key].is_null(), "{key}");
    }
    assert_eq!(fit["successful"], true);
    assert_eq!(fit["requested"], "auto");
    assert!(fit["selection"]["candidates"].as_array().unwrap().len() >= 5);
    assert!(fit["standard_errors"]["kd_r"].as_f64().unwrap() > 0.0);
    let errors = json(&["compare", &at("fit.json"), "--truth", "red-plastic"]);
    // 54 frames of a material the family describes: what noise and calibration leave.
    assert!(errors["rel_in"].as_f64().unwrap() < 0.02, "{errors}");
    json(&["export", &at("fit.json"), "--format", "bsdf", "--out", &at("sample.bsdf")]);
    json(&["render", &at("fit.json"), "--beside", "red-plastic", "--out", &at("two.png"), "--size", "32"]);
    let dbrdf = json(&["fit", run(), "--model", "dbrdf", "--out", &at("dbrdf.json")]);
    assert_eq!(dbrdf["model"], "dbrdf");
    json(&["export", &at("dbrdf.json"), "--format", "density", "--out", &at("p.exr")]);
}

#[test]
fn bad_input_is_refused_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let out = at("fit.json");
    refused(&["fit", run(), "--model", "dbdrf", "--out", &out], &["dbdrf", "did you mean dbrdf", "mixture"]);
    refused(&["fit", run(), "--out", &at("fit.txt")], &[".json"]);
    refused(&["fit", run(), "--order", "4", "--out", &out], &["order 2"]);
    refused(&["fit", run(), "--edge-deg", "-1", "--out", &out], &["--edge-deg"]);
    refused(&["fit", &at("nowhere"), "--out", &out], &["nowhere"]);

    // A run without coefficients, and one whose coefficients are cut short.
    let empty = folder.path().join("empty");
    copied(&empty);
    std::fs::remove_file(empty.join("coefficients.exr")).unwrap();
    refused(&["fit", empty.to_str().unwrap(), "--out", &out], &["coefficients.exr"]);
    let cut = folder.path().join("cut");
    copied(&cut);
    let bytes = std::fs::read(RUN.1.join("coefficients.exr")).unwrap();
    for length in [0, 40, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(cut.join("coefficients.exr"), &bytes[..length]).unwrap();
        refused(&["fit", cut.to_str().unwrap(), "--out", &out], &["coefficients.exr"]);
    }
    assert!(!Path::new(&out).exists());

    // A fit of another zone, a damaged one, one whose search failed.
    json(&["fit", run(), "--model", "ggx", "--out", &out]);
    refused(
        &["compare", &out, "--truth", "red-plastic", "--zone", "9,90"],
        &["fitted in 9.00..57.00 deg", "leave --zone out"],
    );
    refused(&["compare", &out, "--truth", "red-plasti"], &["red-plastic"]);
    let text = std::fs::read_to_string(&out).unwrap();
    let fit: Value = serde_json::from_str(&text).unwrap();
    let with = |change: &dyn Fn(&mut Value)| {
        let mut fit = fit.clone();
        change(&mut fit);
        std::fs::write(&out, fit.to_string()).unwrap();
    };
    with(&|fit| fit["brdf"]["ggx"]["lobes"][0]["alpha"][0] = (-1.0).into());
    refused(&["export", &out, "--format", "bsdf", "--out", &at("x.bsdf")], &["alpha", "fit the run again"]);
    with(&|fit| fit["zone_deg"][0] = 70.0.into());
    refused(&["compare", &out, "--truth", "white"], &["zone"]);
    with(&|fit| fit["format"] = 99.into());
    refused(&["compare", &out, "--truth", "white"], &["99"]);
    with(&|fit| {
        fit["successful"] = false.into();
        fit["termination"] = "lost_patience".into();
    });
    refused(&["export", &out, "--format", "bsdf", "--out", &at("x.bsdf")], &["--force", "LostPatience"]);
    assert!(!Path::new(&at("x.bsdf")).exists());
    json(&["export", &out, "--format", "bsdf", "--out", &at("x.bsdf"), "--force"]);
    std::fs::write(&out, &text[..text.len() / 2]).unwrap();
    refused(&["render", &out, "--out", &at("x.png")], &["fit.json"]);
}
