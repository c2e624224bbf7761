//! Many rays side by side: the same steps as for one, without branches, so that vectors of rays take them together.

use nalgebra::{Matrix3, Point3, Vector3};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::Conic;
use super::placed::{CONVERGED_MM, PlacedMirrors};

/// Rays one core takes at a time.
const SHARE: usize = 1024;
/// Newton steps that rays of any pupil of a rig need; what they do not suffice for is followed alone.
const STEPS: usize = 3;

/// A ray: origin (mm) and unit vector, rig frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where it begins.
    pub origin: [f64; 3],
    /// Where it goes.
    pub direction: [f64; 3],
}

/// Where a ray leaves the dome, rig frame; NaN if it misses a mirror.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leaving {
    /// Distance of its point of the convex mirror from that mirror's axis, mm.
    pub rho: f64,
    /// Its point of the dome, mm.
    pub dome: [f64; 3],
    /// Unit vector along which it leaves.
    pub out: [f64; 3],
}

/// Of a ray that misses a mirror.
const NOWHERE: Leaving = Leaving { rho: f64::NAN, dome: [f64::NAN; 3], out: [f64::NAN; 3] };

impl PlacedMirrors {
    /// [`PlacedMirrors::trace`] for many rays, on all cores, into `out`: in the order of the rays, whatever the number of cores.
    ///
    /// # Panics
    /// If `out` is not as long as `rays`.
    pub fn trace_many_into(&self, rays: &[Ray], out: &mut [Leaving]) {
        assert_eq!(rays.len(), out.len(), "a place for each ray");
        let constants = Constants::new(self);
        let arch = Arch::new();
        out.par_chunks_mut(SHARE).zip(rays.par_chunks(SHARE)).for_each(|(out, rays)| {
            arch.dispatch(Following { placed: self, constants: &constants, rays, out });
        });
    }

    /// [`PlacedMirrors::trace_many_into`] a new list.
    pub fn trace_many(&self, rays: &[Ray]) -> Vec<Leaving> {
        let mut out = vec![NOWHERE; rays.len()];
        self.trace_many_into(rays, &mut out);
        out
    }

    fn leaving(&self, ray: &Ray) -> Leaving {
        let traced = self.trace(&Point3::from(ray.origin), &Vector3::from(ray.direction));
        traced.map_or(NOWHERE, |t| Leaving { rho: t.rho, dome: t.dome.into(), out: t.out.into() })
    }
}

/// What all rays share.
struct Constants {
    /// Rig to convex mirror: rotation, then origin in the rig.
    convex: (Matrix3<f64>, Vector3<f64>),
    /// Rig to dome.
    dome: (Matrix3<f64>, Vector3<f64>),
    mirror: Conic,
    /// The dome where it is one.
    ellipsoid: Option<Conic>,
    centre: f64,
    length: f64,
}

impl Constants {
    fn new(placed: &PlacedMirrors) -> Self {
        let mirrors = &placed.mirrors;
        Self {
            convex: placed.convex.inside(),
            dome: placed.dome.inside(),
            mirror: *mirrors.convex(),
            ellipsoid: mirrors.ellipsoid(),
            centre: mirrors.centre().z,
            length: mirrors.path_length(),
        }
    }
}

/// Rays that one instruction takes together.
const LANES: usize = 8;

/// Numbers side by side: what is done to one is done to all.
#[derive(Clone, Copy)]
struct Lanes([f64; LANES]);

impl Lanes {
    #[inline(always)]
    fn all(x: f64) -> Self {
        Self([x; LANES])
    }

    #[inline(always)]
    fn each(f: impl Fn(usize) -> f64) -> Self {
        Self(std::array::from_fn(f))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self::each(|i| self.0[i].sqrt())
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self::each(|i| self.0[i].abs())
    }
}

macro_rules! operator {
    ($name:ident, $function:ident, $operator:tt) => {
        impl std::ops::$name for Lanes {
            type Output = Self;
            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                Self::each(|i| self.0[i] $operator other.0[i])
            }
        }

        impl std::ops::$name<Lanes> for f64 {
            type Output = Lanes;
            #[inline(always)]
            fn $function(self, other: Lanes) -> Lanes {
                Lanes::each(|i| self $operator other.0[i])
            }
        }

        impl std::ops::$name<f64> for Lanes {
            type Output = Self;
            #[inline(always)]
            fn $function(self, other: f64) -> Self {
                Self::each(|i| self.0[i] $operator other)
            }
        }
    };
}

