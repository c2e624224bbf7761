//! What a rig will measure: over polar angles, and what limits it.

use std::f64::consts::{FRAC_PI_2, PI};

use serde::Serialize;
use thiserror::Error;

use crate::optics::{Beam, Device, Misaligned, Misalignment, Rig};

/// Why a rig could not be surveyed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SurveyError {
    /// Rays of a pupil miss a mirror.
    #[error(
        "at {theta_deg:.2} deg rays of the {device}'s pupil (radius {pupil_mm:.2} mm) miss a mirror: raise its f_number or end \
         the zone before"
    )]
    Misses {
        /// Polar angle.
        theta_deg: f64,
        /// `camera` or `projector`.
        device: &'static str,
        /// Radius of its pupil, mm.
        pupil_mm: f64,
    },
    /// The dome does not reach the zone.
    #[error("no ray shows the polar angle {theta_deg:.2} deg: lower zone.theta_max_deg")]
    Unreached {
        /// Polar angle.
        theta_deg: f64,
    },
}

/// One device at one polar angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct View {
    /// Pixels per degree along the meridian and across it.
    pub px_per_deg: [f64; 2],
    /// RMS angle between the pupil's rays and their mean, degrees.
    pub blur_deg: f64,
    /// Angle between the mean of the pupil's rays and the chief ray, degrees.
    pub shift_deg: f64,
    /// Semi-axes of the footprint on the sample, along the meridian and across it, mm.
    pub footprint_mm: [f64; 2],
    /// Share of the pupil whose rays find nothing in their way.
    pub transmitted: f64,
}

/// A rig at one polar angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Angle {
    /// Polar angle.
    pub theta_deg: f64,
    /// The dome's point: distance from the axis.
    pub r_mm: f64,
    /// The dome's point: height.
    pub z_mm: f64,
    /// Angle between the dome's meridian and the axis: negative where a mandrel is undercut.
    pub draft_deg: f64,
    /// Angle of incidence on the convex mirror.
    pub incidence_convex_deg: f64,
    /// Angle of incidence on the dome.
    pub incidence_dome_deg: f64,
    /// The camera.
    pub camera: View,
    /// The projector.
    pub projector: View,
    /// Share of unpolarised light that both mirrors reflect.
    pub mirrors: f64,
    /// Degree of polarisation that both mirrors give to unpolarised light.
    pub polarisation: f64,
}

/// The share of the camera's footprint that the projector lights.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pair {
    /// Of the light.
    pub theta_i_deg: f64,
    /// Of the camera.
    pub theta_o_deg: f64,
    /// Least over azimuths.
    pub lit_share: f64,
}

/// Something that ends the zone.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Limit {
    /// What.
    pub name: &'static str,
    /// Which end of the zone: `inner` or `outer`.
    pub end: &'static str,
    /// Where.
    pub theta_deg: f64,
    /// Whether it is the one that ends the zone there.
    pub binds: bool,
}

/// A rig, surveyed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Survey {
    /// Where the zone could begin and end: the tightest limits.
    pub theta_min_deg: f64,
    /// See `theta_min_deg`.
    pub theta_max_deg: f64,
    /// The zone the rig file asks for.
    pub zone_deg: [f64; 2],
    /// End of the convex mirror's shadow.
    pub shadow_deg: f64,
    /// Polar angle of the dome's widest point; none if it widens down to its end.
    pub undercut_deg: Option<f64>,
    /// Draft at the zone's end; negative beyond the widest point.
    pub draft_deg: f64,
    /// Greatest diameter of the dome as made.
    pub diameter_mm: f64,
    /// Height of the dome's opening above the sample, from which the box is measured.
    pub height_mm: f64,
    /// Radius of the opening that the zone's light needs at that height, both pupils counted.
    pub opening_mm: f64,
    /// Solid angle of the zone over the hemisphere's.
    pub coverage: f64,
    /// The same with cosines.
    pub projected_coverage: f64,
    /// Least of camera and projector over the zone.
    pub min_px_per_deg: f64,
    /// Of the camera.
    pub camera_min_px_per_deg: f64,
    /// Of the projector.
    pub projector_min_px_per_deg: f64,
    /// By how much the least semi-axis of the projector's footprints exceeds the greatest of the camera's.
    pub footprint_margin_mm: f64,
    /// Height error of the sample up to which all that the camera sees stays lit; 0 if it is not at height 0.
    pub height_tolerance_mm: f64,
    /// Polar angle up to which the footprint condition holds for a sample in its place.
    pub footprint_up_to_deg: f64,
    /// Largest relative error that polarisation can make: of a sample that turns all that reaches it.
    pub polarisation_bound: f64,
    /// Share of the projector's light that passes splitter and mirrors twice, least over the zone.
    pub transmission: f64,
    /// What ends the zone.
    pub limits: Vec<Limit>,
    /// Over polar angles.
    pub angles: Vec<Angle>,
    /// Over pairs of polar angles.
    pub pairs: Vec<Pair>,
}

