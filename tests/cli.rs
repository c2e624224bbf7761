//! The program from outside: bad input ends with status 2, says where and what helps, and leaves every file as it was.

mod desk;

use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

use serde_json::{Map, Value};
use tempfile::TempDir;
use zonal::calibrate::CalibrationSet;
use zonal::geometry::{ExitantGrid, Zone};
use zonal::optics::Rig;
use zonal::radiometry::FlatField;
use zonal::reduce::Coefficients;

use desk::{
    PLAN, RIG, ZONAL, assert_refused, assert_unchanged, contents, desk, edit, json, refused, replace, text, zonal,
    zonal_limited,
};

/// A run and its conversion that all tests share; what `measure` and `convert` printed for it.
struct Example {
    folder: PathBuf,
    measured: Output,
    converted: Output,
}

static EXAMPLE: LazyLock<Example> = LazyLock::new(|| {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cli-example");
    // Of an earlier run of the tests.
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("rig.toml"), RIG).unwrap();
    fs::write(folder.join("plan.toml"), PLAN).unwrap();
    let measured = zonal(&folder, "measure rig.toml plan.toml --out run --simulate ggx-0.4 --json");
    assert!(measured.status.success(), "{}", text(&measured.stderr));
    let converted = zonal(&folder, "convert run --out sh.exr --json");
    assert!(converted.status.success(), "{}", text(&converted.stderr));
    Example { folder, measured, converted }
});

/// A desk with a finished run as `run` and its conversion as `sh.exr`.
fn desk_with_run() -> TempDir {
    let desk = desk();
    for (path, bytes) in contents(&EXAMPLE.folder) {
        let path = desk.path().join(path);
        match bytes {
            Some(bytes) => fs::write(path, bytes).unwrap(),
            None => fs::create_dir_all(path).unwrap(),
        }
    }
    desk
}

#[test]
fn rigs_that_cannot_work_are_refused() {
    let cases: [(&str, &str, &[&str]); 11] = [
        ("[zone]", "[zoen]", &["bad.toml", "`zoen`", "expected"]),
        ("focus_mm = 280.0\nf_number = 8.0", "focus = 280.0\nf_number = 8.0", &["bad.toml", "`focus`", "focus_mm"]),
        ("vertex_height_mm", "vertex_height_cm", &["bad.toml", "`vertex_height_cm`", "`vertex_height_mm`"]),
        ("theta_min_deg = 9.0", "theta_min_deg = 57.0", &["bad.toml", "[zone]", "theta_min < theta_max", "correct"]),
        ("theta_min_deg = 9.0", "theta_min_deg = 60.0", &["bad.toml", "[zone]", "theta_min < theta_max", "correct"]),
        ("theta_min_deg = 9.0", "theta_min_deg = nan", &["bad.toml", "[zone]", "correct"]),
        (
            "rim_radius_mm = 126.5",
            "rim_radius_mm = 3.0",
            &["bad.toml", "rays miss the dome", "vertex_height_mm", "lengthen"],
        ),
        ("centre_height_mm = 405.0", "centre_height_mm = 1e309", &["bad.toml", "centre_height_mm"]),
        ("f_number = 2.0", "f_number = -2.0", &["bad.toml", "projector.f_number", "positive"]),
        ("width_px = 800", "width_px = 800000", &["bad.toml", "projector.width_px", "16..=16384"]),
        ("format = 1", "format = 2", &["bad.toml", "format 2", "update"]),
    ];
    for (from, to, words) in cases {
        let desk = desk();
        fs::write(desk.path().join("bad.toml"), RIG).unwrap();
        replace(&desk.path().join("bad.toml"), from, to);
        refused(&desk, "plan bad.toml plan.toml", words);
        refused(&desk, "measure bad.toml plan.toml --out run --simulate ggx-0.4", words);
    }
}

