//! `zonal convert` by every method and `zonal prior`, run as programs.

mod program;

use std::path::PathBuf;
use std::sync::LazyLock;

use program::{json, refused};
use zonal::basis::{Method, size};
use zonal::reduce::Coefficients;
use zonal::store::Layers;

const PLAN: &str = "format = 1\nname = \"small\"\norder = 2\nrepeats = 1\n\
    [exposure]\ncount = 2\nshortest_refreshes = 2\nspacing = 8\n[exitant]\nrings = 12\nsectors = 16\n";

/// A small run of an isotropic sample; one as of a sample whose rings vary; one with half of its cells missing.
static RUNS: LazyLock<(tempfile::TempDir, [String; 3])> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let [run, grained, holed]: [PathBuf; 3] = ["run", "grained", "holed"].map(|name| folder.path().join(name));
    let plan = folder.path().join("plan.toml");
    std::fs::write(&plan, PLAN).unwrap();
    let (plan, out) = (plan.to_str().unwrap(), run.to_str().unwrap());
    json(&["measure", "optics/ghosh-2007-built.toml", plan, "--simulate", "red-plastic", "--out", out]);
    let measured = Coefficients::read(&run.join("coefficients.exr")).unwrap();
    let grid = measured.grid;
    for (copy, change) in [
        (&grained, (|z, phi: f64| z * (1.0 + 0.4 * (2.0 * phi).cos() as f32)) as fn(f32, f64) -> f32),
        (&holed, |z, phi| if phi < 3.0 { f32::NAN } else { z }),
    ] {
        std::fs::create_dir(copy).unwrap();
        std::fs::copy(run.join("run.json"), copy.join("run.json")).unwrap();
        let mut coefficients = measured.clone();
        for (i, z) in coefficients.values.iter_mut().enumerate() {
            *z = change(*z, grid.phi(i % grid.sectors()));
        }
        coefficients.write(&copy.join("coefficients.exr")).unwrap();
    }
    let paths = [run, grained, holed].map(|p| p.to_str().unwrap().to_owned());
    (folder, paths)
});

#[test]
fn every_method_says_how_much_is_data() {
    let folder = tempfile::tempdir().unwrap();
    let names = Method::ALL.map(Method::name).into_iter().chain(["prior"]);
    for name in names {
        let out = folder.path().join(format!("{name}.exr"));
        let said = json(&["convert", &RUNS.1[0], "--method", name, "--out", out.to_str().unwrap()]);
        for key in ["method", "order", "condition", "noise_gain_in", "noise_gain_out", "sh_order"] {
            assert!(!said[key].is_null(), "{name}: {key}");
        }
        let share = said["data_share"].as_f64().unwrap();
        assert!(share > 0.3 && share <= 1.0, "{name}: {share}");
        let file = Layers::read(&out).unwrap();
        let k = size(said["sh_order"].as_u64().unwrap() as usize) - 1;
        for stem in ["y", "sigma", "data"] {
            assert!(file.get(&format!("{stem}_{k:03}.B")).is_some(), "{name}: {stem}");
        }
        // What the file says is a reflectance again.
        let compared = json(&["compare", out.to_str().unwrap(), "--truth", "red-plastic", "--zone", "9,57"]);
        let error = compared["rel_in"].as_f64().unwrap();
        assert!(error < 0.5, "{name}: {error}");
    }
}

/// Where the table of failures says so, and with what to do instead.
#[test]
fn what_cannot_be_converted_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("old.exr");
    std::fs::write(&out, "old").unwrap();
    let table = folder.path().join("prior.toml");
    let built_in = include_str!("../data/prior.toml");
    let out = out.to_str().unwrap();
    let at = table.to_str().unwrap();
    for (run, more, said) in [
        (1, &["--method", "prior"][..], &["anisotropic", "parity"][..]),
        (0, &["--method", "prior", "--both-sides"], &["--both-sides", "parity"]),
        (0, &["--method", "hsh", "--both-sides"], &["--both-sides", "parity"]),
        (0, &["--method", "tikhonov", "--rule", "guess"], &["guess", "gcv"]),
    ] {
        refused(&[&["convert", &RUNS.1[run], "--out", out], more].concat(), said);
    }
    for (from, to, said) in [
        ("version = 1", "version = 9", "version"),
        ("sh_order = 16", "sh_order = 160", "sh_order"),
        ("widening = 2.0", "widening = nan", "widening"),
        ("\"aluminium\"", "\"alumnium\"", "alumnium"),
        ("version = 1", "version = 1\nextra = 2", "extra"),
    ] {
        assert!(built_in.contains(from));
        std::fs::write(&table, built_in.replace(from, to)).unwrap();
        refused(&["convert", &RUNS.1[0], "--method", "prior", "--prior", at, "--out", out], &[said, "prior.toml"]);
    }
    assert_eq!(std::fs::read_to_string(out).unwrap(), "old");
}

/// Missing cells stay missing where each cell is converted by itself, and rings are followed without them.
#[test]
fn missing_cells_do_not_spread() {
    let folder = tempfile::tempdir().unwrap();
    for method in ["parity", "prior", "tikhonov"] {
        let out = folder.path().join("sh.exr");
        json(&["convert", &RUNS.1[2], "--method", method, "--out", out.to_str().unwrap()]);
        let plane = Layers::read(&out).unwrap().get("y_002.G").unwrap().to_vec();
        let missing = plane.iter().filter(|v| v.is_nan()).count();
        assert_eq!(missing, plane.len() / 2, "{method}");
    }
}

#[test]
fn a_prior_is_learned_from_a_few_materials_and_used() {
    let folder = tempfile::tempdir().unwrap();
    let (table, out) = (folder.path().join("prior.toml"), folder.path().join("sh.exr"));
    let (table, out) = (table.to_str().unwrap(), out.to_str().unwrap());
    let names =
        ["blue-acrylic", "green-plastic", "white-paint", "pink-plastic", "violet-acrylic", "specular-red-phenolic"];
    let said = json(&[&["prior", "--out", table, "--materials"], &names[..]].concat());
    assert_eq!(said["materials"], 6);
    let said = json(&["convert", &RUNS.1[0], "--method", "prior", "--prior", table, "--out", out]);
    assert!(said["surprise"].as_f64().unwrap() >= 1.0);
    refused(&["prior", "--out", table, "--materials", "blue-acryl", "b", "c", "d"], &["blue-acryl", "name materials"]);
}
