//! The acquisition plan: frozen, versioned data that iterates into events.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::scheme::growing_steps;
use super::{HIGHEST_MIXED, Lobe, Scheme, SchemeError, Step};
use crate::geometry::Zone;
use crate::optics::Rig;
use crate::radiometry::ColourSpace;

/// Version of the plan file this program writes and the newest it reads.
pub const FORMAT: u32 = 1;

/// Largest order of an acquisition: 882 patterns.
pub const MAX_PLAN_ORDER: usize = 20;

/// Why a plan cannot be run.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PlanError {
    /// The text is not a plan.
    #[error("not an acquisition plan, correct the marked line: {0}")]
    Toml(String),
    /// Written by a newer program.
    #[error("plan format {found} is newer than {FORMAT}, the newest this version reads: update zonal")]
    Format {
        /// The version found.
        found: u32,
    },
    /// No exposures, or two ways to choose them.
    #[error("the plan has {found} of the sections [exposure] and [automatic]: keep one")]
    Exposures {
        /// `none` or `both`.
        found: &'static str,
    },
    /// A noise target outside its range.
    #[error("automatic.noise_rel = {value} is out of range: choose 1e-5..=1, the RMS standard error over RMS z_00")]
    Noise {
        /// The value found.
        value: f64,
    },
    /// The scheme does not know the order.
    #[error(transparent)]
    Scheme(#[from] SchemeError),
    /// An adaptive plan says what it leaves to be found out.
    #[error("an adaptive plan chooses its own {key}: leave it out")]
    Adaptive {
        /// What it has.
        key: &'static str,
    },
    /// A target outside its range.
    #[error(
        "adaptive.gain_rel = {value} is out of range: choose 0.001..=0.5, the share of the error a further step must save"
    )]
    Gain {
        /// The value found.
        value: f64,
    },
    /// A limit of time outside its range.
    #[error("adaptive.limit_s = {value} is out of range: choose 0.5..=3600 seconds")]
    Limit {
        /// The value found.
        value: f64,
    },
    /// A number outside its range.
    #[error("{key} = {value} is out of range: choose {expected}")]
    Range {
        /// The key, with its section.
        key: &'static str,
        /// The value found.
        value: u64,
        /// What it should be.
        expected: &'static str,
    },
}

/// An acquisition: every function of the zonal basis up to an order, by a scheme, in a bracket of exposures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// File format version.
    pub format: u32,
    /// Name of the plan.
    pub name: String,
    /// Zonal order L: (L+1)^2 functions; the highest there may be where the plan is adaptive.
    pub order: usize,
    /// In which combinations functions are shown.
    #[serde(default, skip_serializing_if = "is_pairs")]
    pub scheme: Scheme,
    /// How often the whole sequence is taken.
    pub repeats: usize,
    /// Exposures of every lobe, the same for all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<ExposureBracket>,
    /// What exposures of each pair of lobes are to reach, chosen while it is measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub automatic: Option<AutomaticBracket>,
    /// Takes what each sample needs, and no more; without it everything is taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub adaptive: Option<Adaptive>,
    /// Grid of exitant directions the coefficients are reported on.
    pub exitant: Exitant,
    /// Colours the coefficients are reported in; the camera's if it is not there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub colour: Option<Colour>,
}

fn is_pairs(scheme: &Scheme) -> bool {
    *scheme == Scheme::Pairs
}

/// When an adaptive acquisition stops.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Adaptive {
    /// Share of its error that a further step must be expected to save.
    pub gain_rel: f64,
    /// Seconds on the rig that are not to be exceeded, those in which it waits for decisions among them; the first step is taken in
    /// any case.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit_s: Option<f64>,
}

impl Default for Adaptive {
    /// A twentieth: half of what an observer of two renderings could tell.
    fn default() -> Self {
        Self { gain_rel: 0.05, limit_s: None }
    }
}

/// Steps of a plan that are taken together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stage {
    /// Which of [`Plan::steps`].
    pub steps: Range<usize>,
    /// The highest degree known after it.
    pub order: usize,
    /// Whether it takes the sample to be isotropic.
    pub isotropic: bool,
}

