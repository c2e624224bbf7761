//! A convex mirror and the dome that goes with it in closed form.

use nalgebra::{Point3, Vector3};

use super::Conic;

/// The two mirrors of the rig: millimetres in the rig frame, sample at the origin, optical axis +z.
///
/// A ray leaves the centre of projection C on the axis, meets the convex mirror at P, then the dome at D, then the sample S
/// at the origin. C and S are a stigmatic pair, so |P-C| + |D-P| + |S-D| = K is the same for every ray and the dome has a
/// closed form; the rim, where the edge ray meets the sample's plane, fixes K.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mirrors {
    centre_height: f64,
    convex: Conic,
    path_length: f64,
    edge_radius: f64,
}

/// One ray through the mirrors, millimetres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Path {
    /// Where it meets the convex mirror.
    pub convex: Point3<f64>,
    /// Where it meets the dome.
    pub dome: Point3<f64>,
}

impl Path {
    /// Unit vector from the sample to the dome: the direction the sample sees this ray in.
    pub fn direction(&self) -> Vector3<f64> {
        self.dome.coords.normalize()
    }
}

impl Mirrors {
    /// Mirrors from the height of C, the convex mirror and the dome's rim radius.
    ///
    /// `None` if no ray from C reaches the rim, or a length is not positive, or C is not above the vertex.
    pub fn new(centre_height: f64, convex: Conic, rim_radius: f64) -> Option<Self> {
        let lengths = [centre_height, convex.radius, convex.vertex_height, rim_radius];
        let possible = lengths.iter().all(|x| x.is_finite() && *x > 0.0) && convex.constant.is_finite();
        if !possible || centre_height <= convex.vertex_height {
            return None;
        }
        let mut mirrors = Self { centre_height, convex, path_length: 0.0, edge_radius: 0.0 };
        // The radius at which the reflected ray meets the sample's plane falls as rho grows: bisect for the rim.
        let lands_at = |rho: f64| {
            let p = convex.point(rho);
            let d = convex.reflect(&p, &(p - mirrors.centre()).normalize());
            if d.z < 0.0 { p.x - p.z * d.x / d.z } else { f64::INFINITY }
        };
        let widest =
            if convex.constant > -1.0 { convex.radius / (1.0 + convex.constant).sqrt() } else { f64::INFINITY };
        // A sphere or an ellipsoid ends above the sample's plane: its widest circle still faces C.
        let (mut lo, mut hi) = (0.0, widest.min(convex.rho(0.0).max(0.0)));
        if hi.is_nan() || lands_at(hi) > rim_radius {
            return None;
        }
        loop {
            let mid = 0.5 * (lo + hi);
            // No number lies between.
            if mid <= lo || mid >= hi {
                break;
            }
            if lands_at(mid) > rim_radius { lo = mid } else { hi = mid }
        }
        mirrors.edge_radius = hi;
        let (edge, rim) = (convex.point(hi), Point3::new(rim_radius, 0.0, 0.0));
        mirrors.path_length = (edge - mirrors.centre()).norm() + (rim - edge).norm() + rim_radius;
        Some(mirrors)
    }

    /// The centre of projection C.
    pub fn centre(&self) -> Point3<f64> {
        Point3::new(0.0, 0.0, self.centre_height)
    }

    /// The convex mirror.
    pub fn convex(&self) -> &Conic {
        &self.convex
    }

    /// The constant optical path K, mm.
    pub fn path_length(&self) -> f64 {
        self.path_length
    }

    /// Radius of the convex mirror at which the edge ray is reflected to the rim, mm.
    pub fn edge_radius(&self) -> f64 {
        self.edge_radius
    }

    /// The dome of a hyperboloid with its far focus at C: rays leave as if from the near focus N, so that |X-N| + |X| is the same
    /// for all of its points X. `None` for other convex mirrors, whose domes are no conics.
    pub fn ellipsoid(&self) -> Option<Conic> {
        let [near, far] = self.convex.foci();
        let above = self.centre_height - self.convex.vertex_height;
        let stigmatic = self.convex.constant < -1.0 && (far + above).abs() < 1e-12 * self.centre_height;
        let (major, half) = (0.5 * (self.path_length - (above - near)), 0.5 * (self.convex.vertex_height - near));
        stigmatic.then(|| Conic {
            vertex_height: half + major,
            radius: (major * major - half * half) / major,
            constant: -(half / major).powi(2),
        })
    }

    /// Polar angle below which a convex mirror of radius `rho` shadows the sample, radians.
    pub fn shadow(&self, rho: f64) -> f64 {
        rho.atan2(self.convex.height(rho))
    }

    /// The path of the ray that leaves C along the unit vector `e`; `None` if it misses the convex mirror.
    pub fn trace(&self, e: &Vector3<f64>) -> Option<Path> {
        let t = self.convex.hit(&self.centre(), e)?;
        let p = self.centre() + e * t;
        let d = self.convex.reflect(&p, e);
        Some(Path { convex: p, dome: self.dome_along(&p, t, &d)?.1 })
    }

