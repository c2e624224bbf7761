//! The driver `window`.

use super::{Found, Painter, WindowSettings};
use crate::capture::{CaptureError, Projector, ProjectorFactory, ProjectorLimits};

/// A projector of this driver.
pub struct Window {
    settings: WindowSettings,
}

impl Window {
    /// One of these settings; nothing is opened.
    pub fn new(settings: &WindowSettings, _painter: Painter) -> Self {
        Self { settings: settings.clone() }
    }

    fn unwritten(&self) -> CaptureError {
        let reason = format!("it is not written yet: {:?} must wait", self.settings);
        CaptureError::Device { device: "projector", step: "open".into(), reason }
    }
}

impl ProjectorFactory for Window {
    fn limits(&self) -> Result<ProjectorLimits, CaptureError> {
        Err(self.unwritten())
    }

    fn open(&self) -> Result<Box<dyn Projector>, CaptureError> {
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
