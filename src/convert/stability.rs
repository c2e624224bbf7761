//! Where each way from zonal coefficients to the hemisphere fails: its errors and gains over orders, zones and noise.

use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use serde::Serialize;

use super::{PriorTable, Trial, population};
use crate::basis::{Conversion, ConversionError, Family, Learned, Method, Population, Rule, Strength, gram_condition};
use crate::geometry::Zone;
use crate::reflectance::{Brdf, EXITANT_DEG, ZoneErrors, abc_materials, sgd_materials};

/// What to try the methods on.
///
/// Three scans cross at order [`Scan::ORDER`], noise [`Scan::NOISE`] and the zone 9..57 deg: one over orders (and again on
/// 9..90 deg), one over the zone's upper limit and one over noise.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// Materials the prior has not learned from, at most; each by its two published fits.
    pub materials: usize,
    /// Highest zonal order, at least [`Scan::ORDER`].
    pub max_order: usize,
    /// Upper limits of the zone, degrees.
    pub limits_deg: Vec<f64>,
    /// Standard errors of every zonal coefficient, over z_00.
    pub noises: Vec<f64>,
    /// Of the noise, the same draws at every point.
    pub seed: u64,
}

impl Default for Scan {
    fn default() -> Self {
        Self {
            materials: usize::MAX,
            max_order: 12,
            limits_deg: vec![45.0, 50.0, 57.0, 65.0, 75.0, 85.0, 90.0],
            noises: vec![0.0, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1],
            seed: 1,
        }
    }
}

/// One method at one point of a [`Scan`]; a line of the table that [`stability_csv`] writes.
///
/// Errors are RMS differences of f_cos over its RMS over the hemisphere ([`ZoneErrors`]), medians and 90th percentiles over
/// materials. Gains, condition and strength are medians over materials where the data choose the strength. What a method
/// does not have, or what cannot be computed, is none.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StabilityRow {
    /// Lower limit of the zone, degrees.
    pub zone_min_deg: f64,
    /// Upper limit of the zone, degrees.
    pub zone_max_deg: f64,
    /// Zonal order; for a Gram matrix the order of its functions.
    pub order: usize,
    /// Standard error of every coefficient over z_00.
    pub noise_rel: Option<f64>,
    /// Name of a [`Method`], `prior`, or `gram-all`, `gram-odd`, `gram-hemispherical` for the Gram matrix of a [`Family`].
    pub method: &'static str,
    /// The number in its [`Strength`], 0 where nothing is held back.
    pub strength: Option<f64>,
    /// Condition number of the worst block of the Gram matrix.
    pub condition: Option<f64>,
    /// See [`Conversion::noise_gain_in`].
    pub noise_gain_in: Option<f64>,
    /// See [`Conversion::noise_gain_out`].
    pub noise_gain_out: Option<f64>,
    /// Error in the zone, median.
    pub error_in_median: Option<f64>,
    /// Error in the zone, 90th percentile.
    pub error_in_p90: Option<f64>,
    /// Error in the rest of the hemisphere, median.
    pub error_out_median: Option<f64>,
    /// Error in the rest of the hemisphere, 90th percentile.
    pub error_out_p90: Option<f64>,
    /// Whether [`Conversion::check`] refuses it, or double precision cannot hold it.
    pub refused: bool,
}

/// Lower limit of all zones, degrees: that of the built rig.
const ZONE_MIN_DEG: f64 = 9.0;
/// The Gram matrices' names.
const FAMILIES: [(&str, Family); 3] =
    [("gram-all", Family::All), ("gram-odd", Family::Odd), ("gram-hemispherical", Family::Hemispherical)];

impl Scan {
    /// Order where limits and noise are scanned.
    pub const ORDER: usize = 4;
    /// Noise where orders and limits are scanned: about that of the built rig.
    pub const NOISE: f64 = 0.01;
    /// Upper limit of the built rig's zone, degrees: where noise is scanned.
    pub const BUILT_DEG: f64 = 57.0;
    /// Upper limit of a whole dome's zone, degrees.
    pub const FULL_DEG: f64 = 90.0;

