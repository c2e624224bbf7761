//! Responses to a scheme's frames as zonal coefficients.

use serde::{Deserialize, Serialize};

use super::decoder::{Taken, any_sample};
use super::isotropic::isotropic_sample;
use super::{CellMap, CellResponse, Coefficients, ReduceError};
use crate::basis::size;
use crate::capture::ResponseImage;
use crate::geometry::{ExitantGrid, Zone};
use crate::patterns::{Lobe, Sign, Step};

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

/// Takes the responses to a scheme's frames, in any order, and gives the coefficients.
pub struct Reducer {
    cells: CellMap,
    steps: Vec<Step>,
    /// Divisors of the rates of each step's frames: [`crate::patterns::LobePair::gains`].
    gains: Vec<[f64; 2]>,
    scale: ChannelScale,
    /// By step: the responses to its frames.
    responses: Vec<[Option<CellResponse>; 2]>,
    saturated: usize,
    pixels: usize,
    history: String,
    stray: Option<Coefficients>,
}

/// Coefficients, and how far the sample departs from what was assumed of it.
pub struct Reduced {
    /// The coefficients; functions that no step shows are NaN.
    pub coefficients: Coefficients,
    /// RMS deviation of a coefficient from isotropy beyond noise, over RMS z_00; 0 where isotropy was not assumed.
    pub anisotropy: f64,
}

impl Reducer {
    /// A reducer for these steps; `history` goes into the coefficients.
    pub fn new(cells: CellMap, steps: Vec<Step>, gains: Vec<[f64; 2]>, scale: ChannelScale, history: String) -> Self {
        assert_eq!(gains.len(), steps.len(), "gains for each step");
        let responses = steps.iter().map(|_| [None, None]).collect();
        Self { cells, steps, gains, scale, responses, saturated: 0, pixels: 0, history, stray: None }
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
        let order = self.steps.iter().map(Step::order).max().unwrap_or(0);
        if !alike || stray.order < order {
            return Err(ReduceError::Stray {
                order: stray.order,
                grid: [stray.grid.rings(), stray.grid.sectors()],
                wanted_order: order,
                wanted_grid: [grid.rings(), grid.sectors()],
            });
        }
        self.stray = Some(stray.truncated(order));
        Ok(self)
    }

    /// Takes the response to a frame.
    pub fn add(&mut self, lobe: Lobe, response: &ResponseImage) {
        self.saturated += response.saturated();
        self.pixels += response.crop.len();
        self.responses[lobe.k][usize::from(lobe.sign == Sign::Negative)] = Some(self.cells.apply(response));
    }

    /// Share of pixels that saturated in every exposure, over all frames so far.
    pub fn saturated_fraction(&self) -> f64 {
        self.saturated as f64 / self.pixels.max(1) as f64
    }

    /// The coefficients that `steps` tell, for a sample that is isotropic or for any.
    ///
    /// # Errors
    /// [`ReduceError::Incomplete`] if a frame is missing, [`ReduceError::NoSignal`] if all is dark or saturated.
    pub fn finish(&self, steps: &[usize], isotropic: bool) -> Result<Reduced, ReduceError> {
        let reduced = self.finish_dark(steps, isotropic)?;
        if !reduced.coefficients.noise_rel().is_finite() {
            return Err(ReduceError::NoSignal { saturated_percent: 100.0 * self.saturated_fraction() });
        }
        Ok(reduced)
    }

    /// The same of what may be black.
    ///
    /// # Errors
    /// [`ReduceError::Incomplete`].
    pub fn finish_dark(&self, steps: &[usize], isotropic: bool) -> Result<Reduced, ReduceError> {
        let whole = |&s: &usize| match &self.responses[s] {
            [Some(first), Some(second)] => {
                Some(Taken { step: &self.steps[s], gains: self.gains[s], frames: [first, second] })
            }
            _ => None,
        };
        let taken: Vec<Taken<'_>> = steps.iter().filter_map(whole).collect();
        if taken.len() < steps.len() || taken.is_empty() {
            return Err(ReduceError::Incomplete { found: 2 * taken.len(), expected: 2 * steps.len() });
        }
        let grid = self.cells.grid();
        let n = 3 * grid.len();
        let stray =
            |k: usize, i: usize| self.stray.as_ref().map(|s| [s.values[k * n + i], s.sigma[k * n + i]].map(f64::from));
        let rates = if isotropic { isotropic_sample(&taken, grid, &stray)? } else { any_sample(&taken, n)? };
        let order = taken.iter().map(|t| t.step.order()).max().unwrap_or(0);
        let mut values = vec![f32::NAN; size(order) * n];
        let mut sigma = values.clone();
        for (&k, cells) in rates.functions.iter().zip(&rates.cells) {
            for (i, &[rate, variance]) in cells.iter().enumerate() {
                let theta_o = grid.theta(i % grid.len() / grid.sectors());
                let scale = self.scale.at(&grid.zone(), theta_o, i / grid.len());
                let [light, stray_sigma] = if isotropic { None } else { stray(k, i) }.unwrap_or_default();
                values[k * n + i] = (scale * (rate - light)) as f32;
                sigma[k * n + i] = (scale.abs() * variance.sqrt().hypot(stray_sigma)) as f32;
            }
        }
        let mut history = self.history.clone();
        if isotropic {
            history +=
                &format!("; taken to be isotropic, directions moved by {:.4} deg", rates.displacement.to_degrees());
        }
        let middle = 0.5 * (grid.zone().theta_min() + grid.zone().theta_max());
        let scale = (0..3).map(|c| self.scale.at(&grid.zone(), middle, c).abs()).sum::<f64>() / 3.0;
        let coefficients = Coefficients { grid, order, values, sigma, history };
        let anisotropy = scale * rates.deviation / coefficients.dc();
        Ok(Reduced { coefficients, anisotropy })
    }
}
