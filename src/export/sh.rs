//! Spherical-harmonic coefficients for every exitant direction, as a material and as OpenEXR.

use std::path::Path;

use crate::basis::{Conversion, Family, Harmonics, MAX_ORDER, size};
use crate::convert::{Converted, linear};
use crate::geometry::{Direction, ExitantGrid, Sample, Zone};
use crate::radiometry::ColourSpace;
use crate::reduce::{CHANNEL_NAMES, Coefficients};
use crate::reflectance::{Brdf, Towards};
use crate::store::{Layers, Plane, StoreError};

/// f_cos(wi, wo) = sum over k of y_k(wo) Y_k(wi): real SH over incident directions, a table over exitant ones.
///
/// Between the table's cells y_k is bilinear in theta_o and phi_o; beyond the centres of the first and last ring theta_o
/// is clamped, for the rig measured nothing there.
#[derive(Debug, Clone)]
pub struct ShMaterial {
    /// Exitant directions.
    pub grid: ExitantGrid,
    /// Name of the method the coefficients come from.
    pub method: String,
    /// Zonal order measured.
    pub zonal_order: usize,
    /// Values, linear RGB, 1/sr: index `(k * 3 + channel) * grid.len() + cell`.
    pub values: Vec<f32>,
    /// Standard errors, indexed alike.
    pub sigma: Vec<f32>,
    /// How much of each coefficient is data, 0..=1, indexed alike; the rest is what the method assumes.
    pub data_share: Vec<f32>,
    /// What was measured, with what: see [`Coefficients::history`].
    pub history: String,
    family: Family,
    harmonics: Harmonics,
}

/// Names of families in files, in the order of their declaration.
const FAMILIES: [&str; 3] = ["all", "odd", "hemispherical"];

impl From<Converted> for ShMaterial {
    fn from(converted: Converted) -> Self {
        let Converted { grid, zonal_order, method, family, sh_order, values, sigma, data_share, history } = converted;
        let harmonics = family.harmonics(sh_order).expect("a conversion has a valid order");
        Self { grid, method, zonal_order, values, sigma, data_share, history, family, harmonics }
    }
}

/// The functions of the expansion, for the file's header.
const HEMISPHERICAL: &str = "hemispherical harmonics, orthonormal over the hemisphere (Gautron et al. 2004): H_lm = sqrt(2) times \
the real spherical harmonic of the same phi_i and the polar angle whose cosine is 2 cos(theta_i) - 1";
const FUNCTIONS: &str = "real spherical harmonics, orthonormal over the sphere: Y_lm = N_l|m| P_l|m|(cos theta_i) times 1 for \
m = 0, sqrt(2) cos(m phi_i) for m > 0, sqrt(2) sin(|m| phi_i) for m < 0; N_lm^2 = (2l+1)/(4 pi) (l-m)!/(l+m)!";

impl ShMaterial {
    /// Converts measured zonal coefficients.
    pub fn new(coefficients: &Coefficients, conversion: &Conversion) -> Self {
        linear(coefficients, conversion).into()
    }

    /// Order of the SH.
    pub fn order(&self) -> usize {
        self.harmonics.order()
    }

