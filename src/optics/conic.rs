//! Surfaces of revolution of the second degree.

use nalgebra::{Point3, Vector3};

/// A conic of revolution about the z axis that opens downwards from its vertex: rho^2 - 2 R q + (1 + kappa) q^2 = 0 with
/// q = h - z the depth below the vertex. kappa = -1 is a paraboloid, below it a hyperboloid, 0 a sphere. Millimetres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conic {
    /// Height h of the vertex.
    pub vertex_height: f64,
    /// Radius of curvature R at the vertex, positive: the focal length is R / 2.
    pub radius: f64,
    /// Conic constant kappa.
    pub constant: f64,
}

impl Conic {
    /// The hyperboloid with its far focus at the height `far` and the given vertex and vertex radius: rays from the far focus
    /// leave it as if from the near one. `far` is above the vertex by more than the radius.
    pub fn hyperboloid(vertex_height: f64, radius: f64, far: f64) -> Self {
        let above = far - vertex_height;
        // The near focus lies g below the vertex, with 1/g - 1/above = 2/R; e = (above + g) / (above - g).
        let g = above * radius / (2.0 * above + radius);
        let eccentricity = (above + g) / (above - g);
        Self { vertex_height, radius, constant: -eccentricity * eccentricity }
    }

    /// Depths of both foci below the vertex, mm: the one inside first. Of a paraboloid the second is infinite.
    pub fn foci(&self) -> [f64; 2] {
        let e = (-self.constant).max(0.0).sqrt();
        [self.radius / (1.0 + e), self.radius / (1.0 - e)]
    }

    /// Height of the surface at the distance `rho` from the axis; NaN where there is none.
    pub fn height(&self, rho: f64) -> f64 {
        self.vertex_height
            - rho * rho / (self.radius + (self.radius.powi(2) - (1.0 + self.constant) * rho * rho).sqrt())
    }

    /// Distance from the axis at the height `z` below the vertex; NaN where there is none.
    pub fn rho(&self, z: f64) -> f64 {
        let q = self.vertex_height - z;
        (q * (2.0 * self.radius - (1.0 + self.constant) * q)).sqrt()
    }

    /// Point in the half plane phi = 0.
    pub fn point(&self, rho: f64) -> Point3<f64> {
        Point3::new(rho, 0.0, self.height(rho))
    }

    /// Distance along the unit vector `e` from `origin` to the sheet below the vertex; `None` if the ray misses it.
    #[inline]
    pub fn hit(&self, origin: &Point3<f64>, e: &Vector3<f64>) -> Option<f64> {
        let k = 1.0 + self.constant;
        let (q, dq) = (self.vertex_height - origin.z, -e.z);
        let a = e.x * e.x + e.y * e.y + k * dq * dq;
        let b = origin.x * e.x + origin.y * e.y - self.radius * dq + k * q * dq;
        let c = origin.x * origin.x + origin.y * origin.y - 2.0 * self.radius * q + k * q * q;
        let discriminant = b * b - a * c;
        if discriminant < 0.0 {
            return None;
        }
        // Both roots without cancellation; a hyperboloid's other sheet lies above the vertex.
        let w = -(b + discriminant.sqrt().copysign(b));
        let valid = |t: f64| if t > 0.0 && q + t * dq > -1e-9 { t } else { f64::INFINITY };
        let t = valid(c / w).min(valid(w / a));
        t.is_finite().then_some(t)
    }

    /// Outward normal at the surface's point `p`, of length [`Conic::sagittal_radius`].
    #[inline]
    pub fn normal(&self, p: &Point3<f64>) -> Vector3<f64> {
        Vector3::new(p.x, p.y, self.radius - (1.0 + self.constant) * (self.vertex_height - p.z))
    }

    /// The direction `e` after reflection at the surface's point `p`.
    #[inline]
    pub fn reflect(&self, p: &Point3<f64>, e: &Vector3<f64>) -> Vector3<f64> {
        let n = self.normal(p);
        e - n * (2.0 * e.dot(&n) / n.norm_squared())
    }

    /// Radius of curvature across the meridian at `rho`: the distance to the axis along the normal.
    pub fn sagittal_radius(&self, rho: f64) -> f64 {
        (self.radius.powi(2) - self.constant * rho * rho).sqrt()
    }

    /// Radius of curvature along the meridian at `rho`.
    pub fn meridional_radius(&self, rho: f64) -> f64 {
        self.sagittal_radius(rho).powi(3) / self.radius.powi(2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn conics() -> impl Strategy<Value = Conic> {
        (2.0..20.0f64, -1.5..0.5f64).prop_map(|(radius, constant)| Conic { vertex_height: 135.0, radius, constant })
    }

    proptest! {
        #[test]
        fn points_hit_lie_on_the_surface_and_reflect_about_the_normal(
            conic in conics(), x in -0.5..0.5f64, y in -0.5..0.5f64, u in -0.5..0.5f64,
        ) {
            let target = conic.point(x.hypot(y) * conic.radius);
            let (sin, cos) = y.atan2(x).sin_cos();
            let target = Point3::new(target.x * cos, target.x * sin, target.z);
            let origin = Point3::new(u * 10.0, 3.0, 405.0);
            let e = (target - origin).normalize();
            let t = conic.hit(&origin, &e).unwrap();
            let p = origin + e * t;
            prop_assert!((p.z - conic.height(p.x.hypot(p.y))).abs() < 1e-9);
            let n = conic.normal(&p);
            prop_assert!((n.norm() - conic.sagittal_radius(p.x.hypot(p.y))).abs() < 1e-9);
            let d = conic.reflect(&p, &e);
            prop_assert!((d.norm() - 1.0).abs() < 1e-12 && (d.dot(&n) + e.dot(&n)).abs() < 1e-9);
        }
    }

    #[test]
    fn a_hyperboloid_images_its_far_focus_at_the_near_one() {
        let conic = Conic::hyperboloid(135.0, 8.0, 405.0);
        let (far, near) = (Point3::new(0.0, 0.0, 405.0), Point3::new(0.0, 0.0, 135.0 - conic.foci()[0]));
        assert!((conic.foci()[1] + 270.0).abs() < 1e-9, "{:?}", conic.foci());
        for rho in [0.1, 5.0, 15.0] {
            let p = conic.point(rho);
            let d = conic.reflect(&p, &(p - far).normalize());
            assert!(d.cross(&(p - near)).norm() < 1e-12 * (p - near).norm().powi(2));
        }
    }
}
