//! What devices there are.

use std::fmt::Write as _;

use serde::Serialize;

use super::settings::{self, CameraSettings, Driver, FilesCameraSettings, FilesProjectorSettings, ProjectorSettings};
use crate::capture::CaptureError;

/// What a device is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// It takes frames.
    Camera,
    /// It shows frames.
    Projector,
}

/// A device that was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Found {
    /// What it is for.
    pub role: Role,
    /// What drives it.
    pub driver: Driver,
    /// Make, model and address.
    pub name: String,
    /// What it can do, a line each.
    pub details: Vec<String>,
    /// Why it cannot be used as it is, and what helps.
    pub problem: Option<String>,
    /// The table of a devices file that names it, if it can be used.
    pub toml: Option<String>,
}

impl Found {
    /// A camera with its table.
    pub fn camera(name: String, details: Vec<String>, settings: &CameraSettings) -> Self {
        let toml = Some(settings::camera_table(settings));
        Self { role: Role::Camera, driver: settings.driver(), name, details, problem: None, toml }
    }

    /// A projector with its table.
    pub fn projector(name: String, details: Vec<String>, settings: &ProjectorSettings) -> Self {
        let toml = Some(settings::projector_table(settings));
        Self { role: Role::Projector, driver: settings.driver(), name, details, problem: None, toml }
    }

    /// A device that cannot be used, and what helps.
    pub fn unusable(role: Role, driver: Driver, name: String, problem: String) -> Self {
        Self { role, driver, name, details: Vec::new(), problem: Some(problem), toml: None }
    }
}

/// What all drivers found, and what those that could not look say.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Listing {
    /// Devices.
    pub found: Vec<Found>,
    /// Drivers that say nothing, and why.
    pub silent: Vec<(Driver, String)>,
}

/// Asks every driver what there is.
pub fn list() -> Listing {
    let mut listing = Listing::default();
    for driver in Driver::ALL {
        match list_of(driver) {
            Some(Ok(found)) if found.is_empty() => listing.silent.push((driver, "finds no device".into())),
            Some(Ok(found)) => listing.found.extend(found),
            Some(Err(error)) => listing.silent.push((driver, error.to_string())),
            None => {
                let how = format!("not built in: build with `--features {driver}`, which needs {}", driver.needs());
                listing.silent.push((driver, how));
            }
        }
    }
    listing
}

fn list_of(driver: Driver) -> Option<Result<Vec<Found>, CaptureError>> {
    match driver {
        #[cfg(feature = "v4l")]
        Driver::V4l => Some(super::v4l::list()),
        #[cfg(feature = "aravis")]
        Driver::Aravis => Some(super::aravis::list()),
        #[cfg(feature = "kms")]
        Driver::Kms => Some(super::kms::list()),
        #[cfg(feature = "window")]
        Driver::Window => Some(super::window::list()),
        Driver::Files => Some(Ok(folders())),
        #[allow(unreachable_patterns)] // none is left where all are built in
        _ => None,
    }
}

/// What needs no device: any program that saves or shows pictures.
fn folders() -> Vec<Found> {
    let camera = FilesCameraSettings {
        folder: "frames".into(),
        width_px: 1360,
        height_px: 1024,
        timeout_s: 120.0,
        shortest_s: 1e-4,
        longest_s: 60.0,
    };
    let projector = FilesProjectorSettings {
        folder: "patterns".into(),
        width_px: 800,
        height_px: 600,
        refresh_hz: 60.0,
        settle_s: 0.5,
    };
    vec![
        Found::camera(
            "any program that saves frames into a folder".into(),
            vec!["grey PNG or PGM of 8 or 16 bits; set folder and size".into()],
            &CameraSettings::Files(camera),
        ),
        Found::projector(
            "any program that shows `current.png` of a folder".into(),
            vec!["set folder, size and refresh rate".into()],
            &ProjectorSettings::Files(projector),
        ),
    ]
}

impl Listing {
    /// The listing for people.
    pub fn text(&self) -> String {
        let mut text = String::new();
        for found in &self.found {
            let role = if found.role == Role::Camera { "camera" } else { "projector" };
            let _ = writeln!(text, "{role}, {}: {}", found.driver, found.name);
            for line in &found.details {
                let _ = writeln!(text, "  {line}");
            }
            if let Some(problem) = &found.problem {
                let _ = writeln!(text, "  cannot be used: {problem}");
            }
            for line in found.toml.iter().flat_map(|toml| toml.lines()) {
                let _ = writeln!(text, "    {line}");
            }
            text.push('\n');
        }
        for (driver, why) in &self.silent {
            let _ = writeln!(text, "{driver}: {why}");
        }
        text += "\nA devices file is the line `format = 1`, one [camera] table and one [projector] table from above.";
        text
    }
}
