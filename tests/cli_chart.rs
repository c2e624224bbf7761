//! `zonal chart` from outside: the files, the keys other programs read, and that bad requests end with status 2 and write
//! nothing.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn zonal(folder: &Path, arguments: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_zonal")).current_dir(folder).args(arguments.split(' ')).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Few materials and low orders: where methods fail is seen all the same.
#[test]
fn the_chart_of_stability_is_a_table_a_picture_and_a_page() {
    let desk = tempfile::tempdir().unwrap();
    let output = zonal(desk.path(), "chart stability --out charts/new --materials 2 --max-order 4 --json");
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said: Value = serde_json::from_slice(&output.stdout).expect("one JSON value and nothing else");
    assert!(said["materials"] == 4 && said["seconds"].as_f64().unwrap() > 0.0, "{said}");
    let file = |key: &str| fs::read(desk.path().join(said[key].as_str().unwrap())).unwrap();

    let table = file("csv");
    let mut table = csv::Reader::from_reader(table.as_slice());
    let header: Vec<String> = table.headers().unwrap().iter().map(str::to_owned).collect();
    let column = |name: &str| header.iter().position(|h| h == name).unwrap();
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    assert_eq!(rows.len() as u64, said["rows"].as_u64().unwrap());
    let find = |method: &str, limit: &str, noise: &str| {
        let wanted = [("method", method), ("zone_max_deg", limit), ("order", "4"), ("noise_rel", noise)];
        let mut found = rows.iter().filter(|r| wanted.iter().all(|(name, value)| &r[column(name)] == *value));
        let row = found.next().unwrap_or_else(|| panic!("no {wanted:?}"));
        assert!(found.next().is_none(), "{wanted:?} twice");
        row
    };
    let number = |row: &csv::StringRecord, name: &str| row[column(name)].parse::<f64>().unwrap();
    let thesis = find("thesis", "57.0", "0.01");
    assert!(&thesis[column("refused")] == "true" && number(thesis, "error_out_median") > 1.0, "{thesis:?}");
    assert!(number(thesis, "error_out_p90") >= number(thesis, "error_out_median"));
    let exact = find("thesis", "57.0", "0.0");
    assert!(&exact[column("refused")] == "false" && number(exact, "error_out_median") > 1.0, "{exact:?}");
    assert!(number(find("prior", "57.0", "0.01"), "error_out_median") < 0.2);
    assert!(number(find("thesis", "90.0", "0.01"), "noise_gain_out") < 2.0);
    assert!(number(find("gram-all", "57.0", ""), "condition") > 1e8);

    let picture = image::load_from_memory(&file("png")).unwrap();
    assert!(picture.width() > 1000 && picture.height() > 1000);
    assert!(text(&file("svg")).starts_with("<svg xmlns"));
    let page = text(&file("page"));
    for words in ["<!DOCTYPE html>", "Failures", "stability.csv", "</html>"] {
        assert!(page.contains(words), "{words}");
    }
    let again = zonal(desk.path(), "chart stability --out charts/new");
    assert!(again.status.code() == Some(2) && text(&again.stderr).contains("nothing is overwritten"));
}

/// One material and short runs: what the picture is about is seen all the same.
#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn the_chart_of_time_is_a_table_a_picture_and_a_page() {
    let desk = tempfile::tempdir().unwrap();
    let output = zonal(desk.path(), "chart pareto --out pareto --materials 1 --max-order 4 --json");
    assert!(output.status.success(), "{}", text(&output.stderr));
    let said: Value = serde_json::from_slice(&output.stdout).expect("one JSON value and nothing else");
    let plans = said["plans"].as_array().unwrap();
    let run = plans.iter().filter(|p| p["measured"].is_f64()).count();
    assert!(run >= 12, "{run} plans were run");
    for scheme in ["pairs", "offset", "multiplexed", "isotropic", "adaptive"] {
        assert!(plans.iter().any(|p| p["scheme"] == scheme && p["measured"].is_f64()), "{scheme}");
    }
    let seed = said["seed"].as_array().unwrap();
    assert!(seed.iter().any(|s| s["order"] == 4 && s["rig_s"][1] == 60.0) && seed.iter().any(|s| s["order"] == 10));
    for stage in ["conversion", "fit", "simulation"] {
        let of = |c: &&Value| c["stage"] == stage && c["baseline"] == true;
        assert!(said["computing"].as_array().unwrap().iter().any(|c| of(&c)), "{stage} has its baseline");
    }
    let file = |key: &str| fs::read(desk.path().join(said[key].as_str().unwrap())).unwrap();
    assert!(csv::Reader::from_reader(file("csv").as_slice()).records().count() >= plans.len());
    assert!(image::load_from_memory(&file("png")).unwrap().width() > 1000);
    assert!(text(&file("svg")).contains("Ghosh 2007") && text(&file("page")).contains("pareto.csv"));
}

#[test]
fn bad_requests_are_refused() {
    let desk = tempfile::tempdir().unwrap();
    fs::write(desk.path().join("file"), "x").unwrap();
    let requests = [
        ("chart stabilty --out new", "stability"),
        ("chart stability", "--out"),
        ("chart pareto run --out new", "takes no runs"),
        ("chart pareto --out file/new", "choose another --out"),
        ("chart stability --out file/new", "choose another --out"),
        ("chart stability --out new --materials 0", "at least 1"),
        ("chart stability --out new --max-order 3", "4..=20"),
        ("chart stability --out new --max-order 21", "4..=20"),
    ];
    for (arguments, word) in requests {
        let output = zonal(desk.path(), arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments}: {said}");
        assert!(output.stdout.is_empty() && said.contains(word), "{arguments}: no `{word}` in\n{said}");
    }
    assert_eq!(fs::read_dir(desk.path()).unwrap().count(), 1);
}
