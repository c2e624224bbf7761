//! Distribution-based BRDFs: a density of half vectors and nothing else that bends light.

use std::f64::consts::{FRAC_1_PI, PI, TAU};

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::ggx::{gtr2, schlick};
use super::half::half_vector;
use super::{Brdf, sampling};
use crate::geometry::{Direction, Sample};

/// f = kd / pi + c p(h) F(theta_d) / (cos_i + cos_o - cos_i cos_o) with F = r0 + (1 - r0) (1 - cos(theta_d))^5.
///
/// Ashikhmin & Premoze 2007, Ghosh 2007 eq. 2.13-2.15. Reciprocal; nothing bounds the albedo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dbrdf {
    /// Albedo of the Lambert part, linear RGB, 0..=1.
    pub kd: [f64; 3],
    /// Scale of the density, linear RGB, >= 0.
    pub c: [f64; 3],
    /// Reflectance at normal incidence, 0..=1.
    pub r0: f64,
    /// p(h), 1/sr: integral p(h) dh over the upper hemisphere is 1.
    pub p: Density,
}

/// A density of half vectors over the upper hemisphere, 1/sr.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Density {
    /// A sum of GGX-shaped densities.
    Mixture(Vec<DensityTerm>),
    /// Values over theta_h, linear between knots, constant before the first and after the last; isotropic.
    Table {
        /// Knots, degrees, ascending.
        theta_h_deg: Vec<f64>,
        /// Density at the knots, 1/sr.
        p: Vec<f64>,
    },
}

/// The half vectors between two knots of a table.
struct Ring {
    /// cos(theta_h) at the inner and the outer edge.
    mu: [f64; 2],
    /// Mean density, 1/sr.
    p: f64,
}

impl Ring {
    /// Integral of p over the ring, divided by 2 pi.
    fn weight(&self) -> f64 {
        self.p * (self.mu[0] - self.mu[1]).max(0.0)
    }
}

/// p(h), 1/sr, as a function of a unit vector above the surface.
pub type PreparedDensity<'a> = Box<dyn Fn(&Vector3<f64>) -> f64 + Send + Sync + 'a>;

/// One GGX-shaped density in a mixture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DensityTerm {
    /// Share of the mixture, >= 0; the shares sum to 1.
    pub weight: f64,
    /// Roughness along +x and +y, each in (0, 1].
    pub alpha: [f64; 2],
}

impl Density {
    /// p(h) for a unit vector above the surface.
    pub fn eval(&self, h: &Vector3<f64>) -> f64 {
        self.prepared()(h)
    }

    /// p as a function of h: the integrals of a mixture's terms are found once.
    pub fn prepared(&self) -> PreparedDensity<'_> {
        match self {
            Self::Mixture(terms) => {
                let scaled: Vec<([f64; 2], f64)> =
                    terms.iter().map(|t| (t.alpha, t.weight / gtr2_solid_angle_integral(t.alpha))).collect();
                Box::new(move |h| scaled.iter().map(|&(alpha, scale)| scale * gtr2(alpha, h)).sum())
            }
            Self::Table { theta_h_deg, p } => {
                Box::new(move |h| interpolate(theta_h_deg, p, h.x.hypot(h.y).atan2(h.z).to_degrees()))
            }
        }
    }

    /// A half vector above the surface from two uniform numbers, with density [`Density::pdf`]; `None` if p is 0 everywhere.
    ///
    /// A term of a mixture is drawn as GGX draws it, with p(h) cos(theta_h): the weight f_cos / pdf then stays bounded up to
    /// the horizon. A table is drawn by the mean of p between its knots, evenly over their solid angle.
    fn sample(&self, u: [f64; 2]) -> Option<Vector3<f64>> {
        match self {
            Self::Mixture(terms) => {
                let (i, u0) = sampling::choose(terms.iter().map(|t| t.weight), u[0])?;
                Some(sampling::half_vector(terms[i].alpha, [u0, u[1]]))
            }
            Self::Table { .. } => {
                let rings = self.rings();
                let (i, u0) = sampling::choose(rings.iter().map(Ring::weight), u[0])?;
                let [mu0, mu1] = rings[i].mu;
                Some(Direction::<Sample>::from_mu_phi(mu0 + (mu1 - mu0) * u0, TAU * u[1]).vector())
            }
        }
    }

    /// Density of [`Density::sample`], 1/sr.
    fn pdf(&self, h: &Vector3<f64>) -> f64 {
        match self {
            Self::Mixture(terms) => {
                sampling::mixture(terms.iter().map(|t| t.weight), terms.iter().map(|t| gtr2(t.alpha, h) * h.z))
            }
            Self::Table { .. } => {
                let inside = |ring: &Ring| if ring.mu[1] <= h.z && h.z < ring.mu[0] { ring.p } else { 0.0 };
                let rings = self.rings();
                let total: f64 = rings.iter().map(Ring::weight).sum();
                if total > 0.0 { rings.iter().map(inside).sum::<f64>() / (TAU * total) } else { 0.0 }
            }
        }
    }

    /// A table's knots as rings from the normal to the horizon; none for a mixture.
    fn rings(&self) -> Vec<Ring> {
        let Self::Table { theta_h_deg, p } = self else { return Vec::new() };
        let ends = [(0.0, p.first()), (90.0, p.last())].map(|(theta, p)| (theta, p.copied().unwrap_or(0.0)));
        let inner = theta_h_deg.iter().copied().zip(p.iter().copied());
        let knots: Vec<(f64, f64)> = [ends[0]].into_iter().chain(inner).chain([ends[1]]).collect();
        // Just above 1, so that the normal itself belongs to the first ring.
        let mu = |deg: f64| if deg == 0.0 { 1.0 + f64::EPSILON } else { deg.to_radians().cos() };
        knots.windows(2).map(|k| Ring { mu: [mu(k[0].0), mu(k[1].0)], p: 0.5 * (k[0].1 + k[1].1) }).collect()
    }

    /// Whether p depends on theta_h alone.
    pub fn is_isotropic(&self) -> bool {
        match self {
            Self::Mixture(terms) => terms.iter().all(|t| t.alpha[0] == t.alpha[1]),
            Self::Table { .. } => true,
        }
    }
}