/// Azimuths between light and camera that are tried.
const AZIMUTHS: usize = 5;
/// Polar angles of the pairs.
const PAIRED: usize = 7;
/// A pupil cannot be followed to the very horizon.
const LAST_DEG: f64 = 89.0;
/// Pixels per degree that a pattern wants at the least.
const LEAST_PX_PER_DEG: f64 = 1.0;

impl Survey {
    /// Surveys a rig at steps of `step_deg` in the polar angle.
    ///
    /// # Errors
    /// [`SurveyError`].
    pub fn new(rig: &Rig, step_deg: f64) -> Result<Self, SurveyError> {
        let mirrors = rig.mirrors();
        let zone = rig.zone();
        let (begin, end) = (zone.theta_min().to_degrees(), zone.theta_max().to_degrees());
        // Whole steps from 0 on, and both ends.
        let between = (1..)
            .map(|i| f64::from(i) * step_deg)
            .skip_while(|a| *a <= begin + 1e-9)
            .take_while(|a| *a < end.min(LAST_DEG) - 1e-9);
        let at: Vec<f64> = [begin].into_iter().chain(between).chain([end.min(LAST_DEG)]).collect();
        let steps = at.len() - 1;
        let devices = [Device::Camera, Device::Projector].map(|d| Misaligned::new(rig, &Misalignment::none(), d));
        let angles: Vec<Angle> =
            at.into_iter().map(|theta_deg| angle(rig, &devices, theta_deg)).collect::<Result<_, _>>()?;
        let least = |of: fn(&Angle) -> [f64; 2]| angles.iter().flat_map(of).fold(f64::INFINITY, f64::min);
        let camera_min_px_per_deg = least(|a| a.camera.px_per_deg);
        let projector_min_px_per_deg = least(|a| a.projector.px_per_deg);
        let (margin, up_to) = footprints(&angles);
        let tangents = angles[0].theta_deg.to_radians().tan() + angles[steps].theta_deg.to_radians().tan();
        let shadow_deg = mirrors.shadow(rig.paraboloid_radius_mm()).to_degrees();
        let undercut = mirrors.undercut();
        let limits = limits(rig, &angles, shadow_deg, undercut.map(|p| p.theta.to_degrees()), up_to);
        let bound = |inner: bool| {
            limits.iter().find(|l| l.binds && (l.end == "inner") == inner).map_or(f64::NAN, |l| l.theta_deg)
        };
        let dome_end = rig.dome.theta_max_deg.to_radians();
        let last = mirrors.rho_of(dome_end, mirrors.edge_radius()).and_then(|rho| mirrors.profile(rho));
        let widest = undercut.filter(|p| p.theta < dome_end).map(|p| p.r);
        let [opening_mm, height_mm] = opening(rig);
        let (polarisation, transmission) = coatings(rig, &angles);
        Ok(Self {
            theta_min_deg: bound(true),
            theta_max_deg: bound(false),
            zone_deg: [begin, end],
            shadow_deg,
            undercut_deg: undercut.map(|p| p.theta.to_degrees()),
            draft_deg: angles[steps].draft_deg,
            diameter_mm: 2.0 * widest.or(last.map(|p| p.x)).unwrap_or(f64::NAN),
            height_mm,
            opening_mm,
            coverage: zone.solid_angle() / (2.0 * PI),
            projected_coverage: zone.projected_solid_angle() / PI,
            min_px_per_deg: camera_min_px_per_deg.min(projector_min_px_per_deg),
            camera_min_px_per_deg,
            projector_min_px_per_deg,
            footprint_margin_mm: margin,
            height_tolerance_mm: (margin / tangents).max(0.0),
            footprint_up_to_deg: up_to,
            polarisation_bound: polarisation,
            transmission,
            pairs: pairs(rig, &devices)?,
            limits,
            angles,
        })
    }
}

