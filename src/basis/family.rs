//! The functions a conversion expands in.

use super::harmonics::{Harmonics, OrderError};
use crate::geometry::Zone;

/// A family of functions of incident directions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Family {
    /// All real spherical harmonics.
    All,
    /// Those with l + |m| odd: they vanish at the horizon, as f_cos does, and times sqrt2 are an orthonormal basis of the
    /// hemisphere.
    Odd,
    /// Hemispherical harmonics: the zonal functions of the zone 0..90 deg (Gautron et al. 2004).
    Hemispherical,
}

impl Family {
    /// Its functions up to `order`; of [`Family::Odd`] all spherical harmonics, of which only some are used.
    ///
    /// # Errors
    /// [`OrderError`].
    pub fn harmonics(self, order: usize) -> Result<Harmonics, OrderError> {
        match self {
            Family::All | Family::Odd => Harmonics::spherical(order),
            Family::Hemispherical => Harmonics::zonal(Zone::hemisphere(), order),
        }
    }

    /// The degrees l of the functions used, for one |m|.
    pub fn degrees(self, order: usize, m: usize) -> Vec<usize> {
        (m..=order).filter(|l| self != Family::Odd || (l + m) % 2 == 1).collect()
    }

    /// Integral of a function's square over the domain of the family: 1, but for [`Family::Odd`], whose functions have half
    /// of their energy in the hemisphere.
    pub(super) fn energy(self) -> f64 {
        if self == Family::Odd { 0.5 } else { 1.0 }
    }
}
