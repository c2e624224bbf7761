//! Microfacets with the GGX distribution.

use std::f64::consts::{FRAC_1_PI, PI};

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::half::half_vector;
use super::{Brdf, sampling};
use crate::geometry::{Direction, Sample};

/// f = kd / pi + sum over lobes of D F G2 / (4 cos(theta_i) cos(theta_o)).
///
/// D is the GGX distribution (Walter et al. 2007), G2 the height-correlated Smith term (Heitz 2014), F = f0 + (f90 - f0)
/// (1 - cos(theta_d))^5 (Schlick 1994). Reciprocal. Values outside the ranges given are not checked: the result is then
/// no reflectance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ggx {
    /// Albedo of the Lambert part, linear RGB, 0..=1.
    pub kd: [f64; 3],
    /// Kinds of microfacets, side by side.
    pub lobes: Vec<GgxLobe>,
}

/// Microfacets of one roughness.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GgxLobe {
    /// Roughness along +x (the grain) and along +y, each in (0, 1]; equal for an isotropic surface.
    pub alpha: [f64; 2],
    /// Reflectance of a microfacet at normal incidence times the share of the surface, linear RGB, 0..=1.
    pub f0: [f64; 3],
    /// The same at grazing incidence.
    pub f90: [f64; 3],
}

impl Ggx {
    /// A surface of microfacets alone, white at grazing incidence, with one roughness.
    pub fn isotropic(alpha: f64, f0: [f64; 3]) -> Self {
        Self::anisotropic(alpha, alpha, f0)
    }

    /// A surface of microfacets alone, white at grazing incidence, with its own roughness along and across the grain.
    pub fn anisotropic(alpha_x: f64, alpha_y: f64, f0: [f64; 3]) -> Self {
        Self { kd: [0.0; 3], lobes: vec![GgxLobe { alpha: [alpha_x, alpha_y], f0, f90: [1.0; 3] }] }
    }

    /// Estimated albedos towards `wo` of the diffuser and the lobes.
    pub(super) fn weights(&self, wo: &Direction<Sample>) -> impl Iterator<Item = f64> + Clone {
        std::iter::once(sampling::mean(self.kd)).chain(self.lobes.iter().map(|lobe| lobe.reflectance(wo)))
    }

    /// The lobes scaled by `ks` on a Lambert part of albedo `kd`.
    pub fn on_lambert(mut self, ks: f64, kd: [f64; 3]) -> Self {
        for lobe in &mut self.lobes {
            lobe.f0 = lobe.f0.map(|f| ks * f);
            lobe.f90 = lobe.f90.map(|f| ks * f);
        }
        self.kd = kd;
        self
    }
}

impl GgxLobe {
    /// Fresnel reflectance of the macroscopic surface, mean of the channels: about the albedo of the lobe towards `wo`.
    fn reflectance(&self, wo: &Direction<Sample>) -> f64 {
        let s = schlick(&wo.vector(), &Vector3::z());
        sampling::mean(fresnel(self.f0, self.f90, s))
    }

    /// Density of lights drawn by visible half vectors, 1/sr: G1(wo) D(h) / (4 cos(theta_o)).
    fn pdf(&self, h: &Vector3<f64>, wo: &Vector3<f64>) -> f64 {
        0.5 * gtr2(self.alpha, h) / (wo.z + self.stretched(wo))
    }

    /// D G2 / (4 cos(theta_i) cos(theta_o)): the lobe for F = 1.
    pub(crate) fn shape(&self, h: &Vector3<f64>, wi: &Vector3<f64>, wo: &Vector3<f64>) -> f64 {
        // G2 / (4 cos_i cos_o) without the division by the cosines.
        let visibility = 0.5 / (wo.z * self.stretched(wi) + wi.z * self.stretched(wo));
        gtr2(self.alpha, h) * visibility
    }

    /// The length of `w` scaled by (alpha_x, alpha_y, 1): cos(theta) sqrt(1 + alpha^2 tan^2(theta)).
    fn stretched(&self, w: &Vector3<f64>) -> f64 {
        let (x, y) = (self.alpha[0] * w.x, self.alpha[1] * w.y);
        (x * x + y * y + w.z * w.z).sqrt()
    }
}

/// The GGX distribution of half vectors (GTR with exponent 2), 1/sr: integral D cos(theta_h) dh = 1.
pub(crate) fn gtr2(alpha: [f64; 2], h: &Vector3<f64>) -> f64 {
    let (x, y) = (h.x / alpha[0], h.y / alpha[1]);
    let q = x * x + y * y + h.z * h.z;
    1.0 / (PI * alpha[0] * alpha[1] * q * q)
}

/// Schlick's weight (1 - cos(theta_d))^5 of grazing reflection.
pub(crate) fn schlick(w: &Vector3<f64>, h: &Vector3<f64>) -> f64 {
    (1.0 - w.dot(h).clamp(0.0, 1.0)).powi(5)
}

/// Weight of a lobe between normal and grazing incidence, linear RGB: f0 + (f90 - f0) s, with s of [`schlick`].
pub(super) fn fresnel(f0: [f64; 3], f90: [f64; 3], s: f64) -> [f64; 3] {
    std::array::from_fn(|c| f0[c] + (f90[c] - f0[c]) * s)
}

