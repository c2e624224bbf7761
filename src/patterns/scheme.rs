//! Schemes: in which combinations, and in how many frames, zonal functions are shown.
//!
//! A scheme is a list of steps, each a pair of frames in a row with the same exposures. What a step tells is a known
//! combination of coefficients, so that any scheme is read back by least squares ([`crate::reduce`]).

use std::fmt;
use std::sync::LazyLock;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::basis::{Harmonics, index, lm, size};
use crate::geometry::{Direction, Zone};

/// How functions are shared among frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scheme {
    /// A positive and a negative lobe for each function (Ghosh 2007, section 3.2): 2 (L+1)^2 frames.
    #[default]
    Pairs,
    /// One frame for each function, lifted until it is nowhere negative, beside white and black: about (L+1)^2 frames.
    Offset,
    /// Flat mixtures of all functions, each at 2L+1 azimuths: any sample, less noise where the camera's own prevails.
    Multiplexed,
    /// The same mixtures at one azimuth: the camera sees an isotropic sample from all azimuths at once, which tells the
    /// functions of a mixture apart. 2 (L+1) frames.
    Isotropic,
}

impl Scheme {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Pairs, Self::Offset, Self::Multiplexed, Self::Isotropic];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pairs => "pairs",
            Self::Offset => "offset",
            Self::Multiplexed => "multiplexed",
            Self::Isotropic => "isotropic",
        }
    }

    /// Whether it takes samples to be isotropic.
    pub fn is_isotropic(self) -> bool {
        self == Self::Isotropic
    }

    /// The steps that tell every function up to `order` over `zone`.
    ///
    /// # Errors
    /// [`SchemeError::Order`] where no mixtures are known.
    pub fn steps(self, zone: Zone, order: usize) -> Result<Vec<Step>, SchemeError> {
        match self {
            Self::Pairs => Ok((0..size(order)).map(Step::function).collect()),
            Self::Offset => Ok(offset_steps(zone, order)),
            Self::Multiplexed => mixed_steps(self, zone, order, |hi| 2 * hi + 1),
            Self::Isotropic => mixed_steps(self, zone, order, |_| 1),
        }
    }

    /// Number of steps up to `order`, without their contents.
    ///
    /// # Errors
    /// As [`Scheme::steps`].
    pub fn step_count(self, order: usize) -> Result<usize, SchemeError> {
        let mixtures = |turns: fn(usize) -> usize| {
            let blocks = blocks(self, order)?;
            Ok(blocks.iter().map(|b| b.cos.len() * turns(b.degrees[1])).sum())
        };
        match self {
            Self::Pairs => Ok(size(order)),
            Self::Offset => Ok(1 + (size(order) - 1).div_ceil(2)),
            Self::Multiplexed => mixtures(|hi| 2 * hi + 1),
            Self::Isotropic => mixtures(|_| 1),
        }
    }
}

impl fmt::Display for Scheme {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Why a scheme has no steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum SchemeError {
    /// Mixtures are designed for even orders.
    #[error(
        "scheme `{scheme}` has no mixtures for order {order}: choose an even order from 2 to {HIGHEST_MIXED}, or `pairs`"
    )]
    Order {
        /// The scheme.
        scheme: Scheme,
        /// The order asked for.
        order: usize,
    },
}

/// Highest degree of the mixtures that are known.
pub const HIGHEST_MIXED: usize = 20;

/// A combination of zonal functions, sum of factor Z_k: pairs of k and factor.
#[derive(Debug, Clone, PartialEq)]
pub struct Mixture(pub Vec<(usize, f64)>);

impl Mixture {
    /// Its value where the functions have `values`.
    pub fn of(&self, values: &[f64]) -> f64 {
        self.0.iter().map(|&(k, factor)| factor * values[k]).sum()
    }

    /// The highest degree in it.
    pub fn order(&self) -> usize {
        self.0.iter().map(|&(k, _)| lm(k).0).max().unwrap_or(0)
    }
}

