//! The journal of a run: one JSON line for each thing that happened, written before the next can happen.

use std::collections::HashMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::patterns::{Lobe, Sign};
use crate::store::StoreError;

/// One line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case", deny_unknown_fields)]
pub enum JournalEntry {
    /// The devices were made ready, once for each session.
    Prepared {
        /// What lies between the projector's word that a frame is lit and its light, s.
        latency_s: f64,
        /// Projector code of the patch's lit cells; none without a patch.
        tag_level: Option<u8>,
        /// Contrast of the patch, electrons per second: the lamp's light in this session.
        tag_contrast: Option<f64>,
    },
    /// A frame was taken and stored.
    Frame(FrameEntry),
    /// A frame was no good, or did not come; it is taken again.
    Rejected {
        /// Position in the run.
        index: usize,
        /// The lobe that should be seen.
        #[serde(flatten)]
        lobe: Lobe,
        /// Exposure time wanted, s.
        exposure_s: f64,
        /// The camera's number, if a frame came.
        sequence: Option<u64>,
        /// What was wrong.
        reason: String,
    },
    /// The run waits.
    Paused,
    /// The run goes on.
    Resumed,
    /// The session ended before the run did.
    Stopped {
        /// Why.
        reason: String,
    },
}

/// A frame that was taken.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameEntry {
    /// Position in the run.
    pub index: usize,
    /// Repeat of the sequence.
    pub repeat: usize,
    /// The lobe shown.
    #[serde(flatten)]
    pub lobe: Lobe,
    /// Which of the lobe's exposures it is, from 0.
    pub exposure: usize,
    /// Exposure time achieved, s.
    pub exposure_s: f64,
    /// The camera's gain.
    pub gain: f64,
    /// The camera's frame number.
    pub sequence: u64,
    /// Start of exposure on the session's clock, s.
    pub timestamp_s: f64,
    /// The lamp's light relative to the start of the run, as used for this frame.
    pub light: f64,
    /// This frame's own reading of it, and its standard error; none without a patch.
    pub light_reading: Option<[f64; 2]>,
}

/// Identifies a frame whatever the order it was taken in: repeat, function, whether it is the negative lobe, exposure.
type Key = (usize, usize, bool, usize);

/// What a journal tells of the frames that need not be taken again.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Recorded {
    frames: HashMap<Key, FrameEntry>,
    /// Frames in the order they were taken.
    pub in_order: Vec<FrameEntry>,
    /// Contrast of the patch when the run began.
    pub first_contrast: Option<f64>,
    /// Frames that were no good so far.
    pub rejected: usize,
}

impl Recorded {
    fn new(entries: Vec<JournalEntry>) -> Self {
        let mut recorded = Self::default();
        for entry in entries {
            match entry {
                JournalEntry::Frame(frame) => {
                    recorded.frames.insert(key(frame.repeat, frame.lobe, frame.exposure), frame);
                    recorded.in_order.push(frame);
                }
                JournalEntry::Prepared { tag_contrast, .. } => {
                    recorded.first_contrast = recorded.first_contrast.or(tag_contrast);
                }
                JournalEntry::Rejected { .. } => recorded.rejected += 1,
                JournalEntry::Paused | JournalEntry::Resumed | JournalEntry::Stopped { .. } => {}
            }
        }
        recorded
    }

    /// The entry of an exposure, if it was taken.
    pub fn frame(&self, repeat: usize, lobe: Lobe, exposure: usize) -> Option<&FrameEntry> {
        self.frames.get(&key(repeat, lobe, exposure))
    }

    /// Number of the first frame still to come, on the camera's own count.
    pub fn next_sequence(&self) -> u64 {
        self.in_order.iter().map(|f| f.sequence + 1).max().unwrap_or(0)
    }
}

fn key(repeat: usize, lobe: Lobe, exposure: usize) -> Key {
    (repeat, lobe.k, lobe.sign == Sign::Negative, exposure)
}

/// The journal of a run that is under way; locked, so that no two programs write one run.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
}

