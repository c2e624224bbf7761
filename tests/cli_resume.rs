//! Runs that end before they are done: killed, stopped, on a full disk; and what cannot be resumed.

mod common;
#[allow(dead_code)]
mod program;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use program::{refused, zonal};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use tempfile::TempDir;
use zonal::patterns::{Exitant, Plan};
use zonal::reduce::Coefficients;

/// All hundred with the other thorough tests, a sample of them always.
const KILLS: usize = if cfg!(feature = "thorough") { 16 } else { 8 };

/// A reduced rig, its calibrations, a plan of order 2 and a run that nothing disturbed.
struct Bench {
    folder: TempDir,
}

static BENCH: LazyLock<Bench> = LazyLock::new(|| {
    let bench = Bench { folder: tempfile::tempdir().unwrap() };
    let mut rig = common::coarse(common::rig("ghosh-2007-built"), 4);
    // A flat field that is smaller than a response, for the full disk.
    rig.projector.pitch_um *= 2.0;
    rig.projector.width_px /= 2;
    rig.projector.height_px /= 2;
    fs::write(bench.path("rig.toml"), rig.to_toml()).unwrap();
    let plan = Plan { exitant: Exitant { rings: 6, sectors: 12 }, ..Plan::of_order(2) };
    fs::write(bench.path("plan.toml"), plan.to_toml()).unwrap();
    for kind in ["response", "flat-field", "gray-card"] {
        let output = zonal(&["calibrate", kind, &bench.text("rig.toml"), "--simulate", "--out", &bench.text("cal")]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let output = bench.measure("undisturbed", &[]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    bench
});

impl Bench {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// A measurement into `run`; that exists already if it is to be resumed.
    fn measure(&self, run: &str, more: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_zonal"));
        command.args(["measure", &self.text("rig.toml"), &self.text("plan.toml"), "--out", &self.text(run)]);
        if self.path(run).join("run.json").exists() {
            command.arg("--resume");
        } else {
            command.args(["--simulate", "red-plastic", "--calibration", &self.text("cal")]);
        }
        command.args(more);
        command
    }

    fn assert_undisturbed(&self, run: &str) {
        let bits = |run: &str| {
            let c = Coefficients::read(&self.path(run).join("coefficients.exr")).unwrap();
            c.values.iter().chain(&c.sigma).map(|x| x.to_bits()).collect::<Vec<_>>()
        };
        assert!(bits(run) == bits("undisturbed"), "{run}: coefficients differ");
        let mut taken = frames(&self.path(run));
        taken.sort_unstable();
        assert_eq!(taken, (0..54).collect::<Vec<_>>(), "{run}: every frame once");
        assert!(!self.path(run).join("pending").exists());
    }
}

/// Positions of the frames that a run's journal holds whole.
fn frames(run: &Path) -> Vec<u64> {
    let journal = fs::read_to_string(run.join("journal.jsonl")).unwrap_or_default();
    let lines = journal.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    lines.filter(|entry| entry["event"] == "frame").map(|entry| entry["index"].as_u64().unwrap()).collect()
}

/// Kills the program at a random moment: of all its time, or of the time in which it takes frames.
fn kill(mut child: Child, run: &Path, rng: &mut Xoshiro256PlusPlus) {
    let begun = Instant::now();
    let journal = || fs::metadata(run.join("journal.jsonl")).map_or(0, |m| m.len());
    let before = journal();
    let among_frames = rng.random::<f64>() < 0.8;
    // A line for a frame has some 200 bytes.
    let target = before + if among_frames { rng.random_range(1..8000) } else { 0 };
    let deadline = Duration::from_secs_f64(if among_frames { 30.0 } else { rng.random_range(0.0..1.0) });
    while child.try_wait().unwrap().is_none() && begun.elapsed() < deadline && (!among_frames || journal() < target) {
        std::thread::sleep(Duration::from_micros(100));
    }
    std::thread::sleep(Duration::from_micros(rng.random_range(0..3000)));
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_run_killed_again_and_again_ends_as_if_nothing_had_happened() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
    let (mut kills, mut runs, mut between) = (0, 0, 0);
    while kills < KILLS {
        let name = format!("killed-{runs}");
        let run = BENCH.path(&name);
        loop {
            let finished =
                fs::read_to_string(run.join("run.json")).is_ok_and(|text| text.contains("\"status\": \"complete\""));
            if finished {
                break;
            }
            let mut command = BENCH.measure(&name, &[]);
            if kills == KILLS {
                assert!(command.output().unwrap().status.success());
                continue;
            }
            let held = frames(&run).len();
            kill(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap(), &run, &mut rng);
            kills += 1;
            let holds = frames(&run).len();
            assert!(holds >= held, "a frame that was journaled is gone");
            between += usize::from(holds > held && holds < 54);
        }
        BENCH.assert_undisturbed(&name);
        runs += 1;
    }
    eprintln!("{kills} kills, {between} of them among the frames, in {runs} runs");
    assert!(2 * between > KILLS / 2, "most of the kills should fall among the frames: {between}");
}

fn ended_badly(mut command: Command, status: i32, words: &[&str]) {
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(status), "{said}");
    assert!(words.iter().all(|w| said.contains(w)), "{said}");
}

#[test]
fn a_full_disk_leaves_a_run_that_can_be_resumed() {
    // Files of a kilobyte more than the run's largest calibration: a frame fits, a response does not.
    let largest = fs::metadata(BENCH.path("cal").join("flat-field.exr")).unwrap().len() / 1024;
    for (run, kilobytes) in [("full-1", largest + 1), ("full-2", largest + 4)] {
        let measure = BENCH.measure(run, &[]);
        let words: Vec<String> = std::iter::once(measure.get_program())
            .chain(measure.get_args())
            .map(|w| format!("'{}'", w.to_str().unwrap()))
            .collect();
        let mut limited = Command::new("bash");
        limited.args(["-c", &format!("ulimit -f {kilobytes}; exec {}", words.join(" "))]);
        ended_badly(limited, 2, &["cannot write", "nothing was left half-written"]);
        let status = fs::read_to_string(BENCH.path(run).join("run.json")).unwrap();
        assert!(status.contains("failed"), "{status}");
        assert!(BENCH.measure(run, &[]).output().unwrap().status.success());
        BENCH.assert_undisturbed(run);
    }
}

#[test]
fn ctrl_c_stops_after_a_frame_and_says_how_to_go_on() {
    let run = BENCH.path("stopped");
    let child = BENCH.measure("stopped", &["--paced"]).stderr(Stdio::piped()).spawn().unwrap();
    while frames(&run).len() < 3 {
        std::thread::sleep(Duration::from_millis(5));
    }
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("stopped on request after") && said.contains("--resume"), "{said}");
    assert!(BENCH.measure("stopped", &[]).output().unwrap().status.success());
    BENCH.assert_undisturbed("stopped");
}

#[test]
fn a_journal_cut_in_a_line_is_taken_up_where_it_was_whole() {
    // No power failure takes back a frame that is merged already, and a pair of six is merged with its last: the camera is
    // lost in the middle of one.
    let run = (43..49).map(|n| (n, format!("cut-{n}"))).find_map(|(n, run)| {
        let fault = format!("lost_after={n}");
        ended_badly(BENCH.measure(&run, &["--fault", &fault]), 1, &["frame ", "camera", "cable", "resume"]);
        (!frames(&BENCH.path(&run)).len().is_multiple_of(6)).then_some(run)
    });
    let run = run.expect("six frames make a pair");
    let journal = BENCH.path(&run).join("journal.jsonl");
    let text = fs::read_to_string(&journal).unwrap();
    let frame = text.lines().rfind(|l| l.contains("\"frame\"")).unwrap();
    fs::write(&journal, &text[..text.find(frame).unwrap() + frame.len() / 2]).unwrap();
    assert!(BENCH.measure(&run, &[]).output().unwrap().status.success());
    BENCH.assert_undisturbed(&run);
}

#[test]
fn what_cannot_be_resumed_is_said() {
    ended_badly(BENCH.measure("bad", &["--fault", "lost_after=40"]), 1, &["camera"]);
    let run = BENCH.path("bad");
    let [manifest, journal, rig] = ["run.json", "journal.jsonl", "rig.toml"].map(|name| run.join(name));
    let with = |path: &Path, from: &str, to: &str, words: &[&str]| {
        let text = fs::read_to_string(path).unwrap();
        assert!(text.contains(from), "{text}");
        fs::write(path, text.replacen(from, to, 1)).unwrap();
        ended_badly(BENCH.measure("bad", &[]), 2, words);
        fs::write(path, text).unwrap();
    };
    with(&manifest, "\"format\": 2", "\"format\": 3", &["run.json", "newer", "update zonal"]);
    with(&manifest, "\"format\": 2", "\"format\": 1", &["run.json", "format 1", "measure again"]);
    with(&journal, "\"event\":\"frame\"", "\"event\":\"fram\"", &["journal.jsonl", "line 2", "delete it"]);
    with(&rig, "focus_mm = 280.0", "focus_mm = 281.0", &["rig.toml", "resume with the run's own"]);
    let undisturbed = BENCH.text("undisturbed");
    let (rig, plan) = (BENCH.text("rig.toml"), BENCH.text("plan.toml"));
    refused(&["measure", &rig, &plan, "--out", &undisturbed, "--resume"], &["nothing to resume"]);
    refused(&["measure", &rig, &plan, "--out", &BENCH.text("none"), "--resume"], &["no run to resume"]);
    refused(
        &["measure", &rig, &plan, "--out", &BENCH.text("x"), "--simulate", "red-plastic", "--fault", "drop=no"],
        &["--fault", "NAME=NUMBER"],
    );
    // 16 x 300 refresh periods are 80 s; the camera ends at 60.
    let long = fs::read_to_string(&plan).unwrap().replace("shortest_refreshes = 1", "shortest_refreshes = 300");
    fs::write(BENCH.path("long.toml"), long).unwrap();
    let (long, cal) = (BENCH.text("long.toml"), BENCH.text("cal"));
    refused(
        &["measure", &rig, &long, "--out", &BENCH.text("y"), "--simulate", "red-plastic", "--calibration", &cal],
        &["camera", "exposes for", "change the plan's exposures"],
    );
}