/// A pair of frames.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// Positive and negative part of a mixture, to one scale: black level and ambient light cancel in the difference.
    Parts(Mixture),
    /// Two mixtures that are nowhere negative; black is known from elsewhere.
    Lights([Mixture; 2]),
}

impl Step {
    /// Both lobes of a function.
    pub fn function(k: usize) -> Self {
        Self::Parts(Mixture(vec![(k, 1.0)]))
    }

    /// The highest degree shown.
    pub fn order(&self) -> usize {
        match self {
            Self::Parts(mixture) => mixture.order(),
            Self::Lights(both) => both.iter().map(Mixture::order).max().unwrap_or(0),
        }
    }

    /// The light of both frames where the functions have `values`, before any scale.
    pub fn lights(&self, values: &[f64]) -> [f64; 2] {
        match self {
            Self::Parts(mixture) => {
                let value = mixture.of(values);
                [value.max(0.0), (-value).max(0.0)]
            }
            Self::Lights(both) => both.each_ref().map(|m| m.of(values).max(0.0)),
        }
    }

    /// The greatest light over the zone and, of each frame, its mean as a diffuse sample weighs it (by cos(theta_i)) over that
    /// greatest.
    pub fn brightness(&self, zone: Zone) -> (f64, [f64; 2]) {
        const SAMPLES: [usize; 2] = [60, 120];
        let basis = Harmonics::zonal(zone, self.order()).expect("orders of plans are small");
        let mut values = vec![0.0; basis.len()];
        let (mut peak, mut sums, mut whole) = (0.0f64, [0.0; 2], 0.0);
        for ring in 0..SAMPLES[0] {
            let mu = zone.cos_max() + (zone.cos_min() - zone.cos_max()) * (ring as f64 + 0.5) / SAMPLES[0] as f64;
            for sector in 0..SAMPLES[1] {
                let phi = std::f64::consts::TAU * sector as f64 / SAMPLES[1] as f64;
                basis.eval_direction_into(&Direction::from_mu_phi(mu, phi), &mut values);
                let lights = self.lights(&values);
                peak = peak.max(lights[0]).max(lights[1]);
                sums.iter_mut().zip(lights).for_each(|(sum, light)| *sum += mu * light);
                whole += mu;
            }
        }
        (peak, sums.map(|sum| sum / whole / peak))
    }

    /// What it tells: one mixture if only the difference of its frames does.
    pub fn mixtures(&self) -> &[Mixture] {
        match self {
            Self::Parts(mixture) => std::slice::from_ref(mixture),
            Self::Lights(both) => both,
        }
    }
}

/// Steps that show isotropic samples a block of two degrees more each, beginning with order 2: `(highest degree, steps)`.
pub fn growing_steps(zone: Zone, order: usize) -> Vec<(usize, Vec<Step>)> {
    let chain = (1..=order / 2).filter_map(|i| if i == 1 { block(0, 2) } else { block(2 * i - 1, 2 * i) });
    chain.map(|b| (b.degrees[1], b.steps(zone, 1))).collect()
}

fn offset_steps(zone: Zone, order: usize) -> Vec<Step> {
    let constant = zone.solid_angle().sqrt();
    let lifted = |k: usize| {
        let [least, most] = range(zone, k);
        let span = most - least;
        Mixture(vec![(0, -least * constant / span), (k, 1.0 / span)])
    };
    let white = Mixture(vec![(0, constant)]);
    let functions: Vec<usize> = (1..size(order)).collect();
    let twos = functions.chunks(2).map(|two| {
        let second = two.get(1).map_or_else(|| white.clone(), |&k| lifted(k));
        Step::Lights([lifted(two[0]), second])
    });
    std::iter::once(Step::function(0)).chain(twos).collect()
}