/// integral D(h) dh over the upper hemisphere, no unit: GGX is normalised with cos(theta_h), D-BRDFs without.
///
/// At the azimuth phi the distribution is an isotropic one of some roughness alpha_phi, whose integral over mu is
/// (1 / alpha_phi^2 + atanh(k) / k) / 2 with k^2 = 1 - alpha_phi^2; a periodic sum over phi converges exponentially.
pub fn gtr2_solid_angle_integral(alpha: [f64; 2]) -> f64 {
    const AZIMUTHS: usize = 64;
    let over_mu = |alpha2: f64| {
        let k2 = 1.0 - alpha2;
        // atanh(k) / k and its continuation beyond alpha = 1; the series holds where both are 0 / 0.
        let tail = if k2.abs() < 1e-4 {
            1.0 + k2 / 3.0 + k2 * k2 / 5.0
        } else if k2 > 0.0 {
            k2.sqrt().atanh() / k2.sqrt()
        } else {
            (-k2).sqrt().atan() / (-k2).sqrt()
        };
        alpha2 * alpha2 * 0.5 * (1.0 / alpha2 + tail)
    };
    let scale = 1.0 / (PI * alpha[0] * alpha[1]);
    if alpha[0] == alpha[1] {
        return TAU * scale * over_mu(alpha[0] * alpha[0]);
    }
    let sum: f64 = (0..AZIMUTHS)
        .map(|j| {
            let (s, c) = ((j as f64 + 0.5) * TAU / AZIMUTHS as f64).sin_cos();
            over_mu(1.0 / ((c / alpha[0]).powi(2) + (s / alpha[1]).powi(2)))
        })
        .sum();
    scale * sum * TAU / AZIMUTHS as f64
}

/// 1 / (cos_i + cos_o - cos_i cos_o), what a D-BRDF has in the place of shadowing.
pub(crate) fn openness(cos_i: f64, cos_o: f64) -> f64 {
    1.0 / (cos_i + cos_o - cos_i * cos_o)
}

/// Linear interpolation on ascending knots, constant beyond both ends; 0 without knots.
fn interpolate(knots: &[f64], values: &[f64], at: f64) -> f64 {
    let i = knots.partition_point(|&k| k <= at);
    match (i.checked_sub(1).and_then(|j| knots.get(j).zip(values.get(j))), knots.get(i).zip(values.get(i))) {
        (Some((k0, v0)), Some((k1, v1))) => v0 + (v1 - v0) * (at - k0) / (k1 - k0),
        (Some((_, v)), None) | (None, Some((_, v))) => *v,
        (None, None) => 0.0,
    }
}

