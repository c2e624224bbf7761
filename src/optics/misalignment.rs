//! Rays through a rig whose parts are not quite where they should be.

use std::f64::consts::TAU;

use nalgebra::{Point3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

use super::placed::Reflected;
use super::{Figure, Lens, Mirrors, PlacedMirrors, Pose, Rig};
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
    /// Height of the camera's centre of projection above its place.
    #[serde(skip_serializing_if = "is_zero")]
    pub camera_height_mm: f64,
    /// Height of the projector's centre of projection above its place.
    #[serde(skip_serializing_if = "is_zero")]
    pub projector_height_mm: f64,
    /// By how much farther than stated the camera is focused.
    #[serde(skip_serializing_if = "is_zero")]
    pub camera_focus_mm: f64,
    /// By how much farther than stated the projector is focused.
    #[serde(skip_serializing_if = "is_zero")]
    pub projector_focus_mm: f64,
    /// Height of the paraboloid above its place.
    #[serde(skip_serializing_if = "is_zero")]
    pub paraboloid_height_mm: f64,
    /// Tilt of the paraboloid about its vertex.
    #[serde(skip_serializing_if = "is_zero")]
    pub paraboloid_tilt_deg: [f64; 2],
    /// Height of the dome above its place.
    #[serde(skip_serializing_if = "is_zero")]
    pub dome_height_mm: f64,
    /// Tilt of the dome about the middle of its rim, in the sample's plane.
    #[serde(skip_serializing_if = "is_zero")]
    pub dome_tilt_deg: [f64; 2],
    /// Departure of the dome's meridian into the dome: Legendre polynomials P_0 to P_3 of the polar angle, from the axis
    /// to the dome's end.
    #[serde(skip_serializing_if = "is_zero")]
    pub dome_figure_mm: [f64; 4],
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

/// Nodes of the table of a dome's figure, from the axis to past the dome's end.
const FIGURE_NODES: usize = 64;

/// One device of a misaligned rig: real intersections with both mirrors.
#[derive(Debug, Clone)]
pub struct Misaligned {
    placed: PlacedMirrors,
    lens: Lens,
    centre: Point3<f64>,
    rig_from_device: Rotation3<f64>,
    /// Middle of the convex mirror's trimmed edge.
    trim: Point3<f64>,
    /// Distance along the device's axis to the plane it is focused on, mm.
    focus_mm: f64,
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
        let (displacement, height, turn) = match device {
            Device::Camera => (m.camera_displacement_mm, m.camera_height_mm, m.camera_turn_deg),
            Device::Projector => (m.projector_displacement_mm, m.projector_height_mm, m.projector_turn_deg),
        };
        let focus_mm = match device {
            Device::Camera => rig.camera.focus_mm + m.camera_focus_mm,
            Device::Projector => rig.projector.focus_mm + m.projector_focus_mm,
        };
        let radians = |deg: [f64; 2]| deg.map(f64::to_radians);
        let turned = |deg: [f64; 2]| Rotation3::from_euler_angles(deg[0].to_radians(), deg[1].to_radians(), 0.0);
        let mirrors = rig.mirrors();
        let by = |offset: [f64; 2], height: f64| Vector3::new(offset[0], offset[1], height);
        let convex = Pose::new(
            by(m.paraboloid_offset_mm, m.paraboloid_height_mm),
            radians(m.paraboloid_tilt_deg),
            mirrors.convex().vertex_height,
        );
        let radius_mm = rig.paraboloid_radius_mm();
        let theta_max = rig.dome.theta_max_deg.to_radians();
        Self {
            placed: PlacedMirrors {
                mirrors,
                convex,
                dome: Pose::new(by(m.dome_offset_mm, m.dome_height_mm), radians(m.dome_tilt_deg), 0.0),
                figure: (!is_zero(&m.dome_figure_mm)).then(|| figure(&m.dome_figure_mm, theta_max)),
            },
            lens: Lens {
                focal_px: lens.focal_px * (1.0 + scale_rel),
                centre_u: lens.centre_u + offset_px[0],
                centre_v: lens.centre_v + offset_px[1],
                ..lens
            },
            centre: mirrors.centre() + by(displacement, height),
            rig_from_device: turned(turn),
            trim: convex.point_outside(&Point3::new(0.0, 0.0, mirrors.convex().height(radius_mm))),
            focus_mm,
            rig_from_sample: turned(m.sample_tilt_deg),
            sample_height_mm: m.sample_height_mm,
            radius_mm,
            theta_max,
        }
    }

    /// The same device with another figure of the dome, such as one that was measured.
    pub fn with_figure(mut self, figure: Figure) -> Self {
        self.placed.figure = Some(figure);
        self
    }

    /// The lens, its shift included.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// The mirrors, nominal.
    pub fn mirrors(&self) -> &Mirrors {
        &self.placed.mirrors
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
        self.placed.mirrors.shadow(self.radius_mm)
    }

    /// The centre of projection, mm in the rig frame.
    pub fn centre(&self) -> Point3<f64> {
        self.centre
    }

    /// Middle and radius of the convex mirror's trimmed edge, mm in the rig frame.
    pub fn trim(&self) -> (Point3<f64>, f64) {
        (self.trim, self.radius_mm)
    }

    /// The image of the paraboloid's vertex, about which the zone's image lies.
    pub fn image_centre(&self) -> (f64, f64) {
        let vertex = Point3::new(0.0, 0.0, self.placed.mirrors.convex().vertex_height);
        self.image(&self.placed.convex.point_outside(&vertex))
    }

    /// The image point, in the half plane phi = 0, that shows the polar angle `theta` (radians) in the nominal rig; `None` beyond
    /// what mirrors of this shape can show.
    pub fn nominal_image(&self, theta: f64) -> Option<(f64, f64)> {
        let mirrors = &self.placed.mirrors;
        let rho = mirrors.rho_of(theta, mirrors.edge_radius())?;
        let slope = rho / (mirrors.centre().z - mirrors.convex().height(rho));
        Some(self.lens.pixel(&Vector3::new(slope, 0.0, -1.0)))
    }

    /// Whether the ray of the image point (u, v) meets the paraboloid as built.
    pub fn meets_paraboloid(&self, u: f64, v: f64) -> bool {
        let e = self.rig_from_device * self.lens.ray(u, v);
        let met = self.placed.meet_convex(&self.centre, &e);
        met.is_some_and(|(p, _)| p.x.hypot(p.y) <= self.radius_mm)
    }

    /// The ends of what the device sees, at `azimuths` azimuths of its image, to 1e-6 px.
    pub fn edges(&self, azimuths: usize) -> Edges {
        let (c_u, c_v) = self.image_centre();
        let reach = self.placed.mirrors.edge_radius() * 1.02
            / (self.placed.mirrors.centre().z - self.placed.mirrors.convex().height(self.placed.mirrors.edge_radius()))
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

    /// Where a ray of the pupil arrives: the ray that the lens sends through the point (x, y) of its pupil (mm, in the device's
    /// own frame) to what is in focus at the image point (u, v). `None` if it misses a mirror, edges left out of account.
    pub fn through(&self, u: f64, v: f64, pupil_mm: [f64; 2]) -> Option<Arrival> {
        let chief = self.lens.ray(u, v);
        let from = Vector3::new(pupil_mm[0], pupil_mm[1], 0.0);
        let e = (chief * (self.focus_mm / -chief.z) - from).normalize();
        let ray = self.placed.trace(&(self.centre + self.rig_from_device * from), &(self.rig_from_device * e))?;
        let to_sample = self.rig_from_sample.inverse();
        let (hit, out) = (to_sample * ray.dome, to_sample * ray.out);
        let at = hit + out * ((self.sample_height_mm - hit.z) / out.z);
        Some(Arrival { position_mm: [at.x, at.y], direction: Direction::new(-out), unhindered: self.unhindered(&ray) })
    }

    /// Whether both mirrors are there as built, and the convex one is not in the way of the last leg.
    fn unhindered(&self, ray: &Reflected) -> bool {
        // On its way down the ray passes the convex mirror's edge outside of it.
        let passes = ray.at_height(self.trim.z);
        let lit = ray.dome.z < self.trim.z || (passes.x - self.trim.x).hypot(passes.y - self.trim.y) >= self.radius_mm;
        ray.rho <= self.radius_mm && ray.theta <= self.theta_max && lit
    }

    fn trace(&self, e: &Vector3<f64>) -> Option<Traced> {
        let ray = self.placed.trace(&self.centre, &(self.rig_from_device * e))?;
        // Of the pupil's rays from here, those that meet a raised sample on the axis leave a little steeper.
        let seen = -ray.out - Vector3::z() * (self.sample_height_mm / ray.dome.coords.norm());
        Some(Traced {
            direction: Direction::<RigFrame>::new(seen).to_sample(&self.rig_from_sample),
            unhindered: self.unhindered(&ray),
        })
    }
}

/// A ray's arrival at the sample's surface, in the sample's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// Where it arrives, mm from the sample's middle.
    pub position_mm: [f64; 2],
    /// Where it comes from.
    pub direction: Direction<Sample>,
    /// Whether nothing is in its way.
    pub unhindered: bool,
}

/// A dome's figure from Legendre coefficients of the polar angle over [0, theta_max].
fn figure(legendre: &[f64; 4], theta_max: f64) -> Figure {
    let step = 1.2 * theta_max / (FIGURE_NODES - 1) as f64;
    let node = |i: usize| {
        let x = 2.0 * (i as f64 * step).min(1.1 * theta_max) / theta_max - 1.0;
        let p = [1.0, x, 1.5 * x * x - 0.5, 2.5 * x * x * x - 1.5 * x];
        p.iter().zip(legendre).map(|(p, c)| p * c).sum()
    };
    Figure::new((0..FIGURE_NODES).map(node).collect(), step).expect("finite")
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
