//! The linear ways from zonal coefficients to functions of the hemisphere, and how strongly they are held back.

use super::conversion::{ConversionError, gram_condition};
use super::family::Family;
use crate::geometry::Zone;

/// How zonal coefficients become functions on the whole hemisphere: the maps that are linear and know no material.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Method {
    /// The literal dual basis of all SH up to L over the zone (Ghosh 2007, eq. 3.12-3.16). Fails on partial zones.
    Thesis,
    /// The same dual with the small eigenvalues of the Gram matrix cut.
    Truncated,
    /// The harmonics that vanish at the horizon, as combinations with some of their energy in the zone; others are left out.
    /// Where the zone tells all of them apart none is, and this is [`Method::Parity`].
    Slepian,
    /// Least squares over the zone in the SH with l + m odd, up to L + 1: those that vanish at the horizon, as f_cos does.
    /// Where the zone tells more of them apart, up to L + 4 with curvature gently held down.
    Parity,
    /// The same up to a higher order, curvature held down.
    Tikhonov,
    /// The dual basis of the hemispherical harmonics up to L over the zone (Gautron et al. 2004); where that lacks no more than
    /// a hole at its pole, with curvature gently held down.
    Hsh,
}

/// How strongly a method holds back what the zone says little about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Strength {
    /// Not at all.
    Exact,
    /// Eigenvalues of a Gram block below this share of the block's largest are cut.
    Cut(f64),
    /// Functions with less than this share of their energy in the zone are left out.
    Concentration(f64),
    /// min |W y - Z z|^2 + lambda |(l (l + 1) - 2) y|^2: the factor of the squared curvature, a cosine's left free.
    Curvature(f64),
}

/// Functions of a tenth of their energy in the zone raise noise of 1% to 3% of the signal outside.
const CONCENTRATED: f64 = 0.1;
/// Used where no data chose: the level at which noise of 1% drowns an eigenvalue of the built zone.
const CUT: f64 = 3e-2;
/// The same for curvature.
const CURVATURE: f64 = 1e-4;
/// Orders `parity` may go beyond the zonal one while the zone tells its functions apart this well.
const RAISED_ORDERS: usize = 4;
const HARMLESS: f64 = 3.9;
/// Hemispherical harmonics that a zone tells apart this well miss no more than a hole at its pole.
const SUPPORTED: f64 = 10.0;
/// Orders [`Method::Tikhonov`] goes beyond the zonal one.
const SMOOTH_ORDERS: usize = 4;

impl Method {
    /// All methods, in the order charts list them.
    pub const ALL: [Method; 6] =
        [Method::Thesis, Method::Truncated, Method::Slepian, Method::Parity, Method::Tikhonov, Method::Hsh];

    /// The name used at the prompt and in files.
    pub fn name(self) -> &'static str {
        match self {
            Method::Thesis => "thesis",
            Method::Truncated => "truncated",
            Method::Slepian => "slepian",
            Method::Parity => "parity",
            Method::Tikhonov => "tikhonov",
            Method::Hsh => "hsh",
        }
    }

    /// The functions it expands in.
    pub fn family(self) -> Family {
        match self {
            Method::Thesis | Method::Truncated => Family::All,
            Method::Slepian | Method::Parity | Method::Tikhonov => Family::Odd,
            Method::Hsh => Family::Hemispherical,
        }
    }

    /// The order of these functions that zonal order `order` leads to, at most [`super::MAX_ORDER`].
    ///
    /// # Errors
    /// As [`super::Conversion::new`].
    pub fn sh_order(self, zone: Zone, order: usize) -> Result<usize, ConversionError> {
        let wanted = match self {
            Method::Thesis | Method::Truncated | Method::Hsh => order,
            Method::Slepian | Method::Parity => {
                let mut wanted = order + 1;
                while order > 1 && wanted < (order + RAISED_ORDERS).min(super::MAX_ORDER) {
                    if gram_condition(zone, wanted + 1, Family::Odd)? > HARMLESS {
                        break;
                    }
                    wanted += 1;
                }
                wanted
            }
            Method::Tikhonov => order + SMOOTH_ORDERS,
        };
        Ok(wanted.min(super::MAX_ORDER))
    }

    /// The strength used where no data chose one.
    ///
    /// # Errors
    /// As [`super::Conversion::new`].
    pub fn strength(self, zone: Zone, order: usize) -> Result<Strength, ConversionError> {
        Ok(match self {
            Method::Thesis => Strength::Exact,
            // A zone that lacks no more than a hole at its pole: what would ring there is held down.
            Method::Hsh
                if order > 1 && zone.theta_min() > 0.0 && gram_condition(zone, order, self.family())? < SUPPORTED =>
            {
                Strength::gentle(self.family(), order)
            }
            Method::Hsh => Strength::Exact,
            Method::Truncated => Strength::Cut(CUT),
            Method::Parity | Method::Slepian => {
                let sh_order = self.sh_order(zone, order)?;
                if sh_order > order + 1 {
                    Strength::gentle(Family::Odd, sh_order)
                } else if self == Method::Parity {
                    Strength::Exact
                } else {
                    Strength::Concentration(CONCENTRATED)
                }
            }
            Method::Tikhonov => Strength::Curvature(CURVATURE),
        })
    }

    /// Whether data choose its strength: see [`super::Evidence`].
    pub fn is_tuned(self) -> bool {
        matches!(self, Method::Truncated | Method::Tikhonov)
    }
}

impl Strength {
    /// Curvature held down so little that at the highest order, `sh_order`, it weighs as much as the data: enough to keep
    /// functions beyond the zonal order from ringing where the zone ends.
    pub(super) fn gentle(family: Family, sh_order: usize) -> Self {
        let highest = (sh_order * (sh_order + 1)) as f64;
        Strength::Curvature(family.energy() / (highest * highest))
    }

    /// What a component of singular value `s` is multiplied by, in a block whose largest is `largest`; 1/s unless held back.
    pub(super) fn inverse(self, s: f64, largest: f64, family: Family) -> f64 {
        let keep = match self {
            Strength::Exact => s > 0.0,
            Strength::Cut(cut) => s * s > cut * largest * largest,
            Strength::Concentration(share) => s * s > share * family.energy(),
            Strength::Curvature(lambda) => return s / (s * s + lambda),
        };
        if keep { 1.0 / s } else { 0.0 }
    }
}
