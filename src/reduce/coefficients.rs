//! Zonal coefficients for every exitant direction.

use std::path::Path;

use crate::basis::size;
use crate::geometry::{ExitantGrid, Zone};
use crate::radiometry::ColourSpace;
use crate::store::{Layers, Plane, StoreError};

/// Names of the colour channels in files.
pub const CHANNEL_NAMES: [&str; 3] = ["R", "G", "B"];

/// z_k(wo) = integral over the zone of Z_k(wi) f_cos(wi, wo) dwi and its standard error, linear RGB, unit 1/sqrt(sr).
#[derive(Debug, Clone, PartialEq)]
pub struct Coefficients {
    /// Exitant directions.
    pub grid: ExitantGrid,
    /// Zonal order L.
    pub order: usize,
    /// Values: index `(k * 3 + channel) * grid.len() + cell`; NaN where nothing was measured.
    pub values: Vec<f32>,
    /// Standard errors, indexed alike. Neighbouring cells are correlated by at most 10%.
    pub sigma: Vec<f32>,
    /// What was measured, with what: sample, rig, plan, seed; kept in every file made from this.
    pub history: String,
}

impl Coefficients {
    /// Values of all functions for one channel and cell, k = 0..(L+1)^2.
    pub fn spectrum(&self, channel: usize, cell: usize) -> Vec<f64> {
        self.gather(&self.values, channel, cell)
    }

    /// Standard errors of all functions for one channel and cell.
    pub fn spectrum_sigma(&self, channel: usize, cell: usize) -> Vec<f64> {
        self.gather(&self.sigma, channel, cell)
    }

    fn gather(&self, planes: &[f32], channel: usize, cell: usize) -> Vec<f64> {
        (0..size(self.order)).map(|k| f64::from(planes[(k * 3 + channel) * self.grid.len() + cell])).collect()
    }

    /// All cells of one function in one channel.
    pub fn plane(&self, k: usize, channel: usize) -> &[f32] {
        let n = self.grid.len();
        &self.values[(k * 3 + channel) * n..][..n]
    }

    /// The same measurement as if only functions up to `order` had been shown.
    pub fn truncated(&self, order: usize) -> Self {
        let order = order.min(self.order);
        let n = size(order) * 3 * self.grid.len();
        Self {
            grid: self.grid,
            order,
            values: self.values[..n].to_vec(),
            sigma: self.sigma[..n].to_vec(),
            history: self.history.clone(),
        }
    }

    /// RMS of z_00 over directions and channels; NaN cells left out.
    pub fn dc(&self) -> f64 {
        rms(&self.values[..3 * self.grid.len()])
    }

    /// The highest order up to which every function has been measured.
    pub fn complete_order(&self) -> usize {
        let measured = |k: usize| (0..3).any(|c| self.plane(k, c).iter().any(|z| z.is_finite()));
        (0..=self.order).take_while(|&l| (size(l) - 2 * l - 1..size(l)).all(measured)).last().unwrap_or(0)
    }

    /// RMS of the standard errors over RMS of z_00, both over directions and channels; NaN cells left out.
    pub fn noise_rel(&self) -> f64 {
        rms(&self.sigma) / self.dc()
    }

    /// The colours it is given in.
    pub fn colour_space(&self) -> ColourSpace {
        ColourSpace::of_history(&self.history)
    }

    /// The same measurement in the colours of the projector's primaries: `inverse` is `[primary][channel]`. Channels are
    /// measured by different pixels, so that their noise is independent.
    pub fn in_primaries(&self, inverse: &[[f64; 3]; 3]) -> Self {
        let n = self.grid.len();
        let mut mixed = self.clone();
        for at in (0..size(self.order)).flat_map(|k| (0..n).map(move |cell| k * 3 * n + cell)) {
            for (p, row) in inverse.iter().enumerate() {
                let value = |c: usize| row[c] * f64::from(self.values[at + c * n]);
                let power = |c: usize| (row[c] * f64::from(self.sigma[at + c * n])).powi(2);
                mixed.values[at + p * n] = (0..3).map(value).sum::<f64>() as f32;
                mixed.sigma[at + p * n] = (0..3).map(power).sum::<f64>().sqrt() as f32;
            }
        }
        mixed.history += &format!("; {}", ColourSpace::Projector.label());
        mixed
    }

