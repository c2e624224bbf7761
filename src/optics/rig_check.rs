//! Whether what a rig file says can work.

use super::rig::FORMAT;
use super::{Mirrors, Rig, RigError, SearchTable};
use crate::geometry::Zone;

/// Beyond any rig, within what times and images can be computed from.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 1e-6..=1e9;

impl Rig {
    /// Whether a rig with these numbers can work.
    pub(super) fn check(&self) -> Result<(), RigError> {
        if self.format > FORMAT {
            return Err(RigError::Format { found: self.format });
        }
        let (c, p) = (&self.camera, &self.projector);
        let positive = [
            ("centre_height_mm", self.centre_height_mm),
            ("paraboloid.focal_length_mm", self.paraboloid.focal_length_mm),
            ("paraboloid.vertex_height_mm", self.paraboloid.vertex_height_mm),
            ("dome.rim_radius_mm", self.dome.rim_radius_mm),
            ("camera.focal_length_mm", c.focal_length_mm),
            ("camera.f_number", c.f_number),
            ("camera.pitch_um", c.pitch_um),
            ("camera.gain_dn_per_e", c.gain_dn_per_e),
            ("camera.dark_noise_e", c.dark_noise_e),
            ("camera.full_well_e", c.full_well_e),
            ("camera.linear_limit_dn", c.linear_limit_dn),
            ("camera.max_frame_rate_hz", c.max_frame_rate_hz),
            ("projector.focal_length_mm", p.focal_length_mm),
            ("projector.f_number", p.f_number),
            ("projector.pitch_um", p.pitch_um),
            ("projector.refresh_hz", p.refresh_hz),
            ("alignment.wire_width_mm", self.alignment.wire_width_mm),
            ("alignment.line_width_mm", self.alignment.line_width_mm),
            ("alignment.opening_radius_mm", self.alignment.opening_radius_mm),
        ];
        for (key, value) in positive {
            if !PLAUSIBLE.contains(&value) {
                return Err(RigError::Range { key, value, expected: "a positive number, 1e-6..=1e9" });
            }
        }
        let within = |key, value: f64, lo: f64, hi: f64, expected| {
            if value >= lo && value <= hi { Ok(()) } else { Err(RigError::Range { key, value, expected }) }
        };
        within("camera.readout_s", c.readout_s, 0.0, 10.0, "0..=10 s")?;
        within("camera.bits", f64::from(c.bits), 8.0, 16.0, "8..=16 bits")?;
        let top = f64::from((1u32 << c.bits) - 1);
        within("camera.black_level_dn", c.black_level_dn, 0.0, top, "0..=2^bits - 1")?;
        within(
            "camera.linear_limit_dn",
            c.linear_limit_dn,
            c.black_level_dn + 1.0,
            top,
            "above black, at most 2^bits - 1",
        )?;
        let full = c.black_level_dn + c.gain_dn_per_e * c.full_well_e;
        within("camera.full_well_e (in DN)", full, c.linear_limit_dn, 1e12, "at least camera.linear_limit_dn")?;
        for (key, value) in [
            ("camera.width_px", c.width_px),
            ("camera.height_px", c.height_px),
            ("projector.width_px", p.width_px),
            ("projector.height_px", p.height_px),
        ] {
            within(key, value as f64, 16.0, 16384.0, "16..=16384 pixels")?;
        }
        for (key, value) in [("camera.f_number", c.f_number), ("projector.f_number", p.f_number)] {
            within(key, value, 0.5, 1e3, "0.5..=1000: no lens in air is faster")?;
        }
        within("camera.focus_mm", c.focus_mm, c.focal_length_mm * 1.001, 1e9, "farther than the focal length")?;
        within("projector.focus_mm", p.focus_mm, p.focal_length_mm * 1.001, 1e9, "farther than the focal length")?;
        if let Some(mount) = &self.mount {
            within("mount.radius_mm", mount.radius_mm, 1e-3, self.dome.rim_radius_mm, "0.001..=dome.rim_radius_mm")?;
            within("mount.height_mm", mount.height_mm, 1e-3, self.paraboloid.vertex_height_mm, "below the vertex")?;
        }
        for (key, value) in self.tolerances.entries() {
            within(key, value, 0.0, 10.0, "a standard deviation in 0..=10, in [tolerances]")?;
        }
        let coatings = &self.coatings;
        for (key, value) in [("coatings.mirror_n", coatings.mirror_n), ("coatings.mirror_k", coatings.mirror_k)] {
            within(key, value, 0.0, 100.0, "0..=100")?;
        }
        let (t, r) = (coatings.splitter_transmitted, coatings.splitter_reflected);
        within("coatings.splitter_transmitted", t, 1e-3, 1.0, "0.001..=1")?;
        within("coatings.splitter_reflected", r, 1e-3, 1.001 - t, "0.001..=1, no more than is not transmitted")?;
        let a = &self.alignment;
        within("alignment.screen_height_mm", a.screen_height_mm, -1e3, a.wire_height_mm - 1.0, "1 mm below the wires")?;
        within("alignment.wire_height_mm", a.wire_height_mm, -1e3, self.centre_height_mm - 1.0, "below the lenses")?;
        within("dome.theta_max_deg", self.dome.theta_max_deg, 1.0, 90.0, "1..=90 degrees")?;
        within("zone.theta_max_deg", self.zone.theta_max_deg, -1e9, 90.0, "at most 90 degrees")?;
        let zone = Zone::from_degrees(self.zone.theta_min_deg, self.zone.theta_max_deg)?;
        let mirrors = self.try_mirrors().ok_or(RigError::MissesDome {
            rim_radius_mm: self.dome.rim_radius_mm,
            vertex_height_mm: self.paraboloid.vertex_height_mm,
            focal_length_mm: self.paraboloid.focal_length_mm,
        })?;
        self.check_reach(&zone, &mirrors)?;
        self.search.as_ref().map_or(Ok(()), SearchTable::check)
    }

    fn check_reach(&self, zone: &Zone, mirrors: &Mirrors) -> Result<(), RigError> {
        if let Some(value) = self.paraboloid.edge_radius_mm
            && !(value > 0.0 && value.is_finite())
        {
            return Err(RigError::Range { key: "paraboloid.edge_radius_mm", value, expected: "a positive number" });
        }
        let edge = self.paraboloid_radius_mm();
        let shadow = mirrors.shadow(edge);
        if zone.theta_min() < shadow - 1e-9 {
            return Err(RigError::Shadow { theta_min_deg: self.zone.theta_min_deg, shadow_deg: shadow.to_degrees() });
        }
        let reach = mirrors.profile(edge).map_or(0.0, |p| p.x.atan2(p.z)).min(self.dome.theta_max_deg.to_radians());
        if zone.theta_max() > reach + 1e-9 {
            return Err(RigError::Unreached { theta_max_deg: self.zone.theta_max_deg, reach_deg: reach.to_degrees() });
        }
        let panels = [
            ("camera", self.camera_map(), self.camera.width_px.min(self.camera.height_px)),
            ("projector", self.projector_map(), self.projector.width_px.min(self.projector.height_px)),
        ];
        for (device, map, side) in panels {
            let radius_px = map.radius_px(zone.theta_max()).unwrap_or(f64::INFINITY);
            let available_px = side as f64 / 2.0;
            if radius_px > available_px {
                return Err(RigError::OffPanel { device, radius_px, available_px });
            }
        }
        Ok(())
    }
}
