//! Evaluation of zonal functions and real spherical harmonics by stable normalised recurrences.

use std::f64::consts::PI;

use thiserror::Error;

use crate::geometry::{Direction, Sample, Zone};

/// Largest order that is evaluated; the accuracy statements hold up to it.
pub const MAX_ORDER: usize = 50;

/// An order outside the tested range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error(
    "order {0} is out of range: choose 0..={MAX_ORDER} (an acquisition of order 10 is 726 frames with 3 exposures)"
)]
pub struct OrderError(pub usize);

/// Number of functions up to and including `order`: (order + 1)^2.
pub const fn size(order: usize) -> usize {
    (order + 1) * (order + 1)
}

/// Index k = l(l+1) + m of the function (l, m), |m| <= l.
pub const fn index(l: usize, m: i32) -> usize {
    (l * (l + 1)).wrapping_add_signed(m as isize)
}

/// The (l, m) of index k.
pub fn lm(k: usize) -> (usize, i32) {
    let l = k.isqrt();
    (l, k as i32 - (l * (l + 1)) as i32)
}

/// The orthonormal real basis of one zone (Ghosh 2007, eq. 3.9-3.11) up to an order; on the sphere, real SH (3.7-3.8).
///
/// With x' = ((mu-a) + (mu-b)) / (a-b) and s' = 2 sqrt((a-mu)(mu-b)) / (a-b) the functions are
/// `N_lm P_lm(x') {1, sqrt2 cos(m phi), sqrt2 sin(|m| phi)}`; N absorbs sqrt(2 / (a-b)), so that they are orthonormal
/// over the zone. The recurrence runs on normalised functions: no factorial appears.
#[derive(Debug, Clone)]
pub struct Harmonics {
    pub(super) order: usize,
    pub(super) zone: Zone,
    /// Per m, per l >= m: factors of P_{l-1} x and P_{l-2}; for l = m the first is the step from P_{m-1,m-1}.
    pub(super) steps: Vec<Vec<(f64, f64)>>,
}

/// A polar angle as the recurrences take it.
struct Stretched {
    /// x' = ((mu - a) + (mu - b)) / (a - b).
    x: f64,
    /// sqrt(|1 - x'^2|).
    root: f64,
    /// Sign of x', +1 at 0.
    sign: f64,
    /// 1 - |x'|.
    end: f64,
}

impl Harmonics {
    /// The zonal basis of `zone` up to `order`.
    ///
    /// # Errors
    /// [`OrderError`] above [`MAX_ORDER`].
    pub fn zonal(zone: Zone, order: usize) -> Result<Self, OrderError> {
        if order > MAX_ORDER {
            return Err(OrderError(order));
        }
        let steps = (0..=order)
            .map(|m| {
                let m2 = (m * m) as f64;
                (m..=order)
                    .map(|l| {
                        let l2 = (l * l) as f64;
                        if l == m {
                            let step = if m == 0 { 0.0 } else { ((2 * m + 1) as f64 / (2 * m) as f64).sqrt() };
                            (step, 0.0)
                        } else {
                            let scale = ((4.0 * l2 - 1.0) / (l2 - m2)).sqrt();
                            let before = ((l - 1) * (l - 1)) as f64;
                            let second = if l > m + 1 { ((before - m2) / (4.0 * before - 1.0)).sqrt() } else { 0.0 };
                            (scale, scale * second)
                        }
                    })
                    .collect()
            })
            .collect();
        Ok(Self { order, zone, steps })
    }

    /// Real spherical harmonics up to `order`.
    ///
    /// # Errors
    /// [`OrderError`] above [`MAX_ORDER`].
    pub fn spherical(order: usize) -> Result<Self, OrderError> {
        Self::zonal(Zone::sphere(), order)
    }

    /// The order L.
    pub fn order(&self) -> usize {
        self.order
    }

    /// The zone of orthonormality.
    pub fn zone(&self) -> Zone {
        self.zone
    }

    /// Number of functions, (L+1)^2.
    pub fn len(&self) -> usize {
        size(self.order)
    }

    /// Never true: order 0 has one function.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The normalised polar parts N_lm P_lm(x') for l = m..=L at mu = cos(theta), without sqrt2 and azimuth.
    ///
    /// Outside the zone the polynomial of even m continues; for odd m the square root of |1 - x'^2| does.
    pub fn polar_parts(&self, m: usize, mu: f64, out: &mut Vec<f64>) {
        let stretched = self.stretch(mu);
        let mut diagonal = self.dc();
        for step in &self.steps[1..=m] {
            diagonal *= step[0].0 * stretched.root;
        }
        self.climb(m, &stretched, diagonal, |_, p| out.push(p));
    }

    /// All (L+1)^2 functions in the direction (mu, phi), index k = l(l+1) + m, into `out`.
    ///
    /// # Panics
    /// If `out` is shorter than [`Harmonics::len`].
    pub fn eval_into(&self, mu: f64, cos_phi: f64, sin_phi: f64, out: &mut [f64]) {
        let stretched = self.stretch(mu);
        let mut diagonal = self.dc();
        let (mut cos_m, mut sin_m) = (1.0, 0.0);
        for m in 0..=self.order {
            if m > 0 {
                diagonal *= self.steps[m][0].0 * stretched.root;
                (cos_m, sin_m) = (cos_m * cos_phi - sin_m * sin_phi, sin_m * cos_phi + cos_m * sin_phi);
            }
            let (c, s) = if m == 0 { (1.0, 0.0) } else { (2f64.sqrt() * cos_m, 2f64.sqrt() * sin_m) };
            self.climb(m, &stretched, diagonal, |l, p| {
                let centre = l * (l + 1);
                if m > 0 {
                    out[centre - m] = p * s;
                }
                out[centre + m] = p * c;
            });
        }
    }

