//! A chief ray of the nominal rig with its first derivatives: what pixels, pupils and decentred mirrors do near it.

use nalgebra::{Point3, Vector3};

use crate::optics::Mirrors;

/// A chief ray in the half plane phi = 0, and how its end at the sample changes. Pairs are (along the meridian, across it).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Chief {
    /// Polar angle at the sample, radians.
    pub theta: f64,
    /// Tangent of its angle to the axis at the lens.
    pub slope: f64,
    /// Point of the dome, distance from the axis and height, mm.
    pub dome: [f64; 2],
    /// Angle between the dome's meridian and the axis, radians.
    pub draft: f64,
    /// Change of `slope` (of the azimuth times `slope`) per radian of direction at the sample.
    pub slope_per_radian: [f64; 2],
    /// Displacement on the sample per displacement in the pupil; C and the sample are conjugate, so the focus does not matter.
    pub footprint: [f64; 2],
    /// Change of direction per decentre of the dome, radians per mm, for decentres along and across.
    pub by_dome: [f64; 2],
    /// The same for the convex mirror.
    pub by_convex: [f64; 2],
}

/// Of a ray near another: where it passes a point of it, and its direction.
type Change = (Vector3<f64>, Vector3<f64>);

/// A mirror about one point: the ray's direction there, unit normal, tangent along the meridian, and change of the normal per
/// mm along and across (negative for a concave mirror).
struct Reflection {
    d: Vector3<f64>,
    normal: Vector3<f64>,
    tangent: Vector3<f64>,
    bend: [f64; 2],
}

impl Reflection {
    fn new(d: Vector3<f64>, normal: Vector3<f64>, bend: [f64; 2]) -> Self {
        Self { d, normal, tangent: Vector3::new(normal.z, 0.0, -normal.x), bend }
    }

    /// The change after the mirror, moved by `moved`, from that before it.
    fn after(&self, (at, direction): Change, moved: &Vector3<f64>) -> Change {
        let cos = self.d.dot(&self.normal);
        let hit = at - self.d * ((at - moved).dot(&self.normal) / cos);
        let along = hit - moved;
        let turned = self.tangent * (self.bend[0] * along.dot(&self.tangent)) + Vector3::y() * (self.bend[1] * along.y);
        let tilt = direction.dot(&self.normal) + self.d.dot(&turned);
        (hit, direction - self.normal * (2.0 * tilt) - turned * (2.0 * cos))
    }
}

impl Chief {
    /// The ray that the convex mirror reflects at the radius `rho` > 0, mm; `None` if it misses the dome.
    pub fn new(mirrors: &Mirrors, rho: f64) -> Option<Self> {
        let point = mirrors.profile_point(rho)?;
        let convex = mirrors.convex();
        let (p, dome) = (convex.point(rho), Point3::new(point.r, 0.0, point.z));
        let (w, leg) = (p - mirrors.centre(), dome - p);
        let (from_centre, t, to_sample) = (w.norm(), leg.norm(), dome.coords.norm());
        let (e, d, out) = (w / from_centre, leg / t, -dome.coords / to_sample);
        let bend = [1.0 / convex.meridional_radius(rho), 1.0 / convex.sagittal_radius(rho)];
        let first = Reflection::new(e, convex.normal(&p).normalize(), bend);
        let bend = [-1.0 / point.meridional_radius, -1.0 / point.sagittal_radius];
        let second = Reflection::new(d, Vector3::new(point.normal[0], 0.0, point.normal[1]), bend);
        let still = Vector3::zeros();
        // What leaves C displaced by `at` and turned by `direction`, mirrors displaced.
        let through = |at: Vector3<f64>, direction: Vector3<f64>, convex: &Vector3<f64>, dome: &Vector3<f64>| {
            let (hit, direction) = first.after((at + direction * from_centre, direction), convex);
            second.after((hit + direction * t, direction), dome)
        };
        let turn = |direction: Vector3<f64>| through(still, direction, &still, &still).1.norm();
        let shift = |at: Vector3<f64>| {
            let (hit, direction) = through(at, still, &still, &still);
            let end = hit + direction * to_sample;
            (end - out * (end.z / out.z)).norm()
        };
        let [x, y] = [Vector3::x(), Vector3::y()];
        let slope = rho / (mirrors.centre().z - p.z);
        // Across, a turn by one radian at the lens is 1 / sin alpha of azimuth; along, the tangent grows by 1 / cos^2 alpha.
        let cos = -e.z;
        let per_turn = [1.0 / (cos * cos), 1.0 / cos];
        let turns = [turn(Vector3::new(cos, 0.0, e.x)), turn(y)];
        Some(Self {
            theta: point.theta,
            slope,
            dome: [point.r, point.z],
            draft: point.draft(),
            slope_per_radian: [per_turn[0] / turns[0], per_turn[1] / turns[1]],
            footprint: [shift(x), shift(y)],
            by_dome: [x, y].map(|by| through(still, still, &still, &by).1.norm()),
            by_convex: [x, y].map(|by| through(still, still, &by, &still).1.norm()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Device, Misaligned, Misalignment, PupilTerms, Rig};

    fn rig() -> Rig {
        Rig::from_toml(include_str!("../../optics/ghosh-2007-full.toml")).unwrap()
    }

    fn near(got: f64, want: f64, what: &str) {
        assert!((got / want - 1.0).abs() < 2e-4, "{what}: {got} {want}");
    }

    /// Against differences of rays that are traced to where they meet real mirrors.
    #[test]
    fn derivatives_are_those_of_traced_rays() {
        const BY_MM: f64 = 0.01;
        let rig = rig();
        let device = |m: &Misalignment| Misaligned::new(&rig, m, Device::Camera);
        let nominal = device(&Misalignment::none());
        let map = rig.camera_map();
        for theta in [0.2f64, 0.6, 1.0, 1.4] {
            let mirrors = rig.mirrors();
            let chief = Chief::new(&mirrors, mirrors.rho_of(theta, mirrors.edge_radius()).unwrap()).unwrap();
            near(chief.theta, theta, "theta");
            let terms = PupilTerms::new(&nominal, theta).unwrap();
            near(chief.footprint[0], terms.position[0].abs(), "footprint along");
            near(chief.footprint[1], terms.position[1].abs(), "footprint across");
            let focal_px = rig.camera.lens().focal_px;
            let radius = |theta| map.radius_px(theta).unwrap();
            near(chief.slope * focal_px, radius(theta), "radius");
            let along = (radius(theta + 1e-4) - radius(theta - 1e-4)) / 2e-4;
            near(chief.slope_per_radian[0] * focal_px, along, "pixels along");
            near(chief.slope_per_radian[1] * focal_px, radius(theta) / theta.sin(), "pixels across");
            let (u, v) = nominal.nominal_image(theta).unwrap();
            for (i, by) in [[BY_MM, 0.0], [0.0, BY_MM]].into_iter().enumerate() {
                let change = |plus: Misalignment, minus: Misalignment| {
                    let [a, b] = [plus, minus].map(|m| device(&m).direction_beyond(u, v).unwrap().vector());
                    (a - b).norm() / (2.0 * BY_MM)
                };
                let dome = |by| Misalignment { dome_offset_mm: by, ..Misalignment::none() };
                let convex = |by| Misalignment { paraboloid_offset_mm: by, ..Misalignment::none() };
                let back = by.map(|x: f64| -x);
                near(chief.by_dome[i], change(dome(by), dome(back)), "dome");
                near(chief.by_convex[i], change(convex(by), convex(back)), "convex");
            }
        }
    }
}
