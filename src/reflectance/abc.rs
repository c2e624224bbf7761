//! The ABC model and its published fits of the MERL materials.

use std::f64::consts::FRAC_1_PI;
use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::half::half_vector;
use super::{Brdf, ReadError, sampling};
use crate::geometry::{Direction, Sample};

/// f = kd / pi + F D G / (pi cos(theta_i) cos(theta_o)) with D = a / (1 + b (1 - cos(theta_h)))^c.
///
/// F is the Fresnel reflectance of a dielectric for unpolarised light at the angle between `wi` and the half vector, G
/// the shadowing of V-shaped grooves (Cook & Torrance 1982). Löw, Kronander, Ynnerman, Unger, "BRDF models for accurate
/// and efficient rendering of glossy surfaces", ACM TOG 31(1), 2012. Reciprocal; `a` is a free scale, so nothing
/// bounds the albedo.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Abc {
    /// Albedo of the Lambert part, linear RGB.
    pub kd: [f64; 3],
    /// Height of the lobe, linear RGB, >= 0.
    pub a: [f64; 3],
    /// Sharpness of the lobe, >= 0.
    pub b: f64,
    /// Fall-off of the lobe, > 0.
    pub c: f64,
    /// Index of refraction, > 1.
    pub ior: f64,
}

impl Brdf for Abc {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        let (cos_i, cos_o) = (wi.cos_theta(), wo.cos_theta());
        if cos_i <= 0.0 || cos_o <= 0.0 {
            return [0.0; 3];
        }
        let h = half_vector(wi, wo);
        let lobe = abc_lobe(self.b, self.c, self.ior, [cos_i, cos_o], h.z, wi.vector().dot(&h));
        std::array::from_fn(|k| FRAC_1_PI * self.kd[k] + self.a[k] * lobe)
    }

    /// The diffuser by the cosine law, or a half vector with density D / integral D that mirrors `wo`.
    fn sample(&self, wo: &Direction<Sample>, u: [f64; 2]) -> Option<Direction<Sample>> {
        if wo.cos_theta() <= 0.0 {
            return None;
        }
        let (component, u0) = sampling::choose(self.weights(wo).into_iter(), u[0])?;
        if component == 0 {
            return Some(sampling::cosine([u0, u[1]]));
        }
        let h = Direction::<Sample>::from_mu_phi(1.0 - self.depth(u0 * self.below(1.0)), std::f64::consts::TAU * u[1]);
        sampling::reflect(wo, &h.vector())
    }

    fn pdf(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> f64 {
        if wi.cos_theta() <= 0.0 || wo.cos_theta() <= 0.0 {
            return 0.0;
        }
        let h = half_vector(wi, wo);
        let density = (1.0 + self.b * (1.0 - h.z).max(0.0)).powf(-self.c) / (std::f64::consts::TAU * self.below(1.0));
        let lobe = density / (4.0 * h.dot(&wo.vector()));
        sampling::mixture(self.weights(wo).into_iter(), [sampling::cosine_pdf(wi), lobe].into_iter())
    }

    fn is_isotropic(&self) -> bool {
        true
    }
}

impl Abc {
    /// integral from 0 to x of (1 + b t)^-c dt, where t = 1 - cos(theta_h).
    fn below(&self, x: f64) -> f64 {
        let log = (self.b * x).ln_1p();
        let p = 1.0 - self.c;
        // (e^(p log) - 1) / (p b), with its limits for c = 1 and b = 0.
        if self.b * x < 1e-12 {
            x
        } else if p.abs() < 1e-9 {
            log / self.b
        } else {
            (p * log).exp_m1() / (p * self.b)
        }
    }

    /// The inverse of [`Abc::below`].
    fn depth(&self, integral: f64) -> f64 {
        let p = 1.0 - self.c;
        let log = if p.abs() < 1e-9 { self.b * integral } else { (p * self.b * integral).ln_1p() / p };
        if self.b < 1e-12 { integral } else { (log.exp_m1() / self.b).min(1.0) }
    }

    /// Estimated albedos towards `wo` of the diffuser and the lobe: of that, as if all half vectors lay at the normal.
    fn weights(&self, wo: &Direction<Sample>) -> [f64; 2] {
        let fresnel = fresnel_dielectric(wo.cos_theta(), self.ior);
        // h to wi turns 4 cos_o; f carries 1 / (pi cos_i cos_o).
        let lobe = 8.0 * fresnel * self.below(1.0) / wo.cos_theta().max(0.1);
        [sampling::mean(self.kd), sampling::mean(self.a) * lobe]
    }
}