    /// All functions in one direction.
    pub fn eval(&self, d: &Direction<Sample>) -> Vec<f64> {
        let mut out = vec![0.0; self.len()];
        self.eval_direction_into(d, &mut out);
        out
    }

    /// All functions in one direction, into `out`: see [`Harmonics::eval_into`].
    pub fn eval_direction_into(&self, d: &Direction<Sample>, out: &mut [f64]) {
        let v = d.vector();
        let r = v.x.hypot(v.y);
        let (c, s) = if r > 0.0 { (v.x / r, v.y / r) } else { (1.0, 0.0) };
        self.eval_into(v.z, c, s, out);
    }

    /// Where mu lies between the limits, in the form that keeps all digits at both.
    fn stretch(&self, mu: f64) -> Stretched {
        let (a, b) = (self.zone.cos_min(), self.zone.cos_max());
        let (to_a, to_b) = (mu - a, mu - b);
        let width = a - b;
        let x = (to_a + to_b) / width;
        let (sign, end) = if x < 0.0 { (-1.0, 2.0 * to_b / width) } else { (1.0, -2.0 * to_a / width) };
        Stretched { x, root: 2.0 * (to_a * to_b).abs().sqrt() / width, sign, end }
    }

    /// The value of the constant function.
    pub(super) fn dc(&self) -> f64 {
        (1.0 / (2.0 * PI * (self.zone.cos_min() - self.zone.cos_max()))).sqrt()
    }

    fn climb(&self, m: usize, at: &Stretched, diagonal: f64, mut visit: impl FnMut(usize, f64)) {
        if m == 0 {
            // P_l is steep at both ends, up to l (l + 1) / 2, where x' itself is rounded: climb by differences, which hold
            // the distance to the end and not x'.
            let (mut p, mut difference, mut sign) = (1.0, 0.0, 1.0);
            visit(0, diagonal);
            for l in 1..=self.order {
                let l1 = l as f64;
                difference = ((l1 - 1.0) * difference - (2.0 * l1 - 1.0) * at.end * p) / l1;
                p += difference;
                sign *= at.sign;
                visit(l, sign * (2.0 * l1 + 1.0).sqrt() * diagonal * p);
            }
            return;
        }
        let (mut before, mut p) = (0.0, diagonal);
        visit(m, p);
        for (i, &(first, second)) in self.steps[m].iter().enumerate().skip(1) {
            (before, p) = (p, first * at.x * p - second * before);
            visit(m + i, p);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::quadrature::zone_product;

    /// Rounding of some 10^3 summed products; the basis itself is good to about 1e-14.
    const ORTHONORMAL: f64 = 1e-12;

    #[test]
    fn indices_are_inverse() {
        for k in 0..size(12) {
            let (l, m) = lm(k);
            assert_eq!(index(l, m), k);
        }
        assert_eq!(lm(3), (1, 1));
    }

    #[test]
    fn orthonormal_on_both_zones_and_the_sphere_up_to_order_20() {
        let zones = [Zone::from_degrees(9.0, 57.0).unwrap(), Zone::from_degrees(9.0, 90.0).unwrap(), Zone::sphere()];
        for zone in zones {
            let basis = Harmonics::zonal(zone, 20).unwrap();
            let n = basis.len();
            let mut gram = nalgebra::DMatrix::<f64>::zeros(n, n);
            for (d, w) in zone_product(&zone, 21, 48) {
                let z = nalgebra::DVector::from_vec(basis.eval(&d));
                gram.ger(w, &z, &z, 1.0);
            }
            let worst = (gram - nalgebra::DMatrix::identity(n, n)).amax();
            assert!(worst < ORTHONORMAL, "{zone:?}: {worst:e}");
        }
    }

    #[test]
    fn polar_parts_agree_with_whole_functions() {
        let basis = Harmonics::zonal(Zone::from_degrees(9.0, 57.0).unwrap(), 9).unwrap();
        let all = basis.eval(&Direction::from_mu_phi(0.8, 0.0));
        for m in 0..=9usize {
            let mut parts = Vec::new();
            basis.polar_parts(m, 0.8, &mut parts);
            for (i, p) in parts.iter().enumerate() {
                let factor = if m == 0 { 1.0 } else { 2f64.sqrt() };
                assert!((p * factor - all[index(m + i, m as i32)]).abs() < 1e-13);
            }
        }
    }

    #[test]
    fn closed_forms_of_the_first_functions() {
        let sh = Harmonics::spherical(1).unwrap();
        let d = Direction::from_angles(0.7, 0.3);
        let y = sh.eval(&d);
        let k1 = (3.0 / (4.0 * PI)).sqrt();
        let want = [(1.0 / (4.0 * PI)).sqrt(), k1 * d.vector().y, k1 * d.vector().z, k1 * d.vector().x];
        for (got, want) in y.iter().zip(want) {
            assert!((got - want).abs() < 1e-15);
        }
    }

    #[test]
    fn orders_beyond_the_tested_range_are_refused() {
        assert_eq!(Harmonics::spherical(200).unwrap_err(), OrderError(200));
    }
}
