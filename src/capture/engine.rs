//! The engine: shows patterns, takes frames, merges them, keeps what must not be lost.

use super::{Bench, CaptureError, Crop, Frame, JournalEntry, ResponseImage, RunFolder};
use crate::optics::Rig;
use crate::patterns::{Event, Lobe, Pattern, Plan, Timing};
use crate::radiometry::Sensor;

/// Told of every frame: how many are done, how many there are, and the rig's remaining seconds.
pub type Progress<'a> = dyn FnMut(usize, usize, f64) + 'a;

/// Relative difference between the exposure asked for and the one set that is still the plan's exposure.
const EXPOSURE_TOLERANCE: f64 = 1e-3;

/// Runs plans on a bench.
pub struct Engine<'a> {
    rig: &'a Rig,
    bench: &'a mut dyn Bench,
    crop: Crop,
}

impl<'a> Engine<'a> {
    /// An engine for the devices of a rig.
    pub fn new(rig: &'a Rig, bench: &'a mut dyn Bench) -> Self {
        Self { rig, bench, crop: Crop::of_zone(rig) }
    }

    /// The same engine for another part of the sensor than sees the nominal zone.
    pub fn with_crop(self, crop: Crop) -> Self {
        Self { crop, ..self }
    }

    /// Shows every lobe of `plan` and hands its HDR response, the mean over repeats, to `sink`, in the plan's order.
    ///
    /// `patterns` holds the frames in the order of [`Plan::lobes`]. With a folder, frames are journaled and responses
    /// stored as they come; `sink` gets them as stored.
    ///
    /// # Errors
    /// [`CaptureError`]; what was stored until then stays.
    pub fn run(
        &mut self,
        plan: &Plan,
        patterns: &[Pattern],
        mut folder: Option<&mut RunFolder>,
        progress: &mut Progress<'_>,
        mut sink: impl FnMut(Lobe, ResponseImage),
    ) -> Result<(), CaptureError> {
        let timing = Timing::of(self.rig);
        let events: Vec<Event> = plan.events(&timing).collect();
        let crop = self.crop;
        let sensor = sensor(self.rig);
        let total_s = plan.rig_time(&timing).total_s();
        self.bench.projector().load(patterns)?;
        let stacks = events.chunk_by(|a, b| a.repeat == b.repeat && a.lobe == b.lobe);
        let mut pending: Vec<Vec<ResponseImage>> = vec![Vec::new(); patterns.len()];
        let mut done = 0;
        for (position, stack) in stacks.enumerate() {
            let shown = position % patterns.len();
            self.bench.projector().show(shown)?;
            let mut frames = Vec::with_capacity(stack.len());
            for event in stack {
                let frame = expose(self.bench, self.rig, event.exposure_s)?;
                if let Some(folder) = folder.as_deref_mut() {
                    folder.record(&JournalEntry::new(event, &frame), &frame)?;
                }
                frames.push(frame);
                done += 1;
                progress(done, events.len(), total_s * (1.0 - done as f64 / events.len() as f64));
            }
            pending[shown].push(ResponseImage::merge(&sensor, crop, &frames));
            if pending[shown].len() == plan.repeats {
                let response = ResponseImage::mean(&std::mem::take(&mut pending[shown]));
                let lobe = stack[0].lobe;
                let response = match folder.as_deref_mut() {
                    Some(folder) => folder.keep_response(&lobe, &response)?,
                    None => response.as_stored(),
                };
                sink(lobe, response);
            }
        }
        Ok(())
    }
}

/// Shows patterns one after the other and merges `exposures_s` of each over `crop`: what calibrations are made of.
///
/// # Errors
/// [`CaptureError`].
pub fn capture_sequence(
    rig: &Rig,
    bench: &mut dyn Bench,
    patterns: &[Pattern],
    exposures_s: &[f64],
    crop: Crop,
) -> Result<Vec<ResponseImage>, CaptureError> {
    let sensor = sensor(rig);
    bench.projector().load(patterns)?;
    (0..patterns.len())
        .map(|i| {
            bench.projector().show(i)?;
            let frames = exposures_s.iter().map(|&e| expose(bench, rig, e)).collect::<Result<Vec<_>, _>>()?;
            Ok(ResponseImage::merge(&sensor, crop, &frames))
        })
        .collect()
}

fn expose(bench: &mut dyn Bench, rig: &Rig, wanted_s: f64) -> Result<Frame, CaptureError> {
    let achieved_s = bench.camera().set_exposure(wanted_s)?;
    // Negated so that NaN fails.
    let relative = (achieved_s / wanted_s - 1.0).abs();
    if relative.is_nan() || relative > EXPOSURE_TOLERANCE {
        return Err(CaptureError::Exposure { wanted_s, achieved_s });
    }
    let frame = bench.camera().grab()?;
    let (width, height) = (rig.camera.width_px, rig.camera.height_px);
    if (frame.width, frame.height) != (width, height) || frame.samples.len() != width * height {
        return Err(CaptureError::FrameSize { got_width: frame.width, got_height: frame.height, width, height });
    }
    Ok(frame)
}

/// The sensor's figures as the HDR estimate needs them.
fn sensor(rig: &Rig) -> Sensor {
    let c = &rig.camera;
    Sensor {
        gain_dn_per_e: c.gain_dn_per_e,
        dark_noise_e: c.dark_noise_e,
        black_level_dn: c.black_level_dn,
        limit_dn: c.linear_limit_dn,
    }
}