/// The lobe for `a` = 1, 1/sr.
pub(crate) fn abc_lobe(b: f64, c: f64, ior: f64, cosines: [f64; 2], cos_h: f64, cos_d: f64) -> f64 {
    let cos_d = cos_d.clamp(1e-12, 1.0);
    let fall_off = (1.0 + b * (1.0 - cos_h).max(0.0)).powf(-c);
    fresnel_dielectric(cos_d, ior) * grooves(cosines, cos_h, cos_d) * fall_off
}

/// Derivatives of [`abc_lobe`] by b, c and the index of refraction.
pub(crate) fn abc_lobe_slopes(b: f64, c: f64, ior: f64, cosines: [f64; 2], cos_h: f64, cos_d: f64) -> [f64; 3] {
    let (cos_d, t) = (cos_d.clamp(1e-12, 1.0), (1.0 - cos_h).max(0.0));
    let log = (b * t).ln_1p();
    let shape = grooves(cosines, cos_h, cos_d) * (-c * log).exp();
    let lobe = fresnel_dielectric(cos_d, ior) * shape;
    [-c * t / (1.0 + b * t) * lobe, -log * lobe, fresnel_dielectric_slope(cos_d, ior) * shape]
}

/// Shadowing of V-shaped grooves over pi cos(theta_i) cos(theta_o).
fn grooves([cos_i, cos_o]: [f64; 2], cos_h: f64, cos_d: f64) -> f64 {
    FRAC_1_PI * (2.0 * cos_h * cos_i.min(cos_o) / cos_d).min(1.0) / (cos_i * cos_o)
}

/// Reflectance of the boundary to a dielectric of index `ior` > 1 for unpolarised light at `cos_theta` in 0..=1.
fn fresnel_dielectric(cos_theta: f64, ior: f64) -> f64 {
    let c = cos_theta;
    let g = (ior * ior - 1.0 + c * c).sqrt();
    let s_polarised = (g - c) / (g + c);
    let p_over_s = (c * (g + c) - 1.0) / (c * (g - c) + 1.0);
    0.5 * s_polarised * s_polarised * (1.0 + p_over_s * p_over_s)
}

/// Its derivative by `ior`.
fn fresnel_dielectric_slope(cos_theta: f64, ior: f64) -> f64 {
    let c = cos_theta;
    let g = (ior * ior - 1.0 + c * c).sqrt();
    let (s_polarised, s_slope) = ((g - c) / (g + c), 2.0 * c / (g + c).powi(2));
    let below = c * (g - c) + 1.0;
    let (p_over_s, p_slope) = ((c * (g + c) - 1.0) / below, 2.0 * c * (1.0 - c * c) / (below * below));
    let by_g = s_polarised * s_slope * (1.0 + p_over_s * p_over_s) + s_polarised * s_polarised * p_over_s * p_slope;
    by_g * ior / g
}

/// One built-in fit.
#[derive(Debug, Clone, PartialEq)]
pub struct AbcMaterial {
    /// The name of the material in the MERL database.
    pub name: String,
    /// Its fit.
    pub brdf: Abc,
}

/// The published fits of the 100 MERL materials, in the order of the table.
pub fn abc_materials() -> &'static [AbcMaterial] {
    static MATERIALS: LazyLock<Vec<AbcMaterial>> = LazyLock::new(|| {
        parse(include_str!("../../data/abc_low2012.csv"), "abc_low2012.csv").expect("the built-in table is tested")
    });
    &MATERIALS
}

#[derive(Deserialize)]
#[allow(non_snake_case, reason = "the column names of the publication")]
struct Row {
    material: String,
    kD_r: f64,
    kD_g: f64,
    kD_b: f64,
    A_r: f64,
    A_g: f64,
    A_b: f64,
    B: f64,
    C: f64,
    ior: f64,
}

/// Reads a table with the columns of `data/abc_low2012.csv`; lines that start with `#` are comments.
fn parse(text: &str, file: &str) -> Result<Vec<AbcMaterial>, ReadError> {
    let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).from_reader(text.as_bytes());
    let rows = reader.deserialize::<Row>().map(|row| {
        let row = row.map_err(|e| ReadError::invalid(file, "a row", "a material and nine numbers", e))?;
        let brdf = Abc {
            kd: [row.kD_r, row.kD_g, row.kD_b],
            a: [row.A_r, row.A_g, row.A_b],
            b: row.B,
            c: row.C,
            ior: row.ior,
        };
        let in_range = brdf.kd.iter().chain(&brdf.a).chain([&brdf.b]).all(|v| v.is_finite() && *v >= 0.0)
            && brdf.c.is_finite()
            && brdf.c > 0.0
            && brdf.ior.is_finite()
            && brdf.ior > 1.0;
        if !in_range {
            let expected = "kD, A, B >= 0, C > 0 and ior > 1";
            return Err(ReadError::invalid(file, format!("material {}", row.material), expected, format!("{brdf:?}")));
        }
        Ok(AbcMaterial { name: row.material, brdf })
    });
    rows.collect()
}

