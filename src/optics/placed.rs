//! Mirrors where they really are: rays by real intersections.

use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};

use super::Mirrors;

/// Where a mirror stands: moved and turned about a point of its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    rotation: Rotation3<f64>,
    /// Of the origin of the mirror's own frame, mm.
    translation: Vector3<f64>,
}

impl Pose {
    /// Where it should be.
    pub fn nominal() -> Self {
        Self { rotation: Rotation3::identity(), translation: Vector3::zeros() }
    }

    /// Moved by `by` (mm) and turned about x, then y (radians) at the height `pivot` on its axis.
    pub fn new(by: Vector3<f64>, tilt: [f64; 2], pivot: f64) -> Self {
        let rotation = Rotation3::from_euler_angles(tilt[0], tilt[1], 0.0);
        let pivot = Vector3::z() * pivot;
        Self { rotation, translation: by + pivot - rotation * pivot }
    }

    /// Rotation into the mirror's own frame, and its origin in the rig, mm.
    pub(super) fn inside(&self) -> (Matrix3<f64>, Vector3<f64>) {
        (self.rotation.inverse().into_inner(), self.translation)
    }

    fn point_inside(&self, p: &Point3<f64>) -> Point3<f64> {
        self.rotation.inverse_transform_point(&(p - self.translation))
    }

    /// A point of the mirror's own frame in that of the rig.
    pub fn point_outside(&self, p: &Point3<f64>) -> Point3<f64> {
        self.rotation * p + self.translation
    }
}

/// Departure of the dome's meridian from its closed form, along the normal into the dome.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// Mm, at polar angles from 0 on, `step` radians apart; four at least.
    nodes: Arc<[f64]>,
    step: f64,
}

impl Figure {
    /// From departures (mm) at equally spaced polar angles, `step` radians apart, the first at 0; cubic in between.
    ///
    /// `None` if there are fewer than four, or one is not finite.
    pub fn new(nodes: Vec<f64>, step: f64) -> Option<Self> {
        let usable = nodes.len() >= 4 && step > 0.0 && nodes.iter().all(|d| d.is_finite());
        usable.then(|| Self { nodes: nodes.into(), step })
    }

    /// Departure (mm) and its derivative by theta (mm per radian).
    pub fn at(&self, theta: f64) -> [f64; 2] {
        let x = (theta / self.step).clamp(0.0, (self.nodes.len() - 1) as f64);
        let first = (x as usize).clamp(1, self.nodes.len() - 3) - 1;
        let (n, t) = (&self.nodes[first..][..4], x - first as f64);
        // Newton's form of the cubic through nodes at 0, 1, 2, 3.
        let (a, b, c) = (n[1] - n[0], (n[2] - 2.0 * n[1] + n[0]) / 2.0, (n[3] - 3.0 * n[2] + 3.0 * n[1] - n[0]) / 6.0);
        let value = n[0] + t * (a + (t - 1.0) * (b + (t - 2.0) * c));
        let slope = a + b * (2.0 * t - 1.0) + c * (3.0 * t * t - 6.0 * t + 2.0);
        [value, slope / self.step]
    }
}

/// A ray that both mirrors have reflected; rig frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reflected {
    /// Where it met the convex mirror.
    pub convex: Point3<f64>,
    /// Distance of that point from the convex mirror's own axis.
    pub rho: f64,
    /// Where it met the dome.
    pub dome: Point3<f64>,
    /// Polar angle of that point in the dome's own frame, radians.
    pub theta: f64,
    /// Unit vector along which it leaves the dome.
    pub out: Vector3<f64>,
}

impl Reflected {
    /// Where it meets the plane at the height `z`.
    pub fn at_height(&self, z: f64) -> Point3<f64> {
        self.dome + self.out * ((z - self.dome.z) / self.out.z)
    }
}

/// Both mirrors, each in its place.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedMirrors {
    /// As designed.
    pub mirrors: Mirrors,
    /// Where the convex mirror stands.
    pub convex: Pose,
    /// Where the dome stands.
    pub dome: Pose,
    /// What the dome's meridian is off.
    pub figure: Option<Figure>,
}

/// Steps, mm, below which a point lies on the dome and its normal is known to 1e-9: the next are of their square.
pub(super) const CONVERGED_MM: f64 = 1e-7;

impl PlacedMirrors {
    /// Both where they should be.
    pub fn nominal(mirrors: Mirrors) -> Self {
        Self { mirrors, convex: Pose::nominal(), dome: Pose::nominal(), figure: None }
    }

