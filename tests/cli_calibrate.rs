//! `zonal calibrate` from outside: every kind, the dates and rigs its files are held to, and what is refused.

mod common;
mod program;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use program::{json, refused};
use serde_json::{Value, json};
use tempfile::TempDir;

const PLAN: &str = "format = 1\nname = \"small\"\norder = 1\nrepeats = 1\n\
    [exposure]\ncount = 2\nshortest_refreshes = 1\nspacing = 8\n[exitant]\nrings = 4\nsectors = 8\n";

/// A folder with a small rig, a plan, all calibrations in `cal` and a run with them in `run`.
struct Desk(TempDir);

impl Desk {
    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    /// An argument of the desk for every word that begins with `@`.
    fn words(&self, line: &str) -> Vec<String> {
        line.split(' ').map(|word| word.strip_prefix('@').map_or(word.to_owned(), |name| self.path(name))).collect()
    }

    fn json(&self, line: &str) -> Value {
        let words = self.words(line);
        json(&words.iter().map(String::as_str).collect::<Vec<_>>())
    }

    fn refused(&self, line: &str, said: &[&str]) {
        let words = self.words(line);
        refused(&words.iter().map(String::as_str).collect::<Vec<_>>(), said);
    }

    fn change(&self, name: &str, change: impl FnOnce(&mut Value)) {
        let path = self.path(name);
        let mut value: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        change(&mut value);
        fs::write(path, value.to_string()).unwrap();
    }
}

/// A rig and a plan alone.
fn bare() -> Desk {
    let desk = Desk(tempfile::tempdir().unwrap());
    let rig = common::coarse(common::rig("ghosh-2007-built"), 4);
    fs::write(desk.path("rig.toml"), rig.to_toml()).unwrap();
    fs::write(desk.path("plan.toml"), PLAN).unwrap();
    desk
}

const CALIBRATE: &str = "@rig.toml --simulate --out @cal";
const MEASURE: &str = "measure @rig.toml @plan.toml --simulate red-plastic --calibration @cal --out";

static CALIBRATED: LazyLock<PathBuf> = LazyLock::new(|| {
    let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cli-calibrate");
    let _ = fs::remove_dir_all(&kept);
    fs::create_dir_all(&kept).unwrap();
    let desk = bare();
    for kind in ["response", "flat-field", "gray-card"] {
        assert_eq!(desk.json(&format!("calibrate {kind} {CALIBRATE}"))["kind"], kind);
    }
    desk.json(&format!("{MEASURE} @run"));
    copy(desk.0.path(), &kept);
    kept
});

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let to = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &to);
        } else {
            fs::copy(entry.path(), to).unwrap();
        }
    }
}

