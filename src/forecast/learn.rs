//! Learning the outlook: fits of closed forms that none of the families contains, at every order, with and without noise.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;

use super::outlook::{AtOrder, Class, ClassTable, FORMAT, Outlook};
use crate::basis::{index, lm, size};
use crate::fit::{Fineness, FitError, FitMethod, FitOptions, Forward, Observations, fit};
use crate::geometry::quadrature::polar_about_mirror;
use crate::geometry::{Direction, ExitantGrid, Zone};
use crate::reduce::Coefficients;
use crate::reflectance::{Brdf, Metric};

/// Orders that are tried.
const ORDERS: [usize; 8] = [0, 1, 2, 3, 4, 6, 8, 10];
/// About no noise, and as much as short exposures leave, of a single direction over z_00.
const NOISES: [f64; 2] = [1e-4, 0.03];
/// Errors are no smaller: a model that is exact has none.
const LEAST: f64 = 1e-3;
/// Exitant directions.
const GRID: [usize; 2] = [32, 64];

/// RMS over mean of f_cos for the camera at 50 deg: what classes are told apart by.
pub fn contrast(brdf: &dyn Brdf) -> f64 {
    let wo = Direction::from_angles(50f64.to_radians(), 0.0);
    let (mut sum, mut square, mut whole) = (0.0, 0.0, 0.0);
    for (wi, w) in polar_about_mirror(&wo, 64, 96, 85f64.to_radians()) {
        let f_cos = brdf.eval_cos(&wi, &wo).iter().sum::<f64>() / 3.0;
        (sum, square, whole) = (sum + w * f_cos, square + w * f_cos * f_cos, whole + w);
    }
    (square * whole).sqrt() / sum
}

/// Coefficients of an isotropic material as exact integrals give them, with noise of `noise_rel` times RMS z_00 in each direction.
///
/// # Errors
/// [`FitError::Order`].
pub fn ideal_coefficients(
    brdf: &dyn Brdf,
    zone: Zone,
    order: usize,
    noise_rel: f64,
    seed: u64,
) -> Result<Coefficients, FitError> {
    let grid = ExitantGrid::new(zone, GRID[0], GRID[1]);
    let n = 3 * grid.len();
    let history = "exact integrals".to_owned();
    let blank =
        Coefficients { grid, order, values: vec![1.0; size(order) * n], sigma: vec![1.0; size(order) * n], history };
    let folded = Observations::folded(&blank);
    let exact = Forward::new(&folded, Fineness { radial: 48, around: 96 })?.predict(brdf);
    let (terms, stations) = (&folded.terms, folded.stations.len());
    let constant: f64 = exact.iter().map(|z| z.iter().step_by(terms.len()).map(|z| z * z).sum::<f64>()).sum();
    let sigma = noise_rel * (constant / (3 * stations) as f64).sqrt();
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut made = Coefficients { sigma: vec![sigma as f32; size(order) * n], ..blank };
    for k in 0..size(order) {
        let (l, m) = lm(k);
        let term = terms.binary_search(&index(l, m.abs())).expect("all are there");
        for (i, value) in made.values[k * n..][..n].iter_mut().enumerate() {
            let (channel, cell) = (i / grid.len(), i % grid.len());
            let (sin, cos) = (f64::from(m.abs()) * grid.phi(cell % grid.sectors())).sin_cos();
            let zeta = exact[channel][cell / grid.sectors() * terms.len() + term];
            let unit: f64 = StandardNormal.sample(&mut rng);
            *value = (zeta * if m >= 0 { cos } else { sin } + sigma * unit) as f32;
        }
    }
    Ok(made)
}

/// Learns from materials with names, each fitted at every order.
///
/// # Errors
/// [`FitError`].
pub fn learn(zone: Zone, materials: &[&dyn Brdf], seed: u64) -> Result<Outlook, FitError> {
    let metric = Metric::new(zone);
    let highest = ORDERS[ORDERS.len() - 1];
    // [material][order]: error without noise, and how far noise moves the model.
    let errors = materials
        .par_iter()
        .enumerate()
        .map(|(i, brdf)| {
            let reference = metric.reference(*brdf).ok();
            let [quiet, noisy] = NOISES.map(|noise| ideal_coefficients(*brdf, zone, highest, noise, seed ^ i as u64));
            let (quiet, noisy) = (quiet?, noisy?);
            let at = |&order: &usize| -> Result<[f64; 2], FitError> {
                let fitted = |data: &Coefficients| fit(&data.truncated(order), FitMethod::Auto, &FitOptions::default());
                let (exact, moved) = (fitted(&quiet)?.brdf, fitted(&noisy)?.brdf);
                let error = reference.as_ref().and_then(|r| r.errors(&exact).ok()).map(|e| e.mean.overall());
                let change = metric.errors(&exact, &moved).ok().map(|e| e.mean.overall());
                Ok([error.unwrap_or(f64::NAN), change.unwrap_or(f64::NAN)])
            };
            ORDERS.iter().map(at).collect()
        })
        .collect::<Result<Vec<Vec<[f64; 2]>>, FitError>>()?;
    let classes: Vec<Class> = materials.iter().map(|brdf| Class::of_contrast(contrast(*brdf))).collect();
    let table = |class: Class| {
        let members: Vec<usize> =
            (0..materials.len()).filter(|&i| class == Class::Any || classes[i] == class).collect();
        let orders = ORDERS.iter().enumerate().map(|(o, &order)| {
            // Geometric means change smoothly from order to order where medians jump from one material to the next.
            let mean = |which: usize| {
                let all = members.iter().map(|&i| errors[i][o][which]).filter(|e| e.is_finite());
                let (sum, n) = all.fold((0.0, 0), |(s, n), e| (s + (e + LEAST).ln(), n + 1));
                (sum / f64::from(n)).exp()
            };
            AtOrder { order, misfit: mean(0), per_noise: mean(1) / NOISES[1] }
        });
        (!members.is_empty()).then(|| ClassTable { class, materials: members.len(), orders: orders.collect() })
    };
    Ok(Outlook { version: FORMAT, sectors: GRID[1], class: Class::ALL.into_iter().filter_map(table).collect() })
}
