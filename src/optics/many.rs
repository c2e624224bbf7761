//! Many rays side by side: the same steps as for one, without branches, so that vectors of rays take them together.

use nalgebra::{Matrix3, Point3, Vector3};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::placed::{CONVERGED_MM, PlacedMirrors};

/// Rays whose coordinates lie side by side.
const BLOCK: usize = 64;
/// Rays one core takes at a time.
const SHARE: usize = 4096;
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
            for (out, rays) in out.chunks_mut(BLOCK).zip(rays.chunks(BLOCK)) {
                let mut block = Block::new(rays);
                arch.dispatch(Following { block: &mut block, constants: &constants });
                for (i, (out, ray)) in out.iter_mut().zip(rays).enumerate() {
                    *out = if self.figure.is_none() && block.last_step[i] < CONVERGED_MM {
                        block.leaving(i)
                    } else {
                        self.leaving(ray)
                    };
                }
            }
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
    vertex: f64,
    radius: f64,
    /// 1 + kappa.
    k: f64,
    centre: f64,
    length: f64,
}

impl Constants {
    fn new(placed: &PlacedMirrors) -> Self {
        let (mirrors, convex) = (&placed.mirrors, placed.mirrors.convex());
        Self {
            convex: placed.convex.inside(),
            dome: placed.dome.inside(),
            vertex: convex.vertex_height,
            radius: convex.radius,
            k: 1.0 + convex.constant,
            centre: mirrors.centre().z,
            length: mirrors.path_length(),
        }
    }
}

type Column = [f64; BLOCK];

/// Coordinates side by side: of origins and directions first, of points of the dome and ways out afterwards.
struct Block {
    p: [Column; 3],
    d: [Column; 3],
    rho: Column,
    /// The larger of the last steps along ray and meridian, mm.
    last_step: Column,
}

impl Block {
    fn new(rays: &[Ray]) -> Self {
        let mut block =
            Self { p: [[0.0; BLOCK]; 3], d: [[0.0; BLOCK]; 3], rho: [0.0; BLOCK], last_step: [f64::INFINITY; BLOCK] };
        for (i, ray) in rays.iter().enumerate() {
            for axis in 0..3 {
                block.p[axis][i] = ray.origin[axis];
                block.d[axis][i] = ray.direction[axis];
            }
        }
        block
    }

    fn leaving(&self, i: usize) -> Leaving {
        Leaving { rho: self.rho[i], dome: self.p.map(|c| c[i]), out: self.d.map(|c| c[i]) }
    }

    #[inline(always)]
    fn follow(&mut self, c: &Constants) {
        for first in (0..BLOCK).step_by(LANES) {
            let at = |column: &Column| Lanes::each(|i| column[first + i]);
            let ray = follow(c, self.p.each_ref().map(at), self.d.each_ref().map(at));
            let put = |column: &mut Column, x: Lanes| column[first..first + LANES].copy_from_slice(&x.0);
            for axis in 0..3 {
                put(&mut self.p[axis], ray.dome[axis]);
                put(&mut self.d[axis], ray.out[axis]);
            }
            put(&mut self.rho, ray.rho);
            put(&mut self.last_step, ray.last_step);
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

/// A block on its way, for the widest vectors the processor has.
struct Following<'a> {
    block: &'a mut Block,
    constants: &'a Constants,
}

impl WithSimd for Following<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.block.follow(self.constants);
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
    // The convex mirror, in its own frame: see `Conic::hit`. The way begins above its vertex, so the root of less
    // cancellation is the near one.
    let o = turned(&c.convex.0, less(origin, &c.convex.1), false);
    let e = turned(&c.convex.0, direction, false);
    let (q, dq) = (c.vertex - o[2], -e[2]);
    let a = e[0] * e[0] + e[1] * e[1] + c.k * dq * dq;
    let b = o[0] * e[0] + o[1] * e[1] - c.radius * dq + c.k * q * dq;
    let cc = o[0] * o[0] + o[1] * o[1] - 2.0 * c.radius * q + c.k * q * q;
    let root = (b * b - a * cc).sqrt();
    let w = -(b + Lanes::each(|i| root.0[i].copysign(b.0[i])));
    let [per_a, per_w] = inverses([a, w]);
    let (t0, t1) = (cc * per_w, w * per_a);
    let (q0, q1) = (q + t0 * dq, q + t1 * dq);
    // Without short circuits, which vectors do not have.
    let valid = |t: f64, q: f64| if (t > 0.0) & (q > -1e-9) { t } else { f64::INFINITY };
    let t = Lanes::each(|i| valid(t0.0[i], q0.0[i]).min(valid(t1.0[i], q1.0[i])));
    let p = along(o, e, t);
    let n = [p[0], p[1], c.radius - c.k * (c.vertex - p[2])];
    let turn = -2.0 * dot(e, n) / dot(n, n);
    let reflected = along(e, n, turn);
    let met = (p[0] * p[0] + p[1] * p[1]).sqrt();
    // The dome, in its own frame.
    let rig = turned(&c.convex.0, p, true);
    let rig = [rig[0] + c.convex.1.x, rig[1] + c.convex.1.y, rig[2] + c.convex.1.z];
    let o = turned(&c.dome.0, less(rig, &c.dome.1), false);
    let d = turned(&c.dome.0, turned(&c.convex.0, reflected, true), false);
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
        let n = (c.radius * c.radius - c.k * rho * rho).sqrt();
        let [per_n, per_sum] = inverses([n, c.radius + n]);
        let height = c.vertex - rho * rho * per_sum;
        let tan_beta = rho * per_n;
        let bend = (1.0 + c.k * tan_beta * tan_beta) * per_n;
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
    let hit = along(o, d, t);
    let turn = -2.0 * dot(d, gradient) / dot(gradient, gradient);
    let out = along(d, gradient, turn);
    let hit = turned(&c.dome.0, hit, true);
    Followed {
        dome: [hit[0] + c.dome.1.x, hit[1] + c.dome.1.y, hit[2] + c.dome.1.z],
        out: turned(&c.dome.0, out, true),
        rho: met,
        last_step,
    }
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
