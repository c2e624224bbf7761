//! What goes on while the next frame is taken: merging, storing, reducing.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use super::acquisition::Taken;
use super::{CaptureError, Crop, ResponseImage, RunFolder, SensorMaps};
use crate::patterns::Lobe;
use crate::radiometry::Sensor;

/// Pairs that may wait to be merged: more would only fill the memory.
const QUEUE: usize = 2;

/// Both frames of a step, in one repeat.
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

/// What the worker is asked to do.
pub(super) enum Work {
    /// To merge a pair.
    Pair(Pair),
    /// To answer when everything before is done.
    Flush(SyncSender<()>),
}

/// Hands work over; dropped when there is no more.
pub(super) fn channel() -> (SyncSender<Work>, Receiver<Work>) {
    sync_channel(QUEUE)
}

/// Merges pairs as they come and gives `sink` the mean response of each lobe over all repeats.
pub(super) struct Worker<'a, S> {
    pub sensor: Sensor,
    pub crop: Crop,
    pub maps: Option<&'a SensorMaps>,
    pub repeats: usize,
    pub mixed: bool,
    pub folder: Option<&'a RunFolder>,
    /// Responses of repeats so far, where no folder keeps them: by step.
    pub memory: Vec<Vec<[ResponseImage; 2]>>,
    pub sink: S,
}

impl<S: FnMut(Lobe, ResponseImage)> Worker<'_, S> {
    /// Works until the sender is dropped or something fails.
    pub fn run(mut self, work: Receiver<Work>) -> Result<(), CaptureError> {
        for work in work {
            match work {
                Work::Pair(pair) => self.take(pair)?,
                // Nobody waits any more where the run has been stopped meanwhile.
                Work::Flush(done) => drop(done.send(())),
            }
        }
        Ok(())
    }

    fn take(&mut self, pair: Pair) -> Result<(), CaptureError> {
        let Pair { k, repeat, lobes } = pair;
        let both = Lobe::both(k, self.mixed);
        let exposures = lobes.each_ref().map(|l| if let LobeFrames::Taken(frames) = l { frames.len() } else { 0 });
        let mut responses = Vec::with_capacity(2);
        for (lobe, frames) in both.into_iter().zip(lobes) {
            responses.push(match frames {
                LobeFrames::Stored => self.stored(lobe, repeat)?,
                LobeFrames::Taken(frames) => self.merge(lobe, repeat, frames)?,
            });
        }
        if let Some(folder) = self.folder {
            for (lobe, exposures) in both.iter().zip(exposures) {
                folder.drop_pending(repeat, lobe, exposures);
            }
        }
        let pair: [ResponseImage; 2] = responses.try_into().expect("two lobes");
        if self.repeats == 1 {
            both.into_iter().zip(pair).for_each(|(lobe, response)| (self.sink)(lobe, response));
            return Ok(());
        }
        if self.folder.is_none() {
            self.memory[k].push(pair);
        }
        if repeat + 1 == self.repeats {
            for (i, lobe) in both.into_iter().enumerate() {
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
