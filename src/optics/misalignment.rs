//! Rays through a rig whose parts are not quite where they should be.

use std::f64::consts::TAU;

use nalgebra::{Point3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

use super::{Lens, Mirrors, Rig};
use crate::geometry::{Direction, Rig as RigFrame, Sample};

/// Which of the two devices at the centre of projection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Device {
    /// The camera.
    Camera,
    /// The projector.
    Projector,
}

/// What is out of place, in the rig frame as both devices see it (through the beam splitter). Pairs are (x, y), or
/// (column, row) for `_px`. A device's turn is about its own centre of projection: positive about x it looks towards +y,
/// positive about y towards -x.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Misalignment {
    /// Shift of the camera's optical axis on its sensor.
    pub camera_offset_px: [f64; 2],
    /// Shift of the projector's optical axis on its panel.
    pub projector_offset_px: [f64; 2],
    /// Decentre of the paraboloid.
    pub paraboloid_offset_mm: [f64; 2],
    /// Decentre of the dome.
    pub dome_offset_mm: [f64; 2],
    /// Tilt of the sample about x and y.
    pub sample_tilt_deg: [f64; 2],
    /// Lateral displacement of the camera's centre of projection.
    #[serde(skip_serializing_if = "is_zero")]
    pub camera_displacement_mm: [f64; 2],
    /// Turn of the camera about x and y.
    #[serde(skip_serializing_if = "is_zero")]
    pub camera_turn_deg: [f64; 2],
    /// Lateral displacement of the projector's centre of projection.
    #[serde(skip_serializing_if = "is_zero")]
    pub projector_displacement_mm: [f64; 2],
    /// Turn of the projector about x and y.
    #[serde(skip_serializing_if = "is_zero")]
    pub projector_turn_deg: [f64; 2],
    /// Height of the sample above the point both devices are aimed at.
    #[serde(skip_serializing_if = "is_zero")]
    pub sample_height_mm: f64,
    /// Relative error of the camera's focal length.
    #[serde(skip_serializing_if = "is_zero")]
    pub camera_scale_rel: f64,
    /// Relative error of the projector's focal length: it moves the edges of the zone that is lit.
    #[serde(skip_serializing_if = "is_zero")]
    pub projector_scale_rel: f64,
}

/// Records of rigs whose devices stand where they should keep the form they had before devices could be displaced.
fn is_zero<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

impl Misalignment {
    /// The nominal rig itself.
    pub fn none() -> Self {
        Self::default()
    }
}

/// One device of a misaligned rig: real intersections with both mirrors, no closed form for the dome.
#[derive(Debug, Clone)]
pub struct Misaligned {
    mirrors: Mirrors,
    lens: Lens,
    centre: Point3<f64>,
    rig_from_device: Rotation3<f64>,
    paraboloid: Vector3<f64>,
    dome: Vector3<f64>,
    rig_from_sample: Rotation3<f64>,
    sample_height_mm: f64,
    radius_mm: f64,
    theta_max: f64,
}

/// A ray followed to the sample.
struct Traced {
    direction: Direction<Sample>,
    /// Whether both mirrors are there as built, and the paraboloid is not in the way of the last leg.
    unhindered: bool,
}

/// The ends of what a device sees of the sample, by azimuth of its image: polar angles and azimuths at the sample, radians.
#[derive(Debug, Clone, PartialEq)]
pub struct Edges {
    /// (theta, phi) at the end of the paraboloid's shadow.
    pub inner: Vec<(f64, f64)>,
    /// (theta, phi) where the dome, or the paraboloid, ends.
    pub outer: Vec<(f64, f64)>,
}

impl Edges {
    /// The polar angles that are seen at every azimuth: [theta_min, theta_max], radians.
    pub fn usable(&self) -> [f64; 2] {
        let inner = self.inner.iter().map(|e| e.0).fold(0.0, f64::max);
        [inner, self.outer.iter().map(|e| e.0).fold(f64::INFINITY, f64::min)]
    }
}