#[test]
fn plans_that_cannot_run_are_refused() {
    let cases: [(&str, &str, &[&str]); 9] = [
        ("order = 1", "order = 200", &["bad.toml", "order = 200", "0..=20"]),
        ("order = 1", "order = -1", &["bad.toml", "line 3", "-1"]),
        ("order = 1", "oder = 1", &["bad.toml", "`oder`", "`order`"]),
        ("shortest_refreshes", "shortest_s", &["bad.toml", "`shortest_s`", "`shortest_refreshes`"]),
        ("count = 2", "count = 99999999999", &["bad.toml", "line 6", "99999999999"]),
        ("rings = 8", "rings = 1", &["bad.toml", "exitant.rings = 1", "3..=512"]),
        ("repeats = 1", "", &["bad.toml", "missing field `repeats`"]),
        ("format = 1", "format = 2", &["bad.toml", "format 2", "update"]),
        ("\"small\"", "\"small", &["bad.toml", "line 2"]),
    ];
    for (from, to, words) in cases {
        let desk = desk();
        fs::write(desk.path().join("bad.toml"), PLAN).unwrap();
        replace(&desk.path().join("bad.toml"), from, to);
        refused(&desk, "plan rig.toml bad.toml", words);
        refused(&desk, "patterns rig.toml bad.toml --out frames", words);
    }
    let desk = desk();
    fs::write(desk.path().join("bad.toml"), b"name = \"\xff\"").unwrap();
    refused(&desk, "plan rig.toml bad.toml", &["bad.toml", "UTF-8"]);
    refused(&desk, "plan rig.toml missing.toml", &["missing.toml", "check the path"]);
    refused(&desk, "plan . plan.toml", &["cannot read .", "check the path"]);
    fs::write(desk.path().join("fine.toml"), PLAN.replace("rings = 8", "rings = 512")).unwrap();
    let calibrated = format!("--calibration {}", EXAMPLE.folder.join("run/calibration").display());
    let arguments = format!("measure rig.toml fine.toml --out run --simulate ggx-0.4 {calibrated}");
    refused(&desk, &arguments, &["ring", "fewer exitant.rings"]);
}

#[test]
fn wrong_usage_is_refused() {
    let desk = desk();
    for (arguments, words) in [
        (
            "measure rig.toml plan.toml --out run --simulate ggx-0.44",
            &["`ggx-0.44`", "ggx-0.4,", "zonal materials"][..],
        ),
        ("measure rig.toml plan.toml --out run --simulate rig.toml", &["rig.toml", "zonal materials"]),
        ("measure rig.toml plan.toml --out run", &["--simulate"]),
        ("measure rig.toml plan.toml --out run --simulate ggx-0.4 --seed -1", &["--seed", "-1"]),
        ("measure rig.toml plan.toml --out run --simulate ggx-0.4 --calibration none", &["none", "check the path"]),
        ("calibrate response rig.toml --out cal", &["--simulate"]),
        ("calibrate gray-card rig.toml --out cal --simulate", &["response.json", "zonal calibrate response"]),
        ("render ggx-0.4 --out picture", &["picture", ".png or .exr"]),
        ("render ggx-0.4 --out picture.jpg", &["picture.jpg", ".png or .exr"]),
        ("render ggx-0.4 --out old.png --size 0", &["--size 0", "8..=4096"]),
        ("render ggx-0.4 --out old.png --exposure nan", &["--exposure NaN", "positive"]),
        ("render ggx-0.4 --out old.png --exposure -1", &["--exposure -1", "positive"]),
        ("render ggx-0.4 --out old.png --probe rig.toml", &["rig.toml", ".hdr or .exr"]),
        ("render ggx-0.4 --out old.png --beside white-", &["`white-`", "white,"]),
        ("render old.exr --out old.png", &["old.exr", "make it again"]),
        ("render ggx-0.4", &["--out"]),
        ("convert run --out old.exr", &["run/run.json", "check the path"]),
        ("convert . --out old.exr", &["run.json", "check the path"]),
        ("convert run --out old.exr --order -1", &["--order", "-1"]),
        ("convert run --out old.exr --method best", &["best", "parity"]),
        ("reduce .", &["run.json", "check the path"]),
        ("demo --out page --material ggx", &["`ggx`", "did you mean"]),
        ("explain", &["explain"]),
    ] {
        refused(&desk, arguments, words);
    }
}

