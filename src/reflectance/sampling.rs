//! Drawing directions: what the samplers of the models share.

use std::f64::consts::{FRAC_1_PI, TAU};

use nalgebra::Vector3;

use crate::geometry::{Direction, Sample};

/// A direction above the surface by the cosine law.
pub(super) fn cosine(u: [f64; 2]) -> Direction<Sample> {
    Direction::from_mu_phi((1.0 - u[0]).sqrt(), TAU * u[1])
}

/// Density of [`cosine`], 1/sr.
pub(super) fn cosine_pdf(wi: &Direction<Sample>) -> f64 {
    wi.cos_theta().max(0.0) * FRAC_1_PI
}

/// A component drawn by `weights` (>= 0, any scale), and `u` spread over 0..1 again for the next draw; `None` where all
/// weights are 0.
pub(super) fn choose(weights: impl Iterator<Item = f64> + Clone, u: f64) -> Option<(usize, f64)> {
    let total: f64 = weights.clone().sum();
    let mut left = u * total;
    let mut last = None;
    for (i, weight) in weights.enumerate().filter(|(_, w)| *w > 0.0) {
        if left < weight {
            return Some((i, left / weight));
        }
        left -= weight;
        last = Some((i, BELOW_ONE));
    }
    // Rounding has carried u past the last component.
    last
}

/// Density of a mixture: the mean of `densities` by `weights` (>= 0, any scale); 0 where all weights are 0.
pub(super) fn mixture(weights: impl Iterator<Item = f64>, densities: impl Iterator<Item = f64>) -> f64 {
    let (sum, total) = weights.zip(densities).fold((0.0, 0.0), |(sum, total), (w, d)| (sum + w * d, total + w));
    if total > 0.0 { sum / total } else { 0.0 }
}

/// The largest number a uniform draw from [0, 1) gives.
const BELOW_ONE: f64 = 1.0 - f64::EPSILON / 2.0;

/// A half vector visible from `wo`, with density G1(wo) D(h) (wo . h) / cos(theta_o) for the GGX distribution.
///
/// Dupuy & Benyoub, "Sampling visible GGX normals with spherical caps", HPG 2023.
pub(super) fn visible_half_vector(alpha: [f64; 2], wo: &Direction<Sample>, u: [f64; 2]) -> Vector3<f64> {
    let stretch = Vector3::new(alpha[0], alpha[1], 1.0);
    let w = wo.vector().component_mul(&stretch).normalize();
    let z = (1.0 - u[0]) * (1.0 + w.z) - w.z;
    let cap = Direction::<Sample>::from_mu_phi(z, TAU * u[1]).vector();
    (cap + w).component_mul(&stretch).normalize()
}

/// A half vector with density D(h) cos(theta_h) for the GGX distribution (Walter et al. 2007).
pub(super) fn half_vector(alpha: [f64; 2], u: [f64; 2]) -> Vector3<f64> {
    let slope = (u[0] / (1.0 - u[0])).sqrt();
    let (sin_phi, cos_phi) = (TAU * u[1]).sin_cos();
    Vector3::new(alpha[0] * slope * cos_phi, alpha[1] * slope * sin_phi, 1.0).normalize()
}

/// The light that `h` mirrors `wo` to; `None` where it is below the surface.
pub(crate) fn reflect(wo: &Direction<Sample>, h: &Vector3<f64>) -> Option<Direction<Sample>> {
    let wi = h * (2.0 * h.dot(&wo.vector())) - wo.vector();
    (wi.z > 0.0).then(|| Direction::new(wi))
}

/// Mean of the colour channels: what components are weighed by.
pub(super) fn mean(rgb: [f64; 3]) -> f64 {
    rgb.iter().sum::<f64>() / 3.0
}

#[cfg(test)]
mod tests {
    use super::super::{Abc, Brdf, Dbrdf, Density, DensityTerm, Ggx, GgxLobe, HalfLobe, Lambert, Mixture};
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    /// Standard errors a mean of a fixed seed may be off.
    const STANDARD_ERRORS: f64 = 4.0;
    /// The integral of pdf on the grid of the chi-square test.
    const QUADRATURE: f64 = 2e-3;

    fn models() -> Vec<(&'static str, Box<dyn Brdf>)> {
        let lobe = |alpha, f0| GgxLobe { alpha, f0: [f0; 3], f90: [1.0; 3] };
        let two = Ggx { kd: [0.3, 0.2, 0.1], lobes: vec![lobe([0.2, 0.2], 0.04), lobe([0.2, 0.6], 0.3)] };
        let dbrdf = |p| Dbrdf { kd: [0.2, 0.1, 0.3], c: [0.3; 3], r0: 0.1, p };
        let terms = [(0.6, [0.2, 0.2]), (0.4, [0.3, 0.7])].map(|(weight, alpha)| DensityTerm { weight, alpha });
        let table =
            Density::Table { theta_h_deg: vec![2.0, 10.0, 20.0, 45.0, 80.0], p: vec![3.0, 1.5, 0.4, 0.05, 0.0] };
        let half = vec![HalfLobe { alpha: [0.3, 0.3], f0: [0.05; 3], f90: [0.2; 3] }];
        let both = Mixture { ggx: two.clone(), half };
        let abc = |c| Abc { kd: [0.1, 0.2, 0.3], a: [8.0; 3], b: 100.0, c, ior: 1.5 };
        vec![
            ("lambert", Box::new(Lambert::gray(0.5))),
            ("white ggx", Box::new(Ggx::isotropic(0.3, [1.0; 3]))),
            ("two lobes", Box::new(two)),
            ("mixture", Box::new(dbrdf(Density::Mixture(terms.into())))),
            ("table", Box::new(dbrdf(table))),
            ("both kinds", Box::new(both)),
            ("abc", Box::new(abc(1.5))),
            ("abc with a long tail", Box::new(abc(1.0))),
        ]
    }

