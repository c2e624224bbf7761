//! What a search for better dimensions of a rig may change, what it must keep to and what it is after: `[search]` of a rig file.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::RigError;

/// What is told of a rig's design. As keys in files, snake case with the unit: `projected_coverage`, `volume_l`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Objective {
    /// Share of the hemisphere's solid angle that lies in the zone, 0 to 1.
    SolidCoverage,
    /// Share of the hemisphere's projected solid angle (weighted by the cosine) that lies in the zone, 0 to 1.
    ProjectedCoverage,
    /// Least pixels of the camera per degree at the sample, along and across the meridian.
    CameraPxPerDeg,
    /// The same of the projector.
    ProjectorPxPerDeg,
    /// The lesser of both.
    PxPerDeg,
    /// Least over greatest pixels per degree, 0 to 1.
    Evenness,
    /// Error of the sample's height (mm) up to which every footprint of the camera lies in all of the projector's.
    HoldsToMm,
    /// Volume of the box around dome and sample, litres.
    VolumeL,
    /// Greatest diameter of the dome as built, mm.
    DiameterMm,
    /// Height of the dome's top above the sample, mm.
    HeightMm,
    /// Least angle between the dome's meridian and its axis over the zone, degrees: negative where it is undercut.
    DraftDeg,
    /// Polar angle at which the convex mirror's shadow ends, degrees.
    ShadowDeg,
    /// RMS change of direction over the zone for a decentre of the dome, degrees per mm.
    DomeDegPerMm,
    /// The same for a decentre of the convex mirror.
    ParaboloidDegPerMm,
    /// Root of the sum of both squares: each mirror is off by 1 mm on its own.
    ToleranceDegPerMm,
}

impl Objective {
    /// All of them.
    pub const ALL: [Self; 15] = [
        Self::SolidCoverage,
        Self::ProjectedCoverage,
        Self::CameraPxPerDeg,
        Self::ProjectorPxPerDeg,
        Self::PxPerDeg,
        Self::Evenness,
        Self::HoldsToMm,
        Self::VolumeL,
        Self::DiameterMm,
        Self::HeightMm,
        Self::DraftDeg,
        Self::ShadowDeg,
        Self::DomeDegPerMm,
        Self::ParaboloidDegPerMm,
        Self::ToleranceDegPerMm,
    ];

    /// Its key in files.
    pub fn key(self) -> &'static str {
        match self {
            Self::SolidCoverage => "solid_coverage",
            Self::ProjectedCoverage => "projected_coverage",
            Self::CameraPxPerDeg => "camera_px_per_deg",
            Self::ProjectorPxPerDeg => "projector_px_per_deg",
            Self::PxPerDeg => "px_per_deg",
            Self::Evenness => "evenness",
            Self::HoldsToMm => "holds_to_mm",
            Self::VolumeL => "volume_l",
            Self::DiameterMm => "diameter_mm",
            Self::HeightMm => "height_mm",
            Self::DraftDeg => "draft_deg",
            Self::ShadowDeg => "shadow_deg",
            Self::DomeDegPerMm => "dome_deg_per_mm",
            Self::ParaboloidDegPerMm => "paraboloid_deg_per_mm",
            Self::ToleranceDegPerMm => "tolerance_deg_per_mm",
        }
    }

    /// Whether more of it is better.
    pub fn more_is_better(self) -> bool {
        use Objective::{
            DiameterMm, DomeDegPerMm, HeightMm, ParaboloidDegPerMm, ShadowDeg, ToleranceDegPerMm, VolumeL,
        };
        !matches!(
            self,
            VolumeL | DiameterMm | HeightMm | ShadowDeg | DomeDegPerMm | ParaboloidDegPerMm | ToleranceDegPerMm
        )
    }
}

/// A dimension that a search may change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parameter {
    /// Height of the centre of projection; the devices' focus moves with it.
    CentreHeight,
    /// Focal length of the convex mirror.
    ConvexFocalLength,
    /// Height of its vertex; the devices' focus moves with it.
    VertexHeight,
    /// Its conic constant.
    Conic,
    /// Radius of the dome's rim in the sample's plane.
    RimRadius,
    /// End of the zone; the dome ends as far beyond as it does in the rig searched from.
    ZoneEnd,
    /// Focal length of the camera's lens, its pupil kept.
    CameraFocalLength,
    /// Focal length of the projector's lens, its pupil kept.
    ProjectorFocalLength,
}

