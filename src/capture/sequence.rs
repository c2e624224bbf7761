//! Patterns one after the other, merged: what calibrations are made of.

use super::acquisition::{Acquisition, Taken, sensor};
use super::{Bench, CaptureError, Crop, ResponseImage};
use crate::optics::Rig;
use crate::patterns::Pattern;

/// Gets a proved frame: the positions of its pattern and of its exposure, and its samples.
pub type KeepFrame<'k> = dyn FnMut(usize, usize, Taken) + 'k;

/// Shows patterns one after the other and hands the proved frames of `exposures_s` of each over `crop`, as they come from the
/// camera, to `keep`. An exposure may be listed several times.
///
/// # Errors
/// [`CaptureError`].
pub fn capture_frames(
    rig: &Rig,
    bench: &mut dyn Bench,
    patterns: &[Pattern],
    exposures_s: &[f64],
    crop: Crop,
    keep: &mut KeepFrame<'_>,
) -> Result<(), CaptureError> {
    let mut devices = Acquisition::open(rig, bench, exposures_s)?;
    bench.foresee(patterns);
    let longest_s = exposures_s.iter().copied().fold(0.0, f64::max);
    devices.prepare(patterns, longest_s, None, 0)?;
    for i in 0..patterns.len() {
        devices.take(i, exposures_s, Some(i + 1).filter(|&n| n < patterns.len()), &mut |j, frame| {
            if let Ok(accepted) = frame {
                let samples = Acquisition::cut(&accepted.frame, crop);
                let (exposure_s, light) = (accepted.frame.exposure_s, accepted.light);
                keep(i, j, Taken { samples, exposure_s, light, frame: None });
            }
            Ok(())
        })?;
    }
    devices.restore()
}

/// Shows patterns one after the other and merges `exposures_s` of each over `crop`.
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
    let mut taken = vec![vec![None; exposures_s.len()]; patterns.len()];
    let mut responses = Vec::with_capacity(patterns.len());
    let sensor = sensor(rig);
    capture_frames(rig, bench, patterns, exposures_s, crop, &mut |i, j, frame| {
        taken[i][j] = Some(frame);
        if taken[i].iter().all(Option::is_some) {
            // All of a pattern's frames come before those of the next.
            let frames: Vec<Taken> = std::mem::take(&mut taken[i]).into_iter().flatten().collect();
            responses.push(ResponseImage::merge(&sensor, None, crop, &frames));
        }
    })?;
    Ok(responses)
}