/// Colours of a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Colour {
    /// `camera` or `projector`; the latter needs `zonal calibrate colour`.
    pub space: ColourSpace,
}

/// A geometric series of exposures in whole refresh periods of the projector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExposureBracket {
    /// Number of exposures.
    pub count: u32,
    /// The shortest, in refresh periods of the projector (1/60 s each at 60 Hz).
    pub shortest_refreshes: u32,
    /// Ratio between neighbours.
    pub spacing: u32,
}

/// As few exposures for each pair of lobes as a noise target needs: one of the shortest kind, and what its frames ask for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AutomaticBracket {
    /// Wanted RMS standard error of a function's coefficients over RMS z_00.
    pub noise_rel: f64,
    /// The shortest, in refresh periods of the projector: nothing may saturate in it.
    pub shortest_refreshes: u32,
    /// The longest, in refresh periods.
    pub longest_refreshes: u32,
}

/// Size of the exitant grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exitant {
    /// Rings in theta.
    pub rings: usize,
    /// Sectors in phi.
    pub sectors: usize,
}

/// What the clock of the rig allows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Refresh period of the projector, s.
    pub refresh_s: f64,
    /// Shortest time from one frame to the next, s.
    pub min_frame_s: f64,
    /// Time from the end of an exposure to the earliest start of the next, s.
    pub readout_s: f64,
}

impl Timing {
    /// The timing of a rig's devices.
    pub fn of(rig: &Rig) -> Self {
        Self {
            refresh_s: 1.0 / rig.projector.refresh_hz,
            min_frame_s: 1.0 / rig.camera.max_frame_rate_hz,
            readout_s: rig.camera.readout_s,
        }
    }
}

/// Predicted wall time on the physical rig, seconds, and what it is spent on.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct RigTime {
    /// Shutter open.
    pub exposure_s: f64,
    /// Waiting for the camera's fastest frame time after short exposures.
    pub readout_wait_s: f64,
    /// Pattern changes that such waiting does not hide.
    pub pattern_change_s: f64,
    /// Deciding what to take next, while the rig waits.
    #[serde(default)]
    pub decision_s: f64,
}

impl RigTime {
    /// All together, s.
    pub fn total_s(&self) -> f64 {
        self.exposure_s + self.readout_wait_s + self.pattern_change_s + self.decision_s
    }

    /// One pattern under these exposures, s.
    pub fn of_pattern(exposures_s: &[f64], timing: &Timing) -> Self {
        let open: f64 = exposures_s.iter().sum();
        let frame = |e: f64| (e + timing.readout_s).max(timing.min_frame_s);
        let frames: f64 = exposures_s.iter().map(|&e| frame(e)).sum();
        let idle = exposures_s.last().map_or(0.0, |&e| frame(e) - e);
        Self {
            exposure_s: open,
            readout_wait_s: frames - open,
            pattern_change_s: (timing.refresh_s - idle).max(0.0),
            decision_s: 0.0,
        }
    }

    /// The same `n` times.
    pub fn times(self, n: usize) -> Self {
        let n = n as f64;
        Self {
            exposure_s: n * self.exposure_s,
            readout_wait_s: n * self.readout_wait_s,
            pattern_change_s: n * self.pattern_change_s,
            decision_s: n * self.decision_s,
        }
    }

    /// One after the other.
    pub fn and(self, other: Self) -> Self {
        Self {
            exposure_s: self.exposure_s + other.exposure_s,
            readout_wait_s: self.readout_wait_s + other.readout_wait_s,
            pattern_change_s: self.pattern_change_s + other.pattern_change_s,
            decision_s: self.decision_s + other.decision_s,
        }
    }
}

/// Noise that adaptive plans aim at unless they say otherwise, of z_00: averaged over a ring it is an eighth of this, below what
/// models of real materials miss.
const ADAPTIVE_NOISE: f64 = 0.02;
/// Highest order up to which an adaptive plan follows an anisotropic sample: 49 pairs of lobes.
const ADAPTIVE_PAIRS: usize = 6;