    /// Mean share of data over coefficients and directions, each weighted with its square; NaN cells left out.
    pub fn mean_data_share(&self) -> f64 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (value, share) in self.values.iter().zip(&self.data_share).filter(|(v, _)| v.is_finite()) {
            let square = f64::from(*value) * f64::from(*value);
            sum += square * f64::from(*share);
            weight += square;
        }
        if weight > 0.0 { sum / weight } else { 0.0 }
    }

    /// f_cos without clamping: a reconstruction may be negative.
    pub fn f_cos(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        self.expand(wi, &self.at(wo))
    }

    /// Coefficients of all functions towards `wo`, `[k][channel]`.
    fn at(&self, wo: &Direction<Sample>) -> Vec<[f64; 3]> {
        let taps = self.grid.bilinear(wo.theta(), wo.phi());
        let n = self.grid.len();
        let value = |k: usize, c: usize| {
            let plane = &self.values[(k * 3 + c) * n..][..n];
            taps.iter().map(|&(cell, w)| w * f64::from(plane[cell])).sum::<f64>()
        };
        (0..self.harmonics.len()).map(|k| [0, 1, 2].map(|c| value(k, c))).collect()
    }

    fn expand(&self, wi: &Direction<Sample>, coefficients: &[[f64; 3]]) -> [f64; 3] {
        let mut y = [0.0; size(MAX_ORDER)];
        let y = &mut y[..self.harmonics.len()];
        self.harmonics.eval_direction_into(wi, y);
        let mut sum = [0.0; 3];
        for (y, coefficients) in y.iter().zip(coefficients) {
            for (sum, coefficient) in sum.iter_mut().zip(coefficients) {
                *sum += y * coefficient;
            }
        }
        sum
    }

    /// Writes planes `y_kkk.R|G|B` and `sigma_kkk.R|G|B`, columns = sectors, rows = rings, the convention in the header.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write(&self, path: &Path) -> Result<(), StoreError> {
        let n = self.grid.len();
        let mut image = Layers::new(self.grid.sectors(), self.grid.rings());
        for k in 0..size(self.order()) {
            for (c, name) in CHANNEL_NAMES.iter().enumerate() {
                let at = (k * 3 + c) * n;
                image.plane(format!("y_{k:03}.{name}"), Plane::Float(self.values[at..at + n].to_vec()));
                image.plane(format!("sigma_{k:03}.{name}"), Plane::Float(self.sigma[at..at + n].to_vec()));
                image.plane(format!("data_{k:03}.{name}"), Plane::Float(self.data_share[at..at + n].to_vec()));
            }
        }
        image.attribute("zonal_content", "SH coefficients y_k(wo): f_cos(wi, wo) = sum over k of y_k(wo) Y_k(wi)");
        image.attribute("zonal_units", "1/sr, linear RGB; f_cos is the BRDF times cos(theta_i)");
        image.attribute("zonal_colour_space", ColourSpace::of_history(&self.history).label());
        image.attribute("zonal_convention", crate::reduce::CONVENTION);
        let functions = if self.family == Family::Hemispherical { HEMISPHERICAL } else { FUNCTIONS };
        image.attribute("zonal_functions", functions);
        image.attribute("zonal_family", FAMILIES[self.family as usize]);
        image.attribute(
            "zonal_data_share",
            "planes data_kkk: how much of a coefficient is data, 0..1; the rest is what the method assumes or has learned",
        );
        image.attribute(
            "zonal_interpolation",
            "bilinear in theta_o and phi_o; theta_o clamped to the centres of the first and last row, phi_o wraps",
        );
        image.attribute("zonal_history", self.history.as_str());
        image.attribute("zonal_method", self.method.as_str());
        image.attribute("zonal_order", self.zonal_order as f64);
        image.attribute("zonal_sh_order", self.order() as f64);
        image.attribute("zonal_theta_min_deg", self.grid.zone().theta_min().to_degrees());
        image.attribute("zonal_theta_max_deg", self.grid.zone().theta_max().to_degrees());
        image.write(path)
    }

    /// Reads what [`ShMaterial::write`] wrote.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn read(path: &Path) -> Result<Self, StoreError> {
        let image = Layers::read(path)?;
        let missing = |what: &str| StoreError::invalid(path, format!("`{what}` is missing: convert the run again"));
        let number = |name: &str| image.number(name).ok_or_else(|| missing(name));
        let zone = Zone::from_degrees(number("zonal_theta_min_deg")?, number("zonal_theta_max_deg")?)
            .map_err(|e| StoreError::invalid(path, e.to_string()))?;
        // Files of format 1 knew spherical harmonics only, and no shares.
        let family = match image.text("zonal_family") {
            None => Family::All,
            Some(name) => {
                let known = FAMILIES
                    .iter()
                    .position(|f| f == &name)
                    .map(|i| [Family::All, Family::Odd, Family::Hemispherical][i]);
                known.ok_or_else(|| {
                    StoreError::invalid(path, format!("zonal_family = {name} is not known to this version"))
                })?
            }
        };
        let harmonics = family
            .harmonics(number("zonal_sh_order")? as usize)
            .map_err(|e| StoreError::invalid(path, e.to_string()))?;
        let (mut values, mut sigma, mut data_share) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..harmonics.len() {
            for name in CHANNEL_NAMES {
                for (stem, planes) in [("y", &mut values), ("sigma", &mut sigma)] {
                    let plane = format!("{stem}_{k:03}.{name}");
                    planes.extend(image.get(&plane).ok_or_else(|| missing(&plane))?);
                }
                match image.get(&format!("data_{k:03}.{name}")) {
                    Some(plane) => data_share.extend(plane),
                    None => data_share.resize(values.len(), 1.0),
                }
            }
        }
        Ok(Self {
            grid: ExitantGrid::new(zone, image.height, image.width),
            method: image.text("zonal_method").unwrap_or_default().into(),
            history: image.text("zonal_history").unwrap_or_default().into(),
            zonal_order: number("zonal_order")? as usize,
            values,
            sigma,
            data_share,
            family,
            harmonics,
        })
    }
}

impl Brdf for ShMaterial {
    /// f = f_cos / cos(theta_i); may be negative.
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        if wi.cos_theta() <= 0.0 || wo.cos_theta() <= 0.0 {
            return [0.0; 3];
        }
        self.f_cos(wi, wo).map(|f| f / wi.cos_theta())
    }

    fn eval_cos(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        if wi.cos_theta() <= 0.0 || wo.cos_theta() <= 0.0 { [0.0; 3] } else { self.f_cos(wi, wo) }
    }

    fn towards<'a>(&'a self, wo: &Direction<Sample>) -> Towards<'a> {
        if wo.cos_theta() <= 0.0 {
            return Box::new(|_| [0.0; 3]);
        }
        let coefficients = self.at(wo);
        Box::new(move |wi| if wi.cos_theta() > 0.0 { self.expand(wi, &coefficients) } else { [0.0; 3] })
    }

    fn is_isotropic(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::basis::Method;
    use crate::calibrate::gray_card_coefficients;

    #[test]
    fn an_exact_gray_card_is_lambert_everywhere_and_survives_the_file() {
        let zone = Zone::from_degrees(9.0, 57.0).unwrap();
        let grid = ExitantGrid::new(zone, 4, 6);
        let order = 2;
        let z = gray_card_coefficients(zone, order, 0.18);
        let values: Vec<f32> = z.iter().flat_map(|&z| vec![z as f32; 3 * grid.len()]).collect();
        let coefficients =
            Coefficients { grid, order, sigma: vec![1e-4; values.len()], values, history: String::new() };
        let conversion = Conversion::new(Method::Parity, zone, order).unwrap();
        let material = ShMaterial::new(&coefficients, &conversion);
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("sh.exr");
        material.write(&path).unwrap();
        let back = ShMaterial::read(&path).unwrap();
        for (theta_i, theta_o) in [(0.1, 0.3), (0.9, 0.6), (1.4, 1.2)] {
            let (wi, wo) = (Direction::from_angles(theta_i, 2.0), Direction::from_angles(theta_o, -1.0));
            for material in [&material, &back] {
                let f = material.eval(&wi, &wo)[1];
                assert!((f - 0.18 / std::f64::consts::PI).abs() < 1e-6, "{f}");
            }
        }
    }
}