fn view(device: &Misaligned, name: &'static str, pupil_mm: f64, theta_deg: f64) -> Result<View, SurveyError> {
    let unreached = || SurveyError::Unreached { theta_deg };
    let theta = theta_deg.to_radians();
    let off = 1e-4;
    let radius = |theta: f64| {
        let (u, v) = device.nominal_image(theta)?;
        Some((u - device.lens().centre_u).hypot(v - device.lens().centre_v))
    };
    let (u, v) = device.nominal_image(theta).ok_or_else(unreached)?;
    let inner = radius(theta - off).ok_or_else(unreached)?;
    let here = radius(theta).ok_or_else(unreached)?;
    let beam = Beam::new(device, u, v, pupil_mm).ok_or(SurveyError::Misses { theta_deg, device: name, pupil_mm })?;
    let per_deg = 1f64.to_radians();
    Ok(View {
        px_per_deg: [(here - inner) / off * per_deg, here / theta.sin() * per_deg],
        blur_deg: beam.spread.to_degrees(),
        shift_deg: beam.shift.to_degrees(),
        footprint_mm: beam.semi_axes_mm,
        transmitted: beam.transmitted,
    })
}

fn angle(rig: &Rig, devices: &[Misaligned; 2], theta_deg: f64) -> Result<Angle, SurveyError> {
    let mirrors = rig.mirrors();
    let point = mirrors.rho_of(theta_deg.to_radians(), mirrors.edge_radius());
    let point = point.and_then(|rho| mirrors.profile_point(rho)).ok_or(SurveyError::Unreached { theta_deg })?;
    let convex = rig.coatings.reflectance(point.incidence_convex);
    let dome = rig.coatings.reflectance(point.incidence_dome);
    let (across, along) = (convex[0] * dome[0], convex[1] * dome[1]);
    Ok(Angle {
        theta_deg,
        r_mm: point.r,
        z_mm: point.z,
        draft_deg: point.draft().to_degrees(),
        incidence_convex_deg: point.incidence_convex.to_degrees(),
        incidence_dome_deg: point.incidence_dome.to_degrees(),
        camera: view(&devices[0], "camera", rig.camera.pupil_mm(), theta_deg)?,
        projector: view(&devices[1], "projector", rig.projector.pupil_mm(), theta_deg)?,
        mirrors: 0.5 * (across + along),
        polarisation: (across - along).abs() / (across + along),
    })
}

/// Margin of the footprint condition over all angles, and the angle up to which it is positive.
fn footprints(angles: &[Angle]) -> (f64, f64) {
    let (mut least, mut greatest, mut up_to) = (f64::INFINITY, 0.0f64, f64::NAN);
    for a in angles {
        least = a.projector.footprint_mm.into_iter().fold(least, f64::min);
        greatest = a.camera.footprint_mm.into_iter().fold(greatest, f64::max);
        if least >= greatest {
            up_to = a.theta_deg;
        }
    }
    (least - greatest, up_to)
}

