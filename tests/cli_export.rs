//! `zonal export` and what `zonal render` grew with it, from outside: results, and refusals that leave every file as it was.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;
use zonal::basis::{Conversion, Method};
use zonal::calibrate::gray_card_coefficients;
use zonal::export::ShMaterial;
use zonal::geometry::{Direction, ExitantGrid, Zone};
use zonal::reduce::Coefficients;
use zonal::reflectance::{Brdf, Rgl, open};
use zonal::store::Layers;

const ZONAL: &str = env!("CARGO_BIN_EXE_zonal");

/// A folder with files that refused commands must not touch.
fn desk() -> TempDir {
    let desk = tempfile::tempdir().unwrap();
    for name in ["old.bsdf", "old.exr", "old.png"] {
        fs::write(desk.path().join(name), "old").unwrap();
    }
    desk
}

/// Runs the program in a folder; arguments are split at spaces.
fn zonal(desk: &Path, arguments: &str) -> Output {
    Command::new(ZONAL).current_dir(desk).args(arguments.split(' ')).output().unwrap()
}

/// The command ends well and prints one JSON object.
fn json(desk: &Path, arguments: &str) -> Value {
    let output = zonal(desk, arguments);
    assert!(output.status.success(), "{arguments}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON value and nothing else")
}

/// Names and bytes of the files of a folder.
fn contents(desk: &Path) -> Vec<(String, Vec<u8>)> {
    let file = |entry: fs::DirEntry| (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap());
    let mut files: Vec<_> = fs::read_dir(desk).unwrap().map(|entry| file(entry.unwrap())).collect();
    files.sort();
    files
}

/// Status 2, nothing on stdout, all `words` in the message, and no file changed.
fn refused(desk: &Path, arguments: &str, words: &[&str]) {
    let before = contents(desk);
    let output = zonal(desk, arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments}: {said}");
    assert!(output.stdout.is_empty(), "{arguments}");
    for word in words {
        assert!(said.contains(word), "{arguments}: no `{word}` in\n{said}");
    }
    assert!(before == contents(desk), "{arguments} changed a file");
}

/// A converted gray card whose cells in `holes` hold no number, as those that lost their pixels.
fn converted(path: &Path, holes: std::ops::Range<usize>) {
    let (zone, order) = (Zone::from_degrees(9.0, 57.0).unwrap(), 2);
    let grid = ExitantGrid::new(zone, 4, 6);
    let cells = 3 * grid.len();
    let mut values: Vec<f32> =
        gray_card_coefficients(zone, order, 0.18).iter().flat_map(|&z| vec![z as f32; cells]).collect();
    values.chunks_exact_mut(grid.len()).for_each(|plane| plane[holes.clone()].fill(f32::NAN));
    let coefficients =
        Coefficients { grid, order, sigma: vec![1e-4; values.len()], values, history: "a gray card".into() };
    let conversion = Conversion::new(Method::Parity, zone, order).unwrap();
    ShMaterial::new(&coefficients, &conversion).write(path).unwrap();
}

#[test]
fn a_bsdf_is_what_the_name_says() {
    let desk = desk();
    let said = json(desk.path(), "export ggx-0.2 --format bsdf --out old.bsdf --json");
    let path = desk.path().join("old.bsdf");
    assert_eq!((&said["format"], &said["out"], &said["isotropic"]), (&"bsdf".into(), &"old.bsdf".into(), &true.into()));
    assert_eq!(said["bytes"], fs::metadata(&path).unwrap().len());
    let (back, truth) = (Rgl::read(&path).unwrap(), open("ggx-0.2").unwrap());
    let (wi, wo) = (Direction::from_angles(0.5, 3.0), Direction::from_angles(0.6, 0.0));
    // The file's own interpolation; tests/peers_bsdf.rs bounds it.
    assert!((back.eval(&wi, &wo)[0] / truth.eval(&wi, &wo)[0] - 1.0).abs() < 0.01);
    assert!(back.description().starts_with("ggx-0.2\n") && back.description().contains("f cos(theta) of the light"));
    // What was exported is a material again.
    json(desk.path(), "render old.bsdf --beside ggx-0.2 --size 16 --out old.png --json");
}

