//! Why devices cannot be used as their file says.

use thiserror::Error;

use super::Driver;
use crate::store::StoreError;

/// Why devices cannot be used as their file says.
#[derive(Debug, Error)]
pub enum DevicesError {
    /// The file is no devices file.
    #[error("this is no devices file: {0}; `zonal devices` prints one to paste")]
    Syntax(#[from] toml::de::Error),
    /// The file is of another version.
    #[error("format = {found}: this version reads devices files of format {expected}")]
    Format {
        /// Version found.
        found: u32,
        /// Version read.
        expected: u32,
    },
    /// A value is out of range.
    #[error("{key} = {value} is out of range: choose {range}")]
    Range {
        /// Table and key.
        key: &'static str,
        /// What it says.
        value: String,
        /// What it may say.
        range: String,
    },
    /// The driver is no part of this build.
    #[error(
        "driver = \"{driver}\": this program was built without it: build with `cargo build --release --features {driver}`, \
         which needs {needs}",
        needs = driver.needs()
    )]
    NotBuilt {
        /// The driver, which is also the feature's name.
        driver: Driver,
    },
    /// The file could not be read.
    #[error(transparent)]
    Store(#[from] StoreError),
}