#[test]
fn places_that_cannot_be_written_are_refused_before_work_begins() {
    let desk = desk_with_run();
    fs::create_dir(desk.path().join("folder.png")).unwrap();
    for command in [
        "patterns rig.toml plan.toml",
        "measure rig.toml plan.toml --simulate ggx-0.4",
        "calibrate response rig.toml --simulate",
        "convert run",
        "render ggx-0.4",
        "demo",
    ] {
        for place in ["file/out.png", "file/below/out.png", "/dev/null/out.png"] {
            refused(&desk, &format!("{command} --out {place}"), &[place, "choose another --out"]);
        }
    }
    for place in ["folder.png", "none/out.png", "/dev/null"] {
        refused(&desk, &format!("convert run --out {place}"), &[place, "choose another --out"]);
    }
    for command in ["patterns rig.toml plan.toml", "measure rig.toml plan.toml --simulate ggx-0.4"] {
        refused(&desk, &format!("{command} --out run"), &["run already holds files", "choose another --out"]);
    }
}

#[test]
fn a_file_size_limit_leaves_what_was_there() {
    let desk = desk_with_run();
    for arguments in [
        "patterns rig.toml plan.toml --out frames",
        "measure rig.toml plan.toml --out new --simulate ggx-0.4 --calibration run/calibration",
        "calibrate flat-field rig.toml --out cal --simulate",
        "convert run --out old.exr",
        "render ggx-0.4 --out old.png --size 200",
        "render ggx-0.4 --out old.exr --size 200",
        "reduce run",
    ] {
        let before = contents(desk.path());
        let output = zonal_limited(desk.path(), 2, arguments);
        assert_refused(arguments, &output, &["cannot write", "too large", "free space"]);
        assert_unchanged(arguments, &before, &desk);
    }
}

#[test]
fn a_run_that_breaks_off_says_so() {
    let desk = desk_with_run();
    // An even projector's calibration is a small file, a frame is not.
    let rig = Rig::from_toml(RIG).unwrap();
    let mut calibration = CalibrationSet::read(&desk.path().join("run/calibration"), &rig).unwrap();
    calibration.flat = FlatField::uniform(rig.projector.width_px, rig.projector.height_px);
    calibration.write(&desk.path().join("even"), &rig).unwrap();
    let arguments = "measure rig.toml plan.toml --out new --simulate ggx-0.4 --calibration even";
    let output = zonal_limited(desk.path(), 100, arguments);
    assert_refused(arguments, &output, &["new/pending/000", "too large", "free space"]);
    let record = fs::read(desk.path().join("new/run.json")).unwrap();
    assert_eq!(serde_json::from_slice::<Value>(&record).unwrap()["status"], "failed");
    let left = contents(desk.path());
    assert!(!left.keys().any(|path| path.to_string_lossy().contains(".part")), "{:?}", left.keys());
    for arguments in ["convert new --out old.exr", "reduce new"] {
        refused(&desk, arguments, &["new/run.json", "`failed`", "--resume"]);
    }
}

#[test]
fn a_run_that_saturates_says_so() {
    let desk = desk_with_run();
    replace(
        &desk.path().join("plan.toml"),
        "count = 2\nshortest_refreshes = 2",
        "count = 1\nshortest_refreshes = 6000",
    );
    replace(&desk.path().join("plan.toml"), "order = 1", "order = 0");
    let arguments = "measure rig.toml plan.toml --out new --simulate white --calibration run/calibration";
    refused(&desk, arguments, &["plan.toml", "exposure.shortest_refreshes", "1..=600"]);
    replace(&desk.path().join("plan.toml"), "6000", "600");
    let output = zonal(desk.path(), arguments);
    assert_refused(arguments, &output, &["no signal", "saturated", "exposures"]);
    refused(&desk, "convert new --out old.exr", &["new/run.json", "`failed`", "--resume"]);
}

