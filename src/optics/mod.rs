//! Mirrors, lenses, the map from pixels to directions, and what misalignment does to it. Pure.

mod conic;
mod correction;
mod lanes;
mod many;
mod map;
mod mirrors;
mod misalignment;
mod placed;
mod profile;
mod pupil;
mod rig;
mod rig_check;
mod tolerances;
mod wishes;

pub use conic::Conic;
pub use correction::MapCorrection;
pub(crate) use correction::cubic;
pub use many::{Leaving, Ray};
pub use map::{Lens, OpticalMap};
pub use mirrors::{Mirrors, Path};
pub use misalignment::{Arrival, Device, Edges, Misaligned, Misalignment};
pub use placed::{Figure, PlacedMirrors, Pose, Reflected};
pub use profile::{ProfileError, ProfileMethod, ProfilePoint};
pub use pupil::{Beam, PupilMap, PupilTerms, disc};
pub use rig::{Alignment, Arm, Camera, Dome, Mosaic, Mount, Paraboloid, Projector, Rig, RigError, ZoneLimits};
pub use tolerances::{Coatings, Tolerances};
pub use wishes::{Free, FreeDome, FreeLens, FreeParaboloid, FreeZone, Limits, Objective, Parameter, SearchTable};
