//! What further coefficients are worth to the fit of a sample.

use std::sync::{Mutex, PoisonError};

use super::expected::Expected;
use crate::basis::{index, lm, size};
use crate::fit::{ANISOTROPIC, alternatives};
use crate::measure::{Advice, Adviser, Decision, SoFar};
use crate::reduce::Coefficients;
use crate::reflectance::{Metric, Model};

/// Share of the last step's change of the model, over the error expected, that the next step is taken to save. Chosen, not fitted:
/// over 54 materials outside of the families the mean saving is 0.01 to 0.06 of the change and hardly correlated with it (0 to
/// 0.2); with so little runs would stop at order 2, and the few that gain much would not be followed. With this the median
/// error is that of the best fixed order.
const SAVED: f64 = 0.2;
/// What no coefficient makes smaller: a gray card's albedo and a rig's edges are known to about a percent.
/// Of that the upper end: with .010 `yellow-matte-plastic`, satin-like, is followed to order 6 for a saving of 5.4%.
const CALIBRATED: f64 = 0.012;
/// A function is asked for if its amplitude, carried on from the degrees before, is above this many standard errors.
const SEEN: f64 = 1.0;

/// Advises by fits: how much the last step changed the model, against the error that is left.
///
/// Remembers the model of the stage before, so that one adviser serves one run at a time; the first stage begins anew.
#[derive(Debug, Default)]
pub struct FitAdviser(Mutex<Option<Model>>);

impl FitAdviser {
    fn judged(&self, so_far: &SoFar<'_>, decision: &mut Decision) -> Result<Advice, crate::fit::FitError> {
        let known = so_far.coefficients;
        let expected = Expected::of(known)?;
        decision.error = expected.error;
        let mut former = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let before = match former.take() {
            Some(model) if known.complete_order() > 2 => model,
            // Of the first stage, what its highest degree has changed.
            _ => alternatives(&known.truncated(known.complete_order().saturating_sub(1)), 0)?.model,
        };
        let metric = Metric::new(known.grid.zone());
        let change = metric.errors(&expected.model, &before).map_or(0.0, |e| e.mean.overall());
        *former = Some(expected.model);
        let Some(next) = so_far.next_order else {
            decision.reason = "the plan allows no higher order".into();
            return Ok(Advice::Stop);
        };
        let saving = SAVED * change / expected.error.hypot(CALIBRATED);
        decision.saving = Some(saving);
        let percent = |x: f64| format!("{:.1}%", 100.0 * x);
        if saving < so_far.target.gain_rel {
            decision.reason = format!(
                "the last step changed the model by {}, of {} error that is left order {next} would save {}: less than {}",
                percent(change),
                percent(expected.error),
                percent(saving),
                percent(so_far.target.gain_rel)
            );
            return Ok(Advice::Stop);
        }
        decision.reason =
            format!("the last step changed the model by {}: order {next} is worth taking", percent(change));
        if so_far.isotropic {
            return Ok(Advice::Further);
        }
        let wanted = carrying(known, next);
        if wanted.is_empty() {
            decision.reason = format!("no function of degree {next} is expected above the noise");
            return Ok(Advice::Stop);
        }
        if wanted.len() == 2 * next + 1 { Ok(Advice::Further) } else { Ok(Advice::Functions(wanted)) }
    }
}

impl Adviser for FitAdviser {
    fn advise(&self, so_far: &SoFar<'_>) -> (Advice, Decision) {
        let mut decision = Decision {
            order: so_far.coefficients.order,
            images: 0,
            error: f64::NAN,
            saving: None,
            anisotropy: so_far.anisotropy,
            reason: String::new(),
        };
        if so_far.isotropic && so_far.anisotropy > ANISOTROPIC {
            decision.error = 1.0;
            decision.reason = format!(
                "the sample departs from isotropy by {:.1}% of z_00: it is taken direction by direction",
                100.0 * so_far.anisotropy
            );
            return (Advice::AnySample, decision);
        }
        match self.judged(so_far, &mut decision) {
            Ok(advice) => (advice, decision),
            Err(error) => {
                // What cannot be fitted is not made better by more of the same.
                (decision.error, decision.reason) = (1.0, format!("no fit: {error}"));
                (Advice::Stop, decision)
            }
        }
    }
}

/// Functions of degree `l`, both of a pair, that are expected above their noise: the greater RMS of the same m in the two degrees
/// before.
fn carrying(known: &Coefficients, l: usize) -> Vec<usize> {
    let rms = |planes: &[f32], k: usize| {
        let n = 3 * known.grid.len();
        let finite = planes[k * n..][..n].iter().filter(|z| z.is_finite());
        let (sum, count) = finite.fold((0.0, 0), |(s, c), &z| (s + f64::from(z).powi(2), c + 1));
        if count > 0 { (sum / f64::from(count)).sqrt() } else { 0.0 }
    };
    let worth = |m: i32| {
        (l.saturating_sub(2)..l).filter(|&below| below >= m.unsigned_abs() as usize).any(|below| {
            [m, -m].into_iter().map(|m| index(below, m)).any(|k| {
                let (value, sigma) = (rms(&known.values, k), rms(&known.sigma, k));
                // The noise is part of the RMS.
                value * value - sigma * sigma > (SEEN * sigma).powi(2)
            })
        })
    };
    // |m| = l has no degree before it: it is carried on from |m| = l - 1.
    let m_of = |m: i32| if m.unsigned_abs() as usize == l { m - m.signum() } else { m };
    (size(l) - 2 * l - 1..size(l)).filter(|&k| worth(m_of(lm(k).1))).collect()
}
