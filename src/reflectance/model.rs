//! Any of the closed-form models, as a value that files hold.

use serde::{Deserialize, Serialize};

use super::{Abc, Brdf, Dbrdf, Ggx, Lambert, Mixture, Towards};
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

impl Model {
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