#[test]
fn damaged_runs_are_refused() {
    let cut = |bytes: &mut Vec<u8>| bytes.truncate(bytes.len() / 2);
    let desk = desk_with_run();
    let run = desk.path().join("run");
    let both = ["convert run --out old.exr", "reduce run"];
    let damaged = |name: &str, change: &dyn Fn(&mut Vec<u8>), commands: &[&str], words: &[&str]| {
        let whole = fs::read(run.join(name)).unwrap();
        edit(&run.join(name), change);
        commands.iter().for_each(|arguments| refused(&desk, arguments, words));
        fs::write(run.join(name), whole).unwrap();
    };
    let swap = |from: &'static str, to: &'static str| {
        move |bytes: &mut Vec<u8>| {
            let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).expect(from);
            bytes.splice(at..at + from.len(), to.bytes());
        }
    };
    damaged("run.json", &swap("\"order\": 1,", "\"order\": ,"), &both, &["run/run.json", "line", "column", "again"]);
    damaged("run.json", &swap("\"order\": 1,", "\"order\": \"one\","), &both, &["run/run.json", "\"one\"", "again"]);
    damaged(
        "run.json",
        &swap("\"format\": 2", "\"format\": 3, \"new\": 0"),
        &both,
        &["run/run.json", "format 3", "update"],
    );
    damaged("run.json", &swap("complete", "running"), &both, &["run/run.json", "`running`", "--resume"]);
    damaged(
        "run.json",
        &swap("\"gains\": [", "\"gains\": [1.0,"),
        &["reduce run"],
        &["run/run.json", "`gains`", "again"],
    );
    damaged("run.json", &cut, &both, &["run/run.json", "line", "again"]);
    damaged("coefficients.exr", &cut, &both[..1], &["run/coefficients.exr", "again"]);
    damaged(
        "coefficients.exr",
        &swap("z_003.R", "z_003.S"),
        &both[..1],
        &["run/coefficients.exr", "`z_003.R`", "again"],
    );
    damaged("rig.toml", &cut, &["reduce run"], &["rig.toml", "line"]);
    damaged("plan.toml", &swap("order = 1", "order = 2"), &["reduce run"], &["run/run.json", "`gains`", "again"]);
    damaged("calibration/gray-card.json", &cut, &["reduce run"], &["gray-card.json", "line", "again"]);
    let response = "responses/002_l1_m+0_a_positive.exr";
    damaged(response, &cut, &["reduce run"], &[response, "again"]);
    damaged(response, &|bytes| bytes.clear(), &["reduce run"], &[response, "again"]);
    let other = fs::read(run.join("calibration/flat-field.exr")).unwrap();
    damaged(response, &|bytes| *bytes = other.clone(), &["reduce run"], &[response, "`zonal_crop_u0_px`", "again"]);
    refused(&desk, "convert run --out old.exr --order 200", &["--order 200", "choose a smaller one"]);
}

#[test]
fn calibrations_of_another_rig_are_refused_before_a_folder_appears() {
    let desk = desk_with_run();
    replace(&desk.path().join("rig.toml"), "name = \"ghosh-2007-built\"", "name = \"mine\"");
    for arguments in [
        "measure rig.toml plan.toml --out new --simulate ggx-0.4 --calibration run/calibration",
        "patterns rig.toml plan.toml --out new --calibration run/calibration",
    ] {
        refused(&desk, arguments, &["run/calibration/", "`ghosh-2007-built`", "`mine`", "calibrate this rig"]);
    }
}

#[test]
fn damaged_harmonics_are_refused() {
    let desk = desk_with_run();
    let whole = fs::read(desk.path().join("sh.exr")).unwrap();
    let after = |name: &[u8]| whole.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
    let window = after(b"dataWindow\0box2i\0");
    let order = after(b"zonal_sh_order\0double\0");
    let format = after(b"zonal_format\0double\0");
    type Case<'a> = (&'a str, &'a dyn Fn(&mut Vec<u8>), &'a str);
    let cases: [Case<'_>; 7] = [
        ("truncated", &|bytes| bytes.truncate(whole.len() / 2), "again"),
        ("cut in the header", &|bytes| bytes.truncate(100), "again"),
        ("empty", &|bytes| bytes.clear(), "again"),
        ("of absurd size", &|bytes| bytes[window + 8..window + 16].fill(0x3f), "again"),
        ("of a newer format", &|bytes| bytes[format..format + 8].copy_from_slice(&2f64.to_le_bytes()), "update zonal"),
        ("of absurd order", &|bytes| bytes[order..order + 8].copy_from_slice(&1e300f64.to_le_bytes()), "order"),
        ("of another order", &|bytes| bytes[order..order + 8].copy_from_slice(&9f64.to_le_bytes()), "again"),
    ];
    for (what, change, remedy) in cases {
        eprintln!("{what}");
        fs::write(desk.path().join("bad.exr"), &whole).unwrap();
        edit(&desk.path().join("bad.exr"), change);
        refused(&desk, "render bad.exr --out old.png", &["bad.exr", remedy]);
    }
}

