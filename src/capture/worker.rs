//! What goes on while the next frame is taken: merging, storing, reducing.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use super::acquisition::Taken;
use super::{CaptureError, Crop, ResponseImage, RunFolder, SensorMaps};
use crate::patterns::{Lobe, Sign};
use crate::radiometry::Sensor;

/// Pairs that may wait to be merged: more would only fill the memory.
const QUEUE: usize = 2;

/// Both lobes of a function, in one repeat.
pub(super) struct Pair {
    pub k: usize,
    pub repeat: usize,
    /// What each lobe's response is made of: its frames with the positions they were taken at, or nothing if it is stored.
    pub lobes: [LobeFrames; 2],
}

/// What is known of a lobe.
pub(super) enum LobeFrames {
    /// Its response is stored.
    Stored,
    /// Its frames, and the position of each in the run.
    Taken(Vec<(usize, Taken)>),
}

/// Hands work over; dropped when there is no more.
pub(super) fn channel() -> (SyncSender<Pair>, Receiver<Pair>) {
    sync_channel(QUEUE)
}

/// Merges pairs as they come and gives `sink` the mean response of each lobe over all repeats.
pub(super) struct Worker<'a, S> {
    pub sensor: Sensor,
    pub crop: Crop,
    pub maps: Option<&'a SensorMaps>,
    pub repeats: usize,
    pub folder: Option<&'a RunFolder>,
    /// Responses of repeats so far, where no folder keeps them: by function.
    pub memory: Vec<Vec<[ResponseImage; 2]>>,
    pub sink: S,
}

impl<S: FnMut(Lobe, ResponseImage)> Worker<'_, S> {
    /// Works until the sender is dropped or something fails.
    pub fn run(mut self, pairs: Receiver<Pair>) -> Result<(), CaptureError> {
        for pair in pairs {
            self.take(pair)?;
        }
        Ok(())
    }

    fn take(&mut self, pair: Pair) -> Result<(), CaptureError> {
        let Pair { k, repeat, lobes } = pair;
        let signs = [Sign::Positive, Sign::Negative];
        let exposures = lobes.each_ref().map(|l| if let LobeFrames::Taken(frames) = l { frames.len() } else { 0 });
        let mut responses = Vec::with_capacity(2);
        for (sign, frames) in signs.into_iter().zip(lobes) {
            let lobe = Lobe { k, sign };
            responses.push(match frames {
                LobeFrames::Stored => self.stored(lobe, repeat)?,
                LobeFrames::Taken(frames) => self.merge(lobe, repeat, frames)?,
            });
        }
        if let Some(folder) = self.folder {
            for (sign, exposures) in signs.into_iter().zip(exposures) {
                folder.drop_pending(repeat, &Lobe { k, sign }, exposures);
            }
        }
        let pair: [ResponseImage; 2] = responses.try_into().expect("two lobes");
        if self.repeats == 1 {
            let [positive, negative] = pair;
            (self.sink)(Lobe { k, sign: Sign::Positive }, positive);
            (self.sink)(Lobe { k, sign: Sign::Negative }, negative);
            return Ok(());
        }
        if self.folder.is_none() {
            self.memory[k].push(pair);
        }
        if repeat + 1 == self.repeats {
            for (i, sign) in signs.into_iter().enumerate() {
                let lobe = Lobe { k, sign };
                let all = match self.folder {
                    Some(_) => (0..self.repeats).map(|r| self.stored(lobe, r)).collect::<Result<Vec<_>, _>>()?,
                    None => self.memory[k].iter().map(|pair| pair[i].clone()).collect(),
                };
                (self.sink)(lobe, ResponseImage::mean(&all));
            }
            self.memory[k].clear();
        }
        Ok(())
    }

    fn stored(&self, lobe: Lobe, repeat: usize) -> Result<ResponseImage, CaptureError> {
        let folder = self.folder.expect("only folders keep responses");
        Ok(ResponseImage::read_of(&folder.response_path(&lobe, repeat), self.crop)?)
    }

    fn merge(&self, lobe: Lobe, repeat: usize, frames: Vec<(usize, Taken)>) -> Result<ResponseImage, CaptureError> {
        if let Some(folder) = self.folder.filter(|f| f.keeps_frames()) {
            for (index, taken) in &frames {
                if let Some(frame) = &taken.frame {
                    folder.keep_frame(*index, &lobe, frame)?;
                }
            }
        }
        let taken: Vec<Taken> = frames.into_iter().map(|(_, taken)| taken).collect();
        let response = ResponseImage::merge(&self.sensor, self.maps, self.crop, &taken);
        Ok(match self.folder {
            Some(folder) => folder.keep_response(&lobe, repeat, &response)?,
            None => response.as_stored(),
        })
    }
}