operator!(Add, add, +);
operator!(Sub, sub, -);
operator!(Mul, mul, *);
operator!(Div, div, /);

impl std::ops::Neg for Lanes {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self::each(|i| -self.0[i])
    }
}

/// A core's share of rays, for the widest vectors the processor has.
struct Following<'a> {
    placed: &'a PlacedMirrors,
    constants: &'a Constants,
    rays: &'a [Ray],
    out: &'a mut [Leaving],
}

impl WithSimd for Following<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let (full, rest) = self.rays.as_chunks::<LANES>();
        let (out, last) = self.out.as_chunks_mut::<LANES>();
        for (rays, out) in full.iter().zip(out) {
            let at = |axis: usize| Lanes::each(|i| rays[i].origin[axis]);
            let towards = |axis: usize| Lanes::each(|i| rays[i].direction[axis]);
            let ray = follow(self.constants, [at(0), at(1), at(2)], [towards(0), towards(1), towards(2)]);
            for i in 0..LANES {
                let of = |v: &[Lanes; 3]| [v[0].0[i], v[1].0[i], v[2].0[i]];
                out[i] = Leaving { rho: ray.rho.0[i], dome: of(&ray.dome), out: of(&ray.out) };
            }
            if self.placed.figure.is_some() || !ray.last_step.0.iter().all(|s| *s < CONVERGED_MM) {
                for i in 0..LANES {
                    if self.placed.figure.is_some() || !(ray.last_step.0[i] < CONVERGED_MM) {
                        out[i] = self.placed.leaving(&rays[i]);
                    }
                }
            }
        }
        for (ray, out) in rest.iter().zip(last) {
            *out = self.placed.leaving(ray);
        }
    }
}

struct Followed {
    dome: [Lanes; 3],
    out: [Lanes; 3],
    rho: Lanes,
    last_step: Lanes,
}

#[inline(always)]
fn dot(a: [Lanes; 3], b: [Lanes; 3]) -> Lanes {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// m v, or its transpose.
#[inline(always)]
fn turned(m: &Matrix3<f64>, v: [Lanes; 3], back: bool) -> [Lanes; 3] {
    let e = |i: usize, j: usize| if back { m[(j, i)] } else { m[(i, j)] };
    let row = |i: usize| e(i, 0) * v[0] + e(i, 1) * v[1] + e(i, 2) * v[2];
    [row(0), row(1), row(2)]
}

/// 1 / x of each by one division: what takes longest.
#[inline(always)]
fn inverses<const N: usize>(x: [Lanes; N]) -> [Lanes; N] {
    let mut before = [Lanes::all(1.0); N];
    for i in 1..N {
        before[i] = before[i - 1] * x[i - 1];
    }
    let mut rest = 1.0 / (before[N - 1] * x[N - 1]);
    for i in (0..N).rev() {
        before[i] = rest * before[i];
        rest = rest * x[i];
    }
    before
}

#[inline(always)]
fn less(a: [Lanes; 3], b: &Vector3<f64>) -> [Lanes; 3] {
    [a[0] - b.x, a[1] - b.y, a[2] - b.z]
}

#[inline(always)]
fn along(p: [Lanes; 3], d: [Lanes; 3], t: Lanes) -> [Lanes; 3] {
    [p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]]
}

/// The steps of [`PlacedMirrors::trace`] without branches: what went wrong shows in `last_step`, NaN included.
#[inline(always)]
fn follow(c: &Constants, origin: [Lanes; 3], direction: [Lanes; 3]) -> Followed {
    // The convex mirror, in its own frame: see `Conic::hit`.
    let o = turned(&c.convex.0, less(origin, &c.convex.1), false);
    let e = turned(&c.convex.0, direction, false);
    let quadratic = Quadratic::new(&c.mirror, o, e);
    // c / w is the near root; but a ray steeper than the asymptotes meets the other sheet first, if it begins within it.
    let w = quadratic.w();
    let t = quadratic.root(w, |a, c, w| (a < 0.0) & ((c < 0.0) | (w < 0.0)));
    let depth = c.mirror.vertex_height - o[2] - t * e[2];
    let missed = Lanes::each(|i| if (t.0[i] > 0.0) & (depth.0[i] > -1e-9) { 0.0 } else { f64::NAN });
    let p = along(o, e, t);
    let reflected = reflected(e, normal(&c.mirror, p));
    let rho = (p[0] * p[0] + p[1] * p[1]).sqrt();
    // The dome, in its own frame.
    let rig = turned(&c.convex.0, p, true);
    let rig = [rig[0] + c.convex.1.x, rig[1] + c.convex.1.y, rig[2] + c.convex.1.z];
    let o = turned(&c.dome.0, less(rig, &c.dome.1), false);
    let d = turned(&c.dome.0, turned(&c.convex.0, reflected, true), false);
    let (hit, normal, last_step) = match &c.ellipsoid {
        Some(ellipsoid) => meet_ellipsoid(ellipsoid, o, d),
        None => meet_dome(c, o, d),
    };
    let out = self::reflected(d, normal);
    let hit = turned(&c.dome.0, hit, true);
    Followed {
        dome: [hit[0] + c.dome.1.x, hit[1] + c.dome.1.y, hit[2] + c.dome.1.z],
        out: turned(&c.dome.0, out, true),
        rho,
        last_step: last_step + missed,
    }
}

