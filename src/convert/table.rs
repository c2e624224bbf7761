//! What the prior has learned, as a file.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::basis::Learned;
use crate::reflectance::abc_materials;

/// The version of the table this program writes and reads.
pub const PRIOR_VERSION: u32 = 1;

/// The population of the prior and what was learned on it: `data/prior.toml`.
///
/// The members themselves are the published ABC and SGD fits of `materials`; their coefficients are integrated for the
/// zone and the rings at hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PriorTable {
    /// [`PRIOR_VERSION`].
    pub version: u32,
    /// Order of the spherical harmonics.
    pub sh_order: usize,
    /// Weight of the zone in the projection on them, 0..=1: see [`crate::basis::Projection`].
    pub zone_weight: f64,
    /// See [`Learned::misfit`].
    pub misfit: f64,
    /// See [`Learned::neighbours`].
    pub neighbours: usize,
    /// See [`Learned::independent_rings`].
    pub independent_rings: usize,
    /// See [`Learned::fidelity`].
    pub fidelity: f64,
    /// See [`Learned::widening`].
    pub widening: f64,
    /// Names of the materials.
    pub materials: Vec<String>,
}

/// A table that cannot be used.
#[derive(Debug, Error)]
pub enum PriorTableError {
    /// It is no such table.
    #[error("{0}")]
    Toml(#[from] toml::de::Error),
    /// A value is out of range.
    #[error("`{key}` is {value}: {expected}; `zonal prior --out FILE` makes a table")]
    Value {
        /// The key.
        key: &'static str,
        /// Its value.
        value: String,
        /// What it must be.
        expected: &'static str,
    },
}

impl PriorTable {
    /// The built-in table.
    pub fn built_in() -> Self {
        Self::from_toml(include_str!("../../data/prior.toml")).expect("the built-in table is tested")
    }

    /// The table as [`PriorTable::from_toml`] reads it.
    pub fn to_toml(&self) -> String {
        let table = toml::to_string_pretty(self).expect("plain values");
        format!("# What `zonal convert --method prior` knows beforehand; made by `zonal prior`.\n{table}")
    }

    /// Reads a table.
    ///
    /// # Errors
    /// [`PriorTableError`].
    pub fn from_toml(text: &str) -> Result<Self, PriorTableError> {
        toml::from_str::<Self>(text)?.check()
    }

    /// The table itself, if its values are in range.
    ///
    /// # Errors
    /// [`PriorTableError::Value`].
    pub fn check(self) -> Result<Self, PriorTableError> {
        let table = self;
        let wrong = |key, value: &dyn std::fmt::Display, expected| {
            Err(PriorTableError::Value { key, value: value.to_string(), expected })
        };
        if table.version != PRIOR_VERSION {
            return wrong("version", &table.version, "this program knows version 1");
        }
        if !(2..=30).contains(&table.sh_order) {
            return wrong("sh_order", &table.sh_order, "choose 2 to 30");
        }
        if !(table.zone_weight > 0.0 && table.zone_weight <= 1.0) {
            return wrong("zone_weight", &table.zone_weight, "choose more than 0 and at most 1");
        }
        for (key, value) in [("misfit", table.misfit), ("fidelity", table.fidelity), ("widening", table.widening)] {
            if !(value > 0.0 && value.is_finite()) {
                return wrong(key, &value, "choose a positive number");
            }
        }
        if table.neighbours < 2 || table.independent_rings == 0 {
            return wrong("neighbours", &table.neighbours, "choose at least 2, and at least 1 for independent_rings");
        }
        if table.materials.len() < 4 {
            return wrong("materials", &table.materials.len(), "name at least 4");
        }
        for name in &table.materials {
            if !abc_materials().iter().any(|m| m.name == *name) {
                return wrong("materials", name, "name materials of the ABC and SGD tables");
            }
        }
        Ok(table)
    }

    /// The numbers for the algebra.
    pub fn learned(&self) -> Learned {
        Learned {
            misfit: self.misfit,
            neighbours: self.neighbours,
            independent_rings: self.independent_rings,
            fidelity: self.fidelity,
            widening: self.widening,
        }
    }
}
