//! Lobes of two kinds side by side.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::dbrdf::openness;
use super::ggx::{fresnel, gtr2, schlick};
use super::half::half_vector;
use super::{Brdf, Ggx, gtr2_solid_angle_integral, sampling};
use crate::geometry::{Direction, Sample};

/// f = f_ggx + sum over half lobes of p(h) F(theta_d) / (cos_i + cos_o - cos_i cos_o).
///
/// Microfacet lobes ([`Ggx`], its Lambert part included) darken towards grazing angles by shadowing, lobes of a D-BRDF less
/// so: real materials lie between. Reciprocal; nothing bounds the albedo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mixture {
    /// Microfacet lobes and the Lambert part.
    pub ggx: Ggx,
    /// Lobes of a D-BRDF.
    pub half: Vec<HalfLobe>,
}

/// One term of a D-BRDF with a GGX-shaped density.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HalfLobe {
    /// Roughness along +x and along +y, each in (0, 1].
    pub alpha: [f64; 2],
    /// Weight at normal incidence, linear RGB, >= 0.
    pub f0: [f64; 3],
    /// Weight at grazing incidence, linear RGB, >= 0.
    pub f90: [f64; 3],
}

impl HalfLobe {
    /// p(h) / (cos_i + cos_o - cos_i cos_o): the lobe for F = 1.
    fn shape(&self, h: &Vector3<f64>, cos_i: f64, cos_o: f64) -> f64 {
        gtr2(self.alpha, h) / gtr2_solid_angle_integral(self.alpha) * openness(cos_i, cos_o)
    }
}

impl Brdf for Mixture {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        if wi.cos_theta() <= 0.0 || wo.cos_theta() <= 0.0 {
            return [0.0; 3];
        }
        let mut f = self.ggx.eval(wi, wo);
        let h = half_vector(wi, wo);
        let s = schlick(&wo.vector(), &h);
        for lobe in &self.half {
            let shape = lobe.shape(&h, wi.cos_theta(), wo.cos_theta());
            f.iter_mut().zip(fresnel(lobe.f0, lobe.f90, s)).for_each(|(f, weight)| *f += shape * weight);
        }
        f
    }

    /// The microfacets' share as [`Ggx`] draws it; of a half lobe, a half vector from p(h) cos(theta_h).
    fn sample(&self, wo: &Direction<Sample>, u: [f64; 2]) -> Option<Direction<Sample>> {
        if wo.cos_theta() <= 0.0 {
            return None;
        }
        let (component, u0) = sampling::choose(self.weights(wo), u[0])?;
        match component.checked_sub(1) {
            None => self.ggx.sample(wo, [u0, u[1]]),
            Some(i) => sampling::reflect(wo, &sampling::half_vector(self.half[i].alpha, [u0, u[1]])),
        }
    }

    fn pdf(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> f64 {
        if wi.cos_theta() <= 0.0 || wo.cos_theta() <= 0.0 {
            return 0.0;
        }
        let h = half_vector(wi, wo);
        let jacobian = 4.0 * h.dot(&wo.vector());
        let half = self.half.iter().map(|l| gtr2(l.alpha, &h) * h.z / jacobian);
        sampling::mixture(self.weights(wo), std::iter::once(self.ggx.pdf(wi, wo)).chain(half))
    }

    fn is_isotropic(&self) -> bool {
        self.ggx.is_isotropic() && self.half.iter().all(|l| l.alpha[0] == l.alpha[1])
    }
}

impl Mixture {
    /// Estimated albedos towards `wo` of the microfacets together and of each half lobe.
    fn weights(&self, wo: &Direction<Sample>) -> impl Iterator<Item = f64> + Clone {
        let cos_o = wo.cos_theta();
        let s = schlick(&wo.vector(), &Vector3::z());
        let half = self.half.iter().map(move |l| sampling::mean(fresnel(l.f0, l.f90, s)) * 4.0 * cos_o / (2.0 - cos_o));
        std::iter::once(self.ggx.weights(wo).sum()).chain(half)
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_support::*;
    use super::super::{Dbrdf, Density, DensityTerm};
    use super::*;
    use proptest::prelude::*;

    fn mixture() -> Mixture {
        Mixture {
            ggx: Ggx::isotropic(0.2, [0.04; 3]).on_lambert(0.5, [0.2; 3]),
            half: vec![HalfLobe { alpha: [0.1, 0.3], f0: [0.01, 0.02, 0.03], f90: [0.2; 3] }],
        }
    }

    #[test]
    fn is_the_sum_of_its_parts() {
        let (wi, wo) = (Direction::from_angles(0.35, 0.4), Direction::from_angles(0.95, 3.1));
        let p = Density::Mixture(vec![DensityTerm { weight: 1.0, alpha: [0.1, 0.3] }]);
        let dbrdf = Dbrdf { kd: [0.0; 3], c: [0.2; 3], r0: 0.1, p };
        let whole = mixture().eval(&wi, &wo)[1];
        let parts = mixture().ggx.eval(&wi, &wo)[1] + dbrdf.eval(&wi, &wo)[1];
        assert!((whole / parts - 1.0).abs() < 1e-13);
    }

    #[test]
    fn is_black_below_and_continuous() {
        black_below(&mixture());
        continuous_over_the_wrap(&mixture());
    }

    proptest! {
        #[test]
        fn is_reciprocal(wi in upper(), wo in upper()) {
            reciprocal(&mixture(), &wi, &wo, 1e-9)?;
        }
    }
}
