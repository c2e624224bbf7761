//! Which pixels of the simulated projector's panel light what.

use crate::optics::{Misaligned, Rig};
use crate::patterns::{Rect, TagLayout};

/// Panel pixels whose light goes into the zone.
pub(super) fn lit_zone(rig: &Rig) -> Vec<usize> {
    let (map, zone, p) = (rig.projector_map(), rig.zone(), &rig.projector);
    let lit = |&i: &usize| {
        let direction = map.direction((i % p.width_px) as f64 + 0.5, (i / p.width_px) as f64 + 0.5);
        direction.is_some_and(|d| zone.contains(d.theta()))
    };
    (0..p.width_px * p.height_px).filter(lit).collect()
}

/// Sensor pixels that look past the mirrors at the coded patch, the panel's pixel each sees, and the share of its light that
/// both lenses leave.
pub(super) fn border(rig: &Rig, projector: &Misaligned, camera: &Misaligned) -> Vec<(u32, u32, f32)> {
    let Some(layout) = TagLayout::of(rig) else { return Vec::new() };
    let (width, panel_width) = (rig.camera.width_px, rig.projector.width_px);
    let mut seen = Vec::new();
    for i in 0..width * rig.camera.height_px {
        let (column, row) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let (u, v) = projector.image(&camera.on_plane(column, row, 0.0));
        let in_cell = |cell: &Rect| {
            let (du, dv) = (u - cell.u0 as f64, v - cell.v0 as f64);
            du >= 0.0 && dv >= 0.0 && du < cell.width as f64 && dv < cell.height as f64
        };
        if layout.bits().iter().flat_map(|bit| &bit.panel).any(in_cell) {
            let pixel = v as usize * panel_width + u as usize;
            seen.push((i as u32, pixel as u32, camera.lens().ray(column, row).z.powi(8) as f32));
        }
    }
    seen
}