    /// The dome's point on the ray that the convex mirror reflects at radius `rho`, in the half plane phi = 0.
    pub fn profile(&self, rho: f64) -> Option<Point3<f64>> {
        let p = self.convex.point(rho);
        let w = p - self.centre();
        Some(self.dome_along(&p, w.norm(), &self.convex.reflect(&p, &w.normalize()))?.1)
    }

    /// Distance along `d` to the dome, and the point: t = (k^2 - |w|^2) / (2 (w.d + k)) with w = P - S and k = K - |P-C|; D = P + t d.
    pub(super) fn dome_along(&self, p: &Point3<f64>, from_centre: f64, d: &Vector3<f64>) -> Option<(f64, Point3<f64>)> {
        let k = self.path_length - from_centre;
        let t = (k * k - p.coords.norm_squared()) / (2.0 * (p.coords.dot(d) + k));
        (t > 0.0 && t.is_finite()).then(|| (t, p + d * t))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paraboloid(focal_length: f64, vertex_height: f64) -> Conic {
        Conic { vertex_height, radius: 2.0 * focal_length, constant: -1.0 }
    }

    fn ghosh() -> Mirrors {
        Mirrors::new(405.0, paraboloid(4.0, 135.0), 126.5).unwrap()
    }

    /// Numbers of the derivation, as many digits as it gives.
    #[test]
    fn derived_dimensions_of_the_thesis_rig() {
        let m = ghosh();
        assert!((m.edge_radius() - 18.350).abs() < 5e-4, "{}", m.edge_radius());
        assert!((m.convex().height(m.edge_radius()) - 113.954).abs() < 5e-3);
        assert!((m.shadow(m.edge_radius()).to_degrees() - 9.15).abs() < 5e-3);
        let edge_ray = m.edge_radius().atan2(405.0 - m.convex().height(m.edge_radius())).to_degrees();
        assert!((edge_ray - 3.608).abs() < 1e-3);
        let profile: Vec<_> = (1..=2000).map(|i| m.profile(m.edge_radius() * i as f64 / 2000.0).unwrap()).collect();
        let top = profile.iter().map(|p| p.z).fold(0.0, f64::max);
        assert!((top - 220.1).abs() < 0.5, "{top}");
        let widest = profile.iter().max_by(|p, q| p.x.total_cmp(&q.x)).unwrap();
        assert!((2.0 * widest.x / 25.4 - 11.02).abs() < 0.05, "{}", widest.x);
        assert!((widest.x.atan2(widest.z).to_degrees() - 64.8).abs() < 0.1);
    }

    /// The closed form against what it was derived from: the law of reflection at a numerical normal of the dome.
    #[test]
    fn rays_meet_the_sample() {
        let m = ghosh();
        for i in 1..200 {
            let rho = m.edge_radius() * i as f64 / 200.0;
            let h = 1e-4;
            let (before, at, after) =
                (m.profile(rho - h).unwrap(), m.profile(rho).unwrap(), m.profile(rho + h).unwrap());
            let tangent = (after - before).normalize();
            let normal = Vector3::new(-tangent.z, 0.0, tangent.x);
            let p = Point3::new(rho, 0.0, m.convex().height(rho));
            let d = (at - p).normalize();
            let out = d - normal * (2.0 * d.dot(&normal));
            let miss = at.coords.cross(&out).norm();
            assert!(miss < 2e-5, "rho {rho}: {miss:e} mm"); // second differences of step h
        }
    }

    #[test]
    fn rigs_whose_rays_miss_are_none() {
        assert!(Mirrors::new(405.0, paraboloid(4.0, 135.0), 1e-3).is_none());
        assert!(Mirrors::new(100.0, paraboloid(4.0, 135.0), 126.5).is_none());
        assert!(Mirrors::new(405.0, paraboloid(-4.0, 135.0), 126.5).is_none());
        assert!(Mirrors::new(f64::NAN, paraboloid(4.0, 135.0), 126.5).is_none());
    }

    /// Rays of a hyperboloid with its far focus at C come from the near one: the dome is the ellipsoid about it and S.
    #[test]
    fn the_dome_of_a_hyperboloid_is_an_ellipsoid() {
        let convex = Conic::hyperboloid(135.0, 8.0, 405.0);
        let m = Mirrors::new(405.0, convex, 126.5).unwrap();
        let near = Point3::new(0.0, 0.0, 135.0 - convex.foci()[0]);
        let sum = |p: Point3<f64>| (p - near).norm() + p.coords.norm();
        let want = sum(Point3::new(126.5, 0.0, 0.0));
        for i in 1..=1000 {
            let got = sum(m.profile(m.edge_radius() * f64::from(i) / 1000.0).unwrap());
            assert!((got - want).abs() < 1e-9, "{i}: {:e} mm", got - want);
        }
        let ellipsoid = m.ellipsoid().unwrap();
        for rho in [1.0, 8.0, m.edge_radius()] {
            let p = m.profile(rho).unwrap();
            assert!((ellipsoid.rho(p.z) - p.x).abs() < 1e-9, "{rho}");
        }
        assert!(ghosh().ellipsoid().is_none());
    }
}
