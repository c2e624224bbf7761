//! The folder a run leaves behind.

use std::fs;
use std::path::{Path, PathBuf};

use super::acquisition::Taken;
use super::journal::{FrameEntry, Journal, Recorded};
use super::{Crop, Frame, ResponseImage};
use crate::patterns::Lobe;
use crate::store::{self, StoreError};

/// Version of the run folder.
pub const RUN_FORMAT: u32 = 2;

/// A run folder: `run.json`, `rig.toml`, `plan.toml`, `calibration/`, `journal.jsonl`, `responses/`, `coefficients.exr`,
/// `devices.toml` of a run on real devices; and `pending/` with the frames whose response is not stored yet.
#[derive(Debug, Clone)]
pub struct RunFolder {
    path: PathBuf,
    keep_frames: bool,
    /// Name and text of a file that is written with the folder.
    with: Option<(&'static str, String)>,
}

impl RunFolder {
    /// A run folder to create; it appears with [`RunFolder::begin`].
    ///
    /// # Errors
    /// [`StoreError::NotEmpty`] if the folder holds anything.
    pub fn create(path: &Path, keep_frames: bool) -> Result<Self, StoreError> {
        store::vacant(path)?;
        Ok(Self { path: path.to_owned(), keep_frames, with: None })
    }

    /// The same with a file of this name and text in it.
    pub fn holding(self, name: &'static str, text: String) -> Self {
        Self { with: Some((name, text)), ..self }
    }

    /// Makes the folder with what `fill` writes at the path it is given, whole or not at all.
    ///
    /// # Errors
    /// As [`store::write_dir`].
    pub fn begin(&self, fill: impl FnOnce(&Path) -> Result<(), StoreError>) -> Result<(), StoreError> {
        store::write_dir(&self.path, |part| {
            store::create_dir(&part.join("responses"))?;
            store::create_dir(&part.join("pending"))?;
            if self.keep_frames {
                store::create_dir(&part.join("frames"))?;
            }
            if let Some((name, text)) = &self.with {
                store::write(&part.join(name), text.as_bytes())?;
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
        Ok(Self { path: path.to_owned(), keep_frames: path.join("frames").is_dir(), with: None })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A path inside the folder.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Whether whole frames are kept.
    pub fn keeps_frames(&self) -> bool {
        self.keep_frames
    }

    /// Opens the journal.
    ///
    /// # Errors
    /// As [`Journal::open`].
    pub fn journal(&self) -> Result<(Journal, Recorded), StoreError> {
        Journal::open(&self.file("journal.jsonl"))
    }

    /// Where the response to a lobe is kept; repeats after the first have a number.
    pub fn response_path(&self, lobe: &Lobe, repeat: usize) -> PathBuf {
        let number = if repeat == 0 { String::new() } else { format!("_r{repeat:03}") };
        self.path.join("responses").join(format!("{}{number}.exr", lobe.stem()))
    }

    /// Stores the response to a lobe and returns it as a later reduction will read it.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn keep_response(
        &self,
        lobe: &Lobe,
        repeat: usize,
        response: &ResponseImage,
    ) -> Result<ResponseImage, StoreError> {
        response.write(&self.response_path(lobe, repeat))?;
        Ok(response.as_stored())
    }

    fn pending_path(&self, repeat: usize, lobe: &Lobe, exposure: usize) -> PathBuf {
        self.path.join("pending").join(format!("{}_r{repeat:03}_e{exposure}.pgm", lobe.stem()))
    }

    /// Stores what a response will be made of, until that is stored. Not flushed to the disk: it must outlive the program,
    /// not the machine.
    ///
    /// # Errors
    /// [`StoreError::Write`].
    pub fn keep_pending(&self, entry: &FrameEntry, crop: Crop, samples: &[u16]) -> Result<(), StoreError> {
        let path = self.pending_path(entry.repeat, &entry.lobe, entry.exposure);
        let mut bytes = format!("P5 {} {} 65535\n", crop.width, crop.height).into_bytes();
        let start = bytes.len();
        bytes.resize(start + 2 * samples.len(), 0);
        bytes[start..].chunks_exact_mut(2).zip(samples).for_each(|(b, s)| b.copy_from_slice(&s.to_be_bytes()));
        store::write_quickly(&path, &bytes)
    }

    /// Reads what [`RunFolder::keep_pending`] wrote.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn pending(&self, entry: &FrameEntry, crop: Crop) -> Result<Taken, StoreError> {
        let path = self.pending_path(entry.repeat, &entry.lobe, entry.exposure);
        let bytes = store::read(&path)?;
        let header = format!("P5 {} {} 65535\n", crop.width, crop.height);
        let body = bytes.strip_prefix(header.as_bytes()).filter(|b| b.len() == 2 * crop.len());
        let body = body.ok_or_else(|| {
            let reason =
                format!("not a frame of {} x {} px: delete the run and measure again", crop.width, crop.height);
            StoreError::invalid(&path, reason)
        })?;
        let samples = body.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
        Ok(Taken { samples, exposure_s: entry.exposure_s, light: entry.light, frame: None })
    }

    /// Removes the frames of a lobe whose response is stored.
    pub fn drop_pending(&self, repeat: usize, lobe: &Lobe, exposures: usize) {
        for exposure in 0..exposures {
            // What stays behind is in nobody's way.
            let _ = fs::remove_file(self.pending_path(repeat, lobe, exposure));
        }
    }

    /// Stores a whole frame.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn keep_frame(&self, index: usize, lobe: &Lobe, frame: &Frame) -> Result<(), StoreError> {
        write_frame(&self.file(&format!("frames/{index:05}_{}.png", lobe.stem())), frame)
    }

    /// Removes what only a run under way needs.
    pub fn tidy(&self) {
        // It is empty, or holds what nobody asks for any more.
        let _ = fs::remove_dir_all(self.file("pending"));
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