    /// Writes planes `z_kkk.R|G|B` and `sigma_kkk.R|G|B` as OpenEXR, columns = sectors, rows = rings.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write(&self, path: &Path) -> Result<(), StoreError> {
        let mut image = self.planes();
        image.attribute("zonal_content", "zonal coefficients z_k(wo) of f_cos = f cos(theta_i), and standard errors");
        image.attribute("zonal_units", "1/sqrt(sr), linear RGB");
        image.attribute("zonal_colour_space", self.colour_space().label());
        image.write(path)
    }

    /// All but what the numbers stand for.
    pub(crate) fn planes(&self) -> Layers {
        let mut image = Layers::new(self.grid.sectors(), self.grid.rings());
        let n = self.grid.len();
        for k in 0..size(self.order) {
            for (c, name) in CHANNEL_NAMES.iter().enumerate() {
                let at = (k * 3 + c) * n;
                image.plane(format!("z_{k:03}.{name}"), Plane::Float(self.values[at..at + n].to_vec()));
                image.plane(format!("sigma_{k:03}.{name}"), Plane::Float(self.sigma[at..at + n].to_vec()));
            }
        }
        image.attribute("zonal_convention", CONVENTION);
        image.attribute("zonal_history", self.history.as_str());
        image.attribute("zonal_order", self.order as f64);
        image.attribute("zonal_theta_min_deg", self.grid.zone().theta_min().to_degrees());
        image.attribute("zonal_theta_max_deg", self.grid.zone().theta_max().to_degrees());
        image
    }

    /// Reads what [`Coefficients::write`] wrote.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn read(path: &Path) -> Result<Self, StoreError> {
        Self::of_planes(&Layers::read(path)?, path)
    }

    /// The coefficients in an image read from `path`.
    ///
    /// # Errors
    /// [`StoreError`].
    pub(crate) fn of_planes(image: &Layers, path: &Path) -> Result<Self, StoreError> {
        let missing = |what: &str| StoreError::invalid(path, format!("`{what}` is missing: reduce the run again"));
        let number = |name: &str| image.number(name).ok_or_else(|| missing(name));
        let order = number("zonal_order")? as usize;
        let zone = Zone::from_degrees(number("zonal_theta_min_deg")?, number("zonal_theta_max_deg")?)
            .map_err(|e| StoreError::invalid(path, e.to_string()))?;
        if order > crate::basis::MAX_ORDER {
            return Err(StoreError::invalid(path, format!("zonal_order = {order} is out of range")));
        }
        let grid = ExitantGrid::new(zone, image.height, image.width);
        let (mut values, mut sigma) = (Vec::new(), Vec::new());
        for k in 0..size(order) {
            for name in CHANNEL_NAMES {
                for (stem, planes) in [("z", &mut values), ("sigma", &mut sigma)] {
                    let plane = format!("{stem}_{k:03}.{name}");
                    planes.extend(image.get(&plane).ok_or_else(|| missing(&plane))?);
                }
            }
        }
        let history = image.text("zonal_history").unwrap_or_default().into();
        Ok(Self { grid, order, values, sigma, history })
    }
}

/// How directions and indices are to be read, for file headers.
pub const CONVENTION: &str = "row = ring: theta_o = theta_min + (row + 1/2) (theta_max - theta_min) / rows; column = sector: \
phi_o = (column + 1/2) 360 deg / columns; k = l(l+1) + m; no Condon-Shortley phase; cos(m phi) for m > 0, sin(|m| phi) for m < 0; \
directions point away from the sample, theta from its normal +z, phi from its grain +x";

fn rms(values: &[f32]) -> f64 {
    let (mut sum, mut n) = (0.0, 0usize);
    for v in values.iter().filter(|v| !v.is_nan()) {
        sum += f64::from(*v) * f64::from(*v);
        n += 1;
    }
    (sum / n.max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_survive_a_round_trip_and_a_truncation() {
        let grid = ExitantGrid::new(Zone::from_degrees(9.0, 57.0).unwrap(), 3, 4);
        let n = 4 * 3 * grid.len();
        let values: Vec<f32> = (0..n).map(|i| i as f32 * 0.25 - 3.0).collect();
        let c = Coefficients { grid, order: 1, values, sigma: vec![0.5; n], history: "a test".into() };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("coefficients.exr");
        c.write(&path).unwrap();
        let back = Coefficients::read(&path).unwrap();
        assert_eq!((&back.values, &back.sigma, back.order, &back.history), (&c.values, &c.sigma, 1, &c.history));
        assert_eq!(back.truncated(0).values.len(), 3 * grid.len());
        assert_eq!(back.spectrum(1, 5)[2], f64::from(c.plane(2, 1)[5]));
    }
}