/// a t^2 + 2 b t + c of a ray and a conic.
struct Quadratic {
    a: Lanes,
    b: Lanes,
    c: Lanes,
}

impl Quadratic {
    #[inline(always)]
    fn new(conic: &Conic, o: [Lanes; 3], e: [Lanes; 3]) -> Self {
        let k = 1.0 + conic.constant;
        let (q, dq) = (conic.vertex_height - o[2], -e[2]);
        Self {
            a: e[0] * e[0] + e[1] * e[1] + k * dq * dq,
            b: o[0] * e[0] + o[1] * e[1] - conic.radius * dq + k * q * dq,
            c: o[0] * o[0] + o[1] * o[1] - 2.0 * conic.radius * q + k * q * q,
        }
    }

    /// The roots are c / w, of smaller size, and w / a, neither with cancellation.
    #[inline(always)]
    fn w(&self) -> Lanes {
        let root = (self.b * self.b - self.a * self.c).sqrt();
        -(self.b + Lanes::each(|i| root.0[i].copysign(self.b.0[i])))
    }

    /// w / a where a, c and w say so, else c / w.
    #[inline(always)]
    fn root(&self, w: Lanes, larger: impl Fn(f64, f64, f64) -> bool) -> Lanes {
        let larger = |i: usize| larger(self.a.0[i], self.c.0[i], w.0[i]);
        Lanes::each(|i| if larger(i) { w.0[i] } else { self.c.0[i] })
            / Lanes::each(|i| if larger(i) { self.a.0[i] } else { w.0[i] })
    }
}

/// [`Conic::normal`].
#[inline(always)]
fn normal(conic: &Conic, p: [Lanes; 3]) -> [Lanes; 3] {
    [p[0], p[1], conic.radius - (1.0 + conic.constant) * (conic.vertex_height - p[2])]
}

#[inline(always)]
fn reflected(e: [Lanes; 3], n: [Lanes; 3]) -> [Lanes; 3] {
    along(e, n, -2.0 * dot(e, n) / dot(n, n))
}

/// The point, the normal and no step: from inside, where only one root lies ahead.
#[inline(always)]
fn meet_ellipsoid(ellipsoid: &Conic, o: [Lanes; 3], d: [Lanes; 3]) -> ([Lanes; 3], [Lanes; 3], Lanes) {
    let quadratic = Quadratic::new(ellipsoid, o, d);
    let t = quadratic.root(quadratic.w(), |_, _, w| w > 0.0);
    let hit = along(o, d, t);
    (hit, normal(ellipsoid, hit), Lanes::each(|i| if t.0[i] > 0.0 { 0.0 } else { f64::NAN }))
}