impl Misaligned {
    /// A device of a rig that is misaligned by `m`.
    pub fn new(rig: &Rig, m: &Misalignment, device: Device) -> Self {
        let (lens, scale_rel, offset_px) = match device {
            Device::Camera => (rig.camera.lens(), m.camera_scale_rel, m.camera_offset_px),
            Device::Projector => (rig.projector.lens(), m.projector_scale_rel, m.projector_offset_px),
        };
        let (displacement, turn) = match device {
            Device::Camera => (m.camera_displacement_mm, m.camera_turn_deg),
            Device::Projector => (m.projector_displacement_mm, m.projector_turn_deg),
        };
        let flat = |v: [f64; 2]| Vector3::new(v[0], v[1], 0.0);
        let turned = |deg: [f64; 2]| Rotation3::from_euler_angles(deg[0].to_radians(), deg[1].to_radians(), 0.0);
        let mirrors = rig.mirrors();
        Self {
            mirrors,
            lens: Lens {
                focal_px: lens.focal_px * (1.0 + scale_rel),
                centre_u: lens.centre_u + offset_px[0],
                centre_v: lens.centre_v + offset_px[1],
                ..lens
            },
            centre: mirrors.centre() + flat(displacement),
            rig_from_device: turned(turn),
            paraboloid: flat(m.paraboloid_offset_mm),
            dome: flat(m.dome_offset_mm),
            rig_from_sample: turned(m.sample_tilt_deg),
            sample_height_mm: m.sample_height_mm,
            radius_mm: rig.paraboloid_radius_mm(),
            theta_max: rig.dome.theta_max_deg.to_radians(),
        }
    }

    /// The lens, its shift included.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// The mirrors, nominal.
    pub fn mirrors(&self) -> &Mirrors {
        &self.mirrors
    }

    /// The direction at the sample of the image point (u, v); `None` where the ray misses a mirror as built, or where the
    /// paraboloid shadows the sample.
    pub fn direction(&self, u: f64, v: f64) -> Option<Direction<Sample>> {
        self.trace(&self.lens.ray(u, v)).filter(|t| t.unhindered).map(|t| t.direction)
    }

    /// The same as if both mirrors went on beyond their edges and cast no shadow.
    pub fn direction_beyond(&self, u: f64, v: f64) -> Option<Direction<Sample>> {
        self.trace(&self.lens.ray(u, v)).map(|t| t.direction)
    }

    /// The direction at the sample of a ray in the device's own frame (as [`Lens::ray`] gives them), beyond all edges.
    pub fn along(&self, ray: &Vector3<f64>) -> Option<Direction<Sample>> {
        self.trace(ray).map(|t| t.direction)
    }

    /// Where the ray of the image point (u, v) meets the plane at `height_mm`, in the rig frame and without mirrors.
    pub fn on_plane(&self, u: f64, v: f64, height_mm: f64) -> Point3<f64> {
        let e = self.rig_from_device * self.lens.ray(u, v);
        self.centre + e * ((height_mm - self.centre.z) / e.z)
    }

    /// The image of a point seen without mirrors, in the rig frame (mm): inverse of [`Misaligned::on_plane`].
    pub fn image(&self, point: &Point3<f64>) -> (f64, f64) {
        self.lens.pixel(&self.rig_from_device.inverse_transform_vector(&(point - self.centre)))
    }

    /// The end of the nominal paraboloid's shadow, radians.
    pub fn nominal_shadow(&self) -> f64 {
        self.mirrors.shadow(self.radius_mm)
    }

    /// The centre of projection, mm in the rig frame.
    pub fn centre(&self) -> Point3<f64> {
        self.centre
    }

    /// The image of the paraboloid's vertex, about which the zone's image lies.
    pub fn image_centre(&self) -> (f64, f64) {
        self.image(&(Point3::new(0.0, 0.0, self.mirrors.convex().height(0.0)) + self.paraboloid))
    }

    /// Whether the ray of the image point (u, v) meets the paraboloid as built.
    pub fn meets_paraboloid(&self, u: f64, v: f64) -> bool {
        self.hit_paraboloid(&self.lens.ray(u, v)).is_some_and(|(p, _)| p.x.hypot(p.y) <= self.radius_mm)
    }

