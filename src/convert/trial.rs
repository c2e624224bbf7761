//! How much of known materials a conversion finds: the experiment behind charts, tests and the prior's learning.

use std::f64::consts::FRAC_PI_2;

use nalgebra::DMatrix;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::basis::{
    Conversion, ConversionError, Evidence, Family, Harmonics, Learned, Method, Population, RingMean, Rule, index, size,
};
use crate::geometry::quadrature::polar_about_mirror;
use crate::geometry::{Direction, Fineness, Zone, zone_about_mirror};
use crate::reflectance::{Brdf, EXITANT_DEG, ZoneErrors};

/// Nodes in the polar angle and around it, about the mirror direction: as the error metric has.
const NODES: [usize; 2] = [96, 128];

/// Materials without and with error: f_cos over the hemisphere and exact zonal coefficients, mean of the channels, towards
/// some exitant directions at phi_o = 0.
pub struct Trial {
    zone: Zone,
    order: usize,
    materials: usize,
    scenes: Vec<Scene>,
}

struct Scene {
    directions: Vec<Direction>,
    /// Solid angles.
    weights: Vec<f64>,
    inside: Vec<bool>,
    /// f_cos: nodes x materials.
    values: DMatrix<f64>,
    /// RMS of f_cos over the hemisphere, per material.
    rms: Vec<f64>,
    /// Zonal coefficients: (order+1)^2 x materials.
    z: DMatrix<f64>,
}

/// Zonal coefficients and their variances.
type Spectrum = (Vec<f64>, Vec<f64>);
/// Noisy spectra of all materials and exitant directions: `[exitant][material]`, values and variances.
pub type Spectra = Vec<Vec<Spectrum>>;

impl Trial {
    /// Integrates `materials` over `zone` up to the zonal `order`, towards the exitant directions [`EXITANT_DEG`].
    ///
    /// # Errors
    /// As [`Conversion::new`].
    pub fn new(zone: Zone, order: usize, materials: &[&dyn Brdf]) -> Result<Self, ConversionError> {
        Self::towards(zone, order, materials, &EXITANT_DEG)
    }

    /// The same towards exitant directions at the polar angles `exitant_deg`, degrees.
    ///
    /// # Errors
    /// As [`Conversion::new`].
    pub fn towards(
        zone: Zone,
        order: usize,
        materials: &[&dyn Brdf],
        exitant_deg: &[f64],
    ) -> Result<Self, ConversionError> {
        let zonal = Harmonics::zonal(zone, order)?;
        let scenes = exitant_deg.par_iter().map(|deg| Scene::new(&zonal, materials, deg.to_radians())).collect();
        Ok(Self { zone, order, materials: materials.len(), scenes })
    }

    /// The zone.
    pub fn zone(&self) -> Zone {
        self.zone
    }

    /// Number of materials.
    pub fn len(&self) -> usize {
        self.materials
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.materials == 0
    }

    /// What a rig measures up to `order`, each coefficient with independent noise of `noise_rel` times z_00.
    pub fn spectra(&self, order: usize, noise_rel: f64, rng: &mut impl Rng) -> Spectra {
        assert!(order <= self.order, "the trial holds order {}", self.order);
        let spectrum = |scene: &Scene, i: usize, rng: &mut dyn FnMut() -> f64| {
            let column = scene.z.column(i);
            let exact = &column.as_slice()[..size(order)];
            let sigma = noise_rel * exact[0].abs();
            (exact.iter().map(|z| z + sigma * rng()).collect(), vec![sigma * sigma; exact.len()])
        };
        let mut unit = || StandardNormal.sample(rng);
        self.scenes.iter().map(|s| (0..self.materials).map(|i| spectrum(s, i, &mut unit)).collect()).collect()
    }

    /// Errors of a linear method, one per material; its strength from each material's spectra where `rule` says so.
    ///
    /// # Errors
    /// As [`Conversion::new`].
    pub fn linear(
        &self,
        method: Method,
        order: usize,
        spectra: &Spectra,
        rule: Option<Rule>,
    ) -> Result<Vec<ZoneErrors>, ConversionError> {
        Ok(self.errors_of(&self.conversions(method, order, spectra, rule)?, spectra))
    }

