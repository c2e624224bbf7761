//! The folder a run leaves behind.

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Frame, ResponseImage};
use crate::patterns::{Event, Lobe};
use crate::store::{self, StoreError};

/// Version of the run folder.
pub const RUN_FORMAT: u32 = 1;

/// One line of the journal: a frame that was taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JournalEntry {
    /// Position in the plan.
    pub index: usize,
    /// Repeat of the sequence.
    pub repeat: usize,
    /// The lobe shown.
    pub lobe: Lobe,
    /// Exposure time achieved, s.
    pub exposure_s: f64,
    /// The camera's frame number.
    pub sequence: u64,
    /// Start of exposure on the camera's clock, s.
    pub timestamp_s: f64,
}

impl JournalEntry {
    /// The entry of a frame.
    pub fn new(event: &Event, frame: &Frame) -> Self {
        Self {
            index: event.index,
            repeat: event.repeat,
            lobe: event.lobe,
            exposure_s: frame.exposure_s,
            sequence: frame.sequence,
            timestamp_s: frame.timestamp_s,
        }
    }
}

/// A run folder: `run.json`, `rig.toml`, `plan.toml`, `calibration/`, `journal.jsonl`, `responses/`, `coefficients.exr`.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    keep_frames: bool,
    journal: Option<File>,
}

impl RunFolder {
    /// A run folder to create; it appears with [`RunFolder::begin`].
    ///
    /// # Errors
    /// [`StoreError::NotEmpty`] if the folder holds anything.
    pub fn create(path: &Path, keep_frames: bool) -> Result<Self, StoreError> {
        store::vacant(path)?;
        Ok(Self { path: path.to_owned(), keep_frames, journal: None })
    }

    /// Makes the folder with what `fill` writes at the path it is given, whole or not at all.
    ///
    /// # Errors
    /// As [`store::write_dir`].
    pub fn begin(&self, fill: impl FnOnce(&Path) -> Result<(), StoreError>) -> Result<(), StoreError> {
        store::write_dir(&self.path, |part| {
            store::create_dir(&part.join("responses"))?;
            if self.keep_frames {
                store::create_dir(&part.join("frames"))?;
            }
            fill(part)
        })
    }

    /// Opens an existing run folder.
    ///
    /// # Errors
    /// [`StoreError::Read`] if it has no `run.json`.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let manifest = path.join("run.json");
        fs::metadata(&manifest).map_err(|source| StoreError::Read { path: manifest, source })?;
        Ok(Self { path: path.to_owned(), keep_frames: false, journal: None })
    }

    /// A path inside the folder.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Where the response to a lobe is kept.
    pub fn response_path(&self, lobe: &Lobe) -> PathBuf {
        self.path.join("responses").join(format!("{}.exr", lobe.stem()))
    }

    /// Appends a frame to the journal, and the frame itself where frames are kept.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn record(&mut self, entry: &JournalEntry, frame: &Frame) -> Result<(), StoreError> {
        if self.keep_frames {
            let name = format!("frames/{:05}_{}.png", entry.index, entry.lobe.stem());
            write_frame(&self.file(&name), frame)?;
        }
        let path = self.file("journal.jsonl");
        let failed = |source| StoreError::Write { path: path.clone(), source };
        if self.journal.is_none() {
            self.journal = Some(OpenOptions::new().create(true).append(true).open(&path).map_err(failed)?);
        }
        let line = serde_json::to_string(entry).expect("numbers and names") + "\n";
        self.journal.as_mut().expect("opened above").write_all(line.as_bytes()).map_err(failed)
    }

    /// Stores the response to a lobe and returns it as a later reduction will read it.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn keep_response(&self, lobe: &Lobe, response: &ResponseImage) -> Result<ResponseImage, StoreError> {
        response.write(&self.response_path(lobe))?;
        Ok(response.as_stored())
    }
}

/// Writes a frame as a 16-bit grey PNG.
fn write_frame(path: &Path, frame: &Frame) -> Result<(), StoreError> {
    let image = image::ImageBuffer::<image::Luma<u16>, _>::from_raw(
        frame.width as u32,
        frame.height as u32,
        frame.samples.clone(),
    )
    .expect("one sample for each pixel");
    let mut bytes = std::io::Cursor::new(Vec::new());
    image
        .write_to(&mut bytes, image::ImageFormat::Png)
        .map_err(|e| StoreError::invalid(path, format!("cannot encode PNG: {e}")))?;
    store::write(path, &bytes.into_inner())
}
