//! The population of the prior: published fits as a rig with this zone would have measured them.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::PriorTable;
use crate::basis::{ConversionError, Family, Harmonics, Member, Population, Projection};
use crate::geometry::quadrature::gauss_legendre;
use crate::geometry::{Direction, Fineness, Zone, zone_about_mirror};
use crate::reflectance::{Brdf, abc_materials, sgd_materials};

/// Coefficients to 1e-4 of z_00 for rings inside the zone: errors of harmonics that no smooth material has would look like
/// knowledge, since all members share them.
const FINENESS: Fineness = Fineness { radial: 48, around: 64 };

/// Both published fits of every material of `table`.
pub fn members(table: &PriorTable) -> Vec<(Member, &'static dyn Brdf)> {
    let mut members: Vec<(Member, &'static dyn Brdf)> = Vec::new();
    for (material, name) in table.materials.iter().enumerate() {
        if let Some(m) = abc_materials().iter().find(|m| m.name == *name) {
            members.push((Member { material, family: 0 }, &m.brdf));
        }
        if let Some(m) = sgd_materials().iter().find(|m| m.name == *name) {
            members.push((Member { material, family: 1 }, &m.brdf));
        }
    }
    members
}

/// The members of `table` towards exitant rings at `thetas` (radians, inside the zone), mean of their channels.
///
/// # Errors
/// As [`crate::basis::Conversion::new`].
pub fn population(table: &PriorTable, zone: Zone, order: usize, thetas: &[f64]) -> Result<Population, ConversionError> {
    let members = members(table);
    let brdfs: Vec<&dyn Brdf> = members.iter().map(|m| m.1).collect();
    let projection = Projection::new(zone, table.sh_order, table.zone_weight)?;
    let zonal = Harmonics::zonal(zone, order)?;
    let sh = Family::Odd.harmonics(table.sh_order)?;
    let (z, y): (Vec<_>, Vec<_>) =
        thetas.par_iter().map(|&theta_o| ring(&brdfs, &zonal, &sh, &projection, table.zone_weight, theta_o)).unzip();
    Population::new(zone, order, table.sh_order, members.into_iter().map(|m| m.0).collect(), z, y)
}

/// Zonal coefficients and projections of all members towards one ring, a row for each member.
pub fn ring(
    brdfs: &[&dyn Brdf],
    zonal: &Harmonics,
    sh: &Harmonics,
    projection: &Projection,
    zone_weight: f64,
    theta_o: f64,
) -> (DMatrix<f64>, DMatrix<f64>) {
    let zone = zonal.zone();
    let wo = Direction::from_angles(theta_o, 0.0);
    let zonal_terms: Vec<usize> = cosines(zonal.order());
    let sh_terms = projection.terms();
    let (mut z, mut moments) =
        (DMatrix::zeros(brdfs.len(), zonal_terms.len()), DMatrix::zeros(brdfs.len(), sh_terms.len()));
    for (inside, nodes) in regions(theta_o, &zone) {
        let directions: Vec<Direction> = nodes.iter().map(|n| Direction::new_unchecked(n.0)).collect();
        let mut values = DMatrix::zeros(brdfs.len(), nodes.len());
        for (i, brdf) in brdfs.iter().enumerate() {
            let f_cos = brdf.towards(&wo);
            for (j, (wi, node)) in directions.iter().zip(&nodes).enumerate() {
                // Both sides of the plane of wo.
                values[(i, j)] = 2.0 * node.1 * f_cos(wi).iter().sum::<f64>() / 3.0;
            }
        }
        if inside {
            z += &values * table_of(zonal, &zonal_terms, &directions);
        }
        let weight = if inside { zone_weight } else { 1.0 };
        moments += &values * table_of(sh, &sh_terms, &directions) * weight;
    }
    let mut y = moments.clone();
    for (mut y, moments) in y.row_iter_mut().zip(moments.row_iter()) {
        y.copy_from(&projection.apply(&DVector::from_iterator(sh_terms.len(), moments.iter().copied())).transpose());
    }
    (z, y)
}

/// Indices with m >= 0 up to `order`, ascending.
fn cosines(order: usize) -> Vec<usize> {
    (0..=order).flat_map(|l| (0..=l as i32).map(move |m| crate::basis::index(l, m))).collect()
}

/// Values of some functions: a row for each direction.
fn table_of(harmonics: &Harmonics, terms: &[usize], directions: &[Direction]) -> DMatrix<f64> {
    let n = harmonics.len();
    let mut all = vec![0.0; n * directions.len()];
    harmonics.eval_many_into(directions, &mut all);
    DMatrix::from_fn(directions.len(), terms.len(), |i, j| all[i * n + terms[j]])
}

type Nodes = Vec<(nalgebra::Vector3<f64>, f64)>;

/// Half of the hemisphere, phi_i in 0..pi: whether inside the zone, directions, solid angles.
fn regions(theta_o: f64, zone: &Zone) -> Vec<(bool, Nodes)> {
    use std::f64::consts::{FRAC_PI_2, PI};
    let mut regions = vec![(true, zone_about_mirror(theta_o, zone, FINENESS))];
    if let Ok(above) = Zone::new(zone.theta_max(), FRAC_PI_2) {
        regions.push((false, zone_about_mirror(theta_o, &above, FINENESS)));
    }
    if zone.theta_min() > 0.0 {
        let mut cap = Vec::new();
        for (mu, w) in gauss_legendre(12, zone.cos_min(), 1.0) {
            cap.extend(
                gauss_legendre(24, 0.0, PI)
                    .into_iter()
                    .map(|(phi, dphi)| (Direction::<crate::geometry::Sample>::from_mu_phi(mu, phi).vector(), w * dphi)),
            );
        }
        regions.push((false, cap));
    }
    regions
}