    /// The ends of what the device sees, at `azimuths` azimuths of its image, to 1e-6 px.
    pub fn edges(&self, azimuths: usize) -> Edges {
        let (c_u, c_v) = self.image_centre();
        let reach = self.mirrors.edge_radius() * 1.02
            / (self.mirrors.centre().z - self.mirrors.convex().height(self.mirrors.edge_radius()))
            * self.lens.focal_px;
        // From the middle of what is seen along a radius, each end is bracketed.
        let end = |azimuth: f64, beyond: f64| {
            let (sin, cos) = azimuth.sin_cos();
            let at = |r: f64| self.direction(c_u + r * cos, c_v + r * sin);
            let middle = (1..24).map(|i| f64::from(i) / 24.0 * reach).filter(|&r| at(r).is_some());
            let middle: Vec<f64> = middle.collect();
            let (mut seen, mut unseen) = (middle.get(middle.len() / 2).copied()?, beyond * reach);
            for _ in 0..32 {
                let r = 0.5 * (seen + unseen);
                if at(r).is_some() { seen = r } else { unseen = r }
            }
            at(seen).map(|d| (d.theta(), d.phi()))
        };
        let around = |beyond: f64| {
            (0..azimuths).filter_map(|i| end(i as f64 * TAU / azimuths as f64, beyond)).collect::<Vec<_>>()
        };
        Edges { inner: around(0.0), outer: around(1.0) }
    }

    /// Where the ray `e` of the device meets the paraboloid (in the paraboloid's own frame), and the ray in the rig frame.
    fn hit_paraboloid(&self, e: &Vector3<f64>) -> Option<(Point3<f64>, Vector3<f64>)> {
        let e = self.rig_from_device * e;
        let origin = self.centre - self.paraboloid;
        Some((origin + e * self.mirrors.convex().hit(&origin, &e)?, e))
    }

    fn trace(&self, e: &Vector3<f64>) -> Option<Traced> {
        let (p, e) = self.hit_paraboloid(e)?;
        let rho = p.x.hypot(p.y);
        let d = self.mirrors.convex().reflect(&p, &e);
        let (hit, normal) = self.hit_dome(&(p + self.paraboloid - self.dome), &d, rho)?;
        let out = d - normal * (2.0 * d.dot(&normal));
        let theta = hit.x.hypot(hit.y).atan2(hit.z);
        // On its way down the ray passes the paraboloid's edge outside of it.
        let edge = hit + self.dome - self.paraboloid;
        let passes = edge + out * ((self.mirrors.convex().height(self.radius_mm) - edge.z) / out.z);
        let lit = hit.z < self.mirrors.convex().height(self.radius_mm) || passes.x.hypot(passes.y) >= self.radius_mm;
        // Of the pupil's rays from here, those that meet a raised sample on the axis leave a little steeper.
        let seen = -out - Vector3::z() * (self.sample_height_mm / hit.coords.norm());
        Some(Traced {
            direction: Direction::<RigFrame>::new(seen).to_sample(&self.rig_from_sample),
            unhindered: rho <= self.radius_mm && theta <= self.theta_max && lit,
        })
    }

