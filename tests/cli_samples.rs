//! Samples with names and grains: `zonal measure --sample --grain-deg`, `--batch`, `zonal merge`, `zonal budget` and
//! `zonal chart control`, run as a program.

mod common;
mod program;

use std::path::Path;
use std::sync::LazyLock;

use program::{json, refused, zonal};
use serde_json::Value;
use zonal::reduce::Coefficients;

const PLAN: &str = "format = 1\nname = \"small\"\norder = 1\nrepeats = 1\n\
    [exposure]\ncount = 2\nshortest_refreshes = 2\nspacing = 8\n[exitant]\nrings = 6\nsectors = 12\n";
const BUDGET: &str = "[budget]\ncard_rel = 0.003\ncard_source = \"certificate 17\"\n";

/// One calibration, an anisotropic sample at three angles, an isotropic one at two, and one that cannot be.
const BATCH: &str = r#"
[[sample]]
name = "brushed"
simulate = "ggx-0.1-0.4"
[[sample]]
name = "brushed"
simulate = "ggx-0.1-0.4"
grain_deg = 30
[[sample]]
name = "brushed"
simulate = "ggx-0.1-0.4"
grain_deg = 90
[[sample]]
name = "plain"
simulate = "ggx-0.4"
[[sample]]
name = "plain"
simulate = "ggx-0.4"
grain_deg = 90
[[sample]]
name = "lost"
simulate = "no-such-material"
"#;

/// A folder with the batch measured; tests only read it.
static BENCH: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let rig = common::coarse(common::rig("ghosh-2007-built"), 4).to_toml();
    for (name, text) in
        [("rig.toml", rig.as_str()), ("plan.toml", PLAN), ("budget.toml", BUDGET), ("batch.toml", BATCH)]
    {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let output = zonal(&batch(folder.path(), &[]).iter().map(String::as_str).collect::<Vec<_>>());
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("1 of 6 samples failed") && said.contains("no-such-material"), "{said}");
    folder
});

fn batch(folder: &Path, more: &[&str]) -> Vec<String> {
    let at = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let (rig, plan, list, budget, out) =
        (at("rig.toml"), at("plan.toml"), at("batch.toml"), at("budget.toml"), at("out"));
    let words = ["measure", &rig, &plan, "--batch", &list, "--budget", &budget, "--out", &out];
    words.iter().chain(more).map(|w| (*w).to_owned()).collect()
}

/// A rig of fewer, larger pixels.
fn rig() -> String {
    BENCH.path().join("rig.toml").to_str().unwrap().to_owned()
}

fn run(name: &str) -> String {
    BENCH.path().join("out").join(name).to_str().unwrap().to_owned()
}

fn coefficients(run: &str) -> Coefficients {
    Coefficients::read(&Path::new(run).join("coefficients.exr")).unwrap()
}

