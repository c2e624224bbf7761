//! `zonal convert --both-sides` and what takes its files, run as a program.

mod program;

use std::path::PathBuf;
use std::sync::LazyLock;

use program::{json, refused, zonal};
use zonal::reduce::Coefficients;

const PLAN: &str = "format = 1\nname = \"small\"\norder = 1\nrepeats = 1\n\
    [exposure]\ncount = 2\nshortest_refreshes = 2\nspacing = 8\n[exitant]\nrings = 16\nsectors = 24\n";

/// A small run, and the same with values that depend on theta_o as no reciprocal sample's do.
static RUNS: LazyLock<(tempfile::TempDir, [String; 2])> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let [run, bent]: [PathBuf; 2] = ["run", "bent"].map(|name| folder.path().join(name));
    let plan = folder.path().join("plan.toml");
    std::fs::write(&plan, PLAN).unwrap();
    let (plan, out) = (plan.to_str().unwrap(), run.to_str().unwrap());
    json(&["measure", "optics/ghosh-2007-built.toml", plan, "--simulate", "ggx-0.4", "--out", out]);
    std::fs::create_dir(&bent).unwrap();
    std::fs::copy(run.join("run.json"), bent.join("run.json")).unwrap();
    let mut coefficients = Coefficients::read(&run.join("coefficients.exr")).unwrap();
    let grid = coefficients.grid;
    for (i, z) in coefficients.values.iter_mut().enumerate() {
        *z *= 1.0 + 0.3 * (i % grid.len() / grid.sectors()) as f32 / grid.rings() as f32;
    }
    coefficients.write(&bent.join("coefficients.exr")).unwrap();
    let paths = [run, bent].map(|p| p.to_str().unwrap().to_owned());
    (folder, paths)
});

#[test]
fn a_tensor_goes_from_run_to_renderer() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let run = &RUNS.1[0];
    let said = json(&["convert", run, "--both-sides", "--out", &at("tensor.exr")]);
    for key in ["method", "order", "condition", "noise_gain_in", "noise_gain_out", "exitant_order", "anisotropy"] {
        assert!(!said[key].is_null(), "{key}");
    }
    let reciprocity = &said["reciprocity"];
    eprintln!("{reciprocity}");
    assert_eq!(
        (&said["isotropic"], &reciprocity["imposed"], &reciprocity["holds"]),
        (&true.into(), &true.into(), &true.into())
    );
    assert!(reciprocity["variance_gain"].as_f64().unwrap() > 0.9 * 1.2);
    assert!(reciprocity["violation"].as_f64().unwrap() < reciprocity["expected"].as_f64().unwrap());

    json(&["convert", run, "--out", &at("sh.exr")]);
    let error = |file: &str| json(&["compare", &at(file), "--truth", "ggx-0.4"])["rel_out"].as_f64().unwrap();
    let (of_tensor, of_sh) = (error("tensor.exr"), error("sh.exr"));
    eprintln!("ggx-0.4, order 1, outside: {of_tensor:.3}, with incident directions alone {of_sh:.3}");
    assert!(of_tensor < 1.3 * of_sh);
    json(&["render", &at("tensor.exr"), "--size", "16", "--out", &at("sphere.png")]);
    json(&["export", &at("tensor.exr"), "--format", "bsdf", "--out", &at("tensor.bsdf")]);

    let text = String::from_utf8(zonal(&["convert", run, "--both-sides", "--out", &at("again.exr")]).stdout).unwrap();
    assert!(text.contains("reciprocity imposed") && text.contains("isotropic"), "{text}");
}

#[test]
fn reciprocity_is_imposed_only_where_data_allow_it() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("tensor.exr").to_str().unwrap().to_owned();
    let bent = &RUNS.1[1];
    let both = ["convert", bent, "--both-sides", "--out", &out];
    let said = json(&both);
    assert_eq!(said["reciprocity"]["imposed"], false);
    assert!(said["reciprocity"]["p"].as_f64().unwrap() < 1e-3, "{said}");
    let impose = [&both[..], &["--reciprocity", "impose"]].concat();
    std::fs::remove_file(&out).unwrap();
    refused(&impose, &["not reciprocal", "p = ", "--reciprocity auto", "--force"]);
    assert!(!std::path::Path::new(&out).exists());
    let forced = json(&[&impose[..], &["--force"]].concat());
    assert_eq!(forced["reciprocity"]["imposed"], true);
    assert_eq!(
        json(&["convert", &RUNS.1[0], "--both-sides", "--reciprocity", "ignore", "--out", &out])["reciprocity"]["imposed"],
        false
    );
}

#[test]
fn wrong_usage_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("tensor.exr").to_str().unwrap().to_owned();
    let run = &RUNS.1[0];
    refused(&["convert", run, "--reciprocity", "impose", "--out", &out], &["--both-sides"]);
    refused(
        &["convert", run, "--both-sides", "--exitant-order", "12", "--out", &out],
        &["16 rings and 24 sectors", "order 12"],
    );
    refused(&["convert", run, "--both-sides", "--exitant-order", "90", "--out", &out], &["order 90"]);
    json(&["convert", run, "--both-sides", "--exitant-order", "2", "--out", &out]);
    // A damaged tensor.
    let whole = std::fs::read(&out).unwrap();
    let name = b"zonal_sh_order\0double\0";
    let at = whole.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
    for order in [9.0, 1e300, f64::NAN] {
        let mut bad = whole.clone();
        bad[at..at + 8].copy_from_slice(&f64::to_le_bytes(order));
        std::fs::write(&out, bad).unwrap();
        refused(&["render", &out, "--out", &out], &["tensor.exr", "order"]);
    }
}