/// The point, the normal and the last step of Newton: see `PlacedMirrors::meet_dome`.
#[inline(always)]
fn meet_dome(c: &Constants, o: [Lanes; 3], d: [Lanes; 3]) -> ([Lanes; 3], [Lanes; 3], Lanes) {
    let (radius, vertex, k) = (c.mirror.radius, c.mirror.vertex_height, 1.0 + c.mirror.constant);
    let mut rho = (o[0] * o[0] + o[1] * o[1]).sqrt();
    let from_centre = (o[0] * o[0] + o[1] * o[1] + (o[2] - c.centre) * (o[2] - c.centre)).sqrt();
    let left = c.length - from_centre;
    let mut t = (left * left - dot(o, o)) / (2.0 * (dot(o, d) + left));
    let mut gradient = [Lanes::all(0.0); 3];
    let mut last_step = Lanes::all(0.0);
    for _ in 0..STEPS {
        let x = along(o, d, t);
        let r2 = x[0] * x[0] + x[1] * x[1];
        let (r, to_sample) = (r2.sqrt(), (r2 + x[2] * x[2]).sqrt());
        // The normal's part along the axis: radius - k sag.
        let n = (radius * radius - k * rho * rho).sqrt();
        let [per_n, per_sum] = inverses([n, radius + n]);
        let height = vertex - rho * rho * per_sum;
        let tan_beta = rho * per_n;
        let bend = (1.0 + k * tan_beta * tan_beta) * per_n;
        let (a_z, b_r, b_z) = (height - c.centre, r - rho, x[2] - height);
        let (a, b) = ((rho * rho + a_z * a_z).sqrt(), (b_r * b_r + b_z * b_z).sqrt());
        let [per_a, per_b, per_r, per_x] = inverses([a, b, r, to_sample]);
        let (u_r, u_z) = (b_r * per_b, b_z * per_b);
        let (along_a, along_b) = ((rho - a_z * tan_beta) * per_a, u_r - u_z * tan_beta);
        let p2 = 1.0 + tan_beta * tan_beta;
        let by_rho = along_a - along_b;
        let by_rho_rho =
            (p2 - along_a * along_a) * per_a + (p2 - along_b * along_b) * per_b - (a_z * per_a - u_z) * bend;
        let d_r = (d[0] * x[0] + d[1] * x[1]) * per_r;
        let by_rho_t = -(d_r - d[2] * tan_beta - along_b * (u_r * d_r + u_z * d[2])) * per_b;
        let outwards = u_r * per_r + per_x;
        gradient = [outwards * x[0], outwards * x[1], u_z + x[2] * per_x];
        let by_t = dot(d, gradient);
        let excess = a + b + to_sample - c.length;
        let per_determinant = 1.0 / (by_t * by_rho_rho - by_rho * by_rho_t);
        let dt = -(excess * by_rho_rho - by_rho * by_rho) * per_determinant;
        let drho = -(by_t * by_rho - by_rho_t * excess) * per_determinant;
        (t, rho) = (t + dt, rho + drho);
        last_step = dt.abs() + drho.abs();
    }
    (along(o, d, t), gradient, last_step)
}

#[cfg(test)]
mod tests {
    use super::super::{Conic, Mirrors, Pose};
    use super::*;

    #[test]
    fn many_rays_go_where_each_goes_alone() {
        let convex = Conic { vertex_height: 135.0, radius: 8.0, constant: -1.0 };
        let mirrors = Mirrors::new(405.0, convex, 126.5).unwrap();
        let placed = PlacedMirrors {
            convex: Pose::new(Vector3::new(0.1, -0.2, 0.05), [0.003, -0.002], 135.0),
            dome: Pose::new(Vector3::new(-0.3, 0.1, 0.2), [-0.002, 0.004], 0.0),
            ..PlacedMirrors::nominal(mirrors)
        };
        let ray = |i: u32| {
            let (phi, rho) = (2.4 * f64::from(i), 2.0 + 16.0 * f64::from(i) / 1000.0);
            let origin = Point3::new(12.0 * (0.7 * phi).cos(), 12.0 * (1.3 * phi).sin(), 405.0);
            let target = Point3::new(rho * phi.cos(), rho * phi.sin(), convex.height(rho));
            Ray { origin: origin.into(), direction: (target - origin).normalize().into() }
        };
        let mut rays: Vec<Ray> = (0..1000).map(ray).collect();
        rays.push(Ray { origin: [0.0, 0.0, 405.0], direction: [0.6, 0.0, -0.8] }); // beside the mirror
        let many = placed.trace_many(&rays);
        for (i, (ray, got)) in rays.iter().zip(&many).enumerate() {
            let want = placed.leaving(ray);
            if want.rho.is_nan() {
                assert!(got.rho.is_nan(), "{i}");
                continue;
            }
            for axis in 0..3 {
                assert!((got.dome[axis] - want.dome[axis]).abs() < 1e-9, "{i}: {got:?} {want:?}");
                assert!((got.out[axis] - want.out[axis]).abs() < 1e-9, "{i}: {got:?} {want:?}");
            }
        }
        assert!(many[1000].rho.is_nan() && many[999].rho > 0.0);
    }
}
