//! The dome's meridian: its points with normals and curvatures, what a mould can leave, and ways to compute it.

use nalgebra::Vector2;

use super::Mirrors;

/// A point of the dome's meridian, in the half plane of radius r and height z; millimetres and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProfilePoint {
    /// Radius on the convex mirror of the ray that comes here.
    pub rho: f64,
    /// Distance from the axis.
    pub r: f64,
    /// Height above the sample's plane.
    pub z: f64,
    /// Polar angle seen from the sample.
    pub theta: f64,
    /// Unit normal into the dome, (r, z).
    pub normal: [f64; 2],
    /// Radius of curvature along the meridian.
    pub meridional_radius: f64,
    /// Radius of curvature across it: distance to the axis along the normal.
    pub sagittal_radius: f64,
    /// Angle of incidence on the convex mirror.
    pub incidence_convex: f64,
    /// Angle of incidence on the dome.
    pub incidence_dome: f64,
}

impl ProfilePoint {
    /// Angle between meridian and axis: positive where the dome still widens downwards, so that a mould can be drawn out.
    pub fn draft(&self) -> f64 {
        (-self.normal[1]).atan2(-self.normal[0])
    }
}

impl Mirrors {
    /// The dome's point that the ray at the radius `rho` of the convex mirror meets, with all that belongs to it.
    ///
    /// The normal halves the angle between the ray and the way to the sample. Radii follow from Coddington's equations: at
    /// each mirror the vergences of the beam from C change by 2 / (R cos i) along the meridian and 2 cos i / R across, and
    /// the last are those of a beam that converges at the sample.
    pub fn profile_point(&self, rho: f64) -> Option<ProfilePoint> {
        let dome = self.profile(rho)?;
        let p = self.convex().point(rho);
        let (w, leg) = (p - self.centre(), dome - p);
        let (from_centre, t, to_sample) = (w.norm(), leg.norm(), dome.coords.norm());
        let bisector = -(leg / t) - dome.coords / to_sample;
        let normal = bisector.normalize();
        let cos_dome = 0.5 * bisector.norm();
        let n = self.convex().normal(&p);
        let cos_convex = -w.dot(&n) / (from_centre * n.norm());
        let radius = |virtual_rel: f64, cos_power: f64| {
            let from_convex = 1.0 / (1.0 / from_centre + virtual_rel);
            2.0 / ((1.0 / (t + from_convex) + 1.0 / to_sample) * cos_power)
        };
        Some(ProfilePoint {
            rho,
            r: dome.x,
            z: dome.z,
            theta: dome.x.atan2(dome.z),
            normal: [normal.x, normal.z],
            meridional_radius: radius(2.0 / (self.convex().meridional_radius(rho) * cos_convex), cos_dome),
            sagittal_radius: radius(2.0 * cos_convex / self.convex().sagittal_radius(rho), 1.0 / cos_dome),
            incidence_convex: cos_convex.acos(),
            incidence_dome: cos_dome.acos(),
        })
    }

    /// Radius of the convex mirror whose ray shows the polar angle `theta` (radians), to 1e-12 mm; `None` beyond
    /// what the radius `farthest` shows.
    pub fn rho_of(&self, theta: f64, farthest: f64) -> Option<f64> {
        let angle = |rho: f64| self.profile(rho).map_or(f64::INFINITY, |p| p.x.atan2(p.z));
        let (mut lo, mut hi) = (0.0, farthest);
        if theta > angle(hi) + 1e-9 {
            return None;
        }
        // theta grows with the radius; the dome has no closed inverse.
        for _ in 0..60 {
            let mid = 0.5 * (lo + hi);
            if angle(mid) < theta { lo = mid } else { hi = mid }
        }
        Some(0.5 * (lo + hi))
    }

    /// By how much |P-C| + |D-P| + |S-D| of `steps` computed points differs from K at most, mm: the closed form's own check.
    pub fn path_variation(&self, steps: usize) -> f64 {
        let of = |i: usize| {
            let rho = self.edge_radius() * i as f64 / steps as f64;
            let (p, d) = (self.convex().point(rho), self.profile(rho)?);
            Some(((p - self.centre()).norm() + (d - p).norm() + d.coords.norm() - self.path_length()).abs())
        };
        (1..=steps).filter_map(of).fold(0.0, f64::max)
    }