impl Brdf for Ggx {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        if wi.cos_theta() <= 0.0 || wo.cos_theta() <= 0.0 {
            return [0.0; 3];
        }
        let h = half_vector(wi, wo);
        let (i, o) = (wi.vector(), wo.vector());
        let s = schlick(&o, &h);
        let mut f = self.kd.map(|kd| kd * FRAC_1_PI);
        for lobe in &self.lobes {
            let shape = lobe.shape(&h, &i, &o);
            f.iter_mut().zip(fresnel(lobe.f0, lobe.f90, s)).for_each(|(f, weight)| *f += shape * weight);
        }
        f
    }

    /// The diffuser by the cosine law or one lobe by its visible half vectors, chosen by their estimated albedos.
    fn sample(&self, wo: &Direction<Sample>, u: [f64; 2]) -> Option<Direction<Sample>> {
        if wo.cos_theta() <= 0.0 {
            return None;
        }
        let (component, u0) = sampling::choose(self.weights(wo), u[0])?;
        match component.checked_sub(1) {
            None => Some(sampling::cosine([u0, u[1]])),
            Some(i) => sampling::reflect(wo, &sampling::visible_half_vector(self.lobes[i].alpha, wo, [u0, u[1]])),
        }
    }

    fn pdf(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> f64 {
        if wi.cos_theta() <= 0.0 || wo.cos_theta() <= 0.0 {
            return 0.0;
        }
        let h = half_vector(wi, wo);
        let densities =
            [sampling::cosine_pdf(wi)].into_iter().chain(self.lobes.iter().map(|l| l.pdf(&h, &wo.vector())));
        sampling::mixture(self.weights(wo), densities)
    }

    fn is_isotropic(&self) -> bool {
        self.lobes.iter().all(|l| l.alpha[0] == l.alpha[1])
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_support::*;
    use super::*;
    use proptest::prelude::*;

    const WHITE: [f64; 3] = [1.0; 3];

    #[test]
    fn matches_the_textbook_form() {
        // Written out with Lambda(theta) and plain angles, at unequal angles away from the normal.
        let (theta_i, theta_o, dphi, alpha, f0) = (0.35f64, 0.95f64, 2.6f64, 0.3f64, 0.04f64);
        let (wi, wo) = (Direction::from_angles(theta_i, 0.4), Direction::from_angles(theta_o, 0.4 + dphi));
        let lambda = |t: f64| (-1.0 + (1.0 + (alpha * t.tan()).powi(2)).sqrt()) / 2.0;
        let cos_io = theta_i.cos() * theta_o.cos() + theta_i.sin() * theta_o.sin() * dphi.cos();
        let cos_d = ((1.0 + cos_io) / 2.0).sqrt();
        let cos_h = (theta_i.cos() + theta_o.cos()) / (2.0 * cos_d);
        let d = alpha * alpha / (PI * (cos_h * cos_h * (alpha * alpha - 1.0) + 1.0).powi(2));
        let f = f0 + (1.0 - f0) * (1.0 - cos_d).powi(5);
        let g = 1.0 / (1.0 + lambda(theta_i) + lambda(theta_o));
        let want = 0.2 / PI + 0.8 * d * f * g / (4.0 * theta_i.cos() * theta_o.cos());
        let ggx = Ggx::isotropic(alpha, [f0; 3]).on_lambert(0.8, [0.2; 3]);
        assert!((ggx.eval(&wi, &wo)[1] / want - 1.0).abs() < 1e-13);
    }

    #[test]
    fn white_furnace() {
        // Single scattering loses energy and must never make any; at alpha -> 0 next to nothing is lost.
        for alpha in [0.01, 0.05, 0.1, 0.4, 1.0] {
            for theta in [0.0, 0.4, 0.9, 1.2, 1.4] {
                let albedo = Ggx::isotropic(alpha, WHITE).albedo(&Direction::from_angles(theta, 0.3))[0];
                assert!(albedo <= 1.01, "alpha {alpha}, theta {theta}: {albedo}");
                assert!(alpha > 0.1 || theta > 1.0 || albedo > 0.97, "alpha {alpha}, theta {theta}: {albedo}");
            }
        }
        let brushed = Ggx::anisotropic(0.1, 0.4, WHITE);
        for phi in [0.0, 0.8, 1.6] {
            assert!(brushed.albedo(&Direction::from_angles(0.7, phi))[0] <= 1.01);
        }
    }

    #[test]
    fn a_smooth_grain_along_x_spreads_light_across_it() {
        let brushed = Ggx::anisotropic(0.05, 0.4, WHITE);
        let normal = Direction::from_angles(0.0, 0.0);
        let along = brushed.eval(&Direction::from_angles(0.5, 0.0), &normal)[0];
        let across = brushed.eval(&Direction::from_angles(0.5, PI / 2.0), &normal)[0];
        assert!(across > 10.0 * along);
        assert!(!brushed.is_isotropic());
    }

    #[test]
    fn is_black_below_and_continuous() {
        let ggx = Ggx::anisotropic(0.2, 0.5, [0.3, 0.5, 0.9]).on_lambert(1.0, [0.2; 3]);
        black_below(&ggx);
        continuous_over_the_wrap(&ggx);
    }

    proptest! {
        #[test]
        fn is_reciprocal(wi in upper(), wo in upper(), x in 0.01..1.0f64, y in 0.01..1.0f64) {
            reciprocal(&Ggx::anisotropic(x, y, [0.04, 0.5, 1.0]).on_lambert(1.0, [0.1; 3]), &wi, &wo, 1e-9)?;
        }

        #[test]
        fn equal_roughness_is_isotropic(wi in upper(), wo in upper(), angle in -3.0..3.0f64) {
            let ggx = Ggx::isotropic(0.3, [0.5; 3]);
            let f = ggx.eval(&wi, &wo)[0];
            let g = ggx.eval(&wi.rotated_about_normal(angle), &wo.rotated_about_normal(angle))[0];
            prop_assert!((f - g).abs() <= 1e-10 * f);
        }
    }
}
