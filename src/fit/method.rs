//! The methods by name.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::reflectance::most_alike;

/// A way to make a model of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FitMethod {
    /// Baseline: D-BRDF from the backscatter of the reconstruction (Ghosh 2007).
    Thesis,
    /// Baseline: GGX + Lambert fitted to the reconstruction.
    GgxToReconstruction,
    /// A diffuser.
    Lambert,
    /// One GGX lobe + Lambert.
    Ggx,
    /// One ABC lobe + Lambert: its tail is free.
    Abc,
    /// Two GGX lobes + Lambert.
    Ggx2,
    /// D-BRDF, its density a mixture, + Lambert.
    Dbrdf,
    /// GGX and half-vector lobes of many widths, non-negative, + Lambert.
    Mixture,
    /// The simplest of the above (baselines excepted) that predicts what it has not seen.
    Auto,
}

/// A method nobody knows.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("there is no model `{name}`; did you mean {}? Known: {}", .nearest.join(", "), FitMethod::names().join(", "))]
pub struct UnknownMethod {
    /// The name asked for.
    pub name: String,
    /// The most similar names, best first.
    pub nearest: Vec<String>,
}

impl FitMethod {
    /// All of them: baselines, then families from simple to rich, then `auto`.
    pub const ALL: [Self; 9] = [
        Self::Thesis,
        Self::GgxToReconstruction,
        Self::Lambert,
        Self::Ggx,
        Self::Abc,
        Self::Ggx2,
        Self::Dbrdf,
        Self::Mixture,
        Self::Auto,
    ];

    /// Its name at the prompt and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Thesis => "thesis",
            Self::GgxToReconstruction => "ggx-to-reconstruction",
            Self::Lambert => "lambert",
            Self::Ggx => "ggx",
            Self::Abc => "abc",
            Self::Ggx2 => "ggx2",
            Self::Dbrdf => "dbrdf",
            Self::Mixture => "mixture",
            Self::Auto => "auto",
        }
    }

    /// All names.
    pub fn names() -> Vec<&'static str> {
        Self::ALL.map(Self::name).into()
    }
}

impl fmt::Display for FitMethod {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for FitMethod {
    type Err = UnknownMethod;

    fn from_str(name: &str) -> Result<Self, UnknownMethod> {
        let known = Self::ALL.into_iter().find(|m| m.name() == name);
        known.ok_or_else(|| UnknownMethod {
            name: name.into(),
            nearest: most_alike(name, Self::ALL.iter().map(|m| m.name().to_owned())),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back_and_wrong_ones_get_the_nearest() {
        for method in FitMethod::ALL {
            assert_eq!(method.name().parse(), Ok(method));
            assert_eq!(serde_json::to_value(method).unwrap(), method.name());
        }
        let error = "dbdrf".parse::<FitMethod>().unwrap_err();
        assert_eq!(error.nearest[0], "dbrdf");
        assert!(error.to_string().contains("mixture"));
    }
}
