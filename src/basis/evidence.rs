//! How strongly to regularise, from the data themselves.

use std::sync::Arc;

use nalgebra::DVector;

use super::conversion::{Conversion, ConversionError};
use super::factor::{Factor, Key, factors};
use super::family::Family;
use super::harmonics::index;
use super::method::{Method, Strength};
use crate::geometry::Zone;

/// A rule that chooses a [`Strength`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// Nothing is cut, and curvature held down gently, where the zone says enough (no more noise outside than
    /// [`HARMLESS_GAIN`] times that of the zonal series); elsewhere [`Rule::Gcv`].
    Auto,
    /// The strongest at which what is left out in the zone is no more than the noise (Morozov 1966).
    Discrepancy,
    /// The minimum of generalised cross-validation (Golub, Heath, Wahba 1979), which does not ask for the noise.
    Gcv,
}

/// Powers of measured spectra along the singular vectors of a method's blocks, summed over spectra.
///
/// One strength serves a whole measurement: neighbouring exitant directions then differ by what was measured alone. Each
/// spectrum counts in units of its own noise.
#[derive(Debug, Clone)]
pub struct Evidence {
    method: Method,
    blocks: Arc<Vec<Factor>>,
    /// Per block, per singular value: power of the data and of their noise.
    power: Vec<Vec<[f64; 2]>>,
    /// Power of what no function of the family reaches.
    unreached: f64,
    /// Data per block: (zonal functions, cos and sin).
    data: Vec<f64>,
    spectra: usize,
    /// The strength without evidence, and the one that [`Rule::Auto`] knows without asking.
    own: Strength,
    known: Option<Strength>,
}

/// A noise gain outside the zone that needs no remedy.
pub const HARMLESS_GAIN: f64 = 3.0;
/// Candidates for lambda: twenty a decade would change nothing.
const LAMBDAS: i32 = 4;

impl Evidence {
    /// No evidence yet.
    ///
    /// # Errors
    /// As [`super::Conversion::new`].
    pub fn new(method: Method, zone: Zone, order: usize) -> Result<Self, ConversionError> {
        let (own, sh_order) = (method.strength(zone, order)?, method.sh_order(zone, order)?);
        let curvature = matches!(own, Strength::Curvature(_));
        let key = Key::new(&zone, order, method.family(), sh_order, curvature);
        let blocks = factors(&zone, key)?;
        let power = blocks.iter().map(|b| vec![[0.0; 2]; b.s.len()]).collect();
        let data = blocks.iter().map(|b| b.projected.ncols() as f64 * copies(b.m)).collect();
        // A dual that cannot be told apart does harm.
        let exact = method.is_tuned().then(|| Conversion::with_strength(method, zone, order, Strength::Exact));
        let harmless = matches!(exact, Some(Ok(c)) if c.noise_gain_out <= HARMLESS_GAIN);
        let known = harmless.then(|| if curvature { Strength::gentle(Family::Odd, sh_order) } else { Strength::Exact });
        Ok(Self { method, blocks, power, unreached: 0.0, data, spectra: 0, own, known })
    }

    /// Adds one spectrum, (order + 1)^2 zonal coefficients and their variances; one that is not finite or has no noise says
    /// nothing and is left out.
    pub fn add(&mut self, z: &[f64], variance: &[f64]) {
        let scale = variance.iter().sum::<f64>() / variance.len() as f64;
        if !(scale > 0.0 && scale.is_finite() && z.iter().all(|z| z.is_finite())) {
            return;
        }
        self.spectra += 1;
        for (block, power) in self.blocks.iter().zip(&mut self.power) {
            let n = block.projected.ncols();
            for sign in [1, -1].into_iter().take(copies(block.m) as usize) {
                let at = |i: usize| index(block.m + i, sign * block.m as i32);
                let beta = &block.projected * DVector::from_fn(n, |i, _| z[at(i)]);
                let noise = block.projected.map(|p| p * p) * DVector::from_fn(n, |i, _| variance[at(i)]);
                for ((power, beta), noise) in power.iter_mut().zip(beta.iter()).zip(noise.iter()) {
                    power[0] += beta * beta / scale;
                    power[1] += noise / scale;
                }
                let all: f64 = (0..n).map(|i| z[at(i)] * z[at(i)]).sum();
                self.unreached += (all - beta.norm_squared()).max(0.0) / scale;
            }
        }
    }

    /// The strength that `rule` chooses; the method's own where it takes none or there is no evidence.
    pub fn strength(&self, rule: Rule) -> Strength {
        if !self.method.is_tuned() || self.spectra == 0 {
            return self.own;
        }
        if let (Rule::Auto, Some(known)) = (rule, self.known) {
            return known;
        }
        let candidates = self.candidates();
        match rule {
            Rule::Discrepancy => {
                let noise: f64 = self.power.iter().flatten().map(|p| p[1]).sum();
                let weakest = candidates[candidates.len() - 1];
                candidates.into_iter().find(|c| self.left_out(*c).0 <= noise).unwrap_or(weakest)
            }
            Rule::Gcv | Rule::Auto => {
                let score = |c: &Strength| {
                    let (left_out, freedom) = self.left_out(*c);
                    (left_out + self.unreached) / freedom.max(f64::MIN_POSITIVE).powi(2)
                };
                candidates.into_iter().min_by(|a, b| score(a).total_cmp(&score(b))).expect("some candidates")
            }
        }
    }

    /// Strengths to choose from, strongest first.
    fn candidates(&self) -> Vec<Strength> {
        if let Strength::Curvature(_) = self.own {
            return (-14 * LAMBDAS..=4 * LAMBDAS)
                .rev()
                .map(|i| Strength::Curvature(10f64.powf(f64::from(i) / f64::from(LAMBDAS))))
                .collect();
        }
        let mut cuts: Vec<f64> = self
            .blocks
            .iter()
            .flat_map(|b| b.s.iter().map(|s| (s / b.s[0]).powi(2)))
            .filter(|ratio| *ratio > f64::EPSILON)
            // Just below an eigenvalue: it is kept.
            .map(|ratio| ratio * (1.0 - 1e-9))
            .collect();
        cuts.sort_by(|a, b| b.total_cmp(a));
        cuts.dedup();
        cuts.into_iter().map(Strength::Cut).collect()
    }

    /// Power that the filter leaves out, and what it leaves of the data's degrees of freedom; always some.
    fn left_out(&self, strength: Strength) -> (f64, f64) {
        let (mut power, mut freedom) = (0.0, 0.0);
        for ((block, powers), data) in self.blocks.iter().zip(&self.power).zip(&self.data) {
            freedom += data;
            for (s, p) in block.s.iter().zip(powers) {
                let passed = s * strength.inverse(*s, block.s[0], self.method.family());
                power += (1.0 - passed).powi(2) * p[0];
                freedom -= passed * copies(block.m);
            }
        }
        (power, freedom * self.spectra as f64)
    }
}

/// Functions of one |m|: the cosine and, above 0, the sine.
fn copies(m: usize) -> f64 {
    if m == 0 { 1.0 } else { 2.0 }
}
