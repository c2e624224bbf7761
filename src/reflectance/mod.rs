//! Reflection models and tables: one trait, closed forms, and readers of measured files.
//!
//! | type | what | source |
//! |---|---|---|
//! | [`Lambert`] | a constant | |
//! | [`Ggx`] | microfacets with a Lambert part, isotropic or not | Walter 2007, Heitz 2014 |
//! | [`Dbrdf`] | a density of half vectors with a Lambert part | Ashikhmin & Premoze 2007 |
//! | [`Mixture`] | GGX lobes and half-vector lobes side by side | |
//! | [`Abc`] | fits of 100 MERL materials, built in | Löw 2012 |
//! | [`Sgd`] | other fits of the same materials | Bagher 2012 |
//! | [`Rgl`] | adaptive tables, `.bsdf` files | Dupuy & Jakob 2018 |
//! | [`Merl`] | half-angle tables, `.binary` files | Matusik 2003 |
//! | [`Alta`] | scattered directions, `.dat` text files | Belcour 2014 |
//! | [`NeuralBrdf`] | small networks fitted to MERL materials | Sztrajman 2021 |
//! | [`Turned`] | any of these, mounted at an angle | |
//!
//! [`open`] finds all but [`Sgd`] and the networks by a name or a path; [`Metric`] says how far one is from another. Evaluation is pure; only the functions called `read` and [`open`]
//! touch files. Files are untrusted: whatever is in them, a reader answers with a table or a [`ReadError`].
//!
//! ```
//! use zonal::geometry::Direction;
//! use zonal::reflectance::open;
//!
//! let card = open("gray-card")?;
//! let albedo = card.albedo(&Direction::from_angles(0.5, 0.0));
//! assert!((albedo[0] - 0.18).abs() < 1e-9);
//! # Ok::<(), zonal::reflectance::MaterialError>(())
//! ```

pub(crate) mod abc;
mod alta;
pub(crate) mod dbrdf;
mod error;
pub(crate) mod ggx;
mod half;
mod lambert;
mod material;
mod merl;
mod metric;
mod mixture;
mod model;
mod nbrdf;
mod rgl;
mod sampling;
mod sgd;
mod tensor;
mod turned;
mod zone_errors;

use std::f64::consts::TAU;

use crate::geometry::quadrature::{gauss_legendre, tangents};
use crate::geometry::{Direction, Sample};

pub use abc::{Abc, AbcMaterial, abc_materials};
pub use alta::Alta;
pub use dbrdf::{Dbrdf, Density, DensityTerm, PreparedDensity, gtr2_solid_angle_integral};
pub use error::ReadError;
pub use ggx::{Ggx, GgxLobe};
pub use lambert::Lambert;
pub(crate) use material::most_alike;
pub use material::{MaterialError, MaterialInfo, built_in, open};
pub use merl::Merl;
pub use metric::{
    ALBEDO_DEG, ChannelErrors, METRIC_EXITANT_DEG, Metric, MetricError, MetricErrors, PairDeg, Reference, Side,
};
pub use mixture::{HalfLobe, Mixture};
pub use model::{Model, ModelError};
pub use nbrdf::NeuralBrdf;
pub use rgl::Rgl;
pub(crate) use rgl::{Flattening, Table, Taps, theta_of_u, u_of_theta};
pub(crate) use sampling::reflect;
pub use sgd::{Sgd, SgdChannel, SgdMaterial, sgd_materials};
pub use tensor::{TensorFile, TensorWriter};
pub use turned::Turned;
pub use zone_errors::{EXITANT_DEG, ZoneErrors};

/// f_cos as a function of `wi`, 1/sr, linear RGB.
pub type Towards<'a> = Box<dyn Fn(&Direction<Sample>) -> [f64; 3] + 'a>;

/// A BRDF over the upper hemisphere.
pub trait Brdf: Send + Sync {
    /// f(wi, wo) in 1/sr, linear RGB; `wi` points to the light, `wo` to the camera. 0 where either is not above the
    /// surface. Does *not* contain cos(theta_i).
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3];

    /// f_cos = f cos(theta_i), 1/sr: what the rig measures.
    fn eval_cos(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        self.eval(wi, wo).map(|f| f * wi.cos_theta().max(0.0))
    }

    /// f_cos as a function of `wi` alone, for one `wo`: tables interpolate over exitant directions once.
    fn towards<'a>(&'a self, wo: &Direction<Sample>) -> Towards<'a> {
        let wo = *wo;
        Box::new(move |wi| self.eval_cos(wi, &wo))
    }

    /// Directional albedo, integral f cos(theta_i) dwi over the upper hemisphere for the camera at `wo`, RGB, no unit.
    ///
    /// The rule is polar about the mirror direction and ends at the horizon: Gauss-Legendre in u where the angle to the
    /// mirror direction is chi = chi_horizon(zeta) u^3, midpoints in the azimuth zeta around it. Its error is below 1e-5
    /// for GGX with alpha >= 0.01 at any angle up to 85 deg, and about 1e-3 for glossy RGL tables, which have kinks.
    /// 0 where `wo` is not above the surface.
    fn albedo(&self, wo: &Direction<Sample>) -> [f64; 3] {
        integral_about_mirror(self.towards(wo), wo, ALBEDO_RADIAL, ALBEDO_AROUND)
    }

    /// A direction `wi` for the camera at `wo`, from two uniform numbers in [0, 1), with density [`Brdf::pdf`]; None where
    /// the draw leaves the upper hemisphere (that share counts as absorbed: weigh by f_cos / pdf).
    ///
    /// Models override both; the default is the cosine law.
    fn sample(&self, _wo: &Direction<Sample>, u: [f64; 2]) -> Option<Direction<Sample>> {
        Some(sampling::cosine(u))
    }

    /// Density of [`Brdf::sample`] over solid angle, 1/sr; 0 where it never goes.
    fn pdf(&self, wi: &Direction<Sample>, _wo: &Direction<Sample>) -> f64 {
        sampling::cosine_pdf(wi)
    }

    /// Whether f depends on the azimuths only through phi_i - phi_o (a mirror symmetry is not implied).
    fn is_isotropic(&self) -> bool;
}

