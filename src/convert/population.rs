//! The population of the prior: published fits as a rig with this zone would have measured them.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::PriorTable;
use crate::basis::{ConversionError, Family, Harmonics, Member, Population, Projection};
use crate::geometry::quadrature::gauss_legendre;
use crate::geometry::{Direction, Fineness, Zone, zone_about_mirror};
use crate::reflectance::{Brdf, abc_materials, sgd_materials};

/// For harmonics up to `order`, coefficients to 1e-4 of z_00: errors of those that no smooth material has are alike in all
/// members, and would pass for knowledge.
fn fineness(order: usize) -> Fineness {
    Fineness { radial: 32 + order, around: 32 + 2 * order }
}

/// Rings that are integrated at most; those between are interpolated.
const ANCHORS: usize = 24;

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
    let (least, most) = thetas.iter().fold((f64::INFINITY, 0.0f64), |(a, b), &t| (a.min(t), b.max(t)));
    let anchor = |i: usize| least + (most - least) * i as f64 / (ANCHORS - 1) as f64;
    let anchors: Vec<f64> = if thetas.len() > ANCHORS { (0..ANCHORS).map(anchor).collect() } else { thetas.to_vec() };
    let (mut z, mut y): (Vec<_>, Vec<_>) =
        anchors.par_iter().map(|&theta_o| ring(&brdfs, &zonal, &sh, &projection, table.zone_weight, theta_o)).unzip();
    if thetas.len() > ANCHORS {
        (z, y) = (between(&anchors, &z, thetas), between(&anchors, &y, thetas));
    }
    Population::new(zone, order, table.sh_order, members.into_iter().map(|m| m.0).collect(), z, y)
}

/// Cubic interpolation (Lagrange, the four nearest of equidistant `anchors`) at each of `thetas`.
fn between(anchors: &[f64], values: &[DMatrix<f64>], thetas: &[f64]) -> Vec<DMatrix<f64>> {
    let step = anchors[1] - anchors[0];
    let at = |&theta: &f64| {
        let place = (theta - anchors[0]) / step;
        let first = (place.floor() as isize - 1).clamp(0, anchors.len() as isize - 4) as usize;
        let x = place - first as f64;
        let weight =
            |i: usize| (0..4).filter(|&j| j != i).map(|j| (x - j as f64) / (i as f64 - j as f64)).product::<f64>();
        (1..4).fold(&values[first] * weight(0), |sum, i| sum + &values[first + i] * weight(i))
    };
    thetas.iter().map(at).collect()
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
    for (inside, nodes) in regions(theta_o, &zone, fineness(zonal.order().max(sh.order()))) {
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
fn regions(theta_o: f64, zone: &Zone, fineness: Fineness) -> Vec<(bool, Nodes)> {
    use std::f64::consts::{FRAC_PI_2, PI};
    let mut regions = vec![(true, zone_about_mirror(theta_o, zone, fineness))];
    if let Ok(above) = Zone::new(zone.theta_max(), FRAC_PI_2) {
        regions.push((false, zone_about_mirror(theta_o, &above, fineness)));
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