/// `[search]`: tables of what is free, what is kept to and what counts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SearchTable {
    /// What the front is over: two to five objectives.
    #[serde(default = "usual")]
    pub objectives: Vec<Objective>,
    /// The reference point of the hypervolume: worse than the rig itself in each objective.
    pub reference: BTreeMap<Objective, f64>,
    /// Bounds of what may change.
    pub free: Free,
    /// What every rig found keeps to.
    #[serde(default, skip_serializing_if = "Limits::is_default")]
    pub limits: Limits,
}

fn usual() -> Vec<Objective> {
    vec![Objective::ProjectedCoverage, Objective::VolumeL, Objective::ToleranceDegPerMm, Objective::PxPerDeg]
}

/// `[search.free]`: lower and upper bound of each dimension that may change, under the key it has in the rig file.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Free {
    /// Of [`Parameter::CentreHeight`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub centre_height_mm: Option<[f64; 2]>,
    /// Of the convex mirror.
    #[serde(skip_serializing_if = "is_default")]
    pub paraboloid: FreeParaboloid,
    /// Of the dome.
    #[serde(skip_serializing_if = "is_default")]
    pub dome: FreeDome,
    /// Of the zone.
    #[serde(skip_serializing_if = "is_default")]
    pub zone: FreeZone,
    /// Of the camera.
    #[serde(skip_serializing_if = "is_default")]
    pub camera: FreeLens,
    /// Of the projector.
    #[serde(skip_serializing_if = "is_default")]
    pub projector: FreeLens,
}

/// Bounds of the convex mirror's dimensions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FreeParaboloid {
    /// Of [`Parameter::ConvexFocalLength`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal_length_mm: Option<[f64; 2]>,
    /// Of [`Parameter::VertexHeight`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vertex_height_mm: Option<[f64; 2]>,
    /// Of [`Parameter::Conic`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub conic: Option<[f64; 2]>,
}

/// Bounds of the dome's dimensions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FreeDome {
    /// Of [`Parameter::RimRadius`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rim_radius_mm: Option<[f64; 2]>,
}

/// Bounds of the zone's end.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FreeZone {
    /// Of [`Parameter::ZoneEnd`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub theta_max_deg: Option<[f64; 2]>,
}

/// Bounds of a lens.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FreeLens {
    /// Of its focal length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal_length_mm: Option<[f64; 2]>,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// `[search.limits]`. What is left out does not bind; sensor, panel, footprints that lie in each other and a dome that is not
/// undercut always do.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Limits {
    /// Width, depth and height that the dome, down to the sample's plane, fits in.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub box_mm: Option<[f64; 3]>,
    /// The worst allowed of any objective: `draft_deg = 8.0` is the least draft, `shadow_deg = 9.0` the greatest shadow.
    #[serde(flatten)]
    pub worst: BTreeMap<Objective, f64>,
}

impl Limits {
    fn is_default(&self) -> bool {
        is_default(self)
    }
}

impl SearchTable {
    /// What is free, under its full key, with its bounds.
    pub fn free(&self) -> Vec<(Parameter, &'static str, [f64; 2])> {
        let f = &self.free;
        let all = [
            (Parameter::CentreHeight, "search.free.centre_height_mm", f.centre_height_mm),
            (Parameter::ConvexFocalLength, "search.free.paraboloid.focal_length_mm", f.paraboloid.focal_length_mm),
            (Parameter::VertexHeight, "search.free.paraboloid.vertex_height_mm", f.paraboloid.vertex_height_mm),
            (Parameter::Conic, "search.free.paraboloid.conic", f.paraboloid.conic),
            (Parameter::RimRadius, "search.free.dome.rim_radius_mm", f.dome.rim_radius_mm),
            (Parameter::ZoneEnd, "search.free.zone.theta_max_deg", f.zone.theta_max_deg),
            (Parameter::CameraFocalLength, "search.free.camera.focal_length_mm", f.camera.focal_length_mm),
            (Parameter::ProjectorFocalLength, "search.free.projector.focal_length_mm", f.projector.focal_length_mm),
        ];
        all.into_iter().filter_map(|(p, key, bounds)| Some((p, key, bounds?))).collect()
    }

