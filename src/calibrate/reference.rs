//! What lies in the gray card's place, and the coefficients it should have.

use std::f64::consts::{FRAC_1_PI, PI, TAU};
use std::path::Path;
use std::sync::Arc;

use serde::Deserialize;

use super::CalibrateError;
use crate::basis::{Harmonics, OrderError, index, lm, size};
use crate::geometry::quadrature::zone_mu_angular;
use crate::geometry::{Direction, ExitantGrid, Sample, Zone};
use crate::reflectance::{Brdf, Lambert, open};
use crate::store::{self, StoreError};

/// Albedo of the photographic gray card.
pub const GRAY_CARD_ALBEDO: f64 = 0.18;

/// Nodes of the integrals over a reference, which has no sharp lobes: over the zone's polar angles, and over azimuths.
const NODES: [usize; 2] = [96, 192];

/// A sample of known reflectance.
#[derive(Clone)]
pub struct Reference {
    /// What it is, for files and messages.
    pub name: String,
    material: Known,
}

#[derive(Clone)]
enum Known {
    /// An ideal diffuser of this albedo: its coefficients are known in closed form.
    Ideal(f64),
    /// Anything else; its values times a factor.
    Other(Arc<dyn Brdf>, f64),
}

impl Default for Reference {
    /// The photographic gray card, taken as an ideal diffuser of albedo 0.18.
    fn default() -> Self {
        Self::ideal(GRAY_CARD_ALBEDO)
    }
}

impl Reference {
    /// An ideal diffuser.
    pub fn ideal(albedo: f64) -> Self {
        Self { name: format!("ideal diffuser of albedo {albedo}"), material: Known::Ideal(albedo) }
    }

    /// A material whose values are multiplied by `factor`. It is taken as isotropic.
    pub fn of(name: &str, brdf: Arc<dyn Brdf>, factor: f64) -> Self {
        let times = if factor == 1.0 { String::new() } else { format!(" times {factor}") };
        Self { name: format!("{name}{times}"), material: Known::Other(brdf, factor) }
    }

    /// A table of reflectance factors (`.csv`, `.json`: see [`FactorTable`]) or anything [`open`] reads, times `factor`.
    ///
    /// # Errors
    /// [`CalibrateError`].
    pub fn open(name: &str, factor: f64) -> Result<Self, CalibrateError> {
        let path = Path::new(name);
        let table = match path.extension().and_then(|e| e.to_str()) {
            Some("csv") => Some(FactorTable::read_csv(path)?),
            Some("json") => Some(FactorTable::read_json(path)?),
            _ => None,
        };
        let brdf = match table {
            Some(table) => Arc::new(table) as Arc<dyn Brdf>,
            None => open(name)?,
        };
        Ok(Self::of(name, brdf, factor))
    }

    /// The reference as a material.
    pub fn brdf(&self) -> Arc<dyn Brdf> {
        match &self.material {
            Known::Ideal(albedo) => Arc::new(Lambert::gray(*albedo)),
            Known::Other(brdf, factor) => Arc::new(Scaled(brdf.clone(), *factor)),
        }
    }

    /// Its coefficients z_k(wo) over a grid: index `(k * 3 + channel) * grid.len() + cell`, 1/sqrt(sr).
    ///
    /// # Errors
    /// [`OrderError`].
    pub fn coefficients(&self, grid: ExitantGrid, order: usize) -> Result<Vec<f64>, OrderError> {
        let cells = grid.len();
        match &self.material {
            Known::Ideal(albedo) => {
                let z = gray_card_coefficients(grid.zone(), order, *albedo);
                Ok(z.iter().flat_map(|&z| std::iter::repeat_n(z, 3 * cells)).collect())
            }
            Known::Other(..) => {
                let brdf = self.brdf();
                let rings = (0..grid.rings())
                    .map(|ring| of_ring(brdf.as_ref(), grid.zone(), order, grid.theta(ring)))
                    .collect::<Result<Vec<_>, _>>()?;
                let mut values = vec![0.0; size(order) * 3 * cells];
                for (i, value) in values.iter_mut().enumerate() {
                    let (k, channel, cell) = (i / (3 * cells), i / cells % 3, i % cells);
                    let (l, m) = lm(k);
                    let phi = f64::from(m) * grid.phi(cell % grid.sectors());
                    let z = rings[cell / grid.sectors()][index(l, m.abs()) * 3 + channel];
                    *value = if m >= 0 { z * phi.cos() } else { -z * phi.sin() };
                }
                Ok(values)
            }
        }
    }
}

