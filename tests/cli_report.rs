//! `zonal report` from outside: the page, the keys other programs read, and that bad requests end with status 2 and leave
//! every file as it was.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

use serde_json::Value;
use tempfile::TempDir;
use zonal::fit::FitMethod;
use zonal::reduce::Coefficients;

const PLAN: &str = "format = 1\nname = \"small\"\norder = 2\nrepeats = 1\n\
    [exposure]\ncount = 2\nshortest_refreshes = 2\nspacing = 8\n[exitant]\nrings = 8\nsectors = 12\n";

/// A folder with a finished run of `ggx-0.4` as `run`; tests copy what they damage.
static DESK: LazyLock<PathBuf> = LazyLock::new(|| {
    let desk = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cli-report");
    // Of an earlier run of the tests.
    let _ = fs::remove_dir_all(&desk);
    fs::create_dir_all(&desk).unwrap();
    fs::write(desk.join("rig.toml"), include_str!("../optics/ghosh-2007-built.toml")).unwrap();
    fs::write(desk.join("plan.toml"), PLAN).unwrap();
    let measured = zonal(&desk, "measure rig.toml plan.toml --out run --simulate ggx-0.4");
    assert!(measured.status.success(), "{}", text(&measured.stderr));
    desk
});

fn zonal(folder: &Path, arguments: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_zonal")).current_dir(folder).args(arguments.split(' ')).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A new folder with the run's record and coefficients in `run`.
fn copy() -> TempDir {
    let desk = tempfile::tempdir().unwrap();
    fs::create_dir(desk.path().join("run")).unwrap();
    for name in ["run.json", "coefficients.exr"] {
        fs::copy(DESK.join("run").join(name), desk.path().join("run").join(name)).unwrap();
    }
    desk
}

fn refused(desk: &TempDir, arguments: &str, words: &[&str]) {
    let output = zonal(desk.path(), arguments);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments}: {:?}\n{said}", output.status);
    assert!(output.stdout.is_empty() && said.starts_with("error: "), "{arguments}: {said}");
    for word in words {
        assert!(said.contains(word), "{arguments}: no `{word}` in\n{said}");
    }
    let pages = ["", "run"].map(|folder| fs::read_dir(desk.path().join(folder)).unwrap());
    let page =
        pages.into_iter().flatten().find(|e| e.as_ref().unwrap().path().extension().is_some_and(|e| e == "html"));
    assert!(page.is_none(), "{arguments} wrote {page:?}");
}

#[test]
fn a_run_and_its_truth_become_a_page() {
    let desk = copy();
    let output = zonal(desk.path(), "report run --truth ggx-0.4 --json");
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said: Value = serde_json::from_slice(&output.stdout).expect("one JSON value and nothing else");
    assert_eq!((&said["page"], &said["requested"]), (&"run/report.html".into(), &"auto".into()));
    let methods = said["methods"].as_array().unwrap();
    assert_eq!(methods.len(), FitMethod::ALL.len());
    for method in methods {
        for key in ["rel_in", "rel_out", "log_in", "log_out"] {
            assert!(method["errors"][key].as_f64().is_some_and(|e| e > 0.0), "{key}: {method}");
        }
        assert!(method["chi"].as_f64().unwrap() > 0.0 && method["fit_s"].as_f64().unwrap() > 0.0, "{method}");
    }
    // The sample is of a family that is tried; order 2 and few exposures leave some tenths of a percent.
    const OWN_FAMILY: f64 = 0.05;
    let auto = methods.last().unwrap();
    assert_eq!((&auto["method"], &auto["model"]), (&"auto".into(), &said["model"]));
    assert!(auto["errors"]["rel_in"].as_f64().unwrap() < OWN_FAMILY, "{auto}");
    let page = fs::read_to_string(desk.path().join("run/report.html")).unwrap();
    for words in ["<!DOCTYPE html>", "Methods of fitting", "off ggx-0.4 inside", "</html>"] {
        assert!(page.contains(words), "{words}");
    }
}

#[test]
fn without_truth_the_misfit_is_told() {
    let desk = copy();
    let output = zonal(desk.path(), "report run --model thesis --out page.html");
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    assert!(said.starts_with("thesis: chi") && said.contains("misfit") && said.contains("page: page.html"), "{said}");
    let page = fs::read_to_string(desk.path().join("page.html")).unwrap();
    assert!(page.contains("Fitted model: thesis, as asked for") && !desk.path().join("run/report.html").exists());
}

#[test]
fn bad_requests_are_refused() {
    let desk = copy();
    refused(&desk, "report gone", &["gone/run.json", "check the path"]);
    refused(&desk, "report run --model dbdrf", &["--model", "dbdrf", "did you mean dbrdf"]);
    refused(&desk, "report run --truth ggx-0.44", &["ggx-0.44", "did you mean"]);
    refused(&desk, "report run --truth gone.bsdf", &["gone.bsdf", "check that it exists"]);
    refused(&desk, "report run --out none/page.html", &["none/page.html", "choose another --out"]);
    refused(&desk, "report run --out run", &["cannot write run", "choose another --out"]);
}

#[test]
fn damaged_runs_are_refused() {
    let desk = copy();
    let (record, coefficients) = (desk.path().join("run/run.json"), desk.path().join("run/coefficients.exr"));
    let (json, whole) = (fs::read_to_string(&record).unwrap(), fs::read(&coefficients).unwrap());
    fs::write(&record, json.replace("\"complete\"", "\"failed\"")).unwrap();
    refused(&desk, "report run", &["run/run.json", "`failed`", "--resume"]);
    fs::write(&record, &json[..json.len() / 2]).unwrap();
    refused(&desk, "report run", &["run/run.json", "make it again"]);
    fs::write(&record, json).unwrap();
    let mut black = Coefficients::read(&coefficients).unwrap();
    black.values.fill(0.0);
    black.write(&coefficients).unwrap();
    refused(&desk, "report run", &["z_00 is not positive", "was there a sample"]);
    black.values.fill(f32::NAN);
    black.write(&coefficients).unwrap();
    refused(&desk, "report run", &["no exitant direction with data", "reduce the run again"]);
    fs::write(&coefficients, &whole[..whole.len() / 2]).unwrap();
    refused(&desk, "report run", &["coefficients.exr", "`zonal reduce run`"]);
    fs::remove_file(&coefficients).unwrap();
    refused(&desk, "report run", &["coefficients.exr", "`zonal reduce run`"]);
}

/// A reconstruction of a lobe rings: as a truth it would excuse every model that does not.
#[test]
fn a_reconstruction_is_no_truth() {
    let desk = copy();
    let converted = zonal(desk.path(), "convert run --method thesis --force --out sh.exr");
    assert!(converted.status.success(), "{}", text(&converted.stderr));
    refused(&desk, "report run --truth sh.exr", &["negative", "a reconstruction is no truth"]);
}