    /// Whether bounds and limits are numbers that can be searched between.
    ///
    /// # Errors
    /// [`RigError::Range`] with key, value and remedy.
    pub(super) fn check(&self) -> Result<(), RigError> {
        let error = |key, value, expected| Err(RigError::Range { key, value, expected });
        for (parameter, key, [lo, hi]) in self.free() {
            let least = if parameter == Parameter::Conic { -1e3 } else { 1e-3 };
            if !(least..=1e4).contains(&lo) {
                return error(key, lo, "a lower bound of 0.001..=10000 (a conic constant: from -1000)");
            }
            if !(hi > lo && hi <= 1e4) {
                return error(key, hi, "an upper bound above the lower one, at most 10000");
            }
        }
        if let Some([_, hi]) = self.free.zone.theta_max_deg
            && hi > 89.5
        {
            return error("search.free.zone.theta_max_deg", hi, "an upper bound of at most 89.5 degrees");
        }
        let l = &self.limits;
        if let Some(side) = l.box_mm.into_iter().flatten().find(|s| !(*s > 0.0 && s.is_finite())) {
            return error("search.limits.box_mm", side, "three lengths above 0");
        }
        if let Some(value) = l.worst.values().find(|v| !(v.is_finite() && **v >= 0.0)) {
            return error("search.limits", *value, "limits that are finite and not below 0");
        }
        if let Some(value) = self.reference.values().find(|v| !v.is_finite()) {
            return error("search.reference", *value, "finite numbers");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::Rig;
    use super::*;

    const RIG: &str = include_str!("../../optics/ghosh-2007-search.toml");

    #[test]
    fn tables_survive_a_round_trip_and_rigs_without_one_stay_as_they_are() {
        let rig = Rig::from_toml(RIG).unwrap();
        assert_eq!(Rig::from_toml(&rig.to_toml()).unwrap(), rig);
        assert_eq!(rig.search.as_ref().unwrap().free().len(), 6);
        let plain = Rig { search: None, ..rig };
        assert!(!plain.to_toml().contains("search"));
    }

    #[test]
    fn each_wrong_key_or_number_is_named() {
        let cases = [
            ("box_mm", "box_in", "box_in"),
            ("draft_deg = 8.12", "draft = 8.12", "draft"),
            ("draft_deg = 8.12", "draft_deg = -1.0", "search.limits = -1.0"),
            ("[279.4, 279.4, 254.0]", "[279.4, 0.0, 254.0]", "search.limits.box_mm = 0.0"),
            ("projected_coverage = 0.60", "coverage = 0.60", "coverage"),
            ("projected_coverage = 0.60", "projected_coverage = nan", "search.reference"),
            ("dome.rim_radius_mm = [90.0, 140.0]", "dome.radius_mm = [90.0, 140.0]", "radius_mm"),
            ("rim_radius_mm = [90.0, 140.0]", "rim_radius_mm = [140.0, 90.0]", "search.free.dome.rim_radius_mm = 90.0"),
            ("rim_radius_mm = [90.0, 140.0]", "rim_radius_mm = [-1.0, 90.0]", "search.free.dome.rim_radius_mm = -1.0"),
            ("theta_max_deg = [45.0, 75.0]", "theta_max_deg = [45.0, 95.0]", "search.free.zone.theta_max_deg = 95.0"),
        ];
        for (from, to, word) in cases {
            let text = RIG.replacen(from, to, 1);
            assert_ne!(text, RIG, "{from}");
            let error = Rig::from_toml(&text).unwrap_err().to_string();
            assert!(error.contains(word), "{to}: {error}");
        }
    }

    #[test]
    fn keys_are_those_of_files() {
        for objective in Objective::ALL {
            assert_eq!(serde_json::to_value(objective).unwrap(), objective.key());
        }
    }
}