#[test]
fn a_converted_run_keeps_its_history() {
    let desk = desk();
    converted(&desk.path().join("sh.exr"), 0..0);
    let said = json(desk.path(), "export sh.exr --format bsdf --out gray.bsdf --json");
    assert_eq!(said["isotropic"], false);
    let back = Rgl::read(desk.path().join("gray.bsdf")).unwrap();
    for word in ["sh.exr", "a gray card", "parity"] {
        assert!(back.description().contains(word), "no `{word}` in {}", back.description());
    }
    let f = back.eval(&Direction::from_angles(0.3, 1.0), &Direction::from_angles(0.7, -2.0))[1];
    assert!((f * std::f64::consts::PI / 0.18 - 1.0).abs() < 0.01, "{f}");
}

#[test]
fn what_cannot_be_exported_is_refused() {
    let desk = desk();
    converted(&desk.path().join("holes.exr"), 6..7);
    let cases: [(&str, &[&str]); 9] = [
        ("export ggx-0.2 --format obj --out old.bsdf", &["'obj'", "possible values", "bsdf", "density"]),
        ("export ggx-0.2 --out old.bsdf", &["--format"]),
        ("export ggx-0.2 --format bsdf", &["--out"]),
        ("export ggx-0.2 --format bsdf --out old.png", &["old.png", ".bsdf", "name one"]),
        ("export ggx-0.2 --format density --out old.bsdf", &["old.bsdf", ".exr", "name one"]),
        ("export ggx-0.2 --format density --out old.exr", &["ggx-0.2", "no D-BRDF", "--format bsdf"]),
        ("export ggx-0.3 --format bsdf --out old.bsdf", &["`ggx-0.3`", "ggx-0.2"]),
        ("export ggx-0.2 --format bsdf --out none/new.bsdf", &["none/new.bsdf", "--out"]),
        ("export holes.exr --format bsdf --out old.bsdf", &["no finite value", "theta_o", "rings"]),
    ];
    for (arguments, words) in cases {
        refused(desk.path(), arguments, words);
    }
}

#[test]
fn a_full_disk_leaves_the_old_file() {
    let desk = desk();
    let script = "ulimit -f 200; exec \"$0\" export ggx-0.2 --format bsdf --out old.bsdf";
    let output = Command::new("bash").current_dir(desk.path()).args(["-c", script, ZONAL]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("nothing was left half-written"));
    assert_eq!(fs::read(desk.path().join("old.bsdf")).unwrap(), b"old");
    assert_eq!(contents(desk.path()).len(), 3);
}

#[test]
fn pictures_of_differences_and_cylinders() {
    let desk = desk();
    let arguments = "render ggx-0.4 --beside gray-card --difference --shape cylinder --size 32 --json --out";
    let said = json(desk.path(), &format!("{arguments} old.exr"));
    assert!(said["mean_difference"].as_f64().unwrap() > 0.1 && said["rms_difference"].as_f64().unwrap() > 0.1);
    let image = Layers::read(&desk.path().join("old.exr")).unwrap();
    // Three pictures and two gaps of one pixel; the third holds the first minus the second, signed.
    assert_eq!((image.width, image.height), (3 * 32 + 2, 32));
    let red = image.get("R").unwrap();
    let row = &red[16 * image.width..][..image.width];
    for x in 0..32 {
        assert!((row[66 + x] - (row[x] - row[33 + x])).abs() < 1e-6, "column {x}");
    }
    assert!(row[66..].iter().any(|&d| d > 0.0));
    // A cylinder is lit alike from top to bottom.
    assert_eq!(red[10], red[20 * image.width + 10]);

    json(desk.path(), &format!("{arguments} old.png"));
    refused(desk.path(), "render ggx-0.4 --difference --out old.png", &["--beside"]);
    refused(desk.path(), "render ggx-0.4 --shape cube --out old.png", &["'cube'", "sphere", "cylinder"]);
    assert_eq!(json(desk.path(), "render ggx-0.4 --size 8 --out old.png --json")["mean_difference"], Value::Null);
}
