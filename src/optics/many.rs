//! Many rays side by side: the same steps as for one, without branches, so that vectors of rays take them together.

use nalgebra::{Matrix3, Point3, Vector3};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::Conic;
use super::lanes::{Lanes, inverses};
use super::placed::{CONVERGED_MM, PlacedMirrors};

/// Rays whose coordinates lie side by side.
const BLOCK: usize = 64;
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
        if self.figure.is_some() {
            out.par_iter_mut().zip(rays).for_each(|(out, ray)| *out = self.leaving(ray));
            return;
        }
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
    to_convex: Change,
    convex_to_dome: Change,
    from_dome: Change,
    mirror: Conic,
    /// The dome where it is one.
    ellipsoid: Option<Conic>,
    centre: f64,
    length: f64,
}

impl Constants {
    fn new(placed: &PlacedMirrors) -> Self {
        let mirrors = &placed.mirrors;
        let ((convex, at), (dome, dome_at)) = (placed.convex.inside(), placed.dome.inside());
        Self {
            to_convex: Change::new(convex, -convex * at),
            convex_to_dome: Change::new(dome * convex.transpose(), dome * (at - dome_at)),
            from_dome: Change::new(dome.transpose(), dome_at),
            mirror: *mirrors.convex(),
            ellipsoid: mirrors.ellipsoid(),
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
    last_step: Column,
}

impl Block {
    #[inline(always)]
    fn fill(&mut self, rays: &[Ray; BLOCK]) {
        for (i, ray) in rays.iter().enumerate() {
            for axis in 0..3 {
                self.p[axis][i] = ray.origin[axis];
                self.d[axis][i] = ray.direction[axis];
            }
        }
    }

    /// Whether all rays arrived.
    #[inline(always)]
    fn follow<S: Simd>(&mut self, simd: S, c: &Constants) -> bool {
        let mut steps = Lanes::all(simd, 0.0);
        for first in (0..BLOCK).step_by(Lanes::<S>::COUNT) {
            let at = |column: &Column| Lanes::load(simd, &column[first..]);
            let ray = follow(c, self.p.each_ref().map(at), self.d.each_ref().map(at));
            for axis in 0..3 {
                ray.dome[axis].store(&mut self.p[axis][first..]);
                ray.out[axis].store(&mut self.d[axis][first..]);
            }
            ray.rho.store(&mut self.rho[first..]);
            ray.last_step.store(&mut self.last_step[first..]);
            steps = steps + ray.last_step;
        }
        steps.sum() < CONVERGED_MM
    }

    #[inline(always)]
    fn leaving(&self, i: usize) -> Leaving {
        let of = |v: &[Column; 3]| [v[0][i], v[1][i], v[2][i]];
        Leaving { rho: self.rho[i], dome: of(&self.p), out: of(&self.d) }
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
    fn with_simd<S: Simd>(self, simd: S) {
        let mut block =
            Block { p: [[0.0; BLOCK]; 3], d: [[0.0; BLOCK]; 3], rho: [0.0; BLOCK], last_step: [0.0; BLOCK] };
        let (rays, rest) = self.rays.as_chunks::<BLOCK>();
        let (out, last) = self.out.as_chunks_mut::<BLOCK>();
        for (rays, out) in rays.iter().zip(out) {
            block.fill(rays);
            let arrived = block.follow(simd, self.constants);
            for (i, out) in out.iter_mut().enumerate() {
                *out = block.leaving(i);
            }
            if !arrived {
                let alone = |i: &usize| block.last_step[*i].is_nan() || block.last_step[*i] >= CONVERGED_MM;
                (0..BLOCK).filter(alone).for_each(|i| out[i] = self.placed.leaving(&rays[i]));
            }
        }
        for (ray, out) in rest.iter().zip(last) {
            *out = self.placed.leaving(ray);
        }
    }
}

type Vector<S> = [Lanes<S>; 3];

struct Followed<S: Simd> {
    dome: Vector<S>,
    out: Vector<S>,
    rho: Lanes<S>,
    last_step: Lanes<S>,
}

#[inline(always)]
fn dot<S: Simd>(a: Vector<S>, b: Vector<S>) -> Lanes<S> {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

#[inline(always)]
fn along<S: Simd>(p: Vector<S>, d: Vector<S>, t: Lanes<S>) -> Vector<S> {
    [t.mul_add(d[0], p[0]), t.mul_add(d[1], p[1]), t.mul_add(d[2], p[2])]
}

/// From one frame to another: m v + by.
struct Change {
    /// `None` where neither is turned.
    m: Option<Matrix3<f64>>,
    by: Vector3<f64>,
}

impl Change {
    fn new(m: Matrix3<f64>, by: Vector3<f64>) -> Self {
        Self { m: (m != Matrix3::identity()).then_some(m), by }
    }

    #[inline(always)]
    fn direction<S: Simd>(&self, v: Vector<S>) -> Vector<S> {
        let Some(m) = &self.m else { return v };
        let all = |i: usize, j: usize| Lanes::all(v[0].simd, m[(i, j)]);
        let row = |i: usize| dot([all(i, 0), all(i, 1), all(i, 2)], v);
        [row(0), row(1), row(2)]
    }

    #[inline(always)]
    fn point<S: Simd>(&self, p: Vector<S>) -> Vector<S> {
        let turned = self.direction(p);
        [turned[0] + self.by.x, turned[1] + self.by.y, turned[2] + self.by.z]
    }
}

/// The steps of [`PlacedMirrors::trace`] without branches: what went wrong shows in `last_step`, NaN included.
#[inline(always)]
fn follow<S: Simd>(c: &Constants, origin: Vector<S>, direction: Vector<S>) -> Followed<S> {
    let simd = origin[0].simd;
    let (nan, zero) = (Lanes::all(simd, f64::NAN), Lanes::all(simd, 0.0));
    // The convex mirror: see `Conic::hit`.
    let (o, e) = (c.to_convex.point(origin), c.to_convex.direction(direction));
    let quadratic = Quadratic::new(&c.mirror, o, e);
    // c / w is the near root; but a ray steeper than the asymptotes meets the other sheet first, if it begins within it.
    let w = quadratic.w();
    let steep = quadratic.a.if_negative(quadratic.c.if_negative(zero - 1.0, w), zero);
    let t = quadratic.root(w, steep);
    let p = along(o, e, t);
    let behind = (-t).if_negative(zero, nan);
    let below = (p[2] - (c.mirror.vertex_height + 1e-9)).if_negative(zero, nan);
    let reflected = reflected(e, normal(&c.mirror, p));
    let rho = p[0].mul_add(p[0], p[1] * p[1]).sqrt();
    let (o, d) = (c.convex_to_dome.point(p), c.convex_to_dome.direction(reflected));
    let (hit, normal, last_step) = match &c.ellipsoid {
        Some(ellipsoid) => meet_ellipsoid(ellipsoid, o, d),
        None => meet_dome(c, o, d),
    };
    let out = self::reflected(d, normal);
    Followed {
        dome: c.from_dome.point(hit),
        out: c.from_dome.direction(out),
        rho,
        last_step: last_step + behind + below,
    }
}

/// a t^2 + 2 b t + c of a ray and a conic.
struct Quadratic<S: Simd> {
    a: Lanes<S>,
    b: Lanes<S>,
    c: Lanes<S>,
}

impl<S: Simd> Quadratic<S> {
    #[inline(always)]
    fn new(conic: &Conic, o: Vector<S>, e: Vector<S>) -> Self {
        let k = 1.0 + conic.constant;
        // Depth below the vertex, and the normal's part along the axis.
        let q = conic.vertex_height - o[2];
        let n = conic.radius - k * q;
        Self {
            a: e[0].mul_add(e[0], e[1].mul_add(e[1], k * e[2] * e[2])),
            b: dot([o[0], o[1], n], e),
            c: o[0].mul_add(o[0], o[1].mul_add(o[1], -(n + conic.radius) * q)),
        }
    }

    /// The roots are c / w, of smaller size, and w / a, neither with cancellation.
    #[inline(always)]
    fn w(&self) -> Lanes<S> {
        let root = self.b.mul_add(self.b, -self.a * self.c).sqrt();
        -(self.b + self.b.if_negative(-root, root))
    }

    /// w / a where `choice` is negative, else c / w.
    #[inline(always)]
    fn root(&self, w: Lanes<S>, choice: Lanes<S>) -> Lanes<S> {
        choice.if_negative(w, self.c) / choice.if_negative(self.a, w)
    }
}

/// [`Conic::normal`].
#[inline(always)]
fn normal<S: Simd>(conic: &Conic, p: Vector<S>) -> Vector<S> {
    [p[0], p[1], conic.radius - (1.0 + conic.constant) * (conic.vertex_height - p[2])]
}

#[inline(always)]
fn reflected<S: Simd>(e: Vector<S>, n: Vector<S>) -> Vector<S> {
    along(e, n, -2.0 * dot(e, n) / dot(n, n))
}

/// The point, the normal and no step: from inside, where only one root lies ahead.
#[inline(always)]
fn meet_ellipsoid<S: Simd>(ellipsoid: &Conic, o: Vector<S>, d: Vector<S>) -> (Vector<S>, Vector<S>, Lanes<S>) {
    let quadratic = Quadratic::new(ellipsoid, o, d);
    let w = quadratic.w();
    let t = quadratic.root(w, -w);
    let hit = along(o, d, t);
    let (nan, zero) = (Lanes::all(t.simd, f64::NAN), Lanes::all(t.simd, 0.0));
    (hit, normal(ellipsoid, hit), (-t).if_negative(zero, nan))
}

/// The point, the normal and the last step of Newton: see `PlacedMirrors::meet_dome`.
#[inline(always)]
fn meet_dome<S: Simd>(c: &Constants, o: Vector<S>, d: Vector<S>) -> (Vector<S>, Vector<S>, Lanes<S>) {
    let (radius, vertex, k) = (c.mirror.radius, c.mirror.vertex_height, 1.0 + c.mirror.constant);
    let mut rho = (o[0] * o[0] + o[1] * o[1]).sqrt();
    let from_centre = (o[0] * o[0] + o[1] * o[1] + (o[2] - c.centre) * (o[2] - c.centre)).sqrt();
    let left = c.length - from_centre;
    let mut t = (left * left - dot(o, o)) / (2.0 * (dot(o, d) + left));
    let mut gradient = o;
    let mut last_step = t;
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

    /// A paraboloid, whose dome is no conic; a hyperboloid whose dome is an ellipsoid; one with its focus elsewhere.
    #[test]
    fn many_rays_go_where_each_goes_alone() {
        let paraboloid = Conic { vertex_height: 135.0, radius: 8.0, constant: -1.0 };
        for convex in [paraboloid, Conic::hyperboloid(135.0, 8.0, 405.0), Conic::hyperboloid(135.0, 8.0, 500.0)] {
            let mirrors = Mirrors::new(405.0, convex, 126.5).unwrap();
            assert_eq!(mirrors.ellipsoid().is_some(), (convex.foci()[1] + 270.0).abs() < 1e-9);
            let nominal = PlacedMirrors::nominal(mirrors);
            let placed = PlacedMirrors {
                convex: Pose::new(Vector3::new(0.1, -0.2, 0.05), [0.003, -0.002], 135.0),
                dome: Pose::new(Vector3::new(-0.3, 0.1, 0.2), [-0.002, 0.004], 0.0),
                ..nominal.clone()
            };
            compare(&nominal, &convex);
            compare(&placed, &convex);
        }
    }

    fn compare(placed: &PlacedMirrors, convex: &Conic) {
        let ray = |i: u32| {
            let (phi, rho) = (2.4 * f64::from(i), 2.0 + 16.0 * f64::from(i) / 1000.0);
            let origin = Point3::new(12.0 * (0.7 * phi).cos(), 12.0 * (1.3 * phi).sin(), 405.0);
            let target = Point3::new(rho * phi.cos(), rho * phi.sin(), convex.height(rho));
            Ray { origin: origin.into(), direction: (target - origin).normalize().into() }
        };
        let mut rays: Vec<Ray> = (0..1000).map(ray).collect();
        // Beside the mirror.
        rays[500] = Ray { origin: [0.0, 0.0, 405.0], direction: [0.6, 0.0, -0.8] };
        let many = placed.trace_many(&rays);
        assert!(many[500].rho.is_nan() && many[999].rho > 0.0);
        for (i, (ray, got)) in rays.iter().zip(&many).enumerate().filter(|(i, _)| *i != 500) {
            let want = placed.leaving(ray);
            for axis in 0..3 {
                assert!((got.dome[axis] - want.dome[axis]).abs() < 1e-9, "{i}: {got:?} {want:?}");
                assert!((got.out[axis] - want.out[axis]).abs() < 1e-9, "{i}: {got:?} {want:?}");
            }
        }
    }
}