impl Journal {
    /// Opens or makes a journal and reads what it holds. A last line that was cut short, as when power fails, is removed.
    ///
    /// # Errors
    /// [`StoreError`]; a damaged line that is not the last is [`StoreError::Invalid`] with its number, and so is a journal
    /// in use.
    pub fn open(path: &Path) -> Result<(Self, Recorded), StoreError> {
        let failed = |source| StoreError::Write { path: path.to_owned(), source };
        let mut file = OpenOptions::new().create(true).append(true).read(true).open(path).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(StoreError::invalid(path, "another program writes this run: wait for it or stop it"));
            }
            Err(TryLockError::Error(source)) => return Err(failed(source)),
        }
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(|source| StoreError::Read { path: path.to_owned(), source })?;
        let whole = bytes.iter().rposition(|&b| b == b'\n').map_or(0, |i| i + 1);
        let entries = entries(path, &bytes[..whole])?;
        if whole < bytes.len() {
            file.set_len(whole as u64).map_err(failed)?;
        }
        Ok((Self { path: path.to_owned(), file }, Recorded::new(entries)))
    }

    /// Appends a line; it is the system's when this returns, and outlives the program.
    ///
    /// # Errors
    /// [`StoreError::Write`]; what was written of the line is taken back.
    pub fn append(&mut self, entry: &JournalEntry) -> Result<(), StoreError> {
        let line = serde_json::to_string(entry).expect("numbers and names") + "\n";
        let failed = |source| StoreError::Write { path: self.path.clone(), source };
        let before = self.file.metadata().map_err(failed)?.len();
        self.file.write_all(line.as_bytes()).map_err(|source| {
            // A full disk may have taken half a line.
            let _ = self.file.set_len(before);
            failed(source)
        })
    }
}

fn entries(path: &Path, bytes: &[u8]) -> Result<Vec<JournalEntry>, StoreError> {
    let lines = bytes.split(|&b| b == b'\n').filter(|line| !line.is_empty());
    lines
        .enumerate()
        .map(|(i, line)| {
            serde_json::from_slice(line).map_err(|e| {
                let reason = format!(
                    "line {line} cannot be read ({e}): delete it and all that follow, those frames are then taken again",
                    line = i + 1
                );
                StoreError::invalid(path, reason)
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn entry(index: usize) -> JournalEntry {
        let lobe = Lobe::both(index / 2, false)[index % 2];
        JournalEntry::Frame(FrameEntry {
            index,
            repeat: 0,
            lobe,
            exposure: 0,
            exposure_s: 0.25,
            gain: 1.0,
            sequence: index as u64,
            timestamp_s: 0.5,
            light: 1.0,
            light_reading: Some([1.0, 1e-3]),
        })
    }

    #[test]
    fn a_cut_line_is_dropped_and_a_damaged_one_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.jsonl");
        let (mut journal, recorded) = Journal::open(&path).unwrap();
        assert_eq!(recorded, Recorded::default());
        for i in 0..4 {
            journal.append(&entry(i)).unwrap();
        }
        assert!(Journal::open(&path).unwrap_err().to_string().contains("another program"));
        drop(journal);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 20]).unwrap();
        let (journal, recorded) = Journal::open(&path).unwrap();
        assert_eq!((recorded.in_order.len(), recorded.next_sequence()), (3, 3));
        drop(journal);
        let damaged = text.replacen("\"frame\"", "\"fram\"", 2).replacen("\"fram\"", "\"frame\"", 1);
        std::fs::write(&path, damaged).unwrap();
        let said = Journal::open(&path).unwrap_err().to_string();
        assert!(said.contains("line 2") && said.contains("taken again"), "{said}");
    }

    proptest! {
        #[test]
        fn any_cut_leaves_whole_lines(cut in 0usize..800) {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("journal.jsonl");
            let (mut journal, _) = Journal::open(&path).unwrap();
            for i in 0..4 {
                journal.append(&entry(i)).unwrap();
            }
            drop(journal);
            let bytes = std::fs::read(&path).unwrap();
            let cut = cut.min(bytes.len());
            std::fs::write(&path, &bytes[..cut]).unwrap();
            let whole = bytes[..cut].iter().filter(|&&b| b == b'\n').count();
            let (mut journal, recorded) = Journal::open(&path).unwrap();
            prop_assert_eq!(recorded.in_order.len(), whole);
            journal.append(&entry(whole)).unwrap();
            drop(journal);
            prop_assert_eq!(Journal::open(&path).unwrap().1.in_order.len(), whole + 1);
        }

        #[test]
        fn no_text_is_a_panic(text in "\\PC{0,200}") {
            let _ = entries(Path::new("j"), text.as_bytes());
        }
    }
}
