//! From a run's zonal coefficients to functions of all incident directions, for every exitant one.
//!
//! [`linear`] applies a [`Conversion`], whose strength [`tuned`] takes from the data; [`prior`] knows other materials.
//! [`Trial`] finds out how much of known materials a method recovers.

mod learn;
mod planes;
mod population;
mod stability;
mod table;
mod trial;

use rayon::prelude::*;
use thiserror::Error;

pub use learn::{LearningError, half_of_the_materials, learn};
pub use planes::Converted;
pub use population::{members, population, ring};
pub use stability::{Scan, StabilityRow, stability_csv};
pub use table::{PRIOR_VERSION, PriorTable, PriorTableError};
pub use trial::{Spectra, Trial, ring_mean};

use crate::basis::{
    Block, Conversion, ConversionError, Evidence, Family, Method, Population, RingMap, RingMean, Rule, Strength,
};
use crate::fit::{ANISOTROPIC, Observations};
use crate::reduce::Coefficients;
use planes::{add_product, finish};

/// Why a run could not be converted.
#[derive(Debug, Error)]
pub enum ConvertError {
    /// The algebra refused.
    #[error(transparent)]
    Conversion(#[from] ConversionError),
    /// The prior's materials are isotropic and the sample is not.
    #[error(
        "the sample is anisotropic (rings deviate by {:.1}% of z_00, more than {:.0}%) and the prior knows isotropic materials only: \
         use `--method parity` or `tikhonov`",
        100.0 * .anisotropy,
        100.0 * ANISOTROPIC
    )]
    Anisotropic {
        /// RMS deviation from the ring's mean over RMS z_00.
        anisotropy: f64,
    },
    /// No exitant direction has all its coefficients.
    #[error(
        "no ring of exitant directions has all of its {functions} coefficients: measure with a shorter exposure, or use a lower `--order`"
    )]
    NoData {
        /// Number of zonal functions.
        functions: usize,
    },
}

/// The conversion by `method` for this measurement, its strength chosen by `rule` where the method takes one.
///
/// # Errors
/// [`ConversionError`].
pub fn tuned(coefficients: &Coefficients, method: Method, rule: Rule) -> Result<Conversion, ConversionError> {
    /// Cells that are asked; more do not change the answer.
    const CELLS: usize = 512;
    let (zone, order) = (coefficients.grid.zone(), coefficients.order);
    if !method.is_tuned() {
        return Conversion::new(method, zone, order);
    }
    let mut evidence = Evidence::new(method, zone, order)?;
    // Steps that are no divisor of the number of sectors see all azimuths.
    for cell in (0..coefficients.grid.len()).step_by((coefficients.grid.len() / CELLS).max(1) | 1) {
        for channel in 0..3 {
            let variance: Vec<f64> = coefficients.spectrum_sigma(channel, cell).iter().map(|s| s * s).collect();
            evidence.add(&coefficients.spectrum(channel, cell), &variance);
        }
    }
    Conversion::with_strength(method, zone, order, evidence.strength(rule))
}

/// Applies `conversion` to every exitant cell and channel; what is NaN stays NaN.
pub fn linear(coefficients: &Coefficients, conversion: &Conversion) -> Converted {
    let family = conversion.method.family();
    let mut converted = Converted::empty(coefficients, conversion.method.name(), family, conversion.sh_order);
    let mut pieces = converted.pieces(coefficients.grid.len());
    let mut tasks = Vec::new();
    for block in &conversion.blocks {
        for sign in signs(block.m) {
            for channel in 0..3 {
                let rows = pieces.take(&block.degrees, sign * block.m as i32, channel, 0);
                tasks.push((block, *sign, channel, rows));
            }
        }
    }
    tasks.into_par_iter().for_each(|(block, sign, channel, mut rows): (&Block, i32, usize, _)| {
        add_product(coefficients, &block.matrix, block.m, sign, channel, 0, &mut rows);
        finish(&mut rows, &block.data_share);
    });
    converted
}

/// What [`prior`] found beside the coefficients.
#[derive(Debug, Clone, PartialEq)]
pub struct PriorFindings {
    /// RMS over rings and channels of the noise gain in the zone: see [`Conversion::noise_gain_in`].
    pub noise_gain_in: f64,
    /// The same outside the zone.
    pub noise_gain_out: f64,
    /// Worst condition number of the systems solved.
    pub condition: f64,
    /// How much wider than the population the data are, in variance, mean over rings and channels: 1 for a material like its
    /// members; above about 30 its error bars are guesses.
    pub surprise: f64,
}

/// Converts an isotropic sample with the help of the materials of `table`: see [`crate::basis::Population`].
///
/// # Errors
/// [`ConvertError`].
pub fn prior(coefficients: &Coefficients, table: &PriorTable) -> Result<(Converted, PriorFindings), ConvertError> {
    let grid = coefficients.grid;
    let folded = Observations::folded(coefficients);
    if folded.anisotropy > ANISOTROPIC {
        return Err(ConvertError::Anisotropic { anisotropy: folded.anisotropy });
    }
    if folded.stations.is_empty() {
        return Err(ConvertError::NoData { functions: crate::basis::size(coefficients.order) });
    }
    let thetas: Vec<f64> = folded.stations.iter().map(|s| grid.theta(s.ring)).collect();
    let population = population(table, grid.zone(), coefficients.order, &thetas)?;
    by_population(coefficients, &folded, &population, table)
}