    /// Published fits of materials that `table` does not name: ABC fits, then SGD fits.
    pub fn test_materials(&self, table: &PriorTable) -> Vec<&'static dyn Brdf> {
        let unseen: Vec<_> = abc_materials().iter().filter(|m| !table.materials.contains(&m.name)).collect();
        let count = self.materials.min(unseen.len());
        let chosen: Vec<_> = (0..count).map(|i| unseen[i * unseen.len() / count]).collect();
        let abc = chosen.iter().map(|m| &m.brdf as &dyn Brdf);
        let sgd = sgd_materials().iter().filter(|s| chosen.iter().any(|m| m.name == s.name));
        abc.chain(sgd.map(|m| &m.brdf as &dyn Brdf)).collect()
    }

    /// Tries all methods at all points.
    ///
    /// # Errors
    /// As [`Conversion::new`].
    pub fn run(&self, table: &PriorTable) -> Result<Vec<StabilityRow>, ConversionError> {
        let materials = self.test_materials(table);
        let mut limits = self.limits_deg.clone();
        limits.extend([Self::BUILT_DEG, Self::FULL_DEG]);
        limits.sort_by(f64::total_cmp);
        limits.dedup();
        let rows: Vec<Vec<StabilityRow>> = limits
            .into_iter()
            .map(|limit_deg| {
                let of_orders = [Self::BUILT_DEG, Self::FULL_DEG].contains(&limit_deg);
                let mut points = vec![(Self::ORDER, Self::NOISE)];
                if of_orders {
                    points.extend((0..=self.max_order).map(|order| (order, Self::NOISE)));
                }
                if limit_deg == Self::BUILT_DEG {
                    points.extend(self.noises.iter().map(|&noise| (Self::ORDER, noise)));
                }
                points.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
                points.dedup();
                let site = Site::new(limit_deg, points.iter().map(|p| p.0).max().unwrap_or(0), &materials, table)?;
                let mut rows: Vec<StabilityRow> = points
                    .into_par_iter()
                    .map(|(order, noise)| site.rows(order, noise, self.seed))
                    .collect::<Result<Vec<_>, _>>()?
                    .concat();
                if of_orders {
                    for order in 0..=self.max_order {
                        rows.extend(site.conditions(order)?);
                    }
                }
                Ok(rows)
            })
            .collect::<Result<_, ConversionError>>()?;
        Ok(rows.concat())
    }
}

/// A zone with all that was measured through it.
struct Site {
    limit_deg: f64,
    zone: Zone,
    trial: Trial,
    population: Population,
    learned: Learned,
}

impl Site {
    /// Exitant directions beyond the zone cannot be measured: they are left out.
    fn new(limit_deg: f64, order: usize, materials: &[&dyn Brdf], table: &PriorTable) -> Result<Self, ConversionError> {
        let zone = Zone::from_degrees(ZONE_MIN_DEG, limit_deg).expect("limits lie above the zone's lower one");
        let exitant_deg: Vec<f64> = EXITANT_DEG.into_iter().filter(|&deg| deg < limit_deg).collect();
        let thetas: Vec<f64> = exitant_deg.iter().map(|deg| deg.to_radians()).collect();
        let (trial, population) = rayon::join(
            || Trial::towards(zone, order, materials, &exitant_deg),
            || population(table, zone, order, &thetas),
        );
        Ok(Self { limit_deg, zone, trial: trial?, population: population?, learned: table.learned() })
    }

    /// All methods at one order and noise.
    fn rows(&self, order: usize, noise: f64, seed: u64) -> Result<Vec<StabilityRow>, ConversionError> {
        let spectra = self.trial.spectra(order, noise, &mut Xoshiro256PlusPlus::seed_from_u64(seed));
        let linear = |&method: &Method| {
            let row = StabilityRow { noise_rel: Some(noise), ..self.empty(method.name(), order) };
            match self.trial.conversions(method, order, &spectra, Some(Rule::Auto)) {
                Ok(conversions) => {
                    let of = |value: fn(&Conversion) -> f64| at(conversions.iter().map(value).collect(), 0.5);
                    let refused = conversions.iter().filter(|c| c.check(noise).is_err()).count();
                    let row = StabilityRow {
                        strength: of(|c| number(c.strength)),
                        condition: of(|c| c.condition),
                        noise_gain_in: of(|c| c.noise_gain_in),
                        noise_gain_out: of(|c| c.noise_gain_out),
                        refused: 2 * refused > conversions.len(),
                        ..row
                    };
                    Ok(row.with_errors(&self.trial.errors_of(&conversions, &spectra)))
                }
                Err(ConversionError::RankDeficient { .. } | ConversionError::Decomposition { .. }) => {
                    Ok(StabilityRow { refused: true, ..row })
                }
                Err(error) => Err(error),
            }
        };
        let prior = || -> Result<StabilityRow, ConversionError> {
            let population = self.population.truncated(order)?;
            let row = StabilityRow { noise_rel: Some(noise), ..self.empty("prior", order) };
            Ok(row.with_errors(&self.trial.prior(&population, &self.learned, &spectra)?))
        };
        let (linear, prior): (Result<Vec<_>, _>, _) =
            rayon::join(|| Method::ALL.par_iter().map(linear).collect(), prior);
        Ok([linear?, vec![prior?]].concat())
    }

    /// The Gram matrices of all families up to one order.
    fn conditions(&self, order: usize) -> Result<Vec<StabilityRow>, ConversionError> {
        // There is no odd function of order 0.
        let some = FAMILIES.into_iter().filter(|f| order > 0 || f.1 != Family::Odd);
        some.map(|(name, family)| {
            let condition = Some(gram_condition(self.zone, order, family)?);
            Ok(StabilityRow { condition, ..self.empty(name, order) })
        })
        .collect()
    }

