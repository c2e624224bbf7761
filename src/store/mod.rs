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
    /// A folder to be made holds something already.
    #[error("{path} already holds files: choose another --out, nothing is overwritten", path = path.display())]
    NotEmpty {
        /// The folder.
        path: PathBuf,
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
    String::from_utf8(read(path)?).map_err(|e| StoreError::invalid(path, format!("not text ({e}): save it as UTF-8")))
}

/// Creates a folder and its parents.
///
/// # Errors
/// [`StoreError::Write`].
pub fn create_dir(path: &Path) -> Result<(), StoreError> {
    fs::create_dir_all(path).map_err(|source| StoreError::Write { path: path.to_owned(), source })
}

/// Writes a file whole or not at all: to a temporary name beside it, flushed to the disk, then renamed. A symbolic link
/// stays, the file it leads to is replaced.
///
/// # Errors
/// [`StoreError::Write`]; the temporary file is removed and an older file of that name stays as it was.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
    write_and(path, bytes, fs::File::sync_data)
}

/// As [`write()`], without waiting for the disk: the file outlives the program that wrote it, but not a loss of power.
///
/// # Errors
/// As [`write()`].
pub fn write_quickly(path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
    write_and(path, bytes, |_| Ok(()))
}

fn write_and(path: &Path, bytes: &[u8], finish: impl FnOnce(&fs::File) -> io::Result<()>) -> Result<(), StoreError> {
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let part = part(&target);
    let attempt = || -> io::Result<()> {
        let mut file = fs::File::create(&part)?;
        file.write_all(bytes)?;
        finish(&file)?;
        fs::rename(&part, &target)
    };
    attempt().map_err(|source| {
        // Best effort: the first error is the one to report.
        let _ = fs::remove_file(&part);
        StoreError::Write { path: path.to_owned(), source }
    })
}

/// Removes a file.
///
/// # Errors
/// [`StoreError::Write`].
pub fn remove(path: &Path) -> Result<(), StoreError> {
    fs::remove_file(path).map_err(|source| StoreError::Write { path: path.to_owned(), source })
}

/// Makes a folder whole or not at all: `fill` gets a temporary name beside it, renamed when all is written.
///
/// # Errors
/// [`StoreError::NotEmpty`] if the folder holds anything, [`StoreError::Write`], and what `fill` returns; the temporary
/// folder is removed.
pub fn write_dir<E: From<StoreError>>(path: &Path, fill: impl FnOnce(&Path) -> Result<(), E>) -> Result<(), E> {
    vacant(path)?;
    let part = part(path);
    // A program that was killed may have left one.
    let _ = fs::remove_dir_all(&part);
    let rename = || fs::rename(&part, path).map_err(|source| StoreError::Write { path: path.to_owned(), source });
    let attempt = create_dir(&part).map_err(E::from).and_then(|()| fill(&part)).and_then(|()| Ok(rename()?));
    attempt.inspect_err(|_| {
        // Best effort: the first error is the one to report.
        let _ = fs::remove_dir_all(&part);
    })
}

/// Checks that a folder is empty or does not exist.
///
/// # Errors
/// [`StoreError::NotEmpty`], or [`StoreError::Write`] if it is no folder.
pub fn vacant(path: &Path) -> Result<(), StoreError> {
    match fs::read_dir(path).map(|mut entries| entries.next().is_some()) {
        Ok(false) => Ok(()),
        Ok(true) => Err(StoreError::NotEmpty { path: path.to_owned() }),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(source) => Err(StoreError::Write { path: path.to_owned(), source }),
    }
}

/// The temporary name beside a path.
fn part(path: &Path) -> PathBuf {
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(".part");
    path.with_file_name(name)
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
    serde_json::from_slice(&read(path)?).map_err(|e| StoreError::invalid(path, format!("{e}: make it again")))
}

/// Reads a value from JSON whose key `format` is its version, which is looked at before anything else.
///
/// # Errors
/// As [`read_json`], and [`StoreError::Invalid`] for a version above `newest`.
pub fn read_versioned<T: DeserializeOwned>(path: &Path, newest: u32) -> Result<T, StoreError> {
    let value: serde_json::Value = read_json(path)?;
    if let Some(found) = value.get("format").and_then(serde_json::Value::as_u64).filter(|&f| f > u64::from(newest)) {
        let reason = format!("format {found} is newer than {newest}, the newest this version reads: update zonal");
        return Err(StoreError::invalid(path, reason));
    }
    serde_json::from_value(value).map_err(|e| StoreError::invalid(path, format!("{e}: make it again")))
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

    #[test]
    #[cfg(unix)]
    fn links_stay_links() {
        let dir = tempfile::tempdir().unwrap();
        let (file, link) = (dir.path().join("file"), dir.path().join("link"));
        write(&file, b"old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write(&link, b"new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(read(&file).unwrap(), b"new");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
    }

    #[test]
    fn a_folder_is_made_whole_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("folder");
        let half = |part: &Path| {
            write(&part.join("a"), b"x")?;
            write(&part.join("missing/b"), b"x")
        };
        assert!(matches!(write_dir(&folder, half), Err(StoreError::Write { .. })));
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
        fs::create_dir(&folder).unwrap();
        write_dir(&folder, |part| write(&part.join("a"), b"x")).unwrap();
        assert_eq!(read(&folder.join("a")).unwrap(), b"x");
        let again = write_dir(&folder, |part| write(&part.join("b"), b"x"));
        assert!(matches!(again, Err(StoreError::NotEmpty { .. })));
        assert!(write_dir(&folder.join("a"), half).is_err());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
