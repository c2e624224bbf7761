//! `zonal plan` and adaptive measurements from outside: budgets, forecasts, keys that other programs read, bad requests.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn zonal(folder: &Path, arguments: &str) -> Output {
    let root = env!("CARGO_MANIFEST_DIR");
    let arguments = arguments.replace("RIG", &format!("{root}/optics/ghosh-2007-built.toml"));
    let arguments = arguments.replace("PLAN", &format!("{root}/patterns/order-4.toml"));
    Command::new(env!("CARGO_BIN_EXE_zonal")).current_dir(folder).args(arguments.split(' ')).output().unwrap()
}

fn said(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON value and nothing else")
}

#[test]
fn plans_are_forecast_and_found_for_a_budget() {
    let desk = tempfile::tempdir().unwrap();
    let given = said(&zonal(desk.path(), "plan RIG PLAN --json"));
    assert_eq!(given["frames"], 150);
    assert!((given["rig_s"].as_f64().unwrap() - 20.0).abs() < 1e-9);
    let error = |v: &Value| v["predicted_error"].as_f64().unwrap();
    let by_class = ["matte", "satin", "glossy", "specular"]
        .map(|c| error(&said(&zonal(desk.path(), &format!("plan RIG PLAN --class {c} --json")))));
    assert!(by_class.is_sorted() && by_class[0] > 0.0 && by_class[3] < 1.0, "{by_class:?}");
    let mut last = f64::INFINITY;
    for budget in [1.0, 5.0, 10.0, 20.0, 60.0] {
        let best =
            said(&zonal(desk.path(), &format!("plan RIG PLAN --budget {budget} --out best-{budget}.toml --json")));
        assert!(best["rig_s"].as_f64().unwrap() <= budget, "{best}");
        assert!(error(&best) <= last, "more time never costs accuracy: {best}");
        last = error(&best);
        let again = said(&zonal(desk.path(), &format!("plan RIG best-{budget}.toml --json")));
        assert_eq!((&again["frames"], &again["rig_s"]), (&best["frames"], &best["rig_s"]));
    }
    assert!(last < error(&given));
    let any = said(&zonal(desk.path(), "plan RIG PLAN --budget 10 --any-sample --json"));
    assert_ne!(any["scheme"], "isotropic");
    let adaptive = said(&zonal(desk.path(), "plan RIG PLAN --budget 10 --adaptive --out adaptive.toml --json"));
    assert!(adaptive["rig_s"].as_f64().unwrap() < 3.0, "the least it takes: {adaptive}");
    assert!(fs::read_to_string(desk.path().join("adaptive.toml")).unwrap().contains("limit_s = 10"));
}

#[test]
fn an_adaptive_measurement_says_what_it_decided() {
    let desk = tempfile::tempdir().unwrap();
    let measured = said(&zonal(desk.path(), "measure RIG PLAN --adaptive --simulate gray-card --out run --json"));
    assert_eq!((&measured["order"], &measured["isotropic"]), (&Value::from(2), &Value::from(true)));
    let decision = &measured["decisions"][0];
    assert!(decision["reason"].as_str().unwrap().contains("would save"), "{decision}");
    assert!(measured["frames"].as_u64().unwrap() < 24 && measured["rig_s"].as_f64().unwrap() < 3.0);
    let plan = fs::read_to_string(desk.path().join("run/plan.toml")).unwrap();
    assert!(plan.contains("[adaptive]") && plan.contains("gain_rel"), "{plan}");
    for arguments in ["reduce run", "fit run --out fit.json", "convert run --method parity --out sh.exr", "budget run"]
    {
        let output = zonal(desk.path(), arguments);
        assert!(output.status.success(), "{arguments}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn bad_requests_are_refused() {
    let desk = tempfile::tempdir().unwrap();
    let plan = fs::read_to_string(format!("{}/patterns/order-4.toml", env!("CARGO_MANIFEST_DIR"))).unwrap();
    let write =
        |name: &str, from: &str, to: &str| fs::write(desk.path().join(name), plan.replacen(from, to, 1)).unwrap();
    write("odd.toml", "order = 4", "order = 3\nscheme = \"isotropic\"");
    write("unknown.toml", "order = 4", "order = 4\nscheme = \"hadamard\"");
    write("greedy.toml", "[exitant]", "[adaptive]\ngain_rel = 0.9\n\n[exitant]\n");
    write("twice.toml", "repeats = 1\n", "repeats = 2\n\n[adaptive]\ngain_rel = 0.05\n");
    let files = fs::read_dir(desk.path()).unwrap().count();
    let requests = [
        ("plan RIG PLAN --budget 0", "above 0"),
        ("plan RIG PLAN --budget NaN", "above 0"),
        ("plan RIG PLAN --budget 0.01", "larger --budget"),
        ("plan RIG PLAN --out x.toml", "--budget"),
        ("plan RIG PLAN --adaptive", "--budget"),
        ("plan RIG PLAN --budget 0.6 --adaptive", "larger --budget"),
        ("measure RIG PLAN --adaptive --limit 0 --simulate white --out run", "limit_s = 0"),
        ("plan RIG PLAN --class shiny", "glossy"),
        ("plan RIG odd.toml", "even order"),
        ("plan RIG unknown.toml", "hadamard"),
        ("plan RIG greedy.toml", "gain_rel = 0.9"),
        ("plan RIG twice.toml", "chooses its own repeats"),
        ("measure RIG PLAN --adaptive --gain 0 --simulate white --out run", "gain_rel = 0"),
        ("measure RIG PLAN --gain 0.1 --simulate white --out run", "--adaptive"),
    ];
    for (arguments, word) in requests {
        let output = zonal(desk.path(), arguments);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments}: {text}");
        assert!(output.stdout.is_empty() && text.contains(word), "{arguments}: no `{word}` in\n{text}");
    }
    assert_eq!(fs::read_dir(desk.path()).unwrap().count(), files, "nothing is written");
}
