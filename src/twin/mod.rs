//! The simulated rig: an independent forward model behind the same traits as real devices.
//!
//! `pinhole` traces chief rays through a slightly *perturbed* rig with real mirror intersections, integrates pixels as
//! areas, and has a real projector's response, contrast and leakage and a real camera's noise, wells and bits; only the
//! crosses of an alignment are seen and lit through finite pupils. `finite` is the same with the pupils of camera and
//! projector between sample and devices: footprints, blur, vignetting, and stray light. The reconstruction knows only the
//! nominal rig and what calibrations measured on the perturbed one.

mod bench;
mod clock;
mod config;
mod devices;
mod faults;
mod finite;
mod forward;
mod geometry;
mod light;
mod panel;
mod scene;
mod sensor;
mod targets;

pub use bench::TwinBench;
pub use clock::{RealClock, VirtualClock};
pub use config::{SensorTruth, TwinConfig};
pub use devices::Truth;
pub use faults::Faults;
pub use finite::{FiniteOptics, Pupils};
pub use forward::{Accuracy, ResponseField, lobe_width};
pub use geometry::InverseMap;
pub use light::PatternLight;