    /// The conversion of each material: all alike, but where `rule` says to find the strength from the material's spectra.
    ///
    /// # Errors
    /// As [`Conversion::new`].
    pub fn conversions(
        &self,
        method: Method,
        order: usize,
        spectra: &Spectra,
        rule: Option<Rule>,
    ) -> Result<Vec<Conversion>, ConversionError> {
        let Some(rule) = rule.filter(|_| method.is_tuned()) else {
            return Ok(vec![Conversion::new(method, self.zone, order)?; self.materials]);
        };
        let evidence = Evidence::new(method, self.zone, order)?;
        let tuned = |i: usize| {
            let mut evidence = evidence.clone();
            spectra.iter().for_each(|s| evidence.add(&s[i].0, &s[i].1));
            Conversion::with_strength(method, self.zone, order, evidence.strength(rule))
        };
        (0..self.materials).into_par_iter().map(tuned).collect()
    }

    /// Errors of `conversions` of one method, one for each material.
    pub fn errors_of(&self, conversions: &[Conversion], spectra: &Spectra) -> Vec<ZoneErrors> {
        let Some(first) = conversions.first() else { return Vec::new() };
        let one = |(i, c): (usize, &Conversion)| spectra.iter().map(|s| c.apply(&s[i].0)).collect();
        let estimates: Vec<Vec<Vec<f64>>> = conversions.iter().enumerate().map(one).collect();
        self.judge(&first.harmonics(), &estimates)
    }

    /// Errors of the prior, one per material, each converted from its own spectra alone.
    ///
    /// # Errors
    /// As [`Population::maps`].
    pub fn prior(
        &self,
        population: &Population,
        learned: &Learned,
        spectra: &Spectra,
    ) -> Result<Vec<ZoneErrors>, ConversionError> {
        let estimates = (0..self.materials)
            .into_par_iter()
            .map(|i| by_rings(population, learned, spectra, i))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(self.judge(&Family::Odd.harmonics(population.sh_order())?, &estimates))
    }

    /// Shares of directions, by solid angle, in which the prior's 68% interval holds the truth: `[material]`, and there
    /// inside and outside the zone. The truth is what the harmonics can hold of it, or f_cos itself where `projected` is
    /// none; `[material][exitant]` in the order of [`crate::basis::Projection::terms`].
    ///
    /// # Errors
    /// As [`Population::maps`].
    pub fn coverage(
        &self,
        population: &Population,
        learned: &Learned,
        spectra: &Spectra,
        projected: Option<(&[usize], &[DMatrix<f64>])>,
    ) -> Result<Vec<[f64; 2]>, ConversionError> {
        /// Every so many nodes are looked at.
        const STEP: usize = 23;
        let functions = Family::Odd.harmonics(population.sh_order())?;
        let n = functions.len();
        let tables: Vec<Vec<f64>> = self
            .scenes
            .iter()
            .map(|s| {
                let some: Vec<Direction> = s.directions.iter().step_by(STEP).copied().collect();
                let mut table = vec![0.0; n * some.len()];
                functions.eval_many_into(&some, &mut table);
                table
            })
            .collect();
        (0..self.materials)
            .into_par_iter()
            .map(|i| {
                let rings: Vec<RingMean> = spectra.iter().map(|s| ring_mean(population, &s[i].0, &s[i].1)).collect();
                let mut parts = [[0.0; 2]; 2];
                for (s, map) in population.maps(&rings, learned)?.iter().enumerate() {
                    let scene = &self.scenes[s];
                    let y = map.estimate(&spectra[s][i].0, &spectra[s][i].1, 0.0)?.y;
                    for (row, j) in tables[s].chunks_exact(n).zip((0..).step_by(STEP)) {
                        let got: f64 = row.iter().zip(&y).map(|(f, y)| f * y).sum();
                        let want = match projected {
                            None => scene.values[(j, i)],
                            Some((terms, y)) => terms.iter().enumerate().map(|(t, &k)| row[k] * y[s][(i, t)]).sum(),
                        };
                        let sigma = map.variance_at(row, &spectra[s][i].1).iter().sum::<f64>().sqrt();
                        let part = &mut parts[usize::from(!scene.inside[j])];
                        part[0] += scene.weights[j] * f64::from(u8::from((got - want).abs() <= sigma));
                        part[1] += scene.weights[j];
                    }
                }
                Ok(parts.map(|[held, all]| held / all))
            })
            .collect()
    }