    /// Meets the ray with the dome as a surface of revolution, by Newton steps along the ray and along the profile, from
    /// the nominal point. Returns the point and the unit normal, in the dome's own frame.
    fn hit_dome(&self, origin: &Point3<f64>, d: &Vector3<f64>, rho: f64) -> Option<(Point3<f64>, Vector3<f64>)> {
        const STEP_MM: f64 = 1e-3;
        let mut s = rho.max(1e-2);
        let mut t = (self.mirrors.profile(s)? - Point3::new(s, 0.0, self.mirrors.convex().height(s))).norm();
        let mut found = None;
        for _ in 0..4 {
            let hit = origin + d * t;
            let at = self.mirrors.profile(s)?;
            let tangent = (self.mirrors.profile(s + STEP_MM)? - self.mirrors.profile(s - STEP_MM)?) / (2.0 * STEP_MM);
            let speed = tangent.norm();
            let (tr, tz) = (tangent.x / speed, tangent.z / speed);
            let r = hit.x.hypot(hit.y);
            let (cos_phi, sin_phi) = if r > 0.0 { (hit.x / r, hit.y / r) } else { (1.0, 0.0) };
            let normal = Vector3::new(-tz * cos_phi, -tz * sin_phi, tr);
            found = Some((hit, normal));
            let (dr, dz) = (r - at.x, hit.z - at.z);
            t -= (dr * -tz + dz * tr) / d.dot(&normal);
            s += (dr * tr + dz * tz) / speed;
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig() -> Rig {
        Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap()
    }

    fn camera(m: &Misalignment) -> Misaligned {
        Misaligned::new(&rig(), m, Device::Camera)
    }

    const PIXELS: [(f64, f64); 4] = [(680.0, 470.0), (800.0, 512.3), (610.0, 380.0), (880.0, 560.0)];

    /// Two independent ways to the same direction: real intersections here, the closed form in the nominal map.
    #[test]
    fn an_aligned_rig_is_the_nominal_one() {
        let (traced, nominal) = (camera(&Misalignment::none()), rig().camera_map());
        for (u, v) in PIXELS {
            let (a, b) = (traced.direction(u, v).unwrap(), nominal.direction(u, v).unwrap());
            assert!((a.vector() - b.vector()).norm() < 1e-7, "{u} {v}");
        }
        let [inner, outer] = traced.edges(16).usable();
        let shadow = rig().mirrors().shadow(rig().paraboloid_radius_mm());
        assert!((inner - shadow).abs() < 1e-6 && (outer.to_degrees() - 57.5).abs() < 1e-4, "{inner} {outer}");
    }

    /// Everything but the sample moved alike is the same rig: directions do not change. Turning the sample turns them.
    #[test]
    fn what_moves_together_stays_together() {
        let by = [0.5, -0.3];
        let moved = Misalignment {
            camera_displacement_mm: by,
            paraboloid_offset_mm: by,
            dome_offset_mm: by,
            ..Misalignment::none()
        };
        let tilted = Misalignment { sample_tilt_deg: [0.2, 0.0], ..Misalignment::none() };
        for (u, v) in PIXELS {
            let nominal = camera(&Misalignment::none()).direction(u, v).unwrap().vector();
            assert!((camera(&moved).direction(u, v).unwrap().vector() - nominal).norm() < 1e-9);
            let turned = camera(&tilted).direction(u, v).unwrap().vector();
            let want = Rotation3::from_euler_angles(-0.2f64.to_radians(), 0.0, 0.0) * nominal;
            assert!((turned - want).norm() < 1e-7);
        }
    }

    #[test]
    fn a_turned_device_looks_elsewhere_as_its_signs_say() {
        let m =
            Misalignment { camera_turn_deg: [0.2, 0.1], camera_displacement_mm: [0.5, 0.0], ..Misalignment::none() };
        let device = camera(&m);
        let (u, v) = (rig().camera.lens().centre_u, rig().camera.lens().centre_v);
        let spot = device.on_plane(u, v, 0.0);
        assert!((spot.y - 405.0 * 0.2f64.to_radians().tan()).abs() < 1e-3, "{spot}");
        assert!((spot.x - 0.5 + 405.0 * 0.1f64.to_radians().tan()).abs() < 1e-3, "{spot}");
        let (back_u, back_v) = device.image(&spot);
        assert!((back_u - u).hypot(back_v - v) < 1e-9);
    }

    #[test]
    fn a_decentred_paraboloid_moves_its_shadow_into_the_zone() {
        let m = Misalignment { paraboloid_offset_mm: [0.5, 0.0], ..Misalignment::none() };
        let [inner, _] = camera(&m).edges(64).usable();
        assert!(inner.to_degrees() > 9.1, "{}", inner.to_degrees());
    }

    #[test]
    fn records_of_undisplaced_devices_keep_their_keys() {
        let json = serde_json::to_value(Misalignment::none()).unwrap();
        let keys: Vec<_> = json.as_object().unwrap().keys().cloned().collect();
        assert_eq!(keys.len(), 5, "{keys:?}");
        let m: Misalignment = serde_json::from_str(r#"{"camera_turn_deg": [0.1, 0]}"#).unwrap();
        assert_eq!(m.camera_turn_deg, [0.1, 0.0]);
    }
}
