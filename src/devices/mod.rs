//! Real cameras and projectors behind the traits of [`capture`](crate::capture).
//!
//! A devices file ([`DevicesFile`]) says which driver takes frames and which shows them. All drivers can be named in it; those
//! that need a library of the system are features of the build.

mod bench;
mod error;
mod files;
mod files_projector;
mod first_light;
mod grey_image;
mod list;
mod paint;
mod settings;
mod v4l_formats;

#[cfg(feature = "aravis")]
mod aravis;
#[cfg(feature = "aravis")]
mod aravis_camera;
#[cfg(any(feature = "kms", feature = "window"))]
mod display;
#[cfg(feature = "kms")]
mod kms;
#[cfg(feature = "kms")]
mod kms_output;
#[cfg(feature = "v4l")]
mod v4l;
#[cfg(feature = "v4l")]
mod v4l_camera;
#[cfg(feature = "v4l")]
mod v4l_controls;
#[cfg(feature = "v4l")]
mod v4l_list;
#[cfg(feature = "v4l")]
mod v4l_timing;
#[cfg(feature = "window")]
mod window;
#[cfg(feature = "window")]
mod window_output;

pub use bench::{DeviceBench, MonotonicClock, Operator};
pub use error::DevicesError;
pub use first_light::{Finding, FirstLight, Verdict, first_light};
pub use list::{Found, Listing, Role, list};
pub use paint::Painter;
pub use settings::{
    AravisSettings, CameraSettings, DEVICES_FORMAT, DevicesFile, Driver, FilesCameraSettings, FilesProjectorSettings,
    KmsSettings, ProjectorSettings, Stamp, V4lSettings, WindowSettings,
};
pub use v4l_formats::{PixelFormat, UnpackError, Unpacker};