    /// Where a ray from `origin` along the unit vector `e` meets the convex mirror, as if it had no edge: in the mirror's own
    /// frame, with the ray's direction there.
    pub fn meet_convex(&self, origin: &Point3<f64>, e: &Vector3<f64>) -> Option<(Point3<f64>, Vector3<f64>)> {
        let origin = self.convex.point_inside(origin);
        let e = self.convex.rotation.inverse_transform_vector(e);
        let t = self.mirrors.convex().hit(&origin, &e)?;
        Some((origin + e * t, e))
    }

    /// Follows a ray from `origin` along the unit vector `e` through both mirrors, as if neither had an edge; `None` if it
    /// misses one.
    pub fn trace(&self, origin: &Point3<f64>, e: &Vector3<f64>) -> Option<Reflected> {
        let (p, e) = self.meet_convex(origin, e)?;
        let d = self.convex.rotation * self.mirrors.convex().reflect(&p, &e);
        let convex = self.convex.point_outside(&p);
        let rho = p.x.hypot(p.y);
        let inside = self.dome.point_inside(&convex);
        let d = self.dome.rotation.inverse_transform_vector(&d);
        let (hit, normal) = self.meet_dome(&inside, &d)?;
        let out = d - normal * (2.0 * d.dot(&normal));
        Some(Reflected {
            convex,
            rho,
            dome: self.dome.point_outside(&hit),
            theta: polar(&hit),
            out: self.dome.rotation * out,
        })
    }

    /// Meets a ray with the dome, in the dome's own frame: the point, and the unit normal into the dome.
    ///
    /// A point X lies on the dome if V(X) + |X| = K, with V the shortest path from C by way of the convex mirror to X (Fermat);
    /// the gradient of the left side is the normal. Newton steps in the distance along the ray and in the radius at which the
    /// shortest path is reflected.
    fn meet_dome(&self, origin: &Point3<f64>, d: &Vector3<f64>) -> Option<(Point3<f64>, Vector3<f64>)> {
        let mut rho = origin.x.hypot(origin.y);
        // As if this ray came from C: exact for a rig without errors, and off by their square for others.
        let (mut t, _) = self.mirrors.dome_along(origin, (origin - self.mirrors.centre()).norm(), d)?;
        for _ in 0..12 {
            let x = origin + d * t;
            let path = ShortestPath::new(&self.mirrors, &x, rho);
            let (by_t, by_rho_t) = (d.dot(&path.gradient), path.by_rho_along(d));
            let departure = self.figure.as_ref().map_or(0.0, |f| f.at(polar(&x))[0] * path.gradient.norm());
            let excess = path.length - self.mirrors.path_length() + departure;
            let determinant = by_t * path.by_rho_rho - path.by_rho * by_rho_t;
            let dt = -(excess * path.by_rho_rho - path.by_rho * path.by_rho) / determinant;
            let drho = -(by_t * path.by_rho - by_rho_t * excess) / determinant;
            (t, rho) = (t + dt, rho + drho);
            if dt.abs().max(drho.abs()) < CONVERGED_MM {
                let hit = origin + d * t;
                let inwards = -path.gradient.normalize();
                return Some((hit, self.figure.as_ref().map_or(inwards, |f| self.departed(f, &hit, &inwards, rho))));
            }
            if !(t > 0.0 && rho.is_finite()) {
                return None;
            }
        }
        None
    }

    /// The normal at the point `x` of a dome with a figure, near `n`: that of the nominal meridian's nearest point, tilted.
    fn departed(&self, figure: &Figure, x: &Point3<f64>, n: &Vector3<f64>, mut rho: f64) -> Vector3<f64> {
        let [departure, slope] = figure.at(polar(x));
        let foot = x - n * departure;
        let mut path = ShortestPath::new(&self.mirrors, &foot, rho);
        for _ in 0..3 {
            rho -= path.by_rho / path.by_rho_rho;
            path = ShortestPath::new(&self.mirrors, &foot, rho);
        }
        tilted(&foot, &-path.gradient.normalize(), slope)
    }
}

