//! Files: written whole or not at all, and OpenEXR layers with units in their attributes.

mod exr_layers;

use std::ffi::OsString;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

pub use exr_layers::{Attribute, Layers, Plane};

/// Why a file could not be read or written.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The system refused to read.
    #[error("cannot read {path}: {source}; check the path and its permissions", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: io::Error,
    },
    /// The system refused to write; nothing of the file is left behind.
    #[error(
        "cannot write {path}: {source}; nothing was left half-written: free space or choose another --out",
        path = path.display()
    )]
    Write {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: io::Error,
    },
    /// The file is not what it should be.
    #[error("{path} is damaged or of another kind: {reason}", path = path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong and what helps.
        reason: String,
    },
}

impl StoreError {
    /// An [`StoreError::Invalid`] for `path`.
    pub fn invalid(path: &Path, reason: impl Into<String>) -> Self {
        Self::Invalid { path: path.to_owned(), reason: reason.into() }
    }
}

/// Reads a whole file.
///
/// # Errors
/// [`StoreError::Read`].
pub fn read(path: &Path) -> Result<Vec<u8>, StoreError> {
    fs::read(path).map_err(|source| StoreError::Read { path: path.to_owned(), source })
}

/// Reads a UTF-8 text file.
///
/// # Errors
/// [`StoreError::Read`] or [`StoreError::Invalid`].
pub fn read_text(path: &Path) -> Result<String, StoreError> {
    String::from_utf8(read(path)?).map_err(|e| StoreError::invalid(path, format!("not UTF-8 text ({e})")))
}

/// Creates a folder and its parents.
///
/// # Errors
/// [`StoreError::Write`].
pub fn create_dir(path: &Path) -> Result<(), StoreError> {
    fs::create_dir_all(path).map_err(|source| StoreError::Write { path: path.to_owned(), source })
}

/// Writes a file whole or not at all: to a temporary name beside it, flushed to the disk, then renamed.
///
/// # Errors
/// [`StoreError::Write`]; the temporary file is removed and an older file of that name stays as it was.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(".part");
    let part = path.with_file_name(name);
    let attempt = || -> io::Result<()> {
        let mut file = fs::File::create(&part)?;
        file.write_all(bytes)?;
        file.sync_data()?;
        fs::rename(&part, path)
    };
    attempt().map_err(|source| {
        // Best effort: the first error is the one to report.
        let _ = fs::remove_file(&part);
        StoreError::Write { path: path.to_owned(), source }
    })
}

/// Writes a value as indented JSON.
///
/// # Errors
/// As [`write()`].
pub fn write_json<T: Serialize>(path: &Path, value: &T) -> Result<(), StoreError> {
    let mut text = serde_json::to_vec_pretty(value).map_err(|e| StoreError::invalid(path, e.to_string()))?;
    text.push(b'\n');
    write(path, &text)
}

/// Reads a value from JSON.
///
/// # Errors
/// [`StoreError::Read`] or [`StoreError::Invalid`], which names line and column.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, StoreError> {
    serde_json::from_slice(&read(path)?).map_err(|e| StoreError::invalid(path, e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_nothing_behind() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("file");
        write(&file, b"old").unwrap();
        assert!(matches!(write(&file.join("below"), b"x"), Err(StoreError::Write { .. })));
        let blocked = dir.path().join("folder");
        fs::create_dir(&blocked).unwrap();
        assert!(write(&blocked, b"x").is_err());
        assert_eq!(read(&file).unwrap(), b"old");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
    }
}