/// Least and greatest value of a zonal function over its zone.
fn range(zone: Zone, k: usize) -> [f64; 2] {
    /// Beyond what values between the samples may be: far below a projector's code.
    const MARGIN: f64 = 1e-4;
    const SAMPLES: usize = 400;
    let (l, m) = lm(k);
    let basis = Harmonics::zonal(zone, l).expect("orders of plans are small");
    let phi = if m >= 0 { 0.0 } else { std::f64::consts::FRAC_PI_2 / f64::from(-m) };
    let at = |i: usize| {
        let theta = zone.theta_min() + (zone.theta_max() - zone.theta_min()) * i as f64 / SAMPLES as f64;
        basis.eval(&Direction::from_angles(theta, phi))[k]
    };
    let (lo, hi) = (0..=SAMPLES).map(at).fold((0.0f64, 0.0f64), |(lo, hi), z| (lo.min(z), hi.max(z)));
    // A turn by half a period changes the sign of all but axially symmetric functions.
    let (lo, hi) = if m == 0 { (lo, hi) } else { (-hi.max(-lo), hi.max(-lo)) };
    [lo * (1.0 + MARGIN), hi * (1.0 + MARGIN)]
}

fn mixed_steps(
    scheme: Scheme,
    zone: Zone,
    order: usize,
    turns: impl Fn(usize) -> usize,
) -> Result<Vec<Step>, SchemeError> {
    Ok(blocks(scheme, order)?.iter().flat_map(|b| b.steps(zone, turns(b.degrees[1]))).collect())
}

/// Designed together where that is known, and two degrees at a time above.
fn blocks(scheme: Scheme, order: usize) -> Result<Vec<&'static Block>, SchemeError> {
    if order < 2 || !order.is_multiple_of(2) || order > HIGHEST_MIXED {
        return Err(SchemeError::Order { scheme, order });
    }
    let together = (2..=order).rev().find(|&hi| block(0, hi).is_some()).expect("order 2 is known");
    let further = (together + 1..order).step_by(2).map(|lo| block(lo, lo + 1).expect("known up to the highest"));
    Ok(std::iter::once(block(0, together).expect("just found")).chain(further).collect())
}

/// Mixtures of the degrees lo..=hi; made by `tests/python/multiplexed_design.py`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Block {
    degrees: [usize; 2],
    /// Mean variance of a coefficient over that of a single pair of frames and one azimuth, for a zone of 1 sr.
    variance: f64,
    /// By mixture: factors of cos(m phi) and sin(m phi), m = 0..=hi and there l = max(lo, m)..=hi.
    cos: Vec<Vec<f64>>,
    sin: Vec<Vec<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    version: u32,
    block: Vec<Block>,
}

static BLOCKS: LazyLock<Vec<Block>> = LazyLock::new(|| {
    let table: Table = toml::from_str(include_str!("../../data/multiplexed.toml")).expect("a file of ours");
    assert_eq!(table.version, 1);
    table.block
});

fn block(lo: usize, hi: usize) -> Option<&'static Block> {
    BLOCKS.iter().find(|b| b.degrees == [lo, hi])
}

impl Block {
    fn terms(&self) -> impl Iterator<Item = (usize, usize)> {
        let [lo, hi] = self.degrees;
        (0..=hi).flat_map(move |m| (lo.max(m)..=hi).map(move |l| (l, m)))
    }

    /// Every mixture at `turns` azimuths, scaled to the range of a pattern.
    fn steps(&self, zone: Zone, turns: usize) -> Vec<Step> {
        let unit = zone.solid_angle().sqrt();
        let turned = |(cos, sin): (&Vec<f64>, &Vec<f64>), turn: usize| {
            let psi = std::f64::consts::TAU * turn as f64 / turns as f64;
            let mut mixture = Vec::new();
            for ((l, m), (a, b)) in self.terms().zip(cos.iter().zip(sin)) {
                let (s, c) = (m as f64 * psi).sin_cos();
                let m = m as i32;
                // The design's functions are those of a zone of 1 sr.
                mixture.push((index(l, m), unit * (a * c - b * s)));
                if m > 0 {
                    mixture.push((index(l, -m), unit * (a * s + b * c)));
                }
            }
            mixture.sort_by_key(|&(k, _)| k);
            Step::Parts(Mixture(mixture))
        };
        let mixtures = || self.cos.iter().zip(&self.sin);
        (0..turns).flat_map(|turn| mixtures().map(move |mixture| turned(mixture, turn))).collect()
    }
}