/// Zonal coefficients of a diffuser: z_00 = albedo (a+b) sqrt((a-b)/2pi), z_10 = albedo (a-b)^1.5 / sqrt(6pi), others 0.
pub fn gray_card_coefficients(zone: Zone, order: usize, albedo: f64) -> Vec<f64> {
    let (a, b) = (zone.cos_min(), zone.cos_max());
    let mut z = vec![0.0; size(order)];
    z[0] = albedo * (a + b) * ((a - b) / TAU).sqrt();
    if order > 0 {
        z[2] = albedo * (a - b).powf(1.5) / (6.0 * PI).sqrt();
    }
    z
}

/// Integrals of all functions times f_cos over the zone, for theta_o and phi_o = 0: index `k * 3 + channel`.
fn of_ring(brdf: &dyn Brdf, zone: Zone, order: usize, theta_o: f64) -> Result<Vec<f64>, OrderError> {
    let basis = Harmonics::zonal(zone, order)?;
    let wo = Direction::from_angles(theta_o, 0.0);
    let mut z = vec![0.0; basis.len()];
    let mut sums = vec![0.0; 3 * basis.len()];
    let step = TAU / NODES[1] as f64;
    for (mu, weight) in zone_mu_angular(NODES[0], &zone) {
        for j in 0..NODES[1] {
            let wi = Direction::from_angles(mu.acos(), (j as f64 + 0.5) * step);
            basis.eval_direction_into(&wi, &mut z);
            let f = brdf.eval_cos(&wi, &wo);
            for (sums, z) in sums.chunks_exact_mut(3).zip(&z) {
                sums.iter_mut().zip(&f).for_each(|(sum, f)| *sum += weight * step * z * f);
            }
        }
    }
    Ok(sums)
}

/// A material times a number.
struct Scaled(Arc<dyn Brdf>, f64);

impl Brdf for Scaled {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        self.0.eval(wi, wo).map(|f| f * self.1)
    }

    fn eval_cos(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        self.0.eval_cos(wi, wo).map(|f| f * self.1)
    }

    fn is_isotropic(&self) -> bool {
        self.0.is_isotropic()
    }
}

/// Reflectance factors relative to the ideal white diffuser over the two polar angles, as certificates of reference
/// materials give them: f = factor / pi, bilinear in both angles and held beyond the last of them.
///
/// As CSV: a head line `theta_i_deg,theta_o_deg,factor` and one line for each pair. As JSON:
/// `{"theta_i_deg": [..], "theta_o_deg": [..], "factor": [[..], ..]}`, one row of `factor` for each theta_i.
#[derive(Debug, Clone, PartialEq)]
pub struct FactorTable {
    /// Ascending, radians.
    theta_i: Vec<f64>,
    /// Ascending, radians.
    theta_o: Vec<f64>,
    /// `[theta_i][theta_o]`
    factor: Vec<Vec<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TableFile {
    theta_i_deg: Vec<f64>,
    theta_o_deg: Vec<f64>,
    factor: Vec<Vec<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TableLine {
    theta_i_deg: f64,
    theta_o_deg: f64,
    factor: f64,
}

impl FactorTable {
    /// Reads a CSV table.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn read_csv(path: &Path) -> Result<Self, StoreError> {
        let text = store::read_text(path)?;
        let lines = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes()).into_deserialize();
        let lines: Vec<TableLine> = lines
            .collect::<Result<_, _>>()
            .map_err(|e| StoreError::invalid(path, format!("{e}: columns are theta_i_deg, theta_o_deg, factor")))?;
        let ascending = |angle: &dyn Fn(&TableLine) -> f64| {
            let mut angles: Vec<f64> = lines.iter().map(angle).collect();
            angles.sort_by(f64::total_cmp);
            angles.dedup();
            angles
        };
        let (theta_i_deg, theta_o_deg) = (ascending(&|l| l.theta_i_deg), ascending(&|l| l.theta_o_deg));
        let at = |i: f64, o: f64| {
            let line = lines.iter().find(|l| l.theta_i_deg == i && l.theta_o_deg == o);
            line.map(|l| l.factor).ok_or_else(|| {
                StoreError::invalid(path, format!("theta_i_deg {i}, theta_o_deg {o} is missing: give every pair"))
            })
        };
        let factor = theta_i_deg
            .iter()
            .map(|&i| theta_o_deg.iter().map(|&o| at(i, o)).collect())
            .collect::<Result<_, StoreError>>()?;
        Self::new(TableFile { theta_i_deg, theta_o_deg, factor }, path)
    }