    fn draws(brdf: &dyn Brdf, wo: &Direction<Sample>, count: usize) -> Vec<Option<Direction<Sample>>> {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(2023);
        (0..count).map(|_| brdf.sample(wo, [rng.random(), rng.random()])).collect()
    }

    #[test]
    fn samples_follow_the_pdf() {
        const SAMPLES: usize = 100_000;
        const BINS: [usize; 2] = [18, 24];
        // Midpoints per bin in cos(theta) and phi.
        const FINER: usize = 24;
        for (name, brdf) in models() {
            for theta_o in [0.2, 0.9, 1.3] {
                let wo = Direction::from_angles(theta_o, 0.7);
                let [rows, columns] = BINS.map(|n| n * FINER);
                let mut expected = vec![0.0; BINS[0] * BINS[1]];
                for k in 0..rows * columns {
                    let (i, j) = (k / columns, k % columns);
                    let (mu, phi) = ((i as f64 + 0.5) / rows as f64, ((j as f64 + 0.5) / columns as f64) * TAU);
                    let pdf = brdf.pdf(&Direction::from_mu_phi(mu, phi), &wo);
                    expected[i / FINER * BINS[1] + j / FINER] += pdf * TAU / (rows * columns) as f64 * SAMPLES as f64;
                }
                let mut found = vec![0usize; expected.len()];
                for wi in draws(brdf.as_ref(), &wo, SAMPLES).into_iter().flatten() {
                    let [i, j] = [wi.cos_theta(), wi.phi().rem_euclid(TAU) / TAU];
                    found[(i * 0.999_999_9 * BINS[0] as f64) as usize * BINS[1] + (j * BINS[1] as f64) as usize] += 1;
                }
                let share = expected.iter().sum::<f64>() / SAMPLES as f64;
                let accepted = found.iter().sum::<usize>() as f64 / SAMPLES as f64;
                let error = STANDARD_ERRORS * (accepted * (1.0 - accepted) / SAMPLES as f64).sqrt() + QUADRATURE;
                assert!(share < 1.0 + QUADRATURE && (share - accepted).abs() < error, "{name}: {share} {accepted}");

                // Bins with less than 10 expected samples are pooled.
                let (mut chi2, mut degrees, mut pool) = (0.0, 0.0, [0.0; 2]);
                for (&e, &n) in expected.iter().zip(&found) {
                    if e < 10.0 {
                        pool = [pool[0] + e, pool[1] + n as f64];
                    } else {
                        chi2 += (n as f64 - e).powi(2) / e;
                        degrees += 1.0;
                    }
                }
                chi2 += (pool[1] - pool[0]).powi(2) / pool[0].max(10.0);
                // Chi-square of many degrees is nearly normal: mean d, variance 2 d.
                let limit = degrees + STANDARD_ERRORS * (2.0f64 * degrees).sqrt();
                assert!(chi2 < limit, "{name} at {theta_o}: chi-square {chi2:.0} of {degrees}, limit {limit:.0}");
            }
        }
    }

    #[test]
    fn weights_average_to_the_albedo() {
        const SAMPLES: usize = 40_000;
        let sharp: [(&str, Box<dyn Brdf>); 2] = [
            ("sharp", Box::new(Ggx::isotropic(0.03, [0.5; 3]).on_lambert(0.8, [0.2; 3]))),
            ("brushed", Box::new(Ggx::anisotropic(0.05, 0.4, [1.0; 3]))),
        ];
        for (name, brdf) in models().into_iter().chain(sharp) {
            for theta_o in [0.1, 0.8, 1.2] {
                let wo = Direction::from_angles(theta_o, 0.7);
                let weights: Vec<f64> = draws(brdf.as_ref(), &wo, SAMPLES)
                    .into_iter()
                    .map(|wi| wi.map_or(0.0, |wi| brdf.eval_cos(&wi, &wo)[0] / brdf.pdf(&wi, &wo)))
                    .collect();
                let mean = weights.iter().sum::<f64>() / SAMPLES as f64;
                let variance = weights.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / SAMPLES as f64;
                let error = (variance / SAMPLES as f64).sqrt();
                let albedo = brdf.albedo(&wo)[0];
                // Weights vary little if the density is near the integrand: that is what sampling is for.
                assert!(error < 0.01 * albedo, "{name} at {theta_o}: {error} of {albedo}");
                let off = (mean - albedo).abs();
                assert!(off < STANDARD_ERRORS * error + 1e-4 * albedo, "{name} at {theta_o}: {mean} of {albedo}");
            }
        }
    }

    #[test]
    fn components_use_up_the_number() {
        let weights = [0.0, 1.0, 3.0, 0.0];
        assert_eq!(choose(weights.iter().copied(), 0.125), Some((1, 0.5)));
        assert_eq!(choose(weights.iter().copied(), 0.625), Some((2, 0.5)));
        assert_eq!(choose(weights.iter().copied(), 1.0), Some((2, BELOW_ONE)));
        assert_eq!(choose([0.0; 2].into_iter(), 0.5), None);
    }
}