/// Nodes of [`Brdf::albedo`] away from the mirror direction.
const ALBEDO_RADIAL: usize = 96;
/// Nodes of [`Brdf::albedo`] around the mirror direction.
const ALBEDO_AROUND: usize = 192;

/// The integral of `f_cos` over the upper hemisphere by the rule of [`Brdf::albedo`].
fn integral_about_mirror(
    f_cos: impl Fn(&Direction<Sample>) -> [f64; 3],
    wo: &Direction<Sample>,
    radial: usize,
    around: usize,
) -> [f64; 3] {
    let mut integral = [0.0; 3];
    if wo.cos_theta() <= 0.0 {
        return integral;
    }
    let mirror = wo.mirrored().vector();
    let (t, b) = tangents(&mirror);
    let nodes = gauss_legendre(radial, 0.0, 1.0);
    let dzeta = TAU / around as f64;
    for j in 0..around {
        let (sin_zeta, cos_zeta) = ((j as f64 + 0.5) * dzeta).sin_cos();
        let away = t * cos_zeta + b * sin_zeta;
        let chi_horizon = mirror.z.atan2(-away.z);
        for &(u, w) in &nodes {
            let (sin_chi, cos_chi) = (chi_horizon * u * u * u).sin_cos();
            let wi = Direction::new_unchecked(mirror * cos_chi + away * sin_chi);
            let weight = w * 3.0 * chi_horizon * u * u * sin_chi * dzeta;
            integral.iter_mut().zip(f_cos(&wi)).for_each(|(sum, f)| *sum += weight * f);
        }
    }
    integral
}

#[cfg(test)]
pub(crate) mod test_support {
    use super::*;
    use proptest::prelude::*;

    /// Directions above the surface, away from the horizon by at least a degree.
    pub fn upper() -> impl Strategy<Value = Direction<Sample>> {
        (0.0..1.55f64, -3.1..3.1f64).prop_map(|(theta, phi)| Direction::from_angles(theta, phi))
    }

    /// f must not change by more than `tolerance` (relative) when wi and wo change places.
    pub fn reciprocal(
        brdf: &dyn Brdf,
        wi: &Direction<Sample>,
        wo: &Direction<Sample>,
        tolerance: f64,
    ) -> Result<(), TestCaseError> {
        for (f, g) in brdf.eval(wi, wo).into_iter().zip(brdf.eval(wo, wi)) {
            prop_assert!((f - g).abs() <= tolerance * f.max(g), "{f} against {g}");
        }
        Ok(())
    }

    /// f is 0 unless both directions are above the surface.
    pub fn black_below(brdf: &dyn Brdf) {
        let up = Direction::from_angles(0.7, 0.3);
        for theta in [std::f64::consts::FRAC_PI_2 + 1e-9, 2.0, 3.1] {
            let down = Direction::from_angles(theta, 1.0);
            assert_eq!(brdf.eval(&up, &down), [0.0; 3]);
            assert_eq!(brdf.eval(&down, &up), [0.0; 3]);
            assert_eq!(brdf.eval_cos(&down, &up), [0.0; 3]);
            assert_eq!(brdf.albedo(&down), [0.0; 3]);
        }
    }

    /// f does not jump where phi passes from pi to -pi.
    pub fn continuous_over_the_wrap(brdf: &dyn Brdf) {
        let eps = 1e-9;
        for fixed in [Direction::from_angles(0.4, 0.0), Direction::from_angles(0.9, 2.0)] {
            let [below, above] = [1.0, -1.0].map(|s| Direction::from_angles(0.6, s * (std::f64::consts::PI - eps)));
            for (p, q) in [
                (brdf.eval(&below, &fixed), brdf.eval(&above, &fixed)),
                (brdf.eval(&fixed, &below), brdf.eval(&fixed, &above)),
            ] {
                for (f, g) in p.into_iter().zip(q) {
                    assert!((f - g).abs() <= 1e-5 * f.max(1e-3), "{f} against {g}");
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn albedo_has_converged() {
        // The bound that the documentation of `albedo` gives.
        const BOUND: f64 = 1e-5;
        let white = [1.0; 3];
        for ggx in [Ggx::isotropic(0.01, white), Ggx::isotropic(0.4, white), Ggx::anisotropic(0.05, 0.4, white)] {
            for theta_deg in [0.0f64, 45.0, 70.0, 85.0] {
                let wo = Direction::from_angles(theta_deg.to_radians(), 0.3);
                let finer = integral_about_mirror(|wi| ggx.eval_cos(wi, &wo), &wo, 200, 500)[0];
                let error = ggx.albedo(&wo)[0] / finer - 1.0;
                assert!(error.abs() < BOUND, "{ggx:?} at {theta_deg} deg: {error:e}");
            }
        }
    }
}