    /// Reads a JSON table.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn read_json(path: &Path) -> Result<Self, StoreError> {
        Self::new(store::read_json(path)?, path)
    }

    fn new(file: TableFile, path: &Path) -> Result<Self, StoreError> {
        let ascending = |angles: &[f64]| {
            let range = angles.iter().all(|a| (0.0..90.0).contains(a));
            !angles.is_empty() && range && angles.windows(2).all(|a| a[0] < a[1])
        };
        let rows = file.factor.len() == file.theta_i_deg.len()
            && file.factor.iter().all(|row| row.len() == file.theta_o_deg.len());
        let values = file.factor.iter().flatten().all(|f| f.is_finite() && *f >= 0.0);
        if !ascending(&file.theta_i_deg) || !ascending(&file.theta_o_deg) || !rows || !values {
            let reason =
                "angles must ascend within 0..90 deg, with a factor of 0 or more for each pair: correct the table";
            return Err(StoreError::invalid(path, reason));
        }
        let radians = |angles: Vec<f64>| angles.into_iter().map(f64::to_radians).collect();
        Ok(Self { theta_i: radians(file.theta_i_deg), theta_o: radians(file.theta_o_deg), factor: file.factor })
    }

    /// The factor for a pair of polar angles, radians.
    pub fn factor(&self, theta_i: f64, theta_o: f64) -> f64 {
        let ((i, wi), (o, wo)) = (place(&self.theta_i, theta_i), place(&self.theta_o, theta_o));
        let next = |n: usize, all: &[f64]| (n + 1).min(all.len() - 1);
        let (i1, o1) = (next(i, &self.theta_i), next(o, &self.theta_o));
        let along = |row: &[f64]| row[o] * (1.0 - wo) + row[o1] * wo;
        along(&self.factor[i]) * (1.0 - wi) + along(&self.factor[i1]) * wi
    }
}

/// The node at or below `x` and the share of the next one; held at both ends.
fn place(nodes: &[f64], x: f64) -> (usize, f64) {
    let above = nodes.partition_point(|n| *n <= x);
    match above {
        0 => (0, 0.0),
        n if n == nodes.len() => (n - 1, 0.0),
        n => (n - 1, (x - nodes[n - 1]) / (nodes[n] - nodes[n - 1])),
    }
}

impl Brdf for FactorTable {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        let up = wi.cos_theta() > 0.0 && wo.cos_theta() > 0.0;
        [if up { self.factor(wi.theta(), wo.theta()) * FRAC_1_PI } else { 0.0 }; 3]
    }

    fn is_isotropic(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values stated in the derivation, five digits.
    #[test]
    fn analytic_values_of_the_gray_card() {
        let built = gray_card_coefficients(Zone::from_degrees(9.0, 57.0).unwrap(), 2, 0.18);
        let full = gray_card_coefficients(Zone::from_degrees(9.0, 90.0).unwrap(), 2, 0.18);
        for (got, want) in [(built[0], 0.07324), (built[2], 0.01223), (full[0], 0.07049), (full[2], 0.04070)] {
            assert!((got - want).abs() < 5e-6, "{got} {want}");
        }
        assert!(built.iter().enumerate().all(|(k, z)| k == 0 || k == 2 || *z == 0.0));
    }

    /// Of z_00: the rule is exact for polynomials, what is left is rounding.
    const RULE: f64 = 1e-12;

    #[test]
    fn integrals_of_a_diffuser_are_the_analytic_values() {
        let grid = ExitantGrid::new(Zone::from_degrees(9.0, 57.0).unwrap(), 4, 8);
        let known = Reference::default().coefficients(grid, 2).unwrap();
        let integrated = Reference::of("card", Arc::new(Lambert::gray(0.36)), 0.5).coefficients(grid, 2).unwrap();
        for (got, want) in integrated.iter().zip(&known) {
            assert!((got - want).abs() < RULE * known[0], "{got} {want}");
        }
    }

    #[test]
    fn tables_are_read_and_faults_told() {
        let folder = tempfile::tempdir().unwrap();
        let read = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            if name.ends_with("csv") { FactorTable::read_csv(&path) } else { FactorTable::read_json(&path) }
        };
        let csv = "theta_i_deg, theta_o_deg, factor\n0,0,1.0\n0,60,0.8\n60,0,0.9\n60,60,0.5\n";
        let json = r#"{"theta_i_deg": [0, 60], "theta_o_deg": [0, 60], "factor": [[1.0, 0.8], [0.9, 0.5]]}"#;
        let table = read("a.csv", csv).unwrap();
        assert_eq!(table, read("a.json", json).unwrap());
        let (half, beyond) = (30f64.to_radians(), 80f64.to_radians());
        assert!((table.factor(half, half) - 0.8).abs() < 1e-12);
        assert_eq!(table.factor(beyond, beyond), 0.5);
        let missing = read("b.csv", &csv.replace("60,0,0.9\n", "")).unwrap_err().to_string();
        assert!(missing.contains("theta_i_deg 60, theta_o_deg 0"), "{missing}");
        assert!(read("c.json", &json.replace("0.5", "-0.5")).unwrap_err().to_string().contains("0 or more"));
    }
}