/// The same with a population that has been integrated for the stations of `folded`, the measurement averaged over rings.
///
/// # Errors
/// As [`prior`].
pub fn by_population(
    coefficients: &Coefficients,
    folded: &Observations,
    population: &Population,
    table: &PriorTable,
) -> Result<(Converted, PriorFindings), ConvertError> {
    let grid = coefficients.grid;
    let learned = table.learned();
    let maps = (0..3)
        .into_par_iter()
        .map(|channel| population.maps(&ring_means(coefficients, folded, channel), &learned))
        .collect::<Result<Vec<_>, _>>()?;
    let mut converted = Converted::empty(coefficients, "prior", Family::Odd, table.sh_order);
    converted.values.fill(f32::NAN);
    converted.sigma.fill(f32::NAN);
    let mut pieces = converted.pieces(grid.sectors());
    let mut tasks = Vec::new();
    for (channel, maps) in maps.iter().enumerate() {
        for (station, map) in folded.stations.iter().zip(maps) {
            let rows: Vec<_> = map
                .blocks
                .iter()
                .flat_map(|b| signs(b.m).iter().map(move |sign| (b, *sign)))
                .map(|(b, sign)| (b, sign, pieces.take(&b.degrees, sign * b.m as i32, channel, station.ring)))
                .collect();
            tasks.push((channel, station.ring, rows));
        }
    }
    tasks.into_par_iter().for_each(|(channel, ring, blocks)| {
        for (block, sign, mut rows) in blocks {
            for (i, row) in rows.iter_mut().enumerate() {
                for sector in 0..grid.sectors() {
                    let (sin, cos) = (block.m as f64 * grid.phi(sector)).sin_cos();
                    let turned = if sign > 0 { cos } else { sin };
                    row.values[sector] = (block.offset[i] * turned) as f32;
                    row.sigma[sector] = (block.variance[i] * turned * turned) as f32;
                }
            }
            add_product(coefficients, &block.matrix, block.m, sign, channel, ring * grid.sectors(), &mut rows);
            finish(&mut rows, &block.data_share);
        }
    });
    let findings = findings(&maps, population);
    for k in 0..crate::basis::size(table.sh_order) {
        if !is_odd(k) {
            let planes = k * 3 * grid.len()..(k + 1) * 3 * grid.len();
            converted.values[planes.clone()].fill(0.0);
            converted.sigma[planes].fill(0.0);
        }
    }
    Ok((converted, findings))
}

/// Whether index k belongs to [`Family::Odd`].
fn is_odd(k: usize) -> bool {
    let (l, m) = crate::basis::lm(k);
    (l + m.unsigned_abs() as usize) % 2 == 1
}

/// Means of all rings in one channel.
fn ring_means(coefficients: &Coefficients, folded: &Observations, channel: usize) -> Vec<RingMean> {
    let sectors = coefficients.grid.sectors() as f64;
    let of = |s: &crate::fit::Station| {
        let variance: Vec<f64> = s.sigma.iter().map(|v| v[channel] * v[channel]).collect();
        RingMean {
            z: s.z.iter().map(|v| v[channel]).collect(),
            // Cosines and sines of all sectors went into a mean with m > 0, whose variance is that of one over the sectors.
            direction_variance: variance.iter().map(|v| v * sectors).collect(),
            variance,
        }
    };
    folded.stations.iter().map(of).collect()
}

fn findings(maps: &[Vec<RingMap>], population: &Population) -> PriorFindings {
    let all: Vec<&RingMap> = maps.iter().flatten().collect();
    let mean = |f: &dyn Fn(&RingMap) -> f64| all.iter().map(|m| f(m)).sum::<f64>() / all.len() as f64;
    let gains: Vec<_> = all.iter().map(|m| m.noise_gains(population)).collect();
    let rms = |i: usize| (gains.iter().map(|g| g[i] * g[i]).sum::<f64>() / gains.len() as f64).sqrt();
    PriorFindings {
        noise_gain_in: rms(0),
        noise_gain_out: rms(1),
        condition: all.iter().map(|m| m.condition).fold(1.0, f64::max),
        surprise: mean(&|m| m.surprise),
    }
}

fn signs(m: usize) -> &'static [i32] {
    if m == 0 { &[1] } else { &[1, -1] }
}

/// The strength as text for people.
pub fn strength_text(strength: Strength) -> String {
    match strength {
        Strength::Exact => "nothing held back".into(),
        Strength::Cut(cut) => format!("eigenvalues below {cut:.1e} of the largest cut"),
        Strength::Concentration(share) => {
            format!("functions with less than {share:.2} of their energy in the zone left out")
        }
        Strength::Curvature(lambda) => format!("squared curvature weighted with {lambda:.1e}"),
    }
}
