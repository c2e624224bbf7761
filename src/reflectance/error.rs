//! What can go wrong when a file of measured reflectance is read.

use std::io;
use std::path::Path;

use thiserror::Error;

/// A file of measured reflectance that cannot be used.
#[derive(Debug, Error)]
pub enum ReadError {
    /// The bytes could not be read.
    #[error("cannot read {file}: check that it exists and that you may read it")]
    Io {
        /// The file asked for.
        file: String,
        /// What the operating system said.
        source: io::Error,
    },
    /// The contents contradict the format, or themselves.
    #[error("{file}: {at}: expected {expected}, found {found}; the file is damaged or of another kind: get it again")]
    Invalid {
        /// The file.
        file: String,
        /// The field or the byte offset.
        at: String,
        /// What the format asks for.
        expected: String,
        /// What is there.
        found: String,
    },
    /// The contents may be right, but this reader does not handle them.
    #[error("{file}: {found} is not supported: {remedy}")]
    NotSupported {
        /// The file.
        file: String,
        /// The feature.
        found: String,
        /// What to do instead.
        remedy: &'static str,
    },
}

impl ReadError {
    /// An [`ReadError::Invalid`] from anything that prints.
    pub(super) fn invalid(
        file: &str,
        at: impl Into<String>,
        expected: impl Into<String>,
        found: impl ToString,
    ) -> Self {
        Self::Invalid { file: file.into(), at: at.into(), expected: expected.into(), found: found.to_string() }
    }
}

/// The bytes of a file and the name by which errors call it.
pub(super) fn read_file(path: &Path) -> Result<(Vec<u8>, String), ReadError> {
    let file = path.display().to_string();
    match std::fs::read(path) {
        Ok(bytes) => Ok((bytes, file)),
        Err(source) => Err(ReadError::Io { file, source }),
    }
}
