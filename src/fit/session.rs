//! One set of observations, fitted by any of the methods.

use std::sync::OnceLock;

use super::baselines::{ggx_to_reconstruction, thesis};
use super::dictionary::{DbrdfFamily, Dictionary};
use super::family::{AbcFamily, Family, GgxFamily, LambertFamily};
use super::forward::fineness_of;
use super::likelihood::Likelihood;
use super::search::{Linearised, Minimum, Termination, polish, search, search_from};
use super::select::{Candidate, Selection, choose, predicted_error, reason};
use super::uncertainty::lambert_column;
use super::{FitError, FitMethod, Fitted, Forward, Observations};
use crate::basis::OrderError;
use crate::reflectance::Model;

/// All families of the ladder, fitted.
pub(super) struct Ladder {
    /// The one to take.
    pub chosen: Fitted,
    /// All others, from simple to rich.
    pub others: Vec<Fitted>,
    /// Why.
    pub selection: Selection,
}

/// What all methods share: the rule for the integrals and the columns of many widths.
pub(super) struct Session<'a> {
    pub observations: &'a Observations,
    pub forward: Forward,
    lambert: Vec<f64>,
    dictionary: OnceLock<Dictionary>,
}

impl<'a> Session<'a> {
    pub fn new(observations: &'a Observations) -> Result<Self, OrderError> {
        let forward = Forward::new(observations, fineness_of(observations))?;
        let lambert = lambert_column(&forward);
        Ok(Self { observations, forward, lambert, dictionary: OnceLock::new() })
    }

    pub fn likelihood(&self) -> Likelihood<'_> {
        Likelihood::new(self.observations, &self.forward, &self.lambert)
    }

    fn dictionary(&self) -> &Dictionary {
        self.dictionary.get_or_init(|| Dictionary::new(&self.forward, !self.observations.folded))
    }

    /// Fits one method other than `auto`.
    pub fn fit_one(
        &self,
        likelihood: &Likelihood<'_>,
        method: FitMethod,
        start: Option<&[f64]>,
    ) -> Result<Fitted, FitError> {
        let anisotropic = !self.observations.folded;
        let searched = |family: Box<dyn Family>| -> Result<(Box<dyn Family>, Minimum), FitError> {
            let minimum = match start {
                Some(start) if start.len() == family.shape().len() => search_from(family.as_ref(), likelihood, start),
                Some(start) => {
                    return Err(FitError::Start { model: method, expected: family.shape().len(), got: start.len() });
                }
                None => search(family.as_ref(), likelihood),
            };
            Ok((family, minimum))
        };
        let (family, minimum): (Box<dyn Family>, Minimum) = match method {
            FitMethod::Lambert => searched(Box::new(LambertFamily))?,
            FitMethod::Ggx => searched(Box::new(GgxFamily { lobes: 1, anisotropic }))?,
            FitMethod::Ggx2 => searched(Box::new(GgxFamily { lobes: 2, anisotropic }))?,
            FitMethod::Abc => searched(Box::new(AbcFamily))?,
            FitMethod::Dbrdf => {
                let (family, minimum) = self.dictionary().dbrdf(likelihood);
                (Box::new(family), minimum)
            }
            FitMethod::Mixture => {
                let (family, minimum) = self.dictionary().mixture(likelihood);
                (Box::new(family), minimum)
            }
            FitMethod::GgxToReconstruction => {
                let (family, minimum) = ggx_to_reconstruction(likelihood);
                (Box::new(family), minimum)
            }
            FitMethod::Thesis => {
                let model = thesis(self.observations)?;
                let family = DbrdfFamily { p: model.p };
                let columns = family.columns(&self.forward, &[model.r0]);
                let x = vec![model.kd, model.c];
                let chi2 = likelihood.residuals(&columns, &x).norm_squared();
                let solution = super::likelihood::Solution { x, chi2 };
                let termination = Termination::Direct;
                (Box::new(family), Minimum { theta: vec![model.r0], columns, solution, evaluations: 1, termination })
            }
            FitMethod::Auto => unreachable!("auto is no family"),
        };
        let model = family.model(&minimum.theta, &minimum.solution.x);
        Ok(Fitted { method, family, minimum, model })
    }

    /// Climbs the ladder of families: see [`choose`].
    pub fn auto(&self, likelihood: &Likelihood<'_>) -> Result<Ladder, FitError> {
        const ISOTROPIC: [FitMethod; 6] =
            [FitMethod::Lambert, FitMethod::Ggx, FitMethod::Abc, FitMethod::Ggx2, FitMethod::Dbrdf, FitMethod::Mixture];
        const ANISOTROPIC: [FitMethod; 4] = [FitMethod::Lambert, FitMethod::Ggx, FitMethod::Ggx2, FitMethod::Dbrdf];
        let ladder: &[FitMethod] = if self.observations.folded { &ISOTROPIC } else { &ANISOTROPIC };
        let mut fits = Vec::new();
        let mut candidates = Vec::new();
        for &model in ladder {
            let fitted = self.fit_one(likelihood, model, None)?;
            candidates.push(Candidate {
                model,
                predicted_error: self.predicted_error(&fitted, likelihood),
                fitted_error: self.observations.misfit(
                    &[0, 1, 2].map(|c| likelihood.predict(&fitted.minimum.columns, &fitted.minimum.solution.x, c)),
                ),
                successful: fitted.minimum.termination.was_successful(),
            });
            fits.push(fitted);
        }
        let chosen = choose(&candidates);
        let noise = self.observations.noise_rel();
        let selection = Selection { reason: reason(&candidates, chosen, noise), candidates, noise };
        let fitted = fits.remove(chosen);
        Ok(Ladder { chosen: fitted, others: fits, selection })
    }

    fn predicted_error(&self, fitted: &Fitted, likelihood: &Likelihood<'_>) -> f64 {
        let near = Linearised::new(fitted.family.as_ref(), likelihood.forward, &fitted.minimum);
        predicted_error(likelihood, self.observations, |seen| self.refit(fitted, &near, seen).0)
    }

    /// The family of `fitted` fitted anew to other data, from its own minimum, and the model that this makes.
    fn refit(&self, fitted: &Fitted, near: &Linearised<'_>, seen: &Likelihood<'_>) -> (Minimum, Model) {
        let made = |family: &dyn Family, minimum: Minimum| {
            let model = family.model(&minimum.theta, &minimum.solution.x);
            (minimum, model)
        };
        // Which lobes of a dictionary are taken depends on the data.
        match fitted.method {
            FitMethod::Dbrdf => {
                let (family, minimum) = self.dictionary().dbrdf(seen);
                made(&family, minimum)
            }
            FitMethod::Mixture => {
                let (family, minimum) = self.dictionary().mixture(seen);
                made(&family, minimum)
            }
            _ => made(fitted.family.as_ref(), polish(near, seen, &fitted.minimum.theta)),
        }
    }

    /// Models of the same family from what is left when every `parts`-th ring is taken away, each in turn.
    pub fn without_rings(&self, fitted: &Fitted, likelihood: &Likelihood<'_>, parts: usize) -> Vec<Model> {
        let near = Linearised::new(fitted.family.as_ref(), likelihood.forward, &fitted.minimum);
        let terms = self.observations.terms.len();
        let without = |part: usize| {
            let rings = self.observations.stations.iter().flat_map(|s| std::iter::repeat_n(s.ring, terms));
            let out: Vec<bool> = rings.map(|ring| ring % parts == part).collect();
            self.refit(fitted, &near, &likelihood.without(&out)).1
        };
        (0..parts).map(without).collect()
    }
}
