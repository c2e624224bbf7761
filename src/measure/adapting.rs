//! Taking no more than a sample needs: between stages somebody looks at what is known and says what comes next.

use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use crate::capture::{Director, Spent};
use crate::patterns::{Adaptive, Stage};
use crate::reduce::{Coefficients, Reduced, Reducer};

/// What is known of a sample between two stages.
pub struct SoFar<'a> {
    /// Coefficients, as the last stage gives them.
    pub coefficients: &'a Coefficients,
    /// See [`Reduced::anisotropy`].
    pub anisotropy: f64,
    /// Whether the sample is still taken to be isotropic.
    pub isotropic: bool,
    /// The highest degree that could come next, if any.
    pub next_order: Option<usize>,
    /// When to stop.
    pub target: Adaptive,
}

/// What to do next.
#[derive(Debug, Clone, PartialEq)]
pub enum Advice {
    /// Nothing: what is known will do.
    Stop,
    /// The next stage, all of it.
    Further,
    /// Of the next stage these functions only.
    Functions(Vec<usize>),
    /// To begin anew without assuming isotropy.
    AnySample,
}

/// What was decided, with the figures it was decided by.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Decision {
    /// The highest degree known.
    pub order: usize,
    /// Patterns shown so far.
    pub images: usize,
    /// Error that a fit of what is known is expected to have: [`crate::reflectance::ChannelErrors::overall`].
    pub error: f64,
    /// Share of it that the next stage is expected to save; none where there is no next one.
    pub saving: Option<f64>,
    /// RMS deviation from isotropy beyond noise, over RMS z_00.
    pub anisotropy: f64,
    /// In words.
    pub reason: String,
}

/// Somebody who knows what further coefficients are worth.
pub trait Adviser: Sync {
    /// What to do next, and why. The same for the same coefficients, so that a resumed run decides alike.
    fn advise(&self, so_far: &SoFar<'_>) -> (Advice, Decision);
}

/// A run's stages under an adviser.
pub(super) struct Adapting<'a> {
    stages: &'a [Stage],
    reducer: &'a Mutex<Reducer>,
    adviser: &'a dyn Adviser,
    target: Adaptive,
    /// Stage that is under way.
    stage: Option<usize>,
    /// Steps that the coefficients are made from.
    pub steps: Vec<usize>,
    images: usize,
    /// Time that frames took before the stage under way, s.
    frames_s: f64,
    /// Steps of the stage under way.
    under_way: usize,
    pub decisions: Vec<Decision>,
    /// Why the responses so far say nothing, if they do not.
    pub failure: Option<crate::reduce::ReduceError>,
}

impl<'a> Adapting<'a> {
    pub fn new(stages: &'a [Stage], reducer: &'a Mutex<Reducer>, adviser: &'a dyn Adviser, target: Adaptive) -> Self {
        let decisions = Vec::new();
        Self {
            stages,
            reducer,
            adviser,
            target,
            stage: None,
            steps: Vec::new(),
            images: 0,
            frames_s: 0.0,
            under_way: 0,
            decisions,
            failure: None,
        }
    }

    /// Whether the coefficients rest on isotropy.
    pub fn isotropic(&self) -> bool {
        self.stage.is_some_and(|s| self.stages[s].isotropic)
    }

    fn enter(&mut self, stage: usize, steps: Vec<usize>) -> Vec<usize> {
        self.stage = Some(stage);
        self.images += 2 * steps.len();
        self.under_way = steps.len();
        self.steps.extend(&steps);
        steps
    }

    fn reduced(&self) -> Result<Reduced, crate::reduce::ReduceError> {
        let reducer = self.reducer.lock().unwrap_or_else(PoisonError::into_inner);
        reducer.finish(&self.steps, self.isotropic())
    }
}

impl Director for Adapting<'_> {
    fn next(&mut self, spent: &Spent) -> Vec<usize> {
        let Some(stage) = self.stage else { return self.enter(0, self.stages[0].steps.clone().collect()) };
        let reduced = match self.reduced() {
            Ok(reduced) => reduced,
            Err(error) => {
                self.failure = Some(error);
                return Vec::new();
            }
        };
        let isotropic = self.isotropic();
        let next = stage + 1;
        let following = self.stages.get(next).filter(|s| s.isotropic == isotropic);
        let so_far = SoFar {
            coefficients: &reduced.coefficients,
            anisotropy: reduced.anisotropy,
            isotropic,
            next_order: following.map(|s| s.order),
            target: self.target,
        };
        let (advice, mut decision) = self.adviser.advise(&so_far);
        let wanted = match (advice, following) {
            (Advice::Further, Some(following)) => Some((next, following.steps.clone().collect())),
            (Advice::Functions(wanted), Some(following)) => {
                // Steps of a stage of pairs are its functions, in order.
                let first = following.order * following.order;
                let steps = following.steps.clone().filter(|s| wanted.contains(&(first + s - following.steps.start)));
                Some((next, steps.collect::<Vec<usize>>()))
            }
            (Advice::AnySample, _) => {
                let first = self.stages.iter().position(|s| !s.isotropic);
                first.map(|first| (first, self.stages[first].steps.clone().collect()))
            }
            _ => None,
        };
        let affordable = wanted.filter(|(_, steps)| {
            // Another step costs what the last ones did.
            let step_s = (spent.frames_s - self.frames_s) / self.under_way as f64;
            let ends_s = spent.total_s() + step_s * steps.len() as f64;
            let room = self.target.limit_s.is_none_or(|limit_s| ends_s <= limit_s);
            if !room {
                decision.reason += &format!("; it would end after {ends_s:.1} s, beyond the limit");
            }
            room
        });
        self.decisions.push(Decision { images: self.images, ..decision });
        let Some((stage, steps)) = affordable else { return Vec::new() };
        self.frames_s = spent.frames_s;
        if !self.stages[stage].isotropic && isotropic {
            self.steps.clear();
        }
        self.enter(stage, steps)
    }

    fn is_adaptive(&self) -> bool {
        true
    }

    fn expected(&self) -> usize {
        let under_way = self.stage.map_or(self.stages[0].steps.len(), |_| 0);
        self.images / 2 + under_way
    }
}