/// Mean variance of a coefficient of a block of mixtures over that of `pairs`, frame for frame, where noise does not depend on
/// the light: what a sample's isotropy saves besides is not in it.
pub fn noise_advantage(order: usize) -> Option<f64> {
    let mixed = block(0, order)?;
    let zone = Zone::sphere();
    let pairs: Vec<f64> = mixed
        .terms()
        .map(|(l, m)| {
            let [lo, hi] = range(zone, index(l, m as i32));
            hi.max(-lo).powi(2) * zone.solid_angle()
        })
        .collect();
    let pairs = pairs.iter().sum::<f64>() / pairs.len() as f64 * size(order) as f64;
    Some(mixed.variance * mixed.cos.len() as f64 / pairs)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn built() -> Zone {
        Zone::from_degrees(9.0, 57.0).unwrap()
    }

    #[test]
    fn counts_are_those_of_the_steps_and_bad_orders_are_named() {
        for scheme in Scheme::ALL {
            for order in [2, 4, 6, 10, 12] {
                assert_eq!(scheme.steps(built(), order).unwrap().len(), scheme.step_count(order).unwrap(), "{scheme}");
            }
        }
        assert_eq!(Scheme::Isotropic.step_count(10), Ok(11));
        for order in [0, 3, 22] {
            let error = Scheme::Isotropic.steps(built(), order).unwrap_err();
            assert!(error.to_string().contains(&format!("order {order}")), "{error}");
        }
    }

    /// The script looks for peaks on a grid of its own.
    const PEAK: f64 = 1e-3;

    #[test]
    fn no_frame_exceeds_the_projectors_range_and_lifted_functions_are_nowhere_negative() {
        let zone = built();
        for (scheme, order) in [(Scheme::Offset, 4), (Scheme::Isotropic, 10), (Scheme::Isotropic, 12)] {
            let basis = Harmonics::zonal(zone, order).unwrap();
            let steps = scheme.steps(zone, order).unwrap();
            let mut peaks = vec![[0.0f64; 2]; steps.len()];
            for i in 0..=90 {
                for j in 0..180 {
                    let theta = zone.theta_min() + (zone.theta_max() - zone.theta_min()) * f64::from(i) / 90.0;
                    let values = basis.eval(&Direction::from_angles(theta, f64::from(j) * 2f64.to_radians()));
                    for (step, peaks) in steps.iter().zip(&mut peaks) {
                        if let Step::Lights(both) = step {
                            assert!(both.iter().all(|m| m.of(&values) > -1e-6));
                        }
                        let lights = step.lights(&values);
                        peaks.iter_mut().zip(lights).for_each(|(peak, light)| *peak = peak.max(light));
                    }
                }
            }
            for (step, peaks) in steps.iter().zip(&peaks).skip(1) {
                let peak = peaks[0].max(peaks[1]);
                assert!(peak < 1.0 + PEAK && peak > 0.95, "{scheme} {order}: {peak} of {step:?}");
            }
        }
    }

    #[test]
    fn mixtures_are_flatter_than_functions() {
        // Frames for the same noise where it does not depend on the light.
        for (order, most) in [(2, 0.7), (4, 0.5), (6, 0.42), (10, 0.42)] {
            let ratio = noise_advantage(order).unwrap();
            println!("order {order}: {ratio:.3} of the frames of pairs");
            assert!(ratio < most, "order {order}: {ratio}");
        }
    }
}