    /// The dome's widest point: below it a mould is undercut. `None` if the dome widens down to the sample's plane.
    pub fn undercut(&self) -> Option<ProfilePoint> {
        let point = |rho: f64| self.profile_point(rho).filter(|p| p.z >= 0.0);
        let (mut lo, mut hi) = (0.0, self.edge_radius());
        if point(hi).or_else(|| point(hi * (1.0 - 1e-9)))?.draft() > 0.0 {
            return None;
        }
        for _ in 0..60 {
            let mid = 0.5 * (lo + hi);
            if point(mid)?.draft() > 0.0 { lo = mid } else { hi = mid }
        }
        point(0.5 * (lo + hi))
    }
}

/// How a profile is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProfileMethod {
    /// From the constant optical path.
    ClosedForm,
    /// From the rim inwards, each point on the tangent plane of the one before: the method of Ghosh 2007.
    Euler,
    /// The same differential equation by the classical Runge-Kutta method.
    Rk4,
}

impl ProfileMethod {
    /// All, the exact one first.
    pub const ALL: [Self; 3] = [Self::ClosedForm, Self::Euler, Self::Rk4];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::ClosedForm => "closed form",
            Self::Euler => "Euler",
            Self::Rk4 => "RK4",
        }
    }

    /// Points (r, z) in mm at `steps + 1` equally spaced radii of the convex mirror, from the edge ray inwards to the axis.
    pub fn points(self, mirrors: &Mirrors, steps: usize) -> Vec<[f64; 2]> {
        let step = mirrors.edge_radius() / steps as f64;
        let rho = |i: usize| step * (steps - i) as f64;
        let closed = |rho: f64| mirrors.profile(rho).map_or([f64::NAN; 2], |p| [p.x, p.z]);
        if self == Self::ClosedForm {
            return (0..=steps).map(|i| closed(rho(i))).collect();
        }
        let mut ray = Ray::new(mirrors, rho(0));
        let rim = Vector2::from(closed(rho(0)));
        let mut t = (rim - ray.p).norm();
        let mut points = vec![[rim.x, rim.y]];
        for i in 1..=steps {
            let next = Ray::new(mirrors, rho(i));
            match self {
                Self::Euler => {
                    let (at, normal) = (ray.at(t), ray.normal(t));
                    t = (at - next.p).dot(&normal) / next.d.dot(&normal);
                }
                _ => {
                    let middle = Ray::new(mirrors, rho(i) + 0.5 * step);
                    let k1 = ray.slope(t);
                    let k2 = middle.slope(t - 0.5 * step * k1);
                    let k3 = middle.slope(t - 0.5 * step * k2);
                    let k4 = next.slope(t - step * k3);
                    t -= step / 6.0 * (k1 + 2.0 * (k2 + k3) + k4);
                }
            }
            ray = next;
            let at = ray.at(t);
            points.push([at.x, at.y]);
        }
        points
    }
}

/// The ray that the convex mirror reflects at one radius, in the meridian plane, and how it changes with the radius.
struct Ray {
    p: Vector2<f64>,
    d: Vector2<f64>,
    p_rho: Vector2<f64>,
    d_rho: Vector2<f64>,
}

impl Ray {
    fn new(mirrors: &Mirrors, rho: f64) -> Self {
        let convex = mirrors.convex();
        let p = convex.point(rho);
        let k = 1.0 + convex.constant;
        // A ray alpha off the axis, reflected at a normal beta off it, leaves at alpha + 2 beta from the upward axis.
        let (above, n) = (mirrors.centre().z - p.z, convex.radius - k * (convex.vertex_height - p.z));
        let tan_beta = rho / n;
        let alpha_rho = (above - rho * tan_beta) / (above * above + rho * rho);
        let beta_rho = (n + rho * k * tan_beta) / (n * n + rho * rho);
        let (sin, cos) = (rho.atan2(above) + 2.0 * rho.atan2(n)).sin_cos();
        Self {
            p: Vector2::new(rho, p.z),
            d: Vector2::new(sin, cos),
            p_rho: Vector2::new(1.0, -tan_beta),
            d_rho: Vector2::new(cos, -sin) * (alpha_rho + 2.0 * beta_rho),
        }
    }

    fn at(&self, t: f64) -> Vector2<f64> {
        self.p + self.d * t
    }

    fn normal(&self, t: f64) -> Vector2<f64> {
        -self.d - self.at(t).normalize()
    }

    /// dt/drho along the dome: its tangent is at right angles to the normal.
    fn slope(&self, t: f64) -> f64 {
        let normal = self.normal(t);
        -(self.p_rho + self.d_rho * t).dot(&normal) / self.d.dot(&normal)
    }
}

/// By how much a computed profile differs from the closed form.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProfileError {
    /// Largest distance between points of the same ray, mm.
    pub distance_mm: f64,
    /// Largest angle between chords of the same pair of rays, arc seconds.
    pub slope_arcsec: f64,
}