/// The way from C by the convex mirror at the radius rho to a point X, and on to the sample; in the dome's own frame.
struct ShortestPath {
    /// Its length, mm.
    length: f64,
    /// Derivative by X.
    gradient: Vector3<f64>,
    /// Derivatives by rho.
    by_rho: f64,
    by_rho_rho: f64,
    tan_beta: f64,
    /// cos and sin of the azimuth of X.
    azimuth: [f64; 2],
    /// Unit vector (r, z) from the convex mirror to X, its part along the convex mirror, and the distance.
    leg: ([f64; 2], f64, f64),
}

impl ShortestPath {
    #[inline]
    fn new(mirrors: &Mirrors, x: &Point3<f64>, rho: f64) -> Self {
        let convex = mirrors.convex();
        let k = 1.0 + convex.constant;
        let r2 = x.x * x.x + x.y * x.y;
        let (r, to_sample) = (r2.sqrt(), (r2 + x.z * x.z).sqrt());
        let azimuth = if r > 0.0 { [x.x / r, x.y / r] } else { [1.0, 0.0] };
        let height = convex.height(rho);
        let n = convex.radius - k * (convex.vertex_height - height);
        let tan_beta = rho / n;
        let bend = (1.0 + k * tan_beta * tan_beta) / n;
        let (a_z, b_r, b_z) = (height - mirrors.centre().z, r - rho, x.z - height);
        let (a, b) = ((rho * rho + a_z * a_z).sqrt(), (b_r * b_r + b_z * b_z).sqrt());
        let (u_r, u_z) = (b_r / b, b_z / b);
        let (along_a, along_b) = ((rho - a_z * tan_beta) / a, u_r - u_z * tan_beta);
        let p2 = 1.0 + tan_beta * tan_beta;
        Self {
            length: a + b + to_sample,
            gradient: Vector3::new(u_r * azimuth[0], u_r * azimuth[1], u_z) + x.coords / to_sample,
            by_rho: along_a - along_b,
            by_rho_rho: (p2 - along_a * along_a) / a + (p2 - along_b * along_b) / b - (a_z / a - u_z) * bend,
            tan_beta,
            azimuth,
            leg: ([u_r, u_z], along_b, b),
        }
    }

    /// Derivative of `by_rho` as X moves along `d`.
    #[inline]
    fn by_rho_along(&self, d: &Vector3<f64>) -> f64 {
        let ([u_r, u_z], along, b) = self.leg;
        let d_r = d.x * self.azimuth[0] + d.y * self.azimuth[1];
        -(d_r - d.z * self.tan_beta - along * (u_r * d_r + u_z * d.z)) / b
    }
}

fn polar(x: &Point3<f64>) -> f64 {
    x.x.hypot(x.y).atan2(x.z)
}

/// The normal of a meridian that departs by `slope` mm per radian of theta along the normal `n` at the point `x`.
fn tilted(x: &Point3<f64>, n: &Vector3<f64>, slope: f64) -> Vector3<f64> {
    let r = x.x.hypot(x.y);
    if r == 0.0 {
        return *n;
    }
    // Unit vector along growing theta, and the way along the meridian per radian.
    let towards = Vector3::new(x.x * x.z / r, x.y * x.z / r, -r) / x.coords.norm();
    let tangent = (towards - n * towards.dot(n)).normalize();
    let per_radian = x.coords.norm() / tangent.dot(&towards);
    (n - tangent * (slope / per_radian)).normalize()
}

#[cfg(test)]
mod tests {
    use super::super::Conic;
    use super::*;
    use proptest::prelude::*;

    fn ghosh() -> Mirrors {
        Mirrors::new(405.0, Conic { vertex_height: 135.0, radius: 8.0, constant: -1.0 }, 126.5).unwrap()
    }

    fn aimed(x: f64, y: f64, rho: f64, phi: f64) -> (Point3<f64>, Vector3<f64>) {
        let origin = Point3::new(x, y, 405.0);
        let target = Point3::new(rho * phi.cos(), rho * phi.sin(), ghosh().convex().height(rho));
        (origin, (target - origin).normalize())
    }

