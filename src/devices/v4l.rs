//! The driver `v4l`.

use super::{Found, V4lSettings};
use crate::capture::{Camera, CameraFactory, CameraLimits, CaptureError};

/// A camera of this driver.
pub struct V4l {
    settings: V4lSettings,
}

impl V4l {
    /// One of these settings; nothing is opened.
    pub fn new(settings: &V4lSettings) -> Self {
        Self { settings: settings.clone() }
    }

    fn unwritten(&self) -> CaptureError {
        let reason = format!("it is not written yet: {:?} must wait", self.settings);
        CaptureError::Device { device: "camera", step: "open".into(), reason }
    }
}

impl CameraFactory for V4l {
    fn limits(&self) -> Result<CameraLimits, CaptureError> {
        Err(self.unwritten())
    }

    fn open(&self) -> Result<Box<dyn Camera>, CaptureError> {
        Err(self.unwritten())
    }
}

/// What there is.
///
/// # Errors
/// [`CaptureError::Device`].
pub fn list() -> Result<Vec<Found>, CaptureError> {
    Ok(Vec::new())
}
