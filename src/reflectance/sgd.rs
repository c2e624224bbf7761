//! The SGD model and its published fits of the MERL materials.

use std::f64::consts::{FRAC_1_PI, PI};
use std::sync::LazyLock;

use super::half::half_vector;
use super::{Brdf, ReadError, Towards};
use crate::geometry::{Direction, Sample};

/// One colour channel of [`Sgd`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SgdChannel {
    /// Albedo of the Lambert part.
    pub rho_d: f64,
    /// Scale of the lobe.
    pub rho_s: f64,
    /// Width of the lobe, > 0.
    pub alpha: f64,
    /// Fall-off of the lobe.
    pub p: f64,
    /// Norm of the distribution.
    pub kap: f64,
    /// Reflectance at the normal.
    pub f0: f64,
    /// Slope of the reflectance against cos(theta_d).
    pub f1: f64,
    /// Shadowing: G(theta) = 1 + lambda (1 - exp(c max(0, theta - theta0)^k)), within 0..=1.
    pub lambda: f64,
    /// See `lambda`.
    pub c: f64,
    /// See `lambda`.
    pub k: f64,
    /// See `lambda`, radians.
    pub theta0: f64,
}

/// f = (rho_d + rho_s F D G(theta_i) G(theta_o) / (cos(theta_i) cos(theta_o))) / pi, each channel by itself.
///
/// D = kap e^-x / (pi x^p cos^4(theta_h)) with x = alpha + tan^2(theta_h) / alpha is the shifted gamma distribution,
/// F = f0 - f1 u + (1 - f0)(1 - u)^5 with u = cos(theta_d). Bagher, Soler, Holzschuch, "Accurate fitting of measured
/// reflectances using a shifted gamma micro-facet distribution", Computer Graphics Forum 31(4), 2012. Reciprocal;
/// nothing bounds the albedo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sgd {
    /// Linear RGB.
    pub channels: [SgdChannel; 3],
}

impl SgdChannel {
    fn shadowing(&self, cos_theta: f64) -> f64 {
        let beyond = (cos_theta.min(1.0).acos() - self.theta0).max(0.0);
        (1.0 - self.lambda * (self.c * beyond.powf(self.k)).exp_m1()).clamp(0.0, 1.0)
    }

    /// f for a given G(theta_i) G(theta_o).
    fn shadowed(&self, [cos_i, cos_o]: [f64; 2], cos_h: f64, cos_d: f64, shadowing: f64) -> f64 {
        let cos2 = cos_h * cos_h;
        let x = self.alpha + (1.0 - cos2) / cos2 / self.alpha;
        let density = self.kap * (-x).exp() / (PI * x.powf(self.p) * cos2 * cos2);
        let fresnel = self.f0 - self.f1 * cos_d + (1.0 - self.f0) * (1.0 - cos_d).powi(5);
        FRAC_1_PI * (self.rho_d + self.rho_s * fresnel * density * shadowing / (cos_i * cos_o))
    }
}

impl Brdf for Sgd {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        let (cos_i, cos_o) = (wi.cos_theta(), wo.cos_theta());
        if cos_i <= 0.0 || cos_o <= 0.0 {
            return [0.0; 3];
        }
        let h = half_vector(wi, wo);
        let cos_d = wi.vector().dot(&h).clamp(0.0, 1.0);
        self.channels.each_ref().map(|channel| {
            let shadowing = channel.shadowing(cos_i) * channel.shadowing(cos_o);
            channel.shadowed([cos_i, cos_o], h.z, cos_d, shadowing)
        })
    }

    fn towards<'a>(&'a self, wo: &Direction<Sample>) -> Towards<'a> {
        let wo = *wo;
        let cos_o = wo.cos_theta();
        if cos_o <= 0.0 {
            return Box::new(|_| [0.0; 3]);
        }
        let shadowing = self.channels.each_ref().map(|c| c.shadowing(cos_o));
        Box::new(move |wi| {
            let cos_i = wi.cos_theta();
            if cos_i <= 0.0 {
                return [0.0; 3];
            }
            let h = half_vector(wi, &wo);
            let cos_d = wi.vector().dot(&h).clamp(0.0, 1.0);
            std::array::from_fn(|k| {
                let channel = &self.channels[k];
                cos_i * channel.shadowed([cos_i, cos_o], h.z, cos_d, channel.shadowing(cos_i) * shadowing[k])
            })
        })
    }

    fn is_isotropic(&self) -> bool {
        true
    }
}

/// One published fit.
#[derive(Debug, Clone, PartialEq)]
pub struct SgdMaterial {
    /// The name of the material in the MERL database.
    pub name: String,
    /// Its fit.
    pub brdf: Sgd,
}

