//! Any of the closed-form models, as a value that files hold.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{Abc, Brdf, Dbrdf, Density, Ggx, Lambert, Mixture, Towards};
use crate::geometry::{Direction, Sample};

/// A closed-form model with its parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// A diffuser.
    Lambert(Lambert),
    /// Microfacets, one or two kinds, on a diffuser.
    Ggx(Ggx),
    /// One lobe with a free tail on a diffuser.
    Abc(Abc),
    /// A density of half vectors on a diffuser.
    Dbrdf(Dbrdf),
    /// Lobes of both kinds on a diffuser.
    Mixture(Mixture),
}

/// Parameters that no reflectance has.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("the model's {name} = {value} is out of range, it should be {range}")]
pub struct ModelError {
    /// The parameter.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// What it may be.
    pub range: &'static str,
}

impl Model {
    /// Checks parameters that come from a file.
    ///
    /// # Errors
    /// [`ModelError`] names the first that is out of range.
    pub fn check(&self) -> Result<(), ModelError> {
        match self {
            Self::Lambert(m) => weights("albedo", &m.albedo),
            Self::Ggx(m) => check_ggx(m),
            Self::Abc(m) => {
                weights("kd", &m.kd)?;
                weights("a", &m.a)?;
                within("b", m.b, 0.0..=1e15, "0 or more")?;
                within("c", m.c, 1e-6..=1e6, "positive")?;
                within("ior", m.ior, 1.0 + 1e-9..=1e3, "more than 1")
            }
            Self::Dbrdf(m) => {
                weights("kd", &m.kd)?;
                weights("c", &m.c)?;
                within("r0", m.r0, 0.0..=1.0, "0..=1")?;
                check_density(&m.p)
            }
            Self::Mixture(m) => {
                check_ggx(&m.ggx)?;
                m.half.iter().try_for_each(|l| check_lobe(l.alpha, &l.f0, &l.f90))
            }
        }
    }

    fn inner(&self) -> &dyn Brdf {
        match self {
            Self::Lambert(model) => model,
            Self::Ggx(model) => model,
            Self::Abc(model) => model,
            Self::Dbrdf(model) => model,
            Self::Mixture(model) => model,
        }
    }
}

fn within(
    name: &'static str,
    value: f64,
    allowed: std::ops::RangeInclusive<f64>,
    range: &'static str,
) -> Result<(), ModelError> {
    if allowed.contains(&value) { Ok(()) } else { Err(ModelError { name, value, range }) }
}

fn weights(name: &'static str, values: &[f64]) -> Result<(), ModelError> {
    values.iter().try_for_each(|&v| within(name, v, 0.0..=1e30, "0 or more"))
}

fn check_lobe(alpha: [f64; 2], f0: &[f64; 3], f90: &[f64; 3]) -> Result<(), ModelError> {
    alpha.iter().try_for_each(|&a| within("alpha", a, 1e-6..=1.0, "in (0, 1]"))?;
    weights("f0", f0)?;
    weights("f90", f90)
}

fn check_ggx(ggx: &Ggx) -> Result<(), ModelError> {
    weights("kd", &ggx.kd)?;
    ggx.lobes.iter().try_for_each(|l| check_lobe(l.alpha, &l.f0, &l.f90))
}

fn check_density(p: &Density) -> Result<(), ModelError> {
    match p {
        Density::Mixture(terms) => terms.iter().try_for_each(|t| {
            weights("weight", &[t.weight])?;
            t.alpha.iter().try_for_each(|&a| within("alpha", a, 1e-6..=1.0, "in (0, 1]"))
        }),
        Density::Table { theta_h_deg, p } => {
            weights("p", p)?;
            within(
                "number of densities",
                p.len() as f64,
                theta_h_deg.len() as f64..=theta_h_deg.len() as f64,
                "that of the knots",
            )?;
            weights("theta_h_deg", theta_h_deg)?;
            let step = |k: &[f64]| within("step of theta_h_deg", k[1] - k[0], f64::MIN_POSITIVE..=180.0, "positive");
            theta_h_deg.windows(2).try_for_each(step)
        }
    }
}

impl Brdf for Model {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        self.inner().eval(wi, wo)
    }

    fn towards<'a>(&'a self, wo: &Direction<Sample>) -> Towards<'a> {
        self.inner().towards(wo)
    }

    fn sample(&self, wo: &Direction<Sample>, u: [f64; 2]) -> Option<Direction<Sample>> {
        self.inner().sample(wo, u)
    }

    fn pdf(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> f64 {
        self.inner().pdf(wi, wo)
    }

    fn is_isotropic(&self) -> bool {
        self.inner().is_isotropic()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_from_files_are_checked() {
        let good = [
            r#"{"ggx":{"kd":[0.1,0.1,0.1],"lobes":[{"alpha":[0.1,0.2],"f0":[0,0,0],"f90":[1,1,1]}]}}"#,
            r#"{"dbrdf":{"kd":[0,0,0],"c":[1,1,1],"r0":0.1,"p":{"table":{"theta_h_deg":[1,2],"p":[3,0]}}}}"#,
        ];
        let bad = [
            r#"{"ggx":{"kd":[-0.1,0.1,0.1],"lobes":[]}}"#,
            r#"{"ggx":{"kd":[0.1,0.1,0.1],"lobes":[{"alpha":[0,0.2],"f0":[0,0,0],"f90":[1,1,1]}]}}"#,
            r#"{"dbrdf":{"kd":[0,0,0],"c":[1,1,1],"r0":0.1,"p":{"table":{"theta_h_deg":[2,1],"p":[3,0]}}}}"#,
            r#"{"dbrdf":{"kd":[0,0,0],"c":[1,1,1],"r0":0.1,"p":{"table":{"theta_h_deg":[1,2],"p":[3]}}}}"#,
            r#"{"abc":{"kd":[0,0,0],"a":[1,1,1],"b":10,"c":1,"ior":1}}"#,
        ];
        let check = |text: &str| serde_json::from_str::<Model>(text).unwrap().check();
        assert!(good.iter().all(|text| check(text).is_ok()));
        for text in bad {
            assert!(check(text).unwrap_err().to_string().contains("out of range"), "{text}");
        }
    }
}