/// RMS of differences over their standard errors, middle rings: at the zone's edges cells are cut by it.
fn pulls(a: &Coefficients, b: &Coefficients) -> f64 {
    let (sum, n) = a.values.iter().zip(&a.sigma).zip(b.values.iter().zip(&b.sigma)).fold(
        (0.0, 0.0),
        |(sum, n), ((x, s), (y, t))| {
            let pull = f64::from(x - y) / f64::from(s.hypot(*t));
            (sum + pull * pull, n + 1.0)
        },
    );
    (sum / n).sqrt()
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn a_failed_sample_does_not_keep_the_others() {
    let list: Value =
        serde_json::from_str(&std::fs::read_to_string(BENCH.path().join("out/batch.json")).unwrap()).unwrap();
    let outcomes: Vec<&str> = list.as_array().unwrap().iter().map(|o| o["outcome"].as_str().unwrap()).collect();
    assert_eq!(outcomes, ["measured", "measured", "measured", "measured", "measured", "failed"]);
    assert!(list[5]["error"].as_str().unwrap().contains("no-such-material"));
    let record: Value =
        serde_json::from_str(&std::fs::read_to_string(Path::new(&run("brushed-30deg")).join("run.json")).unwrap())
            .unwrap();
    let provenance = &record["provenance"];
    assert_eq!((&provenance["name"], &provenance["grain_deg"]), (&"brushed".into(), &30.0.into()));
    assert_eq!(provenance["sample"], "ggx-0.1-0.4");
    let began = provenance["started"].as_str().unwrap();
    assert!(began.len() == 20 && began.ends_with('Z'), "{began}");
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn a_batch_goes_on_where_it_stopped() {
    // The others are found complete; the missing material is still missing.
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    for name in ["brushed", "calibration"] {
        copy(&BENCH.path().join("out").join(name), &out.join(name));
    }
    let two = "[[sample]]\nname = \"brushed\"\nsimulate = \"ggx-0.1-0.4\"\n[[sample]]\nname = \"card\"\nsimulate = \"gray-card\"\n";
    std::fs::copy(rig(), folder.path().join("rig.toml")).unwrap();
    for (name, text) in [("plan.toml", PLAN), ("budget.toml", BUDGET), ("batch.toml", two)] {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let words = batch(folder.path(), &["--resume"]);
    let said = json(&words.iter().map(String::as_str).collect::<Vec<_>>());
    let outcome = |i: usize| said["samples"][i]["outcome"].clone();
    assert_eq!((outcome(0), outcome(1)), ("complete before".into(), "measured".into()), "{said}");
    let words = batch(folder.path(), &[]);
    refused(&words.iter().map(String::as_str).collect::<Vec<_>>(), &["already holds files"]);
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().map(|e| e.unwrap().path()) {
        let to = to.join(entry.file_name().unwrap());
        if entry.is_dir() {
            copy(&entry, &to);
        } else {
            std::fs::copy(&entry, &to).unwrap();
        }
    }
}

/// Squares of pulls average 1 where noise alone tells them apart; the rig's alignment, which turns with no sample, adds some.
const WITHIN_NOISE: f64 = 2.0;

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn merged_remounts_agree_with_the_sample_at_zero() {
    let folder = tempfile::tempdir().unwrap();
    for (name, runs) in
        [("brushed", &["brushed", "brushed-30deg", "brushed-90deg"][..]), ("plain", &["plain", "plain-90deg"])]
    {
        let out = folder.path().join(name).to_str().unwrap().to_owned();
        let paths: Vec<String> = runs.iter().map(|r| run(r)).collect();
        let words: Vec<&str> =
            std::iter::once("merge").chain(paths.iter().map(String::as_str)).chain(["--out", &out]).collect();
        let said = json(&words);
        let (merged, straight) = (coefficients(&out), coefficients(&paths[0]));
        let turned = coefficients(&paths[1]);
        let (together, apart) = (pulls(&merged, &straight), pulls(&turned, &straight));
        eprintln!("{name}: pulls {together:.2} merged, {apart:.2} not turned; {said}");
        assert!(together < WITHIN_NOISE, "{name}: {together}");
        assert!(name == "plain" || apart > 5.0 * WITHIN_NOISE, "the grain shows: {apart}");
        assert!(said["reduced_chi2"].as_f64().unwrap() < WITHIN_NOISE.powi(2), "{said}");
        assert!(merged.noise_rel() < 0.9 * straight.noise_rel());
        let provenance = &said["record"]["provenance"];
        assert_eq!(provenance["merged"].as_array().unwrap().len(), runs.len());
        assert_eq!(provenance["grain_deg"], 0.0);
        // What comes after takes it; what needs responses does not.
        json(&["convert", &out, "--out", folder.path().join("sh.exr").to_str().unwrap()]);
        json(&["budget", &out]);
        refused(&["reduce", &out], &["merged"]);
    }
    let out = folder.path().join("mixed").to_str().unwrap().to_owned();
    refused(&["merge", &run("brushed"), &run("plain"), "--out", &out], &["plain", "sample"]);
    refused(&["merge", &run("brushed"), "--out", &out], &["1 runs are too few"]);
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn budgets_are_told_and_taken_on() {
    let said = json(&["budget", &run("plain")]);
    let budget = &said["budget"];
    assert_eq!(
        (&budget["assumed"]["card_rel"], &budget["components"][3]["source"]),
        (&0.003.into(), &"certificate 17".into())
    );
    let [low, high] = [0, 1].map(|i| budget["albedo"]["interval_95"][1][i].as_f64().unwrap());
    let value = budget["albedo"]["value"][1].as_f64().unwrap();
    assert!(low < value && value < high && high - low > 4.0 * 0.003 * value * 0.97, "{low} {value} {high}");
    assert_eq!(budget["rings"].as_array().unwrap().len(), 6);
    let both = json(&["budget", &run("plain"), &run("plain-90deg")]);
    assert_eq!(both["remounts"]["runs"], 2);
    assert!(both["remounts"]["remount_rel"].as_f64().unwrap() < 0.01, "{both}");
    let text = String::from_utf8(zonal(&["budget", &run("plain")]).stdout).unwrap();
    assert!(text.contains("zone edges") && text.contains("systematic"), "{text}");
    refused(&["budget", &run("plain"), &run("brushed")], &["sample"]);
    let bad = BENCH.path().join("bad.toml");
    std::fs::write(&bad, "[budget]\ncard_rel = 7\n").unwrap();
    refused(&["budget", &run("plain"), "--budget", bad.to_str().unwrap()], &["card_rel = 7", "bad.toml"]);
    std::fs::write(&bad, "[budget]\ncard = 7\n").unwrap();
    refused(&["budget", &run("plain"), "--budget", bad.to_str().unwrap()], &["unknown field"]);
    // A fit takes its calibration's uncertainty from there.
    let folder = tempfile::tempdir().unwrap();
    let fit =
        json(&["fit", &run("plain"), "--model", "lambert", "--out", folder.path().join("fit.json").to_str().unwrap()]);
    assert!(fit["calibration"]["scale_rel"].as_f64().unwrap() > 0.003, "{fit}");
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn a_lamp_out_of_control_is_flagged() {
    // One run of the card, its record and coefficients copied with the scatter of a season.
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let calibration = run("calibration");
    let plan = BENCH.path().join("plan.toml").to_str().unwrap().to_owned();
    json(&["measure", &rig(), &plan, "--simulate", "gray-card", "--calibration", &calibration, "--out", &at("card")]);
    let card = coefficients(&at("card"));
    let record = std::fs::read_to_string(folder.path().join("card/run.json")).unwrap();
    let began = serde_json::from_str::<Value>(&record).unwrap()["provenance"]["started"].as_str().unwrap().to_owned();
    let runs: Vec<String> = (0..12).map(|i| at(&format!("day-{i}"))).collect();
    for (i, run) in runs.iter().enumerate() {
        std::fs::create_dir(run).unwrap();
        let factor = if i == 11 { 1.05 } else { 1.0 + 1e-3 * [0.0, 1.0, -1.0][i % 3] };
        let mut today = card.clone();
        today.values.iter_mut().for_each(|z| *z *= factor);
        today.write(&Path::new(run).join("coefficients.exr")).unwrap();
        let date = format!("2026-03-{:02}T09:00:00Z", 12 - i);
        std::fs::write(Path::new(run).join("run.json"), record.replace(&began, &date)).unwrap();
    }
    let words = |out: &str, more: &[&str]| -> Vec<String> {
        let fixed = ["chart", "control", "--out", out];
        fixed.iter().chain(more).map(|w| (*w).to_owned()).chain(runs.iter().cloned()).collect()
    };
    // The last of the list is the first in time: of the first ten runs it widens the limits, alone at the end it stands out.
    let said = json(&words(&at("chart"), &["--baseline", "10"]).iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(said["runs"][0]["run"], runs[11].as_str());
    let reversed: Vec<String> = runs
        .iter()
        .enumerate()
        .map(|(i, run)| {
            let path = Path::new(run).join("run.json");
            let date = format!("2026-03-{:02}T09:00:00Z", 12 - i);
            let text =
                std::fs::read_to_string(&path).unwrap().replace(&date, &format!("2026-04-{:02}T09:00:00Z", i + 1));
            std::fs::write(&path, text).unwrap();
            run.clone()
        })
        .collect();
    let said = json(&words(&at("again"), &["--baseline", "10"]).iter().map(String::as_str).collect::<Vec<_>>());
    let flagged = said["flagged"].as_array().unwrap();
    assert_eq!(flagged.len(), 1, "{flagged:?}");
    assert_eq!(flagged[0]["run"], reversed[11].as_str());
    for file in ["index.html", "control.svg", "control.png", "control.csv"] {
        assert!(Path::new(&at("again")).join(file).metadata().unwrap().len() > 1000, "{file}");
    }
    refused(&["chart", "control", &runs[0], "--out", &at("few")], &["too few"]);
    refused(&["chart", "stability", &runs[0], "--out", &at("few")], &["takes no runs"]);
}
