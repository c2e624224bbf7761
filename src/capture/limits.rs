//! What rig and plan ask for against what devices say they can do, before anything moves.

use super::CaptureError;
use super::device::{Bench, CameraLimits, ProjectorLimits};
use crate::optics::Rig;

/// Relative difference between the exposure asked for and the one set that is still the plan's exposure.
const EXPOSURE_TOLERANCE: f64 = 1e-3;
/// ... and at most, where a camera sets exposures in steps: a frame is merged with the time it was taken with, but colours that
/// a projector shows one after the other are no longer shown equally long.
const STEPPED_TOLERANCE: f64 = 1e-2;

/// How far the display's rate may be from the rig file's: modes of 60 Hz have 59.94 to 60.32. A long exposure of 16 refresh periods
/// is then off by a sixth of one at worst, which only colours that a projector shows one after the other would feel.
const REFRESH_TOLERANCE: f64 = 1e-2;

/// Whether an exposure is the one that was wanted, as nearly as a camera with steps of `step_s` (or none) can set it.
pub(super) fn near(achieved_s: f64, wanted_s: f64, step_s: f64) -> bool {
    // Half a step, and what rounding it takes.
    let nearest = (0.501 * step_s / wanted_s).min(STEPPED_TOLERANCE);
    // False for NaN.
    (achieved_s / wanted_s - 1.0).abs() <= EXPOSURE_TOLERANCE.max(nearest)
}

/// Compares what devices say they can do with a rig and with exposures; nothing is opened for good, nothing moves.
///
/// # Errors
/// [`CaptureError::Limits`]; [`CaptureError::Unusable`].
pub fn check_devices(rig: &Rig, bench: &dyn Bench, exposures_s: &[f64]) -> Result<CameraLimits, CaptureError> {
    let camera = bench.camera().limits().map_err(CaptureError::at_the_start)?;
    let projector = bench.projector().limits().map_err(CaptureError::at_the_start)?;
    check_camera(rig, &camera, exposures_s)?;
    check_projector(rig, &projector)?;
    Ok(camera)
}

fn check_camera(rig: &Rig, limits: &CameraLimits, exposures_s: &[f64]) -> Result<(), CaptureError> {
    let cannot =
        |problem, remedy| CaptureError::Limits { device: "camera", name: limits.name.clone(), problem, remedy };
    let c = &rig.camera;
    if (limits.width, limits.height) != (c.width_px, c.height_px) {
        let problem = format!(
            "delivers {} x {} px, the rig file says {} x {}",
            limits.width, limits.height, c.width_px, c.height_px
        );
        return Err(cannot(problem, "correct camera.width_px and camera.height_px or the camera's mode"));
    }
    let (shortest, longest, step_s) = (limits.shortest_s, limits.longest_s, limits.exposure_step_s);
    // The limits themselves are near where an exposure is rounded to them.
    let can = |e: f64| near(e.max(shortest).min(longest), e, step_s);
    if let Some(bad) = exposures_s.iter().find(|&&e| !can(e)) {
        let problem = format!(
            "exposes for {:.3}..={:.0} ms, the plan asks for {:.3} ms",
            1e3 * shortest,
            1e3 * longest,
            1e3 * bad
        );
        return Err(cannot(problem, "change the plan's exposures"));
    }
    let set_s = |e: f64| if step_s > 0.0 { (e / step_s).round() * step_s } else { e };
    if let Some(bad) = exposures_s.iter().find(|&&e| !near(set_s(e), e, step_s)) {
        let problem =
            format!("sets exposures in steps of {:.3} ms, the plan asks for {:.3} ms", 1e3 * step_s, 1e3 * bad);
        return Err(cannot(problem, "raise shortest_refreshes in the plan's [exposure]"));
    }
    Ok(())
}

fn check_projector(rig: &Rig, limits: &ProjectorLimits) -> Result<(), CaptureError> {
    let cannot =
        |problem, remedy| CaptureError::Limits { device: "projector", name: limits.name.clone(), problem, remedy };
    let p = &rig.projector;
    if (limits.width, limits.height) != (p.width_px, p.height_px) {
        let problem = format!(
            "shows {} x {} px, the rig file says {} x {}",
            limits.width, limits.height, p.width_px, p.height_px
        );
        return Err(cannot(problem, "set its native mode or correct projector.width_px and projector.height_px"));
    }
    if (limits.refresh_hz / p.refresh_hz - 1.0).abs() > REFRESH_TOLERANCE {
        let problem = format!("refreshes at {} Hz, the rig file says {}", limits.refresh_hz, p.refresh_hz);
        return Err(cannot(problem, "set the mode's rate or correct projector.refresh_hz"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::Triggering;

    fn camera(step_s: f64) -> CameraLimits {
        CameraLimits {
            name: "camera".into(),
            width: 1360,
            height: 1024,
            shortest_s: 1e-4,
            longest_s: 0.2,
            exposure_step_s: step_s,
            settling_frames: 0,
            triggering: Triggering::FreeRunning,
            frame_s: 0.03,
            readout_s: 0.0,
        }
    }

    fn checked(step_s: f64, exposures_s: &[f64]) -> Result<(), String> {
        let rig = Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap();
        check_camera(&rig, &camera(step_s), exposures_s).map_err(|e| e.to_string())
    }

    #[test]
    fn steps_of_a_camera_are_borne_up_to_a_percent() {
        // A sixtieth in steps of 0.1 ms is 16.7 ms.
        assert!(near(0.0167, 1.0 / 60.0, 1e-4) && !near(0.0167, 1.0 / 60.0, 0.0));
        assert!(!near(0.0166, 1.0 / 60.0, 1e-4) && !near(0.0168, 1.0 / 60.0, 1e-4));
        assert!(!near(f64::NAN, 0.1, 1e-4));
        checked(1e-4, &[1.0 / 60.0, 4.0 / 60.0]).unwrap();
        let error = checked(2e-3, &[1.0 / 60.0]).unwrap_err();
        assert!(error.contains("steps of 2.000 ms") && error.contains("shortest_refreshes"), "{error}");
    }

    #[test]
    fn limits_are_met_where_an_exposure_is_rounded_to_them() {
        checked(1e-4, &[0.200_04]).unwrap();
        for bad in [0.201, f64::NAN, 0.9e-4] {
            assert!(checked(1e-4, &[bad]).unwrap_err().contains("0.100..=200 ms"), "{bad}");
        }
    }
}