    fn empty(&self, method: &'static str, order: usize) -> StabilityRow {
        StabilityRow {
            zone_min_deg: ZONE_MIN_DEG,
            zone_max_deg: self.limit_deg,
            order,
            noise_rel: None,
            method,
            strength: None,
            condition: None,
            noise_gain_in: None,
            noise_gain_out: None,
            error_in_median: None,
            error_in_p90: None,
            error_out_median: None,
            error_out_p90: None,
            refused: false,
        }
    }
}

impl StabilityRow {
    fn with_errors(self, errors: &[ZoneErrors]) -> Self {
        let of = |error: fn(&ZoneErrors) -> f64, share| at(errors.iter().map(error).collect(), share);
        Self {
            error_in_median: of(|e| e.inside, 0.5),
            error_in_p90: of(|e| e.inside, 0.9),
            error_out_median: of(|e| e.outside, 0.5),
            error_out_p90: of(|e| e.outside, 0.9),
            ..self
        }
    }
}

/// The table as CSV: a header line with the fields of [`StabilityRow`], empty where there is none.
pub fn stability_csv(rows: &[StabilityRow]) -> Vec<u8> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    for row in rows {
        csv.serialize(row).expect("memory takes any row");
    }
    csv.into_inner().expect("memory takes any row")
}

fn number(strength: Strength) -> f64 {
    match strength {
        Strength::Exact => 0.0,
        Strength::Cut(x) | Strength::Concentration(x) | Strength::Curvature(x) => x,
    }
}

/// The value that this share of the values does not exceed, by the nearest rank.
fn at(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get((values.len().saturating_sub(1) as f64 * share).round() as usize).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(zone_max_deg: f64) -> Vec<StabilityRow> {
        let (table, scan) = (PriorTable::built_in(), Scan { materials: 8, ..Scan::default() });
        let site = Site::new(zone_max_deg, 6, &scan.test_materials(&table), &table).unwrap();
        [2, 4, 6].into_iter().flat_map(|order| site.rows(order, Scan::NOISE, 1).unwrap()).collect()
    }

    fn of<'a>(rows: &'a [StabilityRow], method: &str, order: usize) -> &'a StabilityRow {
        rows.iter().find(|r| r.method == method && r.order == order).unwrap()
    }

    /// Bounds of the derivation: thesis 22 and 638 at orders 4 and 6; the prior stays below 0.2 at every order.
    #[test]
    fn on_the_built_zone_the_thesis_explodes_and_the_prior_does_not() {
        let rows = rows(Scan::BUILT_DEG);
        let out = |method, order| of(&rows, method, order).error_out_median.unwrap();
        assert!(out("thesis", 4) > 5.0 && out("thesis", 6) > 100.0);
        for order in [4, 6] {
            assert!(of(&rows, "thesis", order).refused && !of(&rows, "parity", order).refused);
        }
        for order in [2, 4, 6] {
            assert!(out("prior", order) < 0.2, "{order}: {}", out("prior", order));
            assert!(of(&rows, "prior", order).noise_gain_out.is_none());
        }
    }

    /// A zone that is the hemisphere leaves nothing outside, and its own functions are the hemispherical ones.
    #[test]
    fn where_all_is_seen_nothing_is_amplified() {
        for order in [1, 5] {
            let hemisphere = Conversion::new(Method::Hsh, Zone::hemisphere(), order).unwrap();
            assert!((hemisphere.noise_gain_in - 1.0).abs() < 1e-12 && hemisphere.noise_gain_out == 0.0);
            let sphere = Conversion::new(Method::Thesis, Zone::sphere(), order).unwrap();
            assert!((sphere.noise_gain_in - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn test_materials_are_unknown_to_the_prior_and_rows_become_lines() {
        let table = PriorTable::built_in();
        assert_eq!(Scan::default().test_materials(&table).len(), 2 * (100 - table.materials.len()));
        assert_eq!(Scan { materials: 3, ..Scan::default() }.test_materials(&table).len(), 6);
        let site = Site::new(Scan::BUILT_DEG, 1, &[], &table).unwrap();
        let text = String::from_utf8(stability_csv(&site.conditions(1).unwrap())).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(
            lines[0],
            "zone_min_deg,zone_max_deg,order,noise_rel,method,strength,condition,noise_gain_in,noise_gain_out,\
             error_in_median,error_in_p90,error_out_median,error_out_p90,refused"
        );
        assert!(lines.len() == 4 && lines[2].starts_with("9.0,57.0,1,,gram-odd,,"), "{text}");
        assert_eq!((at(vec![3.0, 1.0, 2.0], 0.5), at(vec![], 0.5)), (Some(2.0), None));
    }
}
