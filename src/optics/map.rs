//! Pixels to directions and back.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::Vector3;

use super::{Arm, MapCorrection, Mirrors};
use crate::geometry::{Direction, Sample, Zone};

/// An ideal lens at the centre of projection, looking down the optical axis.
///
/// Pixel coordinates are continuous: the centre of pixel (column i, row j) is (i + 1/2, j + 1/2).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Image distance in pixels.
    pub focal_px: f64,
    /// Column coordinate of the optical axis.
    pub centre_u: f64,
    /// Row coordinate of the optical axis.
    pub centre_v: f64,
    /// Which arm of the beam splitter it looks through.
    pub arm: Arm,
}

impl Lens {
    /// Unit vector, in the rig frame, of the ray through (u, v). The reflected arm mirrors y: phi becomes -phi.
    pub fn ray(&self, u: f64, v: f64) -> Vector3<f64> {
        let y = (self.centre_v - v) / self.focal_px;
        let x = (u - self.centre_u) / self.focal_px;
        Vector3::new(x, self.arm.handedness() * y, -1.0).normalize()
    }

    /// The pixel coordinates of a ray: inverse of [`Lens::ray`].
    pub fn pixel(&self, ray: &Vector3<f64>) -> (f64, f64) {
        let scale = self.focal_px / -ray.z;
        (self.centre_u + ray.x * scale, self.centre_v - self.arm.handedness() * ray.y * scale)
    }
}

/// The map between the pixels of one device and directions at the sample: nominal, or with what a calibration found.
#[derive(Debug, Clone)]
pub struct OpticalMap {
    mirrors: Mirrors,
    lens: Lens,
    theta_max: f64,
    correction: Option<Arc<MapCorrection>>,
}

impl OpticalMap {
    /// The nominal map of a lens through mirrors whose dome is made up to `theta_max` (radians).
    pub fn new(mirrors: Mirrors, lens: Lens, theta_max: f64) -> Self {
        Self { mirrors, lens, theta_max, correction: None }
    }

    /// The same map with a calibration's correction in place of any it had.
    pub fn corrected(self, correction: MapCorrection) -> Self {
        Self { correction: Some(Arc::new(correction)), ..self }
    }

    /// The direction at the sample that belongs to the point (u, v) of the image; `None` where its ray misses a mirror.
    pub fn direction(&self, u: f64, v: f64) -> Option<Direction<Sample>> {
        let (u, v) = self.correction.as_ref().map_or((u, v), |c| c.to_nominal(u, v));
        let path = self.mirrors.trace(&self.lens.ray(u, v))?;
        if path.convex.x.hypot(path.convex.y) > self.mirrors.edge_radius() * (1.0 + 1e-12) {
            return None;
        }
        let d = Direction::new_unchecked(path.direction());
        (d.theta() <= self.theta_max + 1e-9).then_some(d)
    }

    /// The point of the image that a direction at the sample comes from; `None` beyond the dome. Inverse of
    /// [`OpticalMap::direction`] to 1e-9 px.
    pub fn pixel(&self, d: &Direction<Sample>) -> Option<(f64, f64)> {
        if d.theta() > self.theta_max {
            return None;
        }
        let (u, v) = self.nominal_pixel(d, self.mirrors.edge_radius());
        Some(self.correction.as_ref().map_or((u, v), |c| c.from_nominal(u, v)))
    }

    /// The nominal image point of a direction, as if the dome went on beyond its end; `None` farther out than mirrors of
    /// this shape can reach.
    pub fn pixel_beyond(&self, d: &Direction<Sample>) -> Option<(f64, f64)> {
        let farthest = self.mirrors.edge_radius() * BEYOND_EDGE;
        (d.theta() < self.angle(farthest)).then(|| self.nominal_pixel(d, farthest))
    }

    /// Polar angle that the paraboloid's point at radius `rho` shows, radians.
    fn angle(&self, rho: f64) -> f64 {
        self.mirrors.profile(rho).map_or(f64::INFINITY, |p| p.x.atan2(p.z))
    }

    fn nominal_pixel(&self, d: &Direction<Sample>, farthest: f64) -> (f64, f64) {
        let rho = self.mirrors.rho_of(d.theta(), farthest).unwrap_or(farthest);
        let slope = rho / (self.mirrors.centre().z - self.mirrors.convex().height(rho));
        let (sin_phi, cos_phi) = d.phi().sin_cos();
        self.lens.pixel(&Vector3::new(slope * cos_phi, slope * sin_phi, -1.0))
    }

    /// Radius in pixels of the nominal image of the dome.
    pub(super) fn reach_px(&self) -> f64 {
        self.radius_px(self.theta_max).expect("the dome reaches its own end")
    }