impl Brdf for Dbrdf {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        let (cos_i, cos_o) = (wi.cos_theta(), wo.cos_theta());
        if cos_i <= 0.0 || cos_o <= 0.0 {
            return [0.0; 3];
        }
        let h = half_vector(wi, wo);
        let fresnel = self.r0 + (1.0 - self.r0) * schlick(&wo.vector(), &h);
        let lobe = self.p.eval(&h) * fresnel * openness(cos_i, cos_o);
        std::array::from_fn(|c| self.kd[c] * FRAC_1_PI + self.c[c] * lobe)
    }

    /// The diffuser by the cosine law, or a half vector from p that mirrors `wo`, chosen by their estimated albedos.
    fn sample(&self, wo: &Direction<Sample>, u: [f64; 2]) -> Option<Direction<Sample>> {
        if wo.cos_theta() <= 0.0 {
            return None;
        }
        let (component, u0) = sampling::choose(self.weights(wo).into_iter(), u[0])?;
        let u = [u0, u[1]];
        if component == 0 { Some(sampling::cosine(u)) } else { sampling::reflect(wo, &self.p.sample(u)?) }
    }

    /// The lobe's part is pdf(h) / (4 h.wo), Ghosh 2007 eq. 2.30.
    fn pdf(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> f64 {
        if wi.cos_theta() <= 0.0 || wo.cos_theta() <= 0.0 {
            return 0.0;
        }
        let h = half_vector(wi, wo);
        let lobe = self.p.pdf(&h) / (4.0 * h.dot(&wo.vector()));
        sampling::mixture(self.weights(wo).into_iter(), [sampling::cosine_pdf(wi), lobe].into_iter())
    }

    fn is_isotropic(&self) -> bool {
        self.p.is_isotropic()
    }
}

impl Dbrdf {
    /// Estimated albedos towards `wo` of the diffuser and the lobe; of the lobe's, that of all half vectors near the normal.
    fn weights(&self, wo: &Direction<Sample>) -> [f64; 2] {
        let cos_o = wo.cos_theta();
        let fresnel = self.r0 + (1.0 - self.r0) * schlick(&wo.vector(), &Vector3::z());
        [sampling::mean(self.kd), sampling::mean(self.c) * fresnel * 4.0 * cos_o / (2.0 - cos_o)]
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_support::*;
    use super::*;
    use crate::geometry::Zone;
    use crate::geometry::quadrature::zone_product;
    use proptest::prelude::*;

    fn mixture(alphas: &[[f64; 2]]) -> Density {
        let weight = 1.0 / alphas.len() as f64;
        Density::Mixture(alphas.iter().map(|&alpha| DensityTerm { weight, alpha }).collect())
    }

    #[test]
    fn densities_integrate_to_one() {
        // Far below what the mixture is used for; nodes resolve a roughness of 0.1.
        const QUADRATURE: f64 = 1e-6;
        for alphas in
            [vec![[0.1, 0.1]], vec![[1.0, 1.0]], vec![[0.15, 0.5]], vec![[0.3, 0.3], [0.9999, 0.9999], [0.6, 0.2]]]
        {
            let p = mixture(&alphas);
            let nodes = zone_product(&Zone::hemisphere(), 300, 200);
            let sum: f64 = nodes.iter().map(|(h, w)| w * p.eval(&h.vector())).sum();
            assert!((sum - 1.0).abs() < QUADRATURE, "{alphas:?}: {sum}");
        }
    }

    #[test]
    fn matches_the_textbook_form_in_backscatter() {
        // f = c r0 p(h) / (2 cos - cos^2) where wi = wo (Ghosh 2007, eq. 2.15).
        let brdf = Dbrdf { kd: [0.0; 3], c: [0.7; 3], r0: 0.1, p: mixture(&[[0.3, 0.3]]) };
        let w = Direction::from_angles(0.8, 0.4);
        let cos = 0.8f64.cos();
        let want = 0.7 * 0.1 * brdf.p.eval(&w.vector()) / (2.0 * cos - cos * cos);
        assert!((brdf.eval(&w, &w)[0] / want - 1.0).abs() < 1e-13);
    }

    #[test]
    fn a_table_is_linear_between_its_knots_and_constant_beyond() {
        let p = Density::Table { theta_h_deg: vec![10.0, 20.0], p: vec![4.0, 2.0] };
        let at = |deg: f64| p.eval(&Direction::<Sample>::from_angles(deg.to_radians(), 1.0).vector());
        for (deg, want) in [(0.0, 4.0), (10.0, 4.0), (15.0, 3.0), (20.0, 2.0), (80.0, 2.0)] {
            assert!((at(deg) - want).abs() < 1e-9, "{deg}");
        }
    }

    #[test]
    fn is_black_below_and_continuous() {
        let brdf = Dbrdf { kd: [0.1; 3], c: [0.7; 3], r0: 0.1, p: mixture(&[[0.3, 0.3], [0.2, 0.6]]) };
        assert!(!brdf.is_isotropic());
        black_below(&brdf);
        continuous_over_the_wrap(&brdf);
    }

    proptest! {
        #[test]
        fn is_reciprocal(wi in upper(), wo in upper(), x in 0.01..1.0f64, y in 0.01..1.0f64) {
            reciprocal(&Dbrdf { kd: [0.1; 3], c: [0.5; 3], r0: 0.04, p: mixture(&[[x, y]]) }, &wi, &wo, 1e-9)?;
        }
    }
}
