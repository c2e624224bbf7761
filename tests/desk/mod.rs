//! A folder to work in, the program run there, and what it must leave as it was.
#![allow(dead_code)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::{Map, Value};
use tempfile::TempDir;

pub const ZONAL: &str = env!("CARGO_BIN_EXE_zonal");
pub const RIG: &str = include_str!("../../optics/ghosh-2007-built.toml");
pub const PLAN: &str = "format = 1\nname = \"small\"\norder = 1\nrepeats = 1\n\
    [exposure]\ncount = 2\nshortest_refreshes = 2\nspacing = 8\n[exitant]\nrings = 8\nsectors = 12\n";

/// A folder with `rig.toml`, `plan.toml` and files that commands must not touch.
pub fn desk() -> TempDir {
    let desk = tempfile::tempdir().unwrap();
    for (name, content) in
        [("rig.toml", RIG), ("plan.toml", PLAN), ("file", "kept"), ("old.exr", "old"), ("old.png", "old")]
    {
        fs::write(desk.path().join(name), content).unwrap();
    }
    desk
}

/// Everything below a folder: files with their bytes, folders without, parents first.
pub fn contents(folder: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let mut all = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(below) = folders.pop() {
        for entry in fs::read_dir(below).unwrap() {
            let path = entry.unwrap().path();
            let bytes = if path.is_dir() { None } else { Some(fs::read(&path).unwrap()) };
            all.insert(path.strip_prefix(folder).unwrap().to_owned(), bytes);
            if path.is_dir() {
                folders.push(path);
            }
        }
    }
    all
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Runs the program in a folder; arguments are split at spaces.
pub fn zonal(desk: &Path, arguments: &str) -> Output {
    Command::new(ZONAL).current_dir(desk).args(arguments.split(' ')).output().unwrap()
}

/// The same where no file may be longer than `kib` KiB.
pub fn zonal_limited(desk: &Path, kib: usize, arguments: &str) -> Output {
    let script = format!("ulimit -f {kib}; exec \"$0\" \"$@\"");
    Command::new("bash").current_dir(desk).args(["-c", &script, ZONAL]).args(arguments.split(' ')).output().unwrap()
}

/// Status 2, nothing on stdout, and a message that holds all `words`.
pub fn assert_refused(arguments: &str, output: &Output, words: &[&str]) {
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments}: {:?}\n{said}", output.status);
    assert!(output.stdout.is_empty(), "{arguments}: {}", text(&output.stdout));
    assert!(said.starts_with("error: "), "{arguments}: {said}");
    for word in words {
        assert!(said.contains(word), "{arguments}: no `{word}` in\n{said}");
    }
}

/// The command is refused and the folder stays as it was.
pub fn refused(desk: &TempDir, arguments: &str, words: &[&str]) {
    let before = contents(desk.path());
    let output = zonal(desk.path(), arguments);
    assert_refused(arguments, &output, words);
    assert_unchanged(arguments, &before, desk);
}

pub fn assert_unchanged(arguments: &str, before: &BTreeMap<PathBuf, Option<Vec<u8>>>, desk: &TempDir) {
    let after = contents(desk.path());
    let names = |all: &BTreeMap<PathBuf, _>| all.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(before), names(&after), "{arguments}");
    assert!(*before == after, "{arguments} changed a file");
}

/// The command ends well and prints one JSON object.
pub fn json(output: &Output) -> Map<String, Value> {
    assert!(output.status.success(), "{}", text(&output.stderr));
    let value: Value = serde_json::from_slice(&output.stdout).expect("one JSON value and nothing else");
    value.as_object().expect("an object").clone()
}

pub fn edit(path: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = fs::read(path).unwrap();
    change(&mut bytes);
    fs::write(path, bytes).unwrap();
}

/// Replaces text that occurs once.
pub fn replace(path: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(path).unwrap();
    assert_eq!(text.matches(from).count(), 1, "{from}");
    fs::write(path, text.replace(from, to)).unwrap();
}
