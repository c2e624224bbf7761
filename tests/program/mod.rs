//! The program as its users run it, from the root of the package.

use std::process::{Command, Output};

use serde_json::Value;

/// Runs `zonal` with these arguments.
pub fn zonal(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_zonal")).current_dir(env!("CARGO_MANIFEST_DIR")).args(arguments).output().unwrap()
}

/// What it prints with `--json`; it must succeed.
pub fn json(arguments: &[&str]) -> Value {
    let output = zonal(&[&["--json"], arguments].concat());
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// It must end with status 2, print nothing and say these words on stderr.
pub fn refused(arguments: &[&str], said: &[&str]) {
    let output = zonal(arguments);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {error}");
    assert!(output.stdout.is_empty(), "{arguments:?}");
    assert!(said.iter().all(|s| error.contains(s)), "{arguments:?}: {error}");
}
