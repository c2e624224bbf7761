//! `zonal` measures the BRDF of a flat sample with a projector, a camera and a mirrored dome.
//!
//! The projector shows the functions of an orthonormal *zonal* basis as light; one HDR image of each answers with one
//! coefficient of the reflectance for every direction the camera sees. The modules follow the way of the data: a module
//! uses only those listed above it (`tests/architecture.rs` holds them to it).
//!
//! # Conventions
//! The sample lies at the origin, its shading normal is +z and its grain +x. `wi` points to the light and `wo` to the
//! camera, both away from the surface. `f` is the BRDF in 1/sr; `f_cos = f cos(theta_i)` is what the rig measures and
//! what every zonal and spherical-harmonic coefficient describes. Angles are radians inside; degrees exist in files and
//! at the prompt only.

pub mod geometry;
pub mod basis;
pub mod optics;
pub mod handover;
pub mod radiometry;
pub mod store;
pub mod reflectance;
pub mod patterns;
pub mod capture;
pub mod reduce;
pub mod calibrate;
pub mod measure;
pub mod twin;
pub mod devices;
pub mod fit;
pub mod forecast;
pub mod design;
pub mod convert;
pub mod export;
pub mod render;
pub mod report;
