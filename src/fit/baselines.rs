//! Fits to the reconstruction, as Ghosh 2007 makes them: kept to show what fitting in the measured space gains.

use std::f64::consts::{FRAC_1_PI, TAU};

use nalgebra::{DMatrix, DVector};

use super::Observations;
use super::family::{Family, GgxFamily, geometric, ggx_columns};
use super::likelihood::{Likelihood, Solution};
use super::search::{Minimum, Termination};
use crate::basis::{Harmonics, OrderError, WeightedDual};
use crate::reflectance::{Dbrdf, Density};

/// Reflectance at normal incidence of a D-BRDF from backscatter, which cannot tell it: that of glass.
const ASSUMED_R0: f64 = 0.04;

/// The D-BRDF of the thesis (Ghosh 2007, eq. 2.15 and section 3.5): p(h) from the backscatter of the reconstruction,
/// f(w, w) = c r0 p(w) / (2 cos - cos^2), constant beyond the zone's edges.
///
/// The shape is the mean of the channels', the scale each channel's own. A negative reconstruction counts as 0.
///
/// # Errors
/// [`OrderError`].
pub(super) fn thesis(observations: &Observations) -> Result<Dbrdf, OrderError> {
    let grid = observations.grid;
    let basis = Harmonics::zonal(grid.zone(), observations.order)?;
    let mut theta_h_deg: Vec<f64> = Vec::new();
    let mut rows: Vec<[f64; 3]> = Vec::new();
    for ring in 0..grid.rings() {
        let stations: Vec<_> = observations.stations.iter().filter(|s| s.ring == ring).collect();
        if stations.is_empty() {
            continue;
        }
        let theta = grid.theta(ring);
        let functions = basis.eval(&crate::geometry::Direction::from_angles(theta, 0.0));
        let cos = theta.cos();
        let mut row = [0.0; 3];
        for station in &stations {
            for (&k, z) in observations.terms.iter().zip(&station.z) {
                row.iter_mut().zip(z).for_each(|(r, z)| *r += functions[k] * z / stations.len() as f64);
            }
        }
        theta_h_deg.push(theta.to_degrees());
        // f_cos to f, then to c r0 p.
        rows.push(row.map(|f_cos| (f_cos / cos * (2.0 * cos - cos * cos)).max(0.0)));
    }
    let density = |p: Vec<f64>| Density::Table { theta_h_deg: theta_h_deg.clone(), p };
    let integrals = [0, 1, 2].map(|c| integral(&density(rows.iter().map(|r| r[c]).collect())));
    let shape: Vec<f64> = rows.iter().map(|r| r.iter().sum::<f64>() / 3.0).collect();
    let norm = integral(&density(shape.clone()));
    let p = if norm > 0.0 { shape.iter().map(|p| p / norm).collect() } else { vec![1.0 / TAU; shape.len()] };
    Ok(Dbrdf { kd: [0.0; 3], c: integrals.map(|i| i / ASSUMED_R0), r0: ASSUMED_R0, p: density(p) })
}

/// integral p(h) dh over the upper hemisphere, for a density of theta_h alone.
fn integral(p: &Density) -> f64 {
    let nodes = crate::geometry::quadrature::gauss_legendre(400, 0.0, 1.0);
    nodes
        .iter()
        .map(|&(mu, w)| {
            TAU * w * p.eval(&crate::geometry::Direction::<crate::geometry::Sample>::from_mu_phi(mu, 0.0).vector())
        })
        .sum()
}

/// GGX + Lambert fitted to the zonal reconstruction: least squares over the zone, all exitant directions alike.
///
/// By orthonormality the error is that of the coefficients plus what of the model no coefficient sees, so blurred data
/// call for a broad lobe.
pub(super) fn ggx_to_reconstruction(likelihood: &Likelihood<'_>) -> (GgxFamily, Minimum) {
    let family = GgxFamily { lobes: 1, anisotropic: false };
    let solve = |alpha: f64| {
        let columns = family.columns(likelihood.forward, &[alpha]);
        let gram = likelihood.forward.gram(|node| {
            let [f0, f90] = ggx_columns([alpha, alpha], node);
            [FRAC_1_PI, f0, f90]
        });
        let mut x = vec![[0.0; 3]; 3];
        let mut error = 0.0;
        for c in 0..3 {
            let dot = |a: &[f64]| a.iter().zip(&likelihood.z[c]).map(|(a, z)| a * z).sum::<f64>();
            let right = DVector::from_vec(vec![dot(likelihood.lambert), dot(&columns[0]), dot(&columns[1])]);
            let dual = WeightedDual::from_sums(DMatrix::from_fn(3, 3, |i, j| gram[i][j]), right, dot(&likelihood.z[c]));
            let solution = dual.non_negative();
            x.iter_mut().zip(solution.x.iter()).for_each(|(x, s)| x[c] = *s);
            error += solution.chi2;
        }
        (error, columns, x)
    };
    // One dimension and a smooth valley: a fine scan, then one finer around its best.
    let mut evaluations = 0;
    let (mut lo, mut hi) = (0.005, 1.0);
    let mut best = 0.1;
    for _ in 0..3 {
        let tried: Vec<f64> = geometric(lo, hi, 15);
        evaluations += tried.len();
        best = tried.iter().map(|&a| (solve(a).0, a)).min_by(|a, b| a.0.total_cmp(&b.0)).map_or(best, |b| b.1);
        let ratio = (hi / lo).powf(1.0 / 14.0);
        (lo, hi) = ((best / ratio).max(0.005), (best * ratio).min(1.0));
    }
    let (_, columns, x) = solve(best);
    let chi2 = likelihood.residuals(&columns, &x).norm_squared();
    let solution = Solution { x, chi2 };
    (family, Minimum { theta: vec![best], columns, solution, evaluations, termination: Termination::Converged })
}