#[test]
fn the_literal_dual_is_refused_where_noise_exceeds_the_signal() {
    let desk = desk_with_run();
    let (order, grid) = (6, ExitantGrid::new(Zone::from_degrees(9.0, 57.0).unwrap(), 4, 6));
    let values = vec![0.5; 49 * 3 * grid.len()];
    let noisy = Coefficients { grid, order, sigma: vec![0.01; values.len()], values, history: String::new() };
    noisy.write(&desk.path().join("run/coefficients.exr")).unwrap();
    let thesis = "convert run --out old.exr --method thesis";
    refused(&desk, thesis, &["noise_gain_out = ", "noise_rel", "--method parity", "--force"]);
    let forced = json(&zonal(desk.path(), &format!("{thesis} --force --json")));
    assert!(forced["noise_gain_out"].as_f64().unwrap() > 100.0);
    assert_ne!(fs::read(desk.path().join("old.exr")).unwrap(), b"old");
    json(&zonal(desk.path(), "convert run --out sh.exr --json"));
}

#[test]
fn every_command_prints_one_object() {
    let desk = desk_with_run();
    let print = |arguments: &str| json(&zonal(desk.path(), &format!("{arguments} --json")));
    assert!(print("materials")["materials"].as_array().unwrap().len() > 100);
    assert_keys(&print("plan rig.toml plan.toml"), &["order", "images", "frames", "rig_s", "rig_s_items"]);
    assert_eq!(print("patterns rig.toml plan.toml --out frames")["images"], 8);
    assert_eq!(fs::read_dir(desk.path().join("frames")).unwrap().count(), 12);
    assert_eq!(print("calibrate flat-field rig.toml --out cal --simulate")["kind"], "flat-field");
    assert_eq!(print("render sh.exr --out new.png --size 16 --beside ggx-0.4")["out"], "new.png");
    const MEASURED: [&str; 10] = [
        "order",
        "images",
        "frames",
        "rig_s",
        "rig_s_items",
        "compute_s",
        "post_s",
        "zone_deg",
        "noise_rel",
        "saturated_fraction",
    ];
    let measured = json(&EXAMPLE.measured);
    assert_keys(&measured, &MEASURED);
    let reduced = print("reduce run");
    assert_keys(&reduced, &MEASURED);
    assert_eq!(reduced["noise_rel"], measured["noise_rel"]);
    let converted = json(&EXAMPLE.converted);
    assert_keys(&converted, &["method", "order", "condition", "noise_gain_in", "noise_gain_out"]);
}

fn assert_keys(object: &Map<String, Value>, keys: &[&str]) {
    for key in keys {
        assert!(object.contains_key(*key), "no `{key}` in {object:?}");
    }
}

#[test]
fn folders_with_spaces_and_other_letters_will_do() {
    let desk = desk();
    let out = "Proben über Ⅱ/Bild eins.png";
    fs::create_dir(desk.path().join("Proben über Ⅱ")).unwrap();
    let output =
        Command::new(ZONAL).current_dir(desk.path()).args(["render", "ggx-0.4", "--size", "8", "--out", out]).output();
    assert!(output.unwrap().status.success());
    assert!(desk.path().join(out).is_file());

    // Names need not be Unicode; JSON must.
    let odd = OsStr::from_bytes(b"odd\xff.png");
    let arguments = ["render", "ggx-0.4", "--size", "8", "--json", "--out"];
    let output = Command::new(ZONAL).current_dir(desk.path()).args(arguments).arg(odd).output().unwrap();
    assert_eq!(json(&output)["out"], "odd\u{fffd}.png");
    assert!(desk.path().join(odd).is_file());
}
