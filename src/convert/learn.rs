//! What the prior learns from its own materials, each left out in turn.

use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use thiserror::Error;

use super::{PRIOR_VERSION, PriorTable, PriorTableError, Trial, members, population, ring_mean};
use crate::basis::{ConversionError, Family, Learned, RingMean};
use crate::geometry::Zone;
use crate::reflectance::{Brdf, EXITANT_DEG, abc_materials};

/// Why nothing was learned.
#[derive(Debug, Error)]
pub enum LearningError {
    /// The algebra refused.
    #[error(transparent)]
    Conversion(#[from] ConversionError),
    /// There is nothing to learn from, or a given value is out of range.
    #[error(transparent)]
    Table(#[from] PriorTableError),
}

/// Zonal orders that count alike.
const ORDERS: [usize; 3] = [2, 4, 8];
/// Noise of every coefficient, of z_00.
const NOISE_REL: f64 = 0.01;
/// Candidates for [`Learned::misfit`] and [`Learned::neighbours`].
const MISFITS: [f64; 4] = [3e-5, 1e-4, 3e-4, 1e-3];
const NEIGHBOURS: [usize; 3] = [6, 10, 16];

/// Every other material of the published tables, in alphabetical order from the first: the rest is there to test with.
pub fn half_of_the_materials() -> Vec<String> {
    abc_materials().iter().step_by(2).map(|m| m.name.clone()).collect()
}

/// The table for `materials`: the misfit and the number of neighbours that err least outside `zone` when each material is
/// predicted from all others, median over materials, mean over orders, noise of 1%.
///
/// `widening` is given, not learned: closed forms predict one another better than they predict measurements.
///
/// # Errors
/// [`LearningError`].
pub fn learn(zone: Zone, materials: Vec<String>, widening: f64, seed: u64) -> Result<PriorTable, LearningError> {
    let mut table = PriorTable {
        version: PRIOR_VERSION,
        sh_order: 16,
        zone_weight: 0.1,
        misfit: MISFITS[0],
        neighbours: NEIGHBOURS[0],
        independent_rings: EXITANT_DEG.len(),
        fidelity: 1e-4,
        widening,
        materials,
    }
    .check()?;
    let members = members(&table);
    let brdfs: Vec<&dyn Brdf> = members.iter().map(|m| m.1).collect();
    let thetas = EXITANT_DEG.map(f64::to_radians);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let trial = Trial::new(zone, ORDERS[ORDERS.len() - 1], &brdfs)?;
    let functions = Family::Odd.harmonics(table.sh_order).map_err(ConversionError::from)?;
    let mut scores = vec![0.0; MISFITS.len() * NEIGHBOURS.len()];
    for order in ORDERS {
        let everyone = population(&table, zone, order, &thetas)?;
        let spectra = trial.spectra(order, NOISE_REL, &mut rng);
        for (score, learned) in scores.iter_mut().zip(candidates(&table)) {
            let estimates = members
                .par_iter()
                .enumerate()
                .map(|(i, (member, _))| {
                    let others = everyone.without(member.material);
                    let rings: Vec<RingMean> = spectra.iter().map(|s| ring_mean(&others, &s[i].0, &s[i].1)).collect();
                    let maps = others.maps(&rings, &learned)?;
                    let one = |(map, s): (&crate::basis::RingMap, &Vec<(Vec<f64>, Vec<f64>)>)| {
                        Ok(map.estimate(&s[i].0, &s[i].1, 0.0)?.y)
                    };
                    maps.iter().zip(&spectra).map(one).collect()
                })
                .collect::<Result<Vec<Vec<Vec<f64>>>, ConversionError>>()?;
            let mut errors: Vec<f64> = trial.judge(&functions, &estimates).iter().map(|e| e.outside).collect();
            errors.sort_by(f64::total_cmp);
            *score += errors[errors.len() / 2];
        }
    }
    let best = (0..scores.len()).min_by(|&i, &j| scores[i].total_cmp(&scores[j])).expect("some candidates");
    let learned = candidates(&table).nth(best).expect("as many candidates as scores");
    (table.misfit, table.neighbours) = (learned.misfit, learned.neighbours);
    Ok(table)
}

fn candidates(table: &PriorTable) -> impl Iterator<Item = Learned> {
    let start = table.learned();
    MISFITS
        .into_iter()
        .flat_map(move |misfit| NEIGHBOURS.into_iter().map(move |neighbours| Learned { misfit, neighbours, ..start }))
}