impl ProfileError {
    /// Of `steps` steps of a method.
    pub fn of(method: ProfileMethod, mirrors: &Mirrors, steps: usize) -> Self {
        let (exact, points) = (ProfileMethod::ClosedForm.points(mirrors, steps), method.points(mirrors, steps));
        let distance = exact.iter().zip(&points).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
        let chord = |w: &[[f64; 2]]| (w[1][1] - w[0][1]).atan2(w[1][0] - w[0][0]);
        let slope = exact.windows(2).zip(points.windows(2)).map(|(a, b)| (chord(a) - chord(b)).abs());
        Self {
            distance_mm: distance.fold(0.0, f64::max),
            slope_arcsec: slope.fold(0.0, f64::max).to_degrees() * 3600.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Conic;
    use super::*;

    fn paraboloid() -> Mirrors {
        Mirrors::new(405.0, Conic { vertex_height: 135.0, radius: 8.0, constant: -1.0 }, 126.5).unwrap()
    }

    fn hyperboloid() -> Mirrors {
        Mirrors::new(405.0, Conic::hyperboloid(135.0, 8.0, 405.0), 126.5).unwrap()
    }

    /// Two independent derivations: Fermat's principle for points, Coddington's equations for curvatures.
    #[test]
    fn normals_and_radii_are_those_of_the_points() {
        for m in [paraboloid(), hyperboloid()] {
            for i in 1..50 {
                let rho = m.edge_radius() * f64::from(i) / 50.0;
                let h = 1e-3;
                let [a, b, c] = [rho - h, rho, rho + h].map(|rho| m.profile_point(rho).unwrap());
                let (dr, dz) = (c.r - a.r, c.z - a.z);
                let length = dr.hypot(dz);
                let across = (dr * b.normal[0] + dz * b.normal[1]) / length;
                assert!(across.abs() < 1e-6, "{i}: {across}");
                let turn = a.normal[0] * c.normal[1] - a.normal[1] * c.normal[0];
                assert!((length / turn.abs() / b.meridional_radius - 1.0).abs() < 1e-4, "{i} {}", length / turn.abs());
                assert!((b.r / b.normal[0].abs() / b.sagittal_radius - 1.0).abs() < 1e-9, "{i}");
            }
        }
    }

    #[test]
    fn moulds_of_the_thesis_dome() {
        let m = paraboloid();
        let widest = m.undercut().unwrap();
        assert!((widest.theta.to_degrees() - 64.8).abs() < 0.1 && (2.0 * widest.r - 279.8).abs() < 1.3);
        let built = m.profile_point(m.rho_of(57f64.to_radians(), m.edge_radius()).unwrap()).unwrap();
        assert!((built.draft().to_degrees() - 8.1).abs() < 0.2, "{}", built.draft().to_degrees());
        assert!((built.theta.to_degrees() - 57.0).abs() < 1e-9);
    }

    /// Steps to the first and fourth order; the closed form is no step at all.
    #[test]
    fn stepwise_methods_converge_as_their_orders_say() {
        let m = paraboloid();
        for (steps, mm) in [(100, 3.1), (1000, 0.31), (10_000, 0.03)] {
            let euler = ProfileError::of(ProfileMethod::Euler, &m, steps).distance_mm;
            assert!((euler / mm - 1.0).abs() < 0.1, "{steps}: {euler}");
        }
        let [coarse, fine] = [50, 100].map(|steps| ProfileError::of(ProfileMethod::Rk4, &m, steps));
        let order = (coarse.distance_mm / fine.distance_mm).log2();
        assert!((3.5..4.5).contains(&order), "{order} {coarse:?} {fine:?}");
        assert_eq!(ProfileError::of(ProfileMethod::ClosedForm, &m, 100).distance_mm, 0.0);
    }

    /// |P-C| + |D-P| + |S-D| = K along the whole profile, and every ray meets the sample.
    #[test]
    fn the_closed_form_is_consistent() {
        for m in [paraboloid(), hyperboloid()] {
            for i in 1..=1000 {
                let rho = m.edge_radius() * f64::from(i) / 1000.0;
                let (p, q) = (m.convex().point(rho), m.profile_point(rho).unwrap());
                let d = m.profile(rho).unwrap();
                let length = (p - m.centre()).norm() + (d - p).norm() + d.coords.norm();
                assert!((length - m.path_length()).abs() < 1e-9);
                let n = nalgebra::Vector3::new(q.normal[0], 0.0, q.normal[1]);
                let leg = (d - p).normalize();
                let out = leg - n * (2.0 * leg.dot(&n));
                assert!(d.coords.cross(&out).norm() < 1e-9, "{i}");
            }
        }
    }
}
