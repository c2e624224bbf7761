//! The workshop's files against their peers: trimesh measures solids, ezdxf audits and measures sections.
#![cfg(feature = "peers")]

mod common;

use std::f64::consts::PI;
use std::path::Path;

use serde_json::{Value, json};
use zonal::handover::{CHORD_MM, Part, Parts, WALL_MM, dxf, profile_csv, read_profile, stl};
use zonal::optics::{ProfilePoint, Rig};

const RIGS: [&str; 2] =
    [include_str!("../optics/ghosh-2007-built.toml"), include_str!("../optics/ghosh-2007-full.toml")];
/// What sections are compared with, mm: the chord error they promise.
const SECTION_MM: f64 = 1e-3;
/// Spacing of the profile that volumes are integrated over, mm: trapezia are then off by less than 1e-6.
const FINE_MM: f64 = 0.02;

/// Volume and area of the mirror's surface, from radii and curvatures of the profile and not from any outline.
fn volume(parts: &Parts, part: Part) -> (f64, f64) {
    let profile = parts.profile(FINE_MM).unwrap();
    let (area, mut shell, mut slices) = profile.windows(2).fold((0.0, 0.0, 0.0), |(area, shell, slices), w| {
        let band = PI * (w[0].r + w[1].r) * (w[1].r - w[0].r).hypot(w[1].z - w[0].z);
        // Steiner: what lies within the wall of a surface with these curvatures.
        let depth = |p: &ProfilePoint| {
            let ([k, l], t) = ([1.0 / p.meridional_radius, 1.0 / p.sagittal_radius], parts.wall_mm());
            t + t * t * (k + l) / 2.0 + t.powi(3) * k * l / 3.0
        };
        let slice = PI * 0.5 * (w[0].r.powi(2) + w[1].r.powi(2)) * (w[0].z - w[1].z);
        (area + band, shell + band * 0.5 * (depth(&w[0]) + depth(&w[1])), slices + slice)
    });
    match part {
        Part::Dome => return (shell, 2.5 * area),
        Part::Mandrel => return (slices, area),
        Part::ConvexMirror => {}
    }
    let (conic, edge) = (parts.mirrors().convex(), parts.rig().paraboloid_radius_mm());
    let depth = conic.vertex_height - conic.height(edge);
    // A paraboloid fills half of its cylinder; no surface of it is larger than cylinder and lid.
    slices = PI / 2.0 * edge * edge * depth;
    shell = 2.0 * PI * edge * depth + PI * edge * edge;
    (slices, shell)
}

/// The files of a part, and what their peers are to find.
fn case(parts: &Parts, part: Part, folder: &Path) -> Value {
    let name = format!("{} of {}", part.name(), parts.rig().name);
    let [solid, section] = ["stl", "dxf"].map(|kind| folder.join(format!("{name}.{kind}")));
    std::fs::write(&solid, stl(parts, part, CHORD_MM).unwrap()).unwrap();
    std::fs::write(&section, dxf(parts, part).unwrap()).unwrap();
    let (volume, area) = volume(parts, part);
    let edge = parts.rig().paraboloid_radius_mm();
    let conic = parts.mirrors().convex();
    let rho = |i: usize| edge * i as f64 / 2000.0;
    // The true curve, far closer than the polyline's points.
    let curve: Vec<[f64; 2]> = match part {
        Part::ConvexMirror => (0..=2000).map(|i| [rho(i), conic.height(rho(i))]).collect(),
        _ => parts.profile(0.1).unwrap().iter().map(|p| [p.r, p.z]).collect(),
    };
    let widest = parts.undercut().unwrap_or(parts.end());
    json!({
        "name": name,
        "stl": solid,
        "dxf": section,
        "volume_mm3": volume,
        // Faces lie inside their surfaces by less than the chord error.
        "volume_tolerance_mm3": area * CHORD_MM,
        "curve_mm": curve,
        "greatest_radius_mm": match part {
            Part::Dome => widest.r + WALL_MM * -widest.normal[0],
            Part::Mandrel => widest.r,
            Part::ConvexMirror => edge,
        },
        "on_axis": if part == Part::Dome { 0 } else { 2 },
        "tolerance_mm": SECTION_MM,
    })
}

#[test]
fn peers_read_closed_parts_of_the_right_size() {
    let folder = tempfile::tempdir().unwrap();
    let mut cases = Vec::new();
    for text in RIGS {
        let rig = Rig::from_toml(text).unwrap();
        let parts = Parts::new(&rig, rig.alignment.opening_radius_mm, WALL_MM).unwrap();
        assert!(read_profile(&profile_csv(&parts, 0.5).unwrap()).is_ok());
        cases.extend(Part::ALL.map(|part| case(&parts, part, folder.path())));
    }
    common::ask("peer_handover.py", &json!(cases));
}