fn pairs(rig: &Rig, devices: &[Misaligned; 2]) -> Result<Vec<Pair>, SurveyError> {
    let zone = rig.zone();
    let theta = |i: usize| {
        let t = i as f64 / (PAIRED - 1) as f64;
        (zone.theta_min() + t * (zone.theta_max() - zone.theta_min())).min(LAST_DEG.to_radians())
    };
    let beam = |device: usize, theta: f64, phi: f64| {
        let (name, pupil_mm) = [("camera", rig.camera.pupil_mm()), ("projector", rig.projector.pupil_mm())][device];
        let theta_deg = theta.to_degrees();
        let lens = devices[device].lens();
        let (u, v) = devices[device].nominal_image(theta).ok_or(SurveyError::Unreached { theta_deg })?;
        // Turned about the image's centre; the reflected arm's handedness does not matter over a half circle.
        let radius = (u - lens.centre_u).hypot(v - lens.centre_v);
        let (u, v) = (lens.centre_u + radius * phi.cos(), lens.centre_v + radius * phi.sin());
        Beam::new(&devices[device], u, v, pupil_mm).ok_or(SurveyError::Misses { theta_deg, device: name, pupil_mm })
    };
    let mut pairs = Vec::new();
    let cameras: Vec<Beam> = (0..PAIRED).map(|o| beam(0, theta(o), 0.0)).collect::<Result<_, _>>()?;
    for i in 0..PAIRED {
        let lights: Vec<Beam> = (0..AZIMUTHS)
            .map(|a| beam(1, theta(i), a as f64 / (AZIMUTHS - 1) as f64 * PI))
            .collect::<Result<_, _>>()?;
        for (o, camera) in cameras.iter().enumerate() {
            let lit_share = lights.iter().map(|light| light.lit_share(camera)).fold(1.0, f64::min);
            pairs.push(Pair { theta_i_deg: theta(i).to_degrees(), theta_o_deg: theta(o).to_degrees(), lit_share });
        }
    }
    Ok(pairs)
}

fn limits(rig: &Rig, angles: &[Angle], shadow_deg: f64, undercut_deg: Option<f64>, footprint_deg: f64) -> Vec<Limit> {
    let mirrors = rig.mirrors();
    let mut limits: Vec<Limit> = Vec::new();
    let mut add = |name, end, theta_deg: f64| {
        if theta_deg.is_finite() {
            limits.push(Limit { name, end, theta_deg, binds: false });
        }
    };
    add("shadow of the paraboloid", "inner", shadow_deg);
    // A spot of finite size sees the edge over a range of angles: the camera's footprint, at the edge's height.
    let edge = rig.paraboloid_radius_mm();
    let spot = angles[0].camera.footprint_mm[0];
    add("shadow for the whole footprint", "inner", ((edge + spot) / mirrors.convex().height(edge)).atan().to_degrees());
    if let Some(mount) = &rig.mount {
        add("shadow of the mount", "inner", (mount.radius_mm / mount.height_mm).atan().to_degrees());
    }
    let reach = mirrors.profile(edge).map_or(f64::NAN, |p| p.x.atan2(p.z).to_degrees());
    add("edge of the paraboloid", "outer", reach.min(90.0));
    add("end of the dome", "outer", rig.dome.theta_max_deg);
    if let Some(theta_deg) = undercut_deg {
        add("undercut of the mandrel", "outer", theta_deg);
    }
    let devices = [
        ("camera sensor", &rig.camera_map(), rig.camera.width_px.min(rig.camera.height_px)),
        ("projector panel", &rig.projector_map(), rig.projector.width_px.min(rig.projector.height_px)),
    ];
    for (name, map, side) in devices {
        let fits = |theta: f64| map.radius_px(theta).is_some_and(|r| r <= side as f64 / 2.0);
        let (mut lo, mut hi) = (rig.zone().theta_min(), FRAC_PI_2.min(rig.dome.theta_max_deg.to_radians()));
        if fits(hi) {
            continue;
        }
        for _ in 0..40 {
            let middle = 0.5 * (lo + hi);
            if fits(middle) { lo = middle } else { hi = middle }
        }
        add(name, "outer", lo.to_degrees());
    }
    if let Some(a) = angles.iter().find(|a| {
        let all = a.camera.px_per_deg.into_iter().chain(a.projector.px_per_deg);
        all.fold(f64::INFINITY, f64::min) < LEAST_PX_PER_DEG
    }) {
        add("fewer than 1 px/deg", "outer", a.theta_deg);
    }
    if footprint_deg < angles[angles.len() - 1].theta_deg {
        add("footprint condition", "outer", footprint_deg);
    }
    for (end, sign) in [("inner", 1.0), ("outer", -1.0)] {
        let of = limits.iter_mut().filter(|l| l.end == end);
        if let Some(tightest) = of.max_by(|a, b| (sign * a.theta_deg).total_cmp(&(sign * b.theta_deg))) {
            tightest.binds = true;
        }
    }
    limits
}

