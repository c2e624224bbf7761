//! What a rig's dimensions are worth: quantities of its chief rays over the zone.

use serde::Serialize;

use super::chief::Chief;
use super::dimensions::Dimensions;
use crate::optics::{Limits, Mirrors, Objective, Rig};

/// Chief rays over the zone, equally spaced in the radius on the convex mirror: extremes between are missed by less than 1%.
const RAYS: usize = 12;

/// The objectives of a rig; see [`Objective`] for each.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[allow(missing_docs)] // Each is documented where it is named.
pub struct Values {
    pub theta_min_deg: f64,
    pub theta_max_deg: f64,
    pub solid_coverage: f64,
    pub projected_coverage: f64,
    pub camera_px_per_deg: f64,
    pub projector_px_per_deg: f64,
    pub evenness: f64,
    pub holds_to_mm: f64,
    pub volume_l: f64,
    pub diameter_mm: f64,
    pub height_mm: f64,
    pub draft_deg: f64,
    pub shadow_deg: f64,
    pub dome_deg_per_mm: f64,
    pub paraboloid_deg_per_mm: f64,
    /// Radius (px) of the zone's image over that of the sensor and of the panel: at most 1 where it fits.
    pub filled: [f64; 2],
}

impl Values {
    /// Of a rig as it is.
    ///
    /// `None` if the zone is beyond what its mirrors show: no rig that was read.
    pub fn of(rig: &Rig) -> Option<Self> {
        let dimensions = Dimensions::of(rig);
        Self::over(&dimensions, &dimensions.mirrors()?)
    }

    /// Of dimensions whose mirrors are known. `None` if the zone is beyond what the mirrors show, or theta does not grow with
    /// the radius on the convex mirror.
    pub(super) fn over(dimensions: &Dimensions, mirrors: &Mirrors) -> Option<Self> {
        let [start, end] = dimensions.zone_deg.map(f64::to_radians);
        if !(start > 0.0 && start < end) {
            return None;
        }
        let (first, last) = (dimensions.radius_of(mirrors, start)?, dimensions.radius_of(mirrors, end)?);
        let dome_end = mirrors.profile(dimensions.radius_of(mirrors, dimensions.dome_end_deg.to_radians())?)?;
        let mut rays = [None; RAYS];
        for (i, ray) in rays.iter_mut().enumerate() {
            *ray = Some(Chief::new(mirrors, first + (last - first) * i as f64 / (RAYS - 1) as f64)?);
        }
        let rays = rays.map(|r| r.expect("all are set"));
        if rays.windows(2).any(|r| r[1].theta <= r[0].theta || r[1].slope <= r[0].slope) {
            return None;
        }
        let least = |of: fn(&Chief) -> f64| rays.iter().map(of).fold(f64::INFINITY, f64::min);
        let greatest = |of: fn(&Chief) -> f64| rays.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
        let slopes = [
            least(|r| r.slope_per_radian[0].min(r.slope_per_radian[1])),
            greatest(|r| r.slope_per_radian[0].max(r.slope_per_radian[1])),
        ];
        let per_degree = 1f64.to_radians();
        let (camera, projector) = (&dimensions.camera, &dimensions.projector);
        let margin = projector.pupil_mm * least(|r| r.footprint[0].min(r.footprint[1]))
            - camera.pupil_mm * greatest(|r| r.footprint[0].max(r.footprint[1]));
        let diameter_mm = 2.0 * greatest(|r| r.dome[0]).max(dome_end.x);
        let height_mm = mirrors.profile(1e-3 * first)?.z;
        let rms = |of: fn(&Chief) -> [f64; 2]| {
            let square = |r: &Chief| 0.5 * (of(r)[0].powi(2) + of(r)[1].powi(2));
            let strips =
                rays.windows(2).map(|r| (r[0].theta.cos() - r[1].theta.cos()) * 0.5 * (square(&r[0]) + square(&r[1])));
            (strips.sum::<f64>() / (start.cos() - end.cos())).sqrt().to_degrees()
        };
        Some(Self {
            theta_min_deg: dimensions.zone_deg[0],
            theta_max_deg: dimensions.zone_deg[1],
            solid_coverage: start.cos() - end.cos(),
            projected_coverage: start.cos().powi(2) - end.cos().powi(2),
            camera_px_per_deg: camera.focal_px() * slopes[0] * per_degree,
            projector_px_per_deg: projector.focal_px() * slopes[0] * per_degree,
            evenness: slopes[0] / slopes[1],
            holds_to_mm: margin / (start.tan() + end.tan()),
            volume_l: diameter_mm * diameter_mm * height_mm * 1e-6,
            diameter_mm,
            height_mm,
            draft_deg: least(|r| r.draft).to_degrees(),
            shadow_deg: mirrors.shadow(dimensions.edge_radius_mm).to_degrees(),
            dome_deg_per_mm: rms(|r| r.by_dome),
            paraboloid_deg_per_mm: rms(|r| r.by_convex),
            filled: [camera, projector].map(|d| d.focal_px() * rays[RAYS - 1].slope / d.half_side_px),
        })
    }