impl Plan {
    /// The built-in plan of an order: three exposures of 1, 4 and 16 refresh periods.
    pub fn of_order(order: usize) -> Self {
        Self {
            format: FORMAT,
            name: format!("order-{order}"),
            order,
            scheme: Scheme::Pairs,
            repeats: 1,
            exposure: Some(ExposureBracket { count: 3, shortest_refreshes: 1, spacing: 4 }),
            automatic: None,
            adaptive: None,
            exitant: Exitant { rings: 32, sectors: 64 },
            colour: None,
        }
    }

    /// The same plan by another scheme.
    pub fn by(self, scheme: Scheme) -> Self {
        let name = format!("{}-{scheme}", self.name);
        Self { scheme, name, ..self }
    }

    /// The same plan taking no more than a sample needs, exposures included.
    pub fn adapted(self, adaptive: Adaptive) -> Self {
        let automatic = self.automatic.unwrap_or(AutomaticBracket {
            noise_rel: ADAPTIVE_NOISE,
            shortest_refreshes: 1,
            longest_refreshes: 16,
        });
        let name = format!("{}-adaptive", self.name);
        Self {
            name,
            adaptive: Some(adaptive),
            scheme: Scheme::Pairs,
            repeats: 1,
            exposure: None,
            automatic: Some(automatic),
            ..self
        }
    }

    /// Reads and checks a plan file's text.
    ///
    /// # Errors
    /// [`PlanError`], naming key and remedy.
    pub fn from_toml(text: &str) -> Result<Self, PlanError> {
        let plan: Self = toml::from_str(text).map_err(|e| PlanError::Toml(e.to_string()))?;
        plan.check()?;
        Ok(plan)
    }

