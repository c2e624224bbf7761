//! What a workshop makes the mirrors from: the dome's profile as a table, sections as DXF, solids as STL, a drawing as SVG.
//! Pure: text and bytes, no files.
//!
//! Lengths are millimetres and scale is 1:1; r is the distance from the optical axis and z the height above the sample's
//! plane. Every file shows the nominal rig.

mod canvas;
mod drawing;
mod dxf;
mod layout;
mod parts;
mod profile_file;
mod stl;

pub use drawing::drawing_svg;
pub use dxf::dxf;
pub use parts::{HandoverError, Part, Parts};
pub use profile_file::{ProfileFileError, profile_csv, read_profile};
pub use stl::stl;

/// Wall of the dome unless another is asked for, mm.
pub const WALL_MM: f64 = 3.0;
/// Distance of the profile's points along the arc unless another is asked for, mm.
pub const SPACING_MM: f64 = 0.5;
/// Chord error of solids unless another is asked for, mm.
pub const CHORD_MM: f64 = 0.02;
/// Chord error of sections in DXF files, mm: half of what a lathe for optics is set to.
pub const SECTION_CHORD_MM: f64 = 5e-4;

/// Text as part of a line: files end their comments and titles with it.
fn one_line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

#[cfg(test)]
mod samples {
    use super::{Parts, WALL_MM};
    use crate::optics::Rig;

    /// The thesis rigs with the default opening: as built, and the whole dome, which is undercut.
    pub(super) fn thesis() -> [Parts; 2] {
        [include_str!("../../optics/ghosh-2007-built.toml"), include_str!("../../optics/ghosh-2007-full.toml")].map(
            |text| {
                let rig = Rig::from_toml(text).unwrap();
                Parts::new(&rig, rig.alignment.opening_radius_mm, WALL_MM).unwrap()
            },
        )
    }
}