    /// The value of an objective.
    pub fn get(&self, objective: Objective) -> f64 {
        match objective {
            Objective::SolidCoverage => self.solid_coverage,
            Objective::ProjectedCoverage => self.projected_coverage,
            Objective::CameraPxPerDeg => self.camera_px_per_deg,
            Objective::ProjectorPxPerDeg => self.projector_px_per_deg,
            Objective::PxPerDeg => self.camera_px_per_deg.min(self.projector_px_per_deg),
            Objective::Evenness => self.evenness,
            Objective::HoldsToMm => self.holds_to_mm,
            Objective::VolumeL => self.volume_l,
            Objective::DiameterMm => self.diameter_mm,
            Objective::HeightMm => self.height_mm,
            Objective::DraftDeg => self.draft_deg,
            Objective::ShadowDeg => self.shadow_deg,
            Objective::DomeDegPerMm => self.dome_deg_per_mm,
            Objective::ParaboloidDegPerMm => self.paraboloid_deg_per_mm,
            Objective::ToleranceDegPerMm => self.dome_deg_per_mm.hypot(self.paraboloid_deg_per_mm),
        }
    }

    /// How far limits are exceeded: what of, and the excess relative to the limit (to 1 where that is 0). Not above 0 where it
    /// is kept; near 0 it binds.
    pub fn excesses(&self, limits: &Limits) -> Vec<(&'static str, f64)> {
        let mut all = Vec::with_capacity(9);
        self.for_each_excess(limits, |name, excess| all.push((name, excess)));
        all
    }