    /// Solid angle at the sample of the unit square centred on (u, v), steradians; 0 where a ray misses.
    pub fn pixel_solid_angle(&self, u: f64, v: f64) -> f64 {
        let at = |du: f64, dv: f64| self.direction(u + du, v + dv).map(|d| d.vector());
        match (at(0.5, 0.0), at(-0.5, 0.0), at(0.0, 0.5), at(0.0, -0.5)) {
            (Some(e), Some(w), Some(s), Some(n)) => (e - w).cross(&(s - n)).norm(),
            _ => 0.0,
        }
    }

    /// Radius in pixels, from the optical axis, of the circle that shows the polar angle `theta` (radians) in the nominal
    /// image.
    pub fn radius_px(&self, theta: f64) -> Option<f64> {
        (theta <= self.theta_max).then(|| {
            let (u, v) = self.nominal_pixel(&Direction::from_angles(theta, 0.0), self.mirrors.edge_radius());
            (u - self.lens.centre_u).hypot(v - self.lens.centre_v)
        })
    }

    /// Half-open bounding box (u0, v0, u1, v1) in whole pixels of a zone's image, one pixel of margin, clipped to the panel.
    pub fn bounding_box(&self, zone: &Zone, width: usize, height: usize) -> Option<[usize; 4]> {
        let theta_max = zone.theta_max().min(self.theta_max);
        let (c_u, c_v) = (self.lens.centre_u, self.lens.centre_v);
        let r = self.radius_px(theta_max)?;
        let mut ends = [c_u - r, c_v - r, c_u + r, c_v + r];
        if self.correction.is_some() {
            ends = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
            // Between neighbours a circle of 1,000 px bulges by less than a tenth.
            const AZIMUTHS: u32 = 256;
            for i in 0..AZIMUTHS {
                let phi = f64::from(i) * TAU / f64::from(AZIMUTHS);
                let (u, v) = self.pixel(&Direction::from_angles(theta_max, phi))?;
                ends = [ends[0].min(u), ends[1].min(v), ends[2].max(u), ends[3].max(v)];
            }
        }
        let lo = |x: f64| (x - 1.0).floor().max(0.0) as usize;
        let hi = |x: f64, n: usize| ((x + 1.0).ceil().max(0.0) as usize).min(n);
        Some([lo(ends[0]), lo(ends[1]), hi(ends[2], width), hi(ends[3], height)])
    }
}

/// How far beyond the paraboloid's edge, in radii, directions are still followed.
const BEYOND_EDGE: f64 = 1.1;

#[cfg(test)]
mod tests {
    use super::super::Conic;
    use super::*;
    use proptest::prelude::*;

    fn map(arm: Arm) -> OpticalMap {
        let mirrors = Mirrors::new(405.0, Conic { vertex_height: 135.0, radius: 8.0, constant: -1.0 }, 126.5).unwrap();
        OpticalMap::new(mirrors, Lens { focal_px: 5903.0, centre_u: 680.0, centre_v: 512.0, arm }, 90f64.to_radians())
    }

    #[test]
    fn radii_of_the_camera_image() {
        let m = map(Arm::Transmitted);
        for (theta_deg, px) in [(90.0f64, 372.0), (57.0, 221.0), (9.15, 34.0)] {
            assert!((m.radius_px(theta_deg.to_radians()).unwrap() - px).abs() < 0.6, "{theta_deg}");
        }
    }

    #[test]
    fn the_reflected_arm_mirrors_the_azimuth() {
        let (t, r) = (map(Arm::Transmitted), map(Arm::Reflected));
        let (dt, dr) = (t.direction(780.0, 400.0).unwrap(), r.direction(780.0, 400.0).unwrap());
        assert!((dt.theta() - dr.theta()).abs() < 1e-12 && (dt.phi() + dr.phi()).abs() < 1e-12);
        assert!(dt.phi() > 0.0); // rows count downwards, y upwards
    }

    #[test]
    fn solid_angles_of_pixels_fill_the_zone() {
        let m = map(Arm::Transmitted);
        let zone = Zone::from_degrees(20.0, 57.0).unwrap();
        let mut sum = 0.0;
        for j in 280..744 {
            for i in 448..912 {
                let (u, v) = (i as f64 + 0.5, j as f64 + 0.5);
                if m.direction(u, v).is_some_and(|d| zone.contains(d.theta())) {
                    sum += m.pixel_solid_angle(u, v);
                }
            }
        }
        assert!((sum / zone.solid_angle() - 1.0).abs() < 1e-3, "{}", sum / zone.solid_angle());
    }

    proptest! {
        #[test]
        fn pixel_and_direction_are_inverse(theta in 0.02..1.55f64, phi in -3.1..3.1f64, mirrored: bool) {
            let m = map(if mirrored { Arm::Reflected } else { Arm::Transmitted });
            let d = Direction::from_angles(theta, phi);
            let (u, v) = m.pixel(&d).unwrap();
            let back = m.direction(u, v).unwrap();
            prop_assert!((back.vector() - d.vector()).norm() < 1e-9);
        }
    }
}
