//! The noise of a plan before it is run: from the sensor's figures, the lamp, and how the plan spends its frames.

use crate::capture::{Crop, sensor};
use crate::geometry::ExitantGrid;
use crate::optics::Rig;
use crate::patterns::{Plan, Timing};
use crate::radiometry::Sensor;
use crate::reduce::{CellMap, ChannelScale, ReduceError, coefficient_variances};

/// Albedo of the gray card that lamps are rated by.
const CARD: f64 = 0.18;
/// Exposure in which a well-chosen lamp lets the gray card fill half of the full well, s.
const HALF_WELL_S: f64 = 16.0 / 60.0;

/// A rig, as far as its noise goes.
#[derive(Debug, Clone)]
pub struct NoiseModel {
    rig: Rig,
    sensor: Sensor,
    /// Electrons per second of a pixel that sees the gray card when the whole zone is white.
    card_e_s: f64,
    /// Variance of a cell over that of a pixel, mean over cells and channels.
    cell: f64,
    /// The exitant grid that is for.
    grid: ExitantGrid,
}

impl NoiseModel {
    /// The model of a rig whose lamp suits it: half of the full well for the gray card in 16/60 s.
    ///
    /// # Errors
    /// [`ReduceError::EmptyCell`] if the plan's exitant grid is too fine for the camera.
    pub fn new(rig: &Rig, plan: &Plan) -> Result<Self, ReduceError> {
        let grid = ExitantGrid::new(rig.zone(), plan.exitant.rings, plan.exitant.sectors);
        let camera = rig.camera_map();
        let cells = CellMap::new(rig, &camera, Crop::of_map(rig, &camera), grid)?;
        let cell = cells.noise_weights(&ChannelScale::unit()).iter().sum();
        Ok(Self {
            sensor: sensor(rig),
            card_e_s: 0.5 * rig.camera.full_well_e / HALF_WELL_S,
            cell,
            grid,
            rig: rig.clone(),
        })
    }

    /// The same rig with a lamp `factor` times as bright.
    pub fn with_lamp(self, factor: f64) -> Self {
        Self { card_e_s: factor * self.card_e_s, ..self }
    }

    /// RMS standard error of the coefficients over z_00 for a diffuse sample of this albedo: what a run reports as `noise_rel`.
    ///
    /// # Errors
    /// [`ReduceError`] if the plan's scheme cannot be read back.
    pub fn noise_rel(&self, plan: &Plan, albedo: f64) -> Result<f64, ReduceError> {
        let zone = self.rig.zone();
        let white_e_s = self.card_e_s * albedo / CARD;
        let exposures_s = plan.exposures_s(&Timing::of(&self.rig));
        let all = plan.steps(zone);
        let stage = plan.stages(zone).swap_remove(0);
        let steps = &all[stage.steps];
        let mut gains = Vec::with_capacity(steps.len());
        let mut variances = Vec::with_capacity(steps.len());
        for step in steps {
            let (peak, means) = step.brightness(zone);
            gains.push([1.0 / peak; 2]);
            let of = |mean: f64| self.pixel_variance(white_e_s * mean, &exposures_s) * self.cell / plan.repeats as f64;
            variances.push(means.map(of));
        }
        let sectors = self.grid.sectors();
        let found = coefficient_variances(zone, steps, &gains, &variances, stage.isotropic, sectors)?;
        let mean = found.iter().map(|(_, variance)| variance).sum::<f64>() / found.len() as f64;
        // White light is the constant function times the root of the zone's solid angle.
        Ok(mean.sqrt() * zone.solid_angle().sqrt() / white_e_s)
    }

    /// Variance of a pixel's rate under several exposures, those in which it saturates left out; (electrons per second)^2.
    fn pixel_variance(&self, rate_e_s: f64, exposures_s: &[f64]) -> f64 {
        let s = &self.sensor;
        let floor = s.dark_noise_e.powi(2) + 1.0 / (12.0 * s.gain_dn_per_e.powi(2));
        let range = (s.limit_dn - s.black_level_dn) / s.gain_dn_per_e;
        let usable = exposures_s.iter().filter(|&&t| rate_e_s * t < range);
        usable.map(|&t| t * t / (rate_e_s * t + floor)).sum::<f64>().recip()
    }
}