    pub(super) fn for_each_excess(&self, limits: &Limits, mut say: impl FnMut(&'static str, f64)) {
        let over = |value: f64, limit: f64| (value - limit) / if limit == 0.0 { 1.0 } else { limit };
        if let Some([width, depth, height]) = limits.box_mm {
            say("box_width", over(self.diameter_mm, width.min(depth)));
            say("box_height", over(self.height_mm, height));
        }
        for (&objective, &limit) in &limits.worst {
            let excess = over(self.get(objective), limit);
            say(objective.key(), if objective.more_is_better() { -excess } else { excess });
        }
        for always in [Objective::DraftDeg, Objective::HoldsToMm] {
            if !limits.worst.contains_key(&always) {
                say(always.key(), -self.get(always));
            }
        }
        say("sensor", self.filled[0] - 1.0);
        say("panel", self.filled[1] - 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Values {
        Values::of(&Rig::from_toml(text).unwrap()).unwrap()
    }

    const BUILT: &str = include_str!("../../optics/ghosh-2007-built.toml");
    const FULL: &str = include_str!("../../optics/ghosh-2007-full.toml");

    fn near(got: f64, want: f64, margin: f64) {
        assert!((got - want).abs() < margin, "{got} is not {want}");
    }

    /// As many digits as the derivation gives.
    #[test]
    fn objectives_of_the_thesis_rig() {
        let (built, full) = (of(BUILT), of(FULL));
        near(full.shadow_deg, 9.15, 0.005);
        near(full.diameter_mm / 25.4, 11.02, 0.02);
        near(built.height_mm, 220.1, 0.05);
        near(built.draft_deg, 8.1, 0.05);
        near(built.holds_to_mm, 0.2, 0.005);
        near(built.solid_coverage, 0.443, 5e-4);
        near(built.projected_coverage, 0.679, 5e-4);
        near(full.solid_coverage, 0.988, 1e-3);
        for v in [&built, &full] {
            near(v.camera_px_per_deg, 3.7, 0.05);
            near(v.projector_px_per_deg, 2.8, 0.05);
        }
        near(full.filled[0] * 512.0, 372.0, 0.5);
        near(full.filled[1] * 300.0, 281.0, 0.5);
        assert!(
            full.draft_deg < 0.0 && full.holds_to_mm < 0.0,
            "the whole dome is undercut, its footprints do not hold"
        );
    }

    /// Extremes and means of few rays against those of many.
    #[test]
    fn few_rays_tell_what_many_do() {
        let rig = Rig::from_toml(BUILT).unwrap();
        let values = Values::of(&rig).unwrap();
        let mirrors = rig.mirrors();
        let zone = rig.zone();
        let n = 4000;
        let rays: Vec<Chief> = (0..=n)
            .map(|i| zone.theta_min() + (zone.theta_max() - zone.theta_min()) * f64::from(i) / f64::from(n))
            .map(|theta| Chief::new(&mirrors, mirrors.rho_of(theta, mirrors.edge_radius()).unwrap()).unwrap())
            .collect();
        let least = rays.iter().flat_map(|r| r.slope_per_radian).fold(f64::INFINITY, f64::min);
        let greatest = rays.iter().flat_map(|r| r.slope_per_radian).fold(0.0, f64::max);
        near(values.evenness, least / greatest, 1e-3);
        let rms = |of: fn(&Chief) -> [f64; 2]| {
            let square = rays.iter().map(|r| 0.5 * (of(r)[0].powi(2) + of(r)[1].powi(2)) * r.theta.sin()).sum::<f64>();
            (square / rays.iter().map(|r| r.theta.sin()).sum::<f64>()).sqrt().to_degrees()
        };
        near(values.dome_deg_per_mm / rms(|r| r.by_dome), 1.0, 0.01);
        near(values.paraboloid_deg_per_mm / rms(|r| r.by_convex), 1.0, 0.01);
    }

    #[test]
    fn limits_say_which_way_they_bind() {
        let values = of(BUILT);
        let worst = [(Objective::DraftDeg, 9.0), (Objective::ShadowDeg, 8.0), (Objective::Evenness, 0.5)].into();
        let limits = Limits { box_mm: Some([300.0, 270.0, 254.0]), worst };
        let excess = |name| values.excesses(&limits).into_iter().find(|e| e.0 == name).unwrap().1;
        assert!(excess("draft_deg") > 0.0 && excess("shadow_deg") > 0.0 && excess("box_width") > 0.0);
        assert!(excess("evenness") < 0.0 && excess("box_height") < 0.0 && excess("sensor") < 0.0);
        assert!(excess("holds_to_mm") < 0.0, "asked for without being named");
    }

    /// An untrimmed thesis rig wastes coverage on a shadow its dome does not need; the opening is as derived.
    #[test]
    fn trimming_follows_the_derivation() {
        let mut full = Dimensions::of(&Rig::from_toml(FULL).unwrap());
        let mirrors = full.mirrors().unwrap();
        full.dome_end_deg = 90.0;
        full.camera.pupil_mm = 0.0;
        full.projector.pupil_mm = 0.0;
        let opening = |pupil_mm: f64| {
            let mut d = full;
            d.projector.pupil_mm = pupil_mm;
            d.trimmed(&mirrors).unwrap().opening_mm[0]
        };
        near(opening(0.0), 11.7, 0.05);
        near(opening(10.0) - opening(0.0), 3.65, 0.03);
        let built = Rig::from_toml(BUILT).unwrap();
        let dimensions = Dimensions::of(&built);
        let trimmed = dimensions.trimmed(&mirrors).unwrap();
        assert!(trimmed.zone_deg[0] < 5.5 && trimmed.edge_radius_mm < 11.5, "{trimmed:?}");
        let rig = trimmed.to_rig(&built);
        assert_eq!(Rig::from_toml(&rig.to_toml()).unwrap(), rig);
    }
}