    /// Errors of given coefficients, `[material][exitant][k]`.
    pub fn judge(&self, functions: &Harmonics, estimates: &[Vec<Vec<f64>>]) -> Vec<ZoneErrors> {
        let mut errors = vec![ZoneErrors { inside: 0.0, outside: 0.0 }; self.materials];
        for (s, scene) in self.scenes.iter().enumerate() {
            let n = functions.len();
            let mut table = vec![0.0; n * scene.directions.len()];
            functions.eval_many_into(&scene.directions, &mut table);
            let y = DMatrix::from_fn(n, self.materials, |k, i| estimates[i][s][k]);
            let model = DMatrix::from_column_slice(n, scene.directions.len(), &table).tr_mul(&y);
            for (i, errors) in errors.iter_mut().enumerate() {
                let mut parts = [(0.0, 0.0); 2];
                for (j, &w) in scene.weights.iter().enumerate() {
                    let part = &mut parts[usize::from(!scene.inside[j])];
                    part.0 += w * (model[(j, i)] - scene.values[(j, i)]).powi(2);
                    part.1 += w;
                }
                let relative = |(sum, omega): (f64, f64)| {
                    if omega > 0.0 { (sum / omega).sqrt() / scene.rms[i] / self.scenes.len() as f64 } else { 0.0 }
                };
                errors.inside += relative(parts[0]);
                errors.outside += relative(parts[1]);
            }
        }
        errors
    }
}

/// Coefficients that the prior gives material `i` towards each exitant direction, `[exitant][k]`.
pub(super) fn by_rings(
    population: &Population,
    learned: &Learned,
    spectra: &Spectra,
    i: usize,
) -> Result<Vec<Vec<f64>>, ConversionError> {
    let rings: Vec<RingMean> = spectra.iter().map(|s| ring_mean(population, &s[i].0, &s[i].1)).collect();
    let maps = population.maps(&rings, learned)?;
    maps.iter().zip(spectra).map(|(map, s)| Ok(map.estimate(&s[i].0, &s[i].1, 0.0)?.y)).collect()
}

/// One spectrum at phi_o = 0 as the mean of its ring.
pub fn ring_mean(population: &Population, z: &[f64], variance: &[f64]) -> RingMean {
    let terms = population.terms();
    let of = |all: &[f64]| terms.iter().map(|&k| all[k]).collect::<Vec<_>>();
    RingMean { z: of(z), variance: of(variance), direction_variance: of(variance) }
}

impl Scene {
    fn new(zonal: &Harmonics, materials: &[&dyn Brdf], theta_o: f64) -> Self {
        let zone = zonal.zone();
        let wo = Direction::from_angles(theta_o, 0.0);
        let (directions, weights): (Vec<Direction>, Vec<f64>) =
            polar_about_mirror(&wo, NODES[0], NODES[1], FRAC_PI_2).into_iter().unzip();
        let inside = directions.iter().map(|d| zone.contains(d.theta())).collect();
        let fine = zone_about_mirror(theta_o, &zone, Fineness { radial: 48, around: 96 });
        let lit: Vec<Direction> = fine.iter().map(|n| Direction::new_unchecked(n.0)).collect();
        let mut table = vec![0.0; zonal.len() * lit.len()];
        zonal.eval_many_into(&lit, &mut table);
        let table = DMatrix::from_vec(zonal.len(), lit.len(), table);
        let mut values = DMatrix::zeros(directions.len(), materials.len());
        let mut responses = DMatrix::zeros(lit.len(), materials.len());
        for (i, brdf) in materials.iter().enumerate() {
            let f_cos = brdf.towards(&wo);
            let gray = |wi: &Direction| f_cos(wi).iter().sum::<f64>() / 3.0;
            values.column_mut(i).iter_mut().zip(&directions).for_each(|(v, d)| *v = gray(d));
            for ((v, d), node) in responses.column_mut(i).iter_mut().zip(&lit).zip(&fine) {
                *v = 2.0 * node.1 * gray(d);
            }
        }
        let mut z = table * responses;
        // Half of the zone was summed: sines vanish.
        for l in 1..=zonal.order() {
            for m in 1..=l as i32 {
                z.row_mut(index(l, -m)).fill(0.0);
            }
        }
        let omega: f64 = weights.iter().sum();
        let power = |v: nalgebra::DVectorView<'_, f64>| v.iter().zip(&weights).map(|(v, w)| w * v * v).sum::<f64>();
        let rms = values.column_iter().map(|c| (power(c) / omega).sqrt()).collect();
        Self { directions, weights, inside, values, rms, z }
    }
}
