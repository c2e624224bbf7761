//! Lobe differences, scaled, as zonal coefficients.

use serde::{Deserialize, Serialize};

use super::{CellMap, CellResponse, Coefficients, ReduceError};
use crate::basis::size;
use crate::capture::ResponseImage;
use crate::geometry::{ExitantGrid, Zone};
use crate::patterns::{Lobe, Sign};

/// What turns lobe differences in electrons per second into coefficients: one smooth curve over theta_o per channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelScale {
    /// Polynomial coefficients, lowest power first, in x = (2 theta_o - theta_min - theta_max) / (theta_max - theta_min);
    /// red, green, blue; unit: coefficient (1/sqrt(sr)) for one electron per second.
    pub coefficients: [Vec<f64>; 3],
}

impl ChannelScale {
    /// Leaves electrons per second as they are.
    pub fn unit() -> Self {
        Self { coefficients: [vec![1.0], vec![1.0], vec![1.0]] }
    }

    /// The scale of a channel at the polar angle `theta_o` (radians).
    pub fn at(&self, zone: &Zone, theta_o: f64, channel: usize) -> f64 {
        let x = (2.0 * theta_o - zone.theta_min() - zone.theta_max()) / (zone.theta_max() - zone.theta_min());
        self.coefficients[channel].iter().rev().fold(0.0, |sum, c| sum * x + c)
    }
}

/// Takes responses lobe by lobe, positive before negative, and gives the coefficients.
pub struct Reducer {
    cells: CellMap,
    order: usize,
    /// Divisor of each lobe difference: [`crate::patterns::LobePair::gain`].
    gains: Vec<f64>,
    scale: ChannelScale,
    /// A positive lobe that waits for its negative: index and response.
    positive: Option<(usize, CellResponse)>,
    /// Pairs whose two lobes came one after the other.
    pairs: usize,
    values: Vec<f32>,
    sigma: Vec<f32>,
    lobes: usize,
    saturated: usize,
    pixels: usize,
    history: String,
    stray: Option<Coefficients>,
}

impl Reducer {
    /// A reducer for (order+1)^2 pairs of lobes; `history` goes into the coefficients.
    pub fn new(cells: CellMap, order: usize, gains: Vec<f64>, scale: ChannelScale, history: String) -> Self {
        assert_eq!(gains.len(), size(order), "one gain for each function");
        let n = size(order) * 3 * cells.grid().len();
        Self {
            cells,
            order,
            gains,
            scale,
            positive: None,
            pairs: 0,
            values: vec![f32::NAN; n],
            sigma: vec![f32::NAN; n],
            lobes: 0,
            saturated: 0,
            pixels: 0,
            history,
            stray: None,
        }
    }

    /// Takes stray light away: what a black trap in the sample's place sent, in coefficients of [`ChannelScale::unit`] over
    /// the same grid. Its variance is added.
    ///
    /// # Errors
    /// [`ReduceError::Stray`] if it covers other directions or fewer functions.
    pub fn less_stray(mut self, stray: &Coefficients) -> Result<Self, ReduceError> {
        let grid = self.cells.grid();
        let cells = |grid: ExitantGrid| (grid.rings(), grid.sectors());
        let alike = cells(stray.grid) == cells(grid) && stray.grid.zone().is_close(&grid.zone());
        if !alike || stray.order < self.order {
            return Err(ReduceError::Stray {
                order: stray.order,
                grid: [stray.grid.rings(), stray.grid.sectors()],
                wanted_order: self.order,
                wanted_grid: [grid.rings(), grid.sectors()],
            });
        }
        self.stray = Some(stray.truncated(self.order));
        Ok(self)
    }

    /// Takes the response to a lobe.
    pub fn add(&mut self, lobe: Lobe, response: &ResponseImage) {
        self.lobes += 1;
        self.saturated += response.saturated();
        self.pixels += response.crop.len();
        let response = self.cells.apply(response);
        match (lobe.sign, self.positive.take()) {
            (Sign::Positive, _) => self.positive = Some((lobe.k, response)),
            (Sign::Negative, Some((k, positive))) if k == lobe.k => {
                self.pairs += 1;
                self.difference(k, &positive, &response);
            }
            // Counted as missing at the end.
            (Sign::Negative, _) => {}
        }
    }

    fn difference(&mut self, k: usize, positive: &CellResponse, negative: &CellResponse) {
        let grid = self.cells.grid();
        for i in 0..3 * grid.len() {
            let theta_o = grid.theta(i % grid.len() / grid.sectors());
            let scale = self.scale.at(&grid.zone(), theta_o, i / grid.len());
            let at = k * 3 * grid.len() + i;
            let stray = self.stray.as_ref().map_or([0.0; 2], |s| [s.values[at], s.sigma[at]].map(f64::from));
            let light = (positive.rate[i] - negative.rate[i]) / self.gains[k];
            let sigma = (positive.variance[i] + negative.variance[i]).sqrt() / self.gains[k].abs();
            self.values[at] = (scale * (light - stray[0])) as f32;
            self.sigma[at] = (scale.abs() * sigma.hypot(stray[1])) as f32;
        }
    }

    /// Share of pixels that saturated in every exposure, over all lobes so far.
    pub fn saturated_fraction(&self) -> f64 {
        self.saturated as f64 / self.pixels.max(1) as f64
    }

    /// The coefficients.
    ///
    /// # Errors
    /// [`ReduceError::Incomplete`] if a lobe is missing, [`ReduceError::NoSignal`] if all is dark or saturated.
    pub fn finish(self) -> Result<Coefficients, ReduceError> {
        let saturated_percent = 100.0 * self.saturated_fraction();
        let coefficients = self.finish_dark()?;
        if !coefficients.noise_rel().is_finite() {
            return Err(ReduceError::NoSignal { saturated_percent });
        }
        Ok(coefficients)
    }

    /// The coefficients of what may be black.
    ///
    /// # Errors
    /// [`ReduceError::Incomplete`].
    pub fn finish_dark(self) -> Result<Coefficients, ReduceError> {
        let expected = 2 * size(self.order);
        if self.lobes != expected || 2 * self.pairs != expected {
            return Err(ReduceError::Incomplete { found: 2 * self.pairs, expected });
        }
        Ok(Coefficients {
            grid: self.cells.grid(),
            order: self.order,
            values: self.values,
            sigma: self.sigma,
            history: self.history,
        })
    }
}
