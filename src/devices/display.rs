//! What displays have in common: pixels as they take them, an identity gamma ramp, how many frames are kept ready.

use super::Painter;
use crate::capture::CaptureError;
use crate::patterns::Pattern;

/// Memory that frames kept ready may take, bytes: 500 frames of 800 x 600. Frames beyond it are painted when they are shown.
const READY_BYTES: usize = 1 << 30;
/// What a gamma ramp may be off, of 65535: less than half a step of an 8-bit display.
const RAMP_TOLERANCE: u16 = 96;

/// Bytes of a pixel.
pub(super) const PIXEL_BYTES: usize = 4;

/// How many of `count` frames of `frame_bytes` are kept ready.
pub(super) fn kept_ready(count: usize, frame_bytes: usize) -> usize {
    count.min(READY_BYTES / frame_bytes.max(1))
}

/// A frame as blue, green, red and an unused byte for each pixel, row by row.
pub(super) fn paint(painter: &Painter, pattern: &Pattern) -> Vec<u8> {
    painter.rgb(pattern).into_iter().flat_map(|[red, green, blue]| [blue, green, red, 0]).collect()
}

/// The ramp that leaves codes as they are.
pub(super) fn identity_ramp(len: usize) -> Vec<u16> {
    let last = len.saturating_sub(1).max(1);
    (0..len).map(|i| ((i * usize::from(u16::MAX) + last / 2) / last) as u16).collect()
}

/// Whether a ramp leaves codes as they are.
pub(super) fn is_identity(ramp: &[u16]) -> bool {
    let identity = identity_ramp(ramp.len());
    ramp.iter().zip(identity).all(|(&found, wanted)| found.abs_diff(wanted) <= RAMP_TOLERANCE)
}

/// A failure of a projector.
pub(super) fn failed(step: &str, reason: impl ToString) -> CaptureError {
    CaptureError::Device { device: "projector", step: step.into(), reason: reason.to_string() }
}

/// What a projector cannot do.
pub(super) fn cannot(name: &str, problem: impl Into<String>, remedy: &'static str) -> CaptureError {
    CaptureError::Limits { device: "projector", name: name.into(), problem: problem.into(), remedy }
}

/// Whether all frames of a sequence fill a display of this size exactly.
///
/// # Errors
/// [`CaptureError::Device`] for the first that does not.
pub(super) fn check_size(sequence: &[Pattern], width: usize, height: usize) -> Result<(), CaptureError> {
    match sequence.iter().find(|p| (p.width, p.height) != (width, height)) {
        Some(bad) => {
            let sizes = format!("a frame of {} x {} px on a display of {width} x {height}", bad.width, bad.height);
            Err(failed("load", format!("{sizes}: nothing is scaled, set the mode to the rig's projector size")))
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_identity_ramp_runs_from_black_to_white() {
        for len in [2, 16, 256, 1024] {
            let ramp = identity_ramp(len);
            assert!(ramp[0] == 0 && ramp[len - 1] == u16::MAX && ramp.is_sorted(), "{len}");
            assert!(is_identity(&ramp));
        }
        // Some drivers keep 8 bits: 255 * 256 instead of 65535 is another ramp, one rounded to 10 bits is not.
        assert!(!is_identity(&(0..256).map(|i| i << 8).collect::<Vec<u16>>()));
        assert!(is_identity(&(0..256).map(|i| (i * 257) & !63).collect::<Vec<u16>>()));
        let gamma: Vec<u16> = (0..256).map(|i| ((f64::from(i) / 255.0).powf(0.9) * 65535.0) as u16).collect();
        assert!(!is_identity(&gamma));
    }

    #[test]
    fn frames_are_kept_ready_as_far_as_memory_reaches() {
        assert_eq!(kept_ready(18, PIXEL_BYTES * 800 * 600), 18);
        assert!(kept_ready(882, PIXEL_BYTES * 1920 * 1080) < 200);
    }

    #[test]
    fn a_frame_of_another_size_is_refused() {
        let error = check_size(&[Pattern::full(4, 3, 0), Pattern::full(3, 3, 0)], 4, 3).unwrap_err();
        assert!(error.to_string().contains("3 x 3 px on a display of 4 x 3"), "{error}");
    }
}