fn desk() -> Desk {
    let desk = Desk(tempfile::tempdir().unwrap());
    copy(&CALIBRATED, desk.0.path());
    desk
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn all_kinds_serve_one_measurement() {
    let desk = desk();
    let noise = desk.json(&format!("calibrate noise {CALIBRATE}"));
    let gain = noise["figures"]["noise"]["transfer"]["gain_dn_per_e"].as_f64().unwrap();
    // Relative: a sixteenth of the pixels; `calibration::the_camera_is_found_again` is stricter with more.
    assert!((gain / 0.28 - 1.0).abs() < 0.06, "{noise}");
    let linear = desk.json(&format!("calibrate linearity {CALIBRATE}"));
    assert!(linear["figures"]["noise"].is_object() && linear["figures"]["linear_range"]["ends"] == true, "{linear}");
    let trap = desk.json(&format!("calibrate black-trap {CALIBRATE} --plan @plan.toml"));
    assert_eq!(trap["order"], 1);
    // The card's own plan has order 2, the trap was for less.
    desk.refused(&format!("calibrate gray-card {CALIBRATE}"), &["order 1", "order 2", "black-trap --plan"]);
    fs::write(desk.path("second.toml"), PLAN.replace("order = 1", "order = 2")).unwrap();
    desk.json(&format!("calibrate black-trap {CALIBRATE} --plan @second.toml"));
    let card = desk.json(&format!("calibrate gray-card {CALIBRATE}"));
    assert_eq!(card["trap"], true, "{card}");
    desk.refused(&format!("{MEASURE} @mixed --colour projector"), &["zonal calibrate colour"]);
    let colour = desk.json(&format!("calibrate colour {CALIBRATE}"));
    assert!((colour["colour"]["condition"].as_f64().unwrap() - 1.0).abs() < 0.05, "{colour}");
    let measured = desk.json(&format!("{MEASURE} @mixed --colour projector"));
    assert_eq!(measured["colour_space"], "projector");
    for file in ["camera.json", "camera-maps.exr", "black-trap.exr", "colour.json"] {
        assert!(Path::new(&desk.path(&format!("mixed/calibration/{file}"))).is_file(), "{file}");
    }
    assert_eq!(desk.json("reduce @mixed --colour camera")["colour_space"], "camera");
    fs::write(desk.path("third.toml"), PLAN.replace("order = 1", "order = 3")).unwrap();
    let finer = MEASURE.replace("plan.toml", "third.toml");
    desk.refused(&format!("{finer} @finer"), &["order 2", "order 3", "black-trap --plan"]);
    assert!(!Path::new(&desk.path("finer")).exists());
}

#[test]
fn references_are_files_or_materials() {
    let desk = desk();
    let card =
        |more: &str| desk.json(&format!("calibrate gray-card {CALIBRATE} {more}"))["check"]["worst_error"].clone();
    fs::write(desk.path("card.csv"), "theta_i_deg,theta_o_deg,factor\n0,0,0.2\n0,60,0.18\n60,0,0.18\n60,60,0.15\n")
        .unwrap();
    for more in ["--albedo 0.5", "--reference @card.csv", "--reference ggx-0.4 --albedo 0.5"] {
        let error = card(more).as_f64().unwrap();
        // Of z_00, with pixels four times as wide: 0.3% is the best that full ones do, 1.2% was seen here.
        assert!(error < 0.02, "{more}: {error}");
    }
    fs::write(desk.path("bad.csv"), "theta_i_deg,theta_o_deg,factor\n0,0,0.2\n60,60,0.15\n").unwrap();
    desk.refused(&format!("calibrate gray-card {CALIBRATE} --reference @bad.csv"), &["bad.csv", "give every pair"]);
    desk.refused(&format!("calibrate gray-card {CALIBRATE} --reference gry-card"), &["gray-card"]);
    desk.refused(&format!("calibrate gray-card {CALIBRATE} --albedo 1.5"), &["--albedo 1.5", "at most 1"]);
    desk.refused(&format!("calibrate response {CALIBRATE} --albedo 0.5"), &["--albedo", "leave it out"]);
    desk.refused(&format!("calibrate response {CALIBRATE} --method debevec"), &["--method", "leave it out"]);
    desk.refused(&format!("calibrate camera-response {CALIBRATE}"), &["256 codes", "zonal calibrate linearity"]);
    desk.refused(&format!("calibrate gray-card {CALIBRATE} --plan @plan.toml"), &["--plan", "leave it out"]);
}

#[test]
fn files_of_other_times_rigs_and_devices_are_refused() {
    let spoilt = |name: &str, change: &dyn Fn(&mut Value), said: &[&str]| {
        let desk = desk();
        desk.change(&format!("cal/{name}"), change);
        desk.refused(&format!("{MEASURE} @new"), &[&[name], said].concat());
        assert!(!Path::new(&desk.path("new")).exists());
    };
    let age = |file: &mut Value| file["header"]["date"] = "2020-02-29T12:00:00Z".into();
    spoilt("response.json", &age, &["2020-02-29", "--max-age-days", "zonal calibrate response"]);
    spoilt("gray-card.json", &|f| f["format"] = 3.into(), &["format 3", "update zonal"]);
    spoilt("gray-card.json", &|f| f["header"]["devices"] = "real".into(), &["real", "simulated", "calibrate these"]);
    spoilt("response.json", &|f| f["header"]["rig_fingerprint"] = "0".into(), &["fingerprint 0", "calibrate again"]);
    spoilt("response.json", &|f| f["header"]["kind"] = "colour".into(), &["`colour`", "calibrate again"]);

    let desk = desk();
    desk.change("cal/response.json", age);
    desk.json(&format!("{MEASURE} @late --max-age-days 100000"));
    desk.refused(&format!("{MEASURE} @new --max-age-days nan"), &["--max-age-days", "above 0"]);
    desk.change("run/calibration/response.json", age);
    desk.json("reduce @run");
    desk.change("run/calibration/gray-card.json", |f| f["header"]["devices"] = "real".into());
    desk.refused("reduce @run", &["gray-card.json", "real", "simulated"]);
}

#[test]
fn files_of_the_first_format_are_read() {
    let desk = desk();
    for name in ["cal/response.json", "cal/gray-card.json"] {
        desk.change(name, |file| {
            let header = file.as_object_mut().unwrap().remove("header").unwrap();
            file["rig"] = header["rig"].clone();
            file["format"] = 1.into();
        });
    }
    desk.json(&format!("{MEASURE} @new"));
    desk.change("cal/response.json", |file| file["rig"] = json!("other"));
    desk.refused(&format!("{MEASURE} @newer"), &["response.json", "`other`", "calibrate this rig"]);
}

/// A made-up sensor: pairs of images of even light with shot noise.
#[test]
fn noise_is_taken_from_a_data_set_on_disk() {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    const GAIN: f64 = 0.25;
    let desk = bare();
    let mut rng = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(1);
    let mut save = |name: &str, electrons: f64| {
        let mut dn = || {
            let unit: f64 = StandardNormal.sample(&mut rng);
            (20.0 + GAIN * (electrons + unit * (electrons + 100.0).sqrt()).min(12000.0)).round() as u16
        };
        let image = image::ImageBuffer::<image::Luma<u16>, _>::from_fn(64, 64, |_, _| image::Luma([dn()]));
        image.save(desk.0.path().join(name)).unwrap();
    };
    let mut text = "n 12 64 64\n".to_owned();
    for level in 0..=40 {
        let photons = f64::from(level) * 350.0;
        text += &if level == 0 { "d 1000\n".into() } else { format!("b 1000 {}\n", 2.0 * photons) };
        for image in ["a", "b"] {
            let name = format!("{level}-{image}.png");
            save(&name, photons);
            text += &format!("i {name}\n");
        }
    }
    fs::write(desk.path("data.txt"), text).unwrap();
    let said = desk.json("calibrate noise @rig.toml --emva @data.txt --out @cal");
    let found = &said["figures"]["noise"]["transfer"];
    // Relative: 4096 pixels at some 25 levels.
    assert!((found["gain_dn_per_e"].as_f64().unwrap() / GAIN - 1.0).abs() < 0.02, "{said}");
    assert!((said["figures"]["noise"]["black_level_dn"].as_f64().unwrap() - 20.0).abs() < 0.2, "{said}");
    fs::write(desk.path("data.txt"), "n 12 64 64\nb 1 1\ni ../a.png\n").unwrap();
    desk.refused("calibrate noise @rig.toml --emva @data.txt --out @cal", &["data.txt", "line 3", "folder"]);
}