    /// The plan as TOML.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).expect("plain numbers and strings")
    }

    /// Colours the coefficients are reported in.
    pub fn colour_space(&self) -> ColourSpace {
        self.colour.map_or_else(ColourSpace::default, |c| c.space)
    }

    /// The same plan reported in other colours.
    pub fn in_colours(self, space: ColourSpace) -> Self {
        Self { colour: Some(Colour { space }), ..self }
    }

    /// What is shown, a pair of frames each; for an adaptive plan all that it may come to.
    pub fn steps(&self, zone: Zone) -> Vec<Step> {
        if self.adaptive.is_none() {
            return self.scheme.steps(zone, self.order).expect("checked");
        }
        let growing = growing_steps(zone, self.order.min(HIGHEST_MIXED)).into_iter().flat_map(|(_, steps)| steps);
        growing.chain(Scheme::Pairs.steps(zone, self.order.min(ADAPTIVE_PAIRS)).expect("any order")).collect()
    }

    /// Which steps are taken together: all, or what an adaptive plan decides between.
    pub fn stages(&self, zone: Zone) -> Vec<Stage> {
        if self.adaptive.is_none() {
            let isotropic = self.scheme.is_isotropic();
            return vec![Stage { steps: 0..self.step_count(), order: self.order, isotropic }];
        }
        let mut stages = Vec::new();
        let mut next = 0;
        let mut stage = |order: usize, count: usize, isotropic: bool| {
            stages.push(Stage { steps: next..next + count, order, isotropic });
            next += count;
        };
        for (order, steps) in growing_steps(zone, self.order.min(HIGHEST_MIXED)) {
            stage(order, steps.len(), true);
        }
        stage(2, 9, false);
        for order in 3..=self.order.min(ADAPTIVE_PAIRS) {
            stage(order, 2 * order + 1, false);
        }
        stages
    }

    /// Number of steps; those that an adaptive plan takes of any sample.
    pub fn step_count(&self) -> usize {
        match self.adaptive {
            Some(_) => Scheme::Isotropic.step_count(2),
            None => self.scheme.step_count(self.order),
        }
        .expect("checked")
    }

    /// Number of patterns: two for every step.
    pub fn images(&self) -> usize {
        2 * self.step_count()
    }

    /// Whether steps are no functions.
    pub fn is_mixed(&self) -> bool {
        self.scheme != Scheme::Pairs || self.adaptive.is_some()
    }

    /// Number of camera frames; for automatic exposures those of two for each lobe.
    pub fn frames(&self) -> usize {
        self.images() * self.refreshes().len() * self.repeats
    }

    /// Exposure times in s, longest first: the wait after the shortest hides the change of pattern. For automatic
    /// exposures, the longest and the shortest.
    pub fn exposures_s(&self, timing: &Timing) -> Vec<f64> {
        self.refreshes().into_iter().map(|n| f64::from(n) * timing.refresh_s).collect()
    }

    fn refreshes(&self) -> Vec<u32> {
        match (self.exposure, self.automatic) {
            (Some(e), _) => (0..e.count).rev().map(|i| e.shortest_refreshes * e.spacing.pow(i)).collect(),
            (None, Some(a)) => vec![a.longest_refreshes, a.shortest_refreshes],
            (None, None) => Vec::new(),
        }
    }

    /// The frames of these steps, in the order they are shown.
    pub fn lobes(&self, steps: impl IntoIterator<Item = usize>) -> impl Iterator<Item = Lobe> {
        let mixed = self.is_mixed();
        steps.into_iter().flat_map(move |k| Lobe::both(k, mixed))
    }

    /// Wall time on the physical rig, in closed form.
    pub fn rig_time(&self, timing: &Timing) -> RigTime {
        RigTime::of_pattern(&self.exposures_s(timing), timing).times(self.images() * self.repeats)
    }

    /// Whether it can be run.
    ///
    /// # Errors
    /// [`PlanError`], naming key and remedy.
    pub fn check(&self) -> Result<(), PlanError> {
        if self.format > FORMAT {
            return Err(PlanError::Format { found: self.format });
        }
        match (&self.exposure, &self.automatic) {
            (None, None) => return Err(PlanError::Exposures { found: "none" }),
            (Some(_), Some(_)) => return Err(PlanError::Exposures { found: "both" }),
            _ => {}
        }
        let within = |key, value: u64, lo: u64, hi: u64, expected| {
            if (lo..=hi).contains(&value) { Ok(()) } else { Err(PlanError::Range { key, value, expected }) }
        };
        within("order", self.order as u64, 0, MAX_PLAN_ORDER as u64, "0..=20")?;
        within("repeats", self.repeats as u64, 1, 1000, "1..=1000")?;
        match self.adaptive {
            Some(_) if !is_pairs(&self.scheme) => return Err(PlanError::Adaptive { key: "scheme" }),
            Some(_) if self.repeats != 1 => return Err(PlanError::Adaptive { key: "repeats" }),
            Some(a) if !(1e-3..=0.5).contains(&a.gain_rel) => return Err(PlanError::Gain { value: a.gain_rel }),
            Some(Adaptive { limit_s: Some(value), .. }) if !(0.5..=3600.0).contains(&value) => {
                return Err(PlanError::Limit { value });
            }
            Some(_) => within("order", self.order as u64, 2, MAX_PLAN_ORDER as u64, "2..=20")?,
            None => drop(self.scheme.step_count(self.order)?),
        }
        if let Some(e) = &self.exposure {
            within("exposure.count", e.count.into(), 1, 8, "1..=8")?;
            within("exposure.shortest_refreshes", e.shortest_refreshes.into(), 1, 600, "1..=600")?;
            within("exposure.spacing", e.spacing.into(), 2, 16, "2..=16")?;
            let longest = u64::from(e.shortest_refreshes) * u64::from(e.spacing).pow(e.count - 1);
            within("exposure (longest, in refreshes)", longest, 1, 6000, "fewer exposures or a smaller spacing")?;
        }
        if let Some(a) = &self.automatic {
            let shortest = u64::from(a.shortest_refreshes);
            within("automatic.shortest_refreshes", shortest, 1, 600, "1..=600")?;
            within("automatic.longest_refreshes", a.longest_refreshes.into(), shortest, 6000, "shortest..=6000")?;
            if !(1e-5..=1.0).contains(&a.noise_rel) {
                return Err(PlanError::Noise { value: a.noise_rel });
            }
        }
        within("exitant.rings", self.exitant.rings as u64, 3, 512, "3..=512")?;
        within("exitant.sectors", self.exitant.sectors as u64, 4, 1024, "4..=1024")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const THESIS_RIG: Timing = Timing { refresh_s: 1.0 / 60.0, min_frame_s: 1.0 / 15.0, readout_s: 0.0 };

    #[test]
    fn order_4_is_150_frames_in_20_seconds() {
        let plan = Plan::from_toml(include_str!("../../patterns/order-4.toml")).unwrap();
        assert_eq!(plan, Plan::of_order(4));
        assert_eq!((plan.images(), plan.frames()), (50, 150));
        let time = plan.rig_time(&THESIS_RIG);
        assert!((time.total_s() - 20.0).abs() < 1e-9, "{time:?}");
        assert!((time.exposure_s - 17.5).abs() < 1e-9 && time.pattern_change_s == 0.0);
    }

    #[test]
    fn plans_of_isotropic_samples_are_a_fraction_and_adaptive_ones_come_in_stages() {
        let isotropic = Plan::from_toml(include_str!("../../patterns/order-10-isotropic.toml")).unwrap();
        assert_eq!(isotropic, Plan::of_order(10).by(Scheme::Isotropic));
        assert_eq!((isotropic.images(), isotropic.frames()), (22, 66));
        assert!((isotropic.rig_time(&THESIS_RIG).total_s() - 8.8).abs() < 1e-9);
        let adaptive = Plan::from_toml(include_str!("../../patterns/order-10-adaptive.toml")).unwrap();
        assert_eq!(adaptive.name, Plan::of_order(10).adapted(Adaptive::default()).name);
        assert_eq!(Plan::from_toml(&adaptive.to_toml()).unwrap(), adaptive);
        let zone = Zone::from_degrees(9.0, 57.0).unwrap();
        let stages = adaptive.stages(zone);
        let isotropic: Vec<usize> = stages.iter().filter(|s| s.isotropic).map(|s| s.order).collect();
        let any: Vec<usize> = stages.iter().filter(|s| !s.isotropic).map(|s| s.order).collect();
        assert_eq!((isotropic, any), (vec![2, 4, 6, 8, 10], vec![2, 3, 4, 5, 6]));
        assert!(stages.windows(2).all(|w| w[0].steps.end == w[1].steps.start));
        assert_eq!(stages.last().unwrap().steps.end, adaptive.steps(zone).len());
    }

    #[test]
    fn plans_survive_a_round_trip_and_bad_ones_are_named() {
        let plan = Plan::of_order(6);
        assert_eq!(Plan::from_toml(&plan.to_toml()).unwrap(), plan);
        let error = |from: &str, to: &str| Plan::from_toml(&plan.to_toml().replacen(from, to, 1)).unwrap_err();
        assert!(error("order = 6", "order = 200").to_string().contains("order = 200"));
        assert!(error("spacing", "spaceing").to_string().contains("spaceing"));
        assert_eq!(error("format = 1", "format = 2"), PlanError::Format { found: 2 });
        assert!(matches!(error("count = 3", "count = 8"), PlanError::Range { .. }));
        let automatic = "[automatic]\nnoise_rel = 0.01\nshortest_refreshes = 1\nlongest_refreshes = 64\n\n[exitant]";
        assert_eq!(error("[exitant]", automatic), PlanError::Exposures { found: "both" });
        let alone = Plan { exposure: None, ..plan.clone() }.to_toml().replacen("[exitant]", automatic, 1);
        assert_eq!(Plan::from_toml(&alone).unwrap().frames(), 2 * plan.images());
        let silent = alone.replacen("0.01", "0.0", 1);
        assert_eq!(Plan::from_toml(&silent).unwrap_err(), PlanError::Noise { value: 0.0 });
    }
}
