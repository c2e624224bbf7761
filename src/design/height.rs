//! What a sample at the wrong height costs.

use serde::Serialize;

use super::seen::{Blur, Lit, Seen, Shift};
use crate::basis::{OrderError, size};
use crate::fit::{Fineness, Forward, Observations};
use crate::geometry::ExitantGrid;
use crate::optics::{Device, Misalignment, Rig};
use crate::reduce::Coefficients;
use crate::reflectance::Brdf;

/// Exitant rings.
const RINGS: usize = 12;
/// Nodes of the integrals over incident directions.
const FINENESS: Fineness = Fineness { radial: 24, around: 48 };

/// Errors of the zonal coefficients of a sample that is too high.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HeightError {
    /// By how much, mm.
    pub height_mm: f64,
    /// Largest error of a coefficient's RMS over exitant directions, over RMS z_00.
    pub largest_rel: f64,
    /// RMS error of all coefficients over RMS z_00.
    pub total_rel: f64,
    /// Least share of the camera's footprint that is lit, over all pairs of directions in the zone's corners.
    pub lit_share: f64,
}

/// Errors of a material's coefficients up to `order` for each height, by integrals without noise: unlit parts of footprints and
/// shifted directions, against the same rig with its sample in place. `None` if rays of a pupil miss a mirror.
///
/// # Errors
/// [`OrderError`].
pub fn height_errors(
    rig: &Rig,
    brdf: &dyn Brdf,
    order: usize,
    heights_mm: &[f64],
) -> Result<Option<Vec<HeightError>>, OrderError> {
    let grid = ExitantGrid::new(rig.zone(), RINGS, 1);
    let n = 3 * grid.len() * size(order);
    let blank = Coefficients { grid, order, values: vec![0.0; n], sigma: vec![1.0; n], history: String::new() };
    let observations = Observations::anisotropic(&blank);
    let forward = Forward::new(&observations, FINENESS)?;
    let terms = observations.terms.len();
    let measured = |height_mm: f64| {
        let m = Misalignment { sample_height_mm: height_mm, ..Misalignment::none() };
        let seen = Seen {
            brdf,
            projector: Shift::new(rig, &m, Device::Projector)?,
            camera: Shift::new(rig, &m, Device::Camera)?,
            projector_blur: Blur::default(),
            camera_blur: Blur::default(),
            lit: Some(Lit::new(rig, height_mm)?),
        };
        Some(forward.predict(&seen))
    };
    let ideal = forward.predict(brdf);
    let stations = observations.stations.len() as f64;
    let rms = |z: &[Vec<f64>; 3], k: usize| {
        let sum: f64 = z.iter().flat_map(|z| z.iter().skip(k).step_by(terms)).map(|z| z * z).sum();
        (sum / (3.0 * stations)).sqrt()
    };
    let dc = rms(&ideal, 0);
    let of = |&height_mm: &f64| {
        let z = measured(height_mm)?;
        let differences: [Vec<f64>; 3] =
            std::array::from_fn(|c| z[c].iter().zip(&ideal[c]).map(|(a, b)| a - b).collect());
        let each: Vec<f64> = (0..terms).map(|k| rms(&differences, k) / dc).collect();
        Some(HeightError {
            height_mm,
            largest_rel: each.iter().copied().fold(0.0, f64::max),
            total_rel: each.iter().map(|e| e * e).sum::<f64>().sqrt(),
            lit_share: least_share(rig, height_mm)?,
        })
    };
    Ok(heights_mm.iter().map(of).collect())
}

/// Least over the zone's ends and azimuths.
fn least_share(rig: &Rig, height_mm: f64) -> Option<f64> {
    use crate::geometry::Direction;
    let lit = Lit::new(rig, height_mm)?;
    let ends = [rig.zone().theta_min(), rig.zone().theta_max()];
    let mut least = 1.0f64;
    for wi in ends {
        for wo in ends {
            for i in 0..=8 {
                let phi = f64::from(i) / 8.0 * std::f64::consts::PI;
                least = least.min(lit.share(&Direction::from_angles(wi, phi), &Direction::from_angles(wo, 0.0)));
            }
        }
    }
    Some(least)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::open;

    #[test]
    fn what_is_not_lit_costs_more_than_what_is_shifted() {
        let rig = Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap();
        let card = open("gray-card").unwrap();
        let errors = height_errors(&rig, card.as_ref(), 2, &[0.0, 0.1, 0.2, 1.0, 2.0]).unwrap().unwrap();
        assert!(errors[0].total_rel < 1e-6 && errors[0].lit_share == 1.0, "{errors:?}");
        assert!(errors[2].lit_share == 1.0 && errors[2].total_rel < 2e-3, "{errors:?}");
        assert!(errors[4].lit_share < 0.6 && errors[4].total_rel > 0.02, "{errors:?}");
        assert!(errors.is_sorted_by(|a, b| a.total_rel <= b.total_rel), "{errors:?}");
    }
}