/// Radius and height of the dome's opening: where the cone of light to the convex mirror passes the dome.
fn opening(rig: &Rig) -> [f64; 2] {
    let mirrors = rig.mirrors();
    // The cone narrows downwards, the dome widens: one height suits both.
    let edge = rig.paraboloid_radius_mm();
    let [centre, low] = [mirrors.centre().z, mirrors.convex().height(edge)];
    let pupil = rig.camera.pupil_mm().max(rig.projector.pupil_mm());
    let focus = rig.projector.focus_mm;
    let cone = |z: f64| edge * (centre - z) / (centre - low) + pupil * (1.0 - (centre - z) / focus).abs();
    let (mut lo, mut hi) = (mirrors.edge_radius() * 1e-3, mirrors.edge_radius());
    for _ in 0..60 {
        let rho = 0.5 * (lo + hi);
        let inside = mirrors.profile(rho).is_some_and(|p| p.x < cone(p.z));
        if inside { lo = rho } else { hi = rho }
    }
    mirrors.profile(hi).map_or([f64::NAN; 2], |p| [p.x, p.z])
}

/// Bound of polarisation's error, and least transmission from projector to camera for a sample that reflects all.
fn coatings(rig: &Rig, angles: &[Angle]) -> (f64, f64) {
    let p = angles.iter().map(|a| a.polarisation).fold(0.0, f64::max);
    let mirrors = angles.iter().map(|a| a.mirrors).fold(1.0, f64::min);
    // Of a sample with any Mueller matrix, light polarised by p and seen through an analyser of p: p + p + p^2.
    (2.0 * p + p * p, mirrors * mirrors * rig.coatings.splitter_transmitted * rig.coatings.splitter_reflected)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn survey(text: &str) -> Survey {
        Survey::new(&Rig::from_toml(text).unwrap(), 1.0).unwrap()
    }

    /// Figures of the derivation.
    #[test]
    fn the_full_thesis_rig() {
        let s = survey(include_str!("../../optics/ghosh-2007-full.toml"));
        assert!((s.shadow_deg - 9.15).abs() < 0.05, "{}", s.shadow_deg);
        assert!((s.undercut_deg.unwrap() - 64.8).abs() < 0.1);
        assert!((s.diameter_mm - 279.8).abs() < 1.3, "{}", s.diameter_mm);
        let at_57 = s.angles.iter().find(|a| a.theta_deg == 57.0).unwrap();
        assert!((at_57.draft_deg - 8.1).abs() < 0.2, "{} at {}", at_57.draft_deg, at_57.theta_deg);
        assert!((3.6..4.0).contains(&s.camera_min_px_per_deg), "{}", s.camera_min_px_per_deg);
        assert!((2.7..3.0).contains(&s.projector_min_px_per_deg), "{}", s.projector_min_px_per_deg);
        assert!(
            s.footprint_margin_mm < 0.0 && (75.0..85.0).contains(&s.footprint_up_to_deg),
            "{}",
            s.footprint_up_to_deg
        );
        let binding: Vec<&str> = s.limits.iter().filter(|l| l.binds).map(|l| l.name).collect();
        assert_eq!(binding.len(), 2, "{binding:?}");
    }

    #[test]
    fn the_built_thesis_rig_holds_to_two_tenths_of_a_millimetre() {
        let s = survey(include_str!("../../optics/ghosh-2007-built.toml"));
        assert!((s.height_tolerance_mm - 0.2).abs() < 0.01, "{}", s.height_tolerance_mm);
        assert!(s.pairs.iter().all(|p| p.lit_share > 0.9999));
        assert!(s.angles.iter().all(|a| a.camera.transmitted > 0.5 && a.draft_deg > 7.0));
        assert!((s.coverage - 0.443).abs() < 1e-3 && (s.projected_coverage - 0.679).abs() < 1e-3);
    }
}
