//! Patterns one after the other, merged: what calibrations are made of.

use super::acquisition::{Acquisition, Taken};
use super::{Bench, CaptureError, Crop, ResponseImage};
use crate::optics::Rig;
use crate::patterns::Pattern;

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
    let mut devices = Acquisition::open(rig, bench, exposures_s)?;
    let longest_s = exposures_s.iter().copied().fold(0.0, f64::max);
    devices.prepare(patterns, longest_s, None, 0)?;
    let mut responses = Vec::with_capacity(patterns.len());
    for i in 0..patterns.len() {
        let mut taken = vec![None; exposures_s.len()];
        devices.take(i, exposures_s, Some(i + 1).filter(|&n| n < patterns.len()), &mut |j, frame| {
            if let Ok(accepted) = frame {
                let samples = Acquisition::cut(&accepted.frame, crop);
                let (exposure_s, light) = (accepted.frame.exposure_s, accepted.light);
                taken[j] = Some(Taken { samples, exposure_s, light, frame: None });
            }
            Ok(())
        })?;
        let taken: Vec<Taken> = taken.into_iter().flatten().collect();
        responses.push(ResponseImage::merge(&devices.sensor, None, crop, &taken));
    }
    devices.restore()?;
    Ok(responses)
}