    proptest! {
        /// Against the definition: the point met lies on the meridian, and its normal is the meridian's.
        #[test]
        fn rays_of_a_pupil_meet_the_dome(
            x in -15.0..15.0f64, y in -15.0..15.0f64, rho in 3.0..18.0f64, phi in -3.1..3.1f64,
        ) {
            let placed = PlacedMirrors::nominal(ghosh());
            let (origin, e) = aimed(x, y, rho, phi);
            let ray = placed.trace(&origin, &e).unwrap();
            let at = ghosh().profile_point(ghosh().rho_of(ray.theta, 30.0).unwrap()).unwrap();
            let r = ray.dome.x.hypot(ray.dome.y);
            prop_assert!((r - at.r).abs() < 1e-9 && (ray.dome.z - at.z).abs() < 1e-9, "{} {}", r - at.r, ray.dome.z - at.z);
            let d = (ray.dome - ray.convex).normalize();
            let n = Vector3::new(at.normal[0] * ray.dome.x / r, at.normal[0] * ray.dome.y / r, at.normal[1]);
            let out = d - n * (2.0 * d.dot(&n));
            prop_assert!((out - ray.out).norm() < 2e-8);
        }
    }

    #[test]
    fn what_moves_together_reflects_alike() {
        let mirrors = ghosh();
        let by = Vector3::new(0.4, -0.3, 0.2);
        let pose = Pose::new(by, [0.0; 2], 0.0);
        let moved = PlacedMirrors { convex: pose, dome: pose, ..PlacedMirrors::nominal(mirrors) };
        // Turned about the same point, both mirrors and the ray stay what they are to each other.
        let tilt = [0.01, -0.02];
        let turned = Pose::new(Vector3::zeros(), tilt, 0.0);
        let together = PlacedMirrors { convex: turned, dome: turned, ..PlacedMirrors::nominal(mirrors) };
        let rotation = Rotation3::from_euler_angles(tilt[0], tilt[1], 0.0);
        for phi in [0.0, 1.0, 2.5] {
            let (origin, e) = aimed(3.0, -4.0, 12.0, phi);
            let want = PlacedMirrors::nominal(mirrors).trace(&origin, &e).unwrap();
            let got = moved.trace(&(origin + by), &e).unwrap();
            assert!((got.dome - want.dome - by).norm() < 1e-9 && (got.out - want.out).norm() < 1e-12);
            let got = together.trace(&(rotation * origin), &(rotation * e)).unwrap();
            assert!((got.dome - rotation * want.dome).norm() < 1e-9 && (got.out - rotation * want.out).norm() < 1e-11);
        }
    }

    /// A dome that is too small or large everywhere by the same amount, and one whose figure has a slope: against points of
    /// the departed meridian and differences between them.
    #[test]
    fn figures_move_the_dome_along_its_normal() {
        let mirrors = ghosh();
        let step = 0.02;
        let departure = |theta: f64| 0.05 + 0.03 * (2.0 * theta).sin();
        let nodes = (0..90).map(|i| departure(f64::from(i) * step)).collect();
        let placed = PlacedMirrors { figure: Figure::new(nodes, step), ..PlacedMirrors::nominal(mirrors) };
        let moved = |rho: f64| {
            let p = mirrors.profile_point(rho).unwrap();
            let d = departure(p.theta);
            [p.r + d * p.normal[0], p.z + d * p.normal[1]]
        };
        for rho in [6.0, 10.0, 15.0] {
            let (origin, e) = aimed(0.0, 0.0, rho, 0.0);
            let ray = placed.trace(&origin, &e).unwrap();
            let near = |x: f64| {
                let p = moved(x);
                (p[0] - ray.dome.x).hypot(p[1] - ray.dome.z)
            };
            let best =
                (-4000..=4000).map(|i| rho + f64::from(i) * 1e-5).min_by(|a, b| near(*a).total_cmp(&near(*b))).unwrap();
            assert!(near(best) < 2e-4, "{rho}: {}", near(best));
            let (a, b) = (moved(best - 1e-3), moved(best + 1e-3));
            let tangent = Vector3::new(b[0] - a[0], 0.0, b[1] - a[1]).normalize();
            let d = (ray.dome - ray.convex).normalize();
            let along = d.dot(&tangent) - ray.out.dot(&tangent);
            assert!(along.abs() < 2e-5, "{rho}: {along}");
        }
    }

    #[test]
    fn figures_are_cubic_between_their_nodes() {
        let f = |x: f64| 1.0 - 2.0 * x + x.powi(3);
        let figure = Figure::new((0..10).map(|i| f(f64::from(i) * 0.1)).collect(), 0.1).unwrap();
        for x in [0.02, 0.33, 0.87] {
            let [value, slope] = figure.at(x);
            assert!((value - f(x)).abs() < 1e-12 && (slope - 3.0 * x * x + 2.0).abs() < 1e-11);
        }
        assert!(Figure::new(vec![0.0, f64::NAN, 0.0, 0.0], 0.1).is_none());
    }
}