#[cfg(test)]
mod tests {
    use super::super::test_support::*;
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_table_is_complete() {
        let materials = abc_materials();
        assert_eq!(materials.len(), 100);
        assert_eq!(materials[0].name, "alum-bronze");
        assert_eq!(materials[0].brdf.a[2], 27.373095);
        assert_eq!(materials[99].brdf.ior, abc_materials().last().unwrap().brdf.ior);
    }

    #[test]
    fn bad_rows_are_errors_that_name_the_material() {
        let head = "material,kD_r,kD_g,kD_b,A_r,A_g,A_b,B,C,ior\n";
        for row in ["x,0,0,0,1,1,1,10,1,0.5", "x,0,0,0,-1,1,1,10,1,1.5", "x,0,0,0,NaN,1,1,10,1,1.5"] {
            let error = parse(&format!("{head}{row}\n"), "t.csv").unwrap_err().to_string();
            assert!(error.contains("t.csv") && error.contains("material x"), "{error}");
        }
        assert!(parse(&format!("{head}x,0,0\n"), "t.csv").is_err());
    }

    #[test]
    fn fresnel_limits() {
        assert!((fresnel_dielectric(1.0, 1.5) - 0.04).abs() < 1e-15);
        assert!((fresnel_dielectric(0.0, 1.5) - 1.0).abs() < 1e-15);
        // At Brewster's angle tan(theta) = ior the p part vanishes: half of ((n^2 - 1)/(n^2 + 1))^2 is left.
        let n = 1.5f64;
        let brewster = 0.5 * ((n * n - 1.0) / (n * n + 1.0)).powi(2);
        assert!((fresnel_dielectric(n.atan().cos(), n) - brewster).abs() < 1e-15);
    }

    /// A power x^-c with ln x to 11 and c = 3 changes by 33 for each 1 of c's logarithm: differences over 1e-5 of c err by
    /// 33^3 / 6 of its square.
    const DIFFERENCE: f64 = 1e-6;

    #[test]
    fn slopes_are_those_of_the_lobe() {
        for (b, c, ior) in [(3.0, 0.4, 1.3), (800.0, 1.2, 1.6), (1e5, 3.0, 4.0)] {
            for (cos_h, cos_d) in [(1.0, 0.9), (0.9999, 0.5), (0.97, 0.7), (0.6, 0.99)] {
                let lobe = |b, c, ior| abc_lobe(b, c, ior, [0.6, 0.8], cos_h, cos_d);
                let slope = |f: &dyn Fn(f64) -> f64, x: f64| (f(x * (1.0 + 1e-5)) - f(x * (1.0 - 1e-5))) / (2e-5 * x);
                let want = [
                    slope(&|b| lobe(b, c, ior), b),
                    slope(&|c| lobe(b, c, ior), c),
                    slope(&|ior| lobe(b, c, ior), ior),
                ];
                let got = abc_lobe_slopes(b, c, ior, [0.6, 0.8], cos_h, cos_d);
                for ((got, want), x) in got.into_iter().zip(want).zip([b, c, ior]) {
                    assert!((got - want).abs() * x < DIFFERENCE * lobe(b, c, ior), "{got} {want}");
                }
            }
        }
    }

    #[test]
    fn matches_the_published_form() {
        let (wi, wo) = (Direction::from_angles(0.35, 0.4), Direction::from_angles(0.95, 3.1));
        let abc = abc_materials()[10].brdf;
        let (i, o) = (wi.vector(), wo.vector());
        let h = (i + o).normalize();
        let f = fresnel_dielectric(h.dot(&i), abc.ior);
        let d = abc.a[0] / (1.0 + abc.b * (1.0 - h.z)).powf(abc.c);
        let g = 1f64.min(2.0 * h.z * i.z / h.dot(&i)).min(2.0 * h.z * o.z / h.dot(&o));
        let want = abc.kd[0] / std::f64::consts::PI + f * d * g / (std::f64::consts::PI * i.z * o.z);
        assert!((abc.eval(&wi, &wo)[0] / want - 1.0).abs() < 1e-12);
    }

    #[test]
    fn is_black_below_and_continuous() {
        black_below(&abc_materials()[3].brdf);
        continuous_over_the_wrap(&abc_materials()[3].brdf);
    }

    proptest! {
        #[test]
        fn is_reciprocal(wi in upper(), wo in upper(), pick in 0usize..100) {
            reciprocal(&abc_materials()[pick].brdf, &wi, &wo, 1e-7)?;
        }
    }
}