/// The published fits of the 100 MERL materials, in the order of the table.
pub fn sgd_materials() -> &'static [SgdMaterial] {
    static MATERIALS: LazyLock<Vec<SgdMaterial>> = LazyLock::new(|| {
        parse(include_str!("../../data/sgd_bagher2012.csv"), "sgd_bagher2012.csv")
            .expect("the built-in table is tested")
    });
    &MATERIALS
}

/// Reads a table with the columns of `data/sgd_bagher2012.csv`; lines that start with `#` are comments.
fn parse(text: &str, file: &str) -> Result<Vec<SgdMaterial>, ReadError> {
    // Name, other name, 11 parameters and an error by channel.
    type Row = (String, String, [[f64; 3]; 11], [f64; 3]);
    let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).from_reader(text.as_bytes());
    let rows = reader.deserialize::<Row>().map(|row| {
        let (name, _, columns, _) =
            row.map_err(|e| ReadError::invalid(file, "a row", "two names and 36 numbers", e))?;
        let channels = [0, 1, 2].map(|c| {
            let [rho_d, rho_s, alpha, p, f0, f1, kap, lambda, c_, k, theta0] = columns.map(|column| column[c]);
            SgdChannel { rho_d, rho_s, alpha, p, kap, f0, f1, lambda, c: c_, k, theta0 }
        });
        let in_range = columns.iter().flatten().all(|v| v.is_finite()) && channels.iter().all(|c| c.alpha > 0.0);
        if !in_range {
            let expected = "finite numbers and alpha > 0";
            return Err(ReadError::invalid(file, format!("material {name}"), expected, format!("{channels:?}")));
        }
        Ok(SgdMaterial { name, brdf: Sgd { channels } })
    });
    rows.collect()
}

#[cfg(test)]
mod tests {
    use super::super::abc_materials;
    use super::super::test_support::*;
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_table_holds_the_materials_of_the_other() {
        let names = |n: &str| abc_materials().iter().any(|m| m.name == n);
        assert_eq!(sgd_materials().len(), 100);
        assert!(sgd_materials().iter().all(|m| names(&m.name)));
        assert_eq!(sgd_materials()[0].brdf.channels[2].theta0, -0.0661091);
        assert_eq!(sgd_materials()[0].brdf.channels[1].kap, 24.5961);
    }

    /// Two models fitted to the same measurements send back the same light: half of the materials within 8%.
    #[test]
    fn albedos_are_those_of_the_other_fits() {
        let wo = Direction::from_angles(25f64.to_radians(), 0.0);
        let mean = |a: [f64; 3]| a.iter().sum::<f64>() / 3.0;
        let mut differences: Vec<f64> = sgd_materials()
            .iter()
            .step_by(3)
            .map(|m| {
                let other = abc_materials().iter().find(|a| a.name == m.name).unwrap();
                (mean(m.brdf.albedo(&wo)) / mean(other.brdf.albedo(&wo))).ln().abs()
            })
            .collect();
        differences.sort_by(f64::total_cmp);
        assert!(differences[differences.len() / 2] < 0.08, "{differences:?}");
    }

    #[test]
    fn bad_rows_are_errors_that_name_the_material() {
        let head = "c".to_owned() + &",c".repeat(37);
        let row = |alpha: &str| format!("{head}\nx,y{},{alpha}{}\n", ",0.1".repeat(6), ",1".repeat(29));
        assert!(parse(&row("0.5"), "t.csv").is_ok());
        for alpha in ["0", "NaN", "-1"] {
            let error = parse(&row(alpha), "t.csv").unwrap_err().to_string();
            assert!(error.contains("t.csv") && error.contains("material x"), "{error}");
        }
        assert!(parse(&format!("{head}\nx,y,0,0\n"), "t.csv").is_err());
    }

    #[test]
    fn towards_is_eval() {
        let brdf = &sgd_materials()[5].brdf;
        let wo = Direction::from_angles(0.6, 0.2);
        let f_cos = brdf.towards(&wo);
        for theta in [0.1, 0.6, 1.2, 1.7] {
            let wi = Direction::from_angles(theta, 2.0);
            assert_eq!(f_cos(&wi).map(|f| (f * 1e12).round()), brdf.eval_cos(&wi, &wo).map(|f| (f * 1e12).round()));
        }
    }

    #[test]
    fn is_black_below_and_continuous() {
        black_below(&sgd_materials()[3].brdf);
        continuous_over_the_wrap(&sgd_materials()[3].brdf);
    }

    proptest! {
        #[test]
        fn is_reciprocal(wi in upper(), wo in upper(), pick in 0usize..100) {
            reciprocal(&sgd_materials()[pick].brdf, &wi, &wo, 1e-7)?;
        }
    }
}
