//! Which family a measurement supports: prediction of what was held out, at a price for complexity.

use serde::{Deserialize, Serialize};

use super::likelihood::Likelihood;
use super::search::Minimum;
use super::{FitMethod, Observations};

/// A richer family must lower the predicted error by this share to be taken.
///
/// Set on measured materials: at a fifth, `auto` kept single lobes that were twice as far off outside of the zone.
pub const PRICE: f64 = 0.05;

/// A family that was considered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// The family.
    pub model: FitMethod,
    /// RMS error of predicted coefficients that the fit had not seen, over RMS z_00.
    pub predicted_error: f64,
    /// The same for coefficients it had seen.
    pub fitted_error: f64,
    /// Whether the fit ended well.
    pub successful: bool,
}

/// Why a family was chosen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Selection {
    /// From simple to rich.
    pub candidates: Vec<Candidate>,
    /// Standard error of the data, RMS, over RMS z_00: no family predicts better.
    pub noise: f64,
    /// In words.
    pub reason: String,
}

/// Data held out together: every fourth exitant ring, and every fourth lobe, other ones at other rings, each in turn.
///
/// No lobe is held out everywhere: a rig that shows order L measures all of them, and what no direction has seen of the
/// constant lobe nobody can predict.
fn folds(observations: &Observations) -> Vec<Vec<bool>> {
    const PARTS: usize = 4;
    let marked = |out: &dyn Fn(usize, usize) -> bool| -> Vec<bool> {
        let stations = observations.stations.iter();
        stations.flat_map(|s| (0..observations.terms.len()).map(move |t| (s.ring, t))).map(|(r, t)| out(r, t)).collect()
    };
    let rings = (0..PARTS).map(|part| marked(&|ring, _| ring % PARTS == part));
    let lobes = (0..PARTS).map(|part| marked(&|ring, term| (ring / 2 + term) % PARTS == part));
    rings.chain(lobes).filter(|f| f.contains(&true) && f.contains(&false)).collect()
}

/// RMS over held-out data of the prediction's error, over `dc`; `refit` fits what is seen.
pub(super) fn predicted_error(
    likelihood: &Likelihood<'_>,
    observations: &Observations,
    refit: impl Fn(&Likelihood<'_>) -> Minimum,
) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for out in folds(observations) {
        let minimum = refit(&likelihood.without(&out));
        for c in 0..3 {
            let prediction = likelihood.predict(&minimum.columns, &minimum.solution.x, c);
            for i in (0..out.len()).filter(|&i| out[i]) {
                sum += (prediction[i] - likelihood.z[c][i]).powi(2);
                count += 1;
            }
        }
    }
    (sum / count.max(1) as f64).sqrt() / observations.dc()
}

/// The index of the candidate to take: up the ladder, each step for that share less error. Fits that failed are passed over.
pub(super) fn choose(candidates: &[Candidate]) -> usize {
    let mut chosen = 0;
    for (i, candidate) in candidates.iter().enumerate().skip(1) {
        if candidate.successful && candidate.predicted_error < (1.0 - PRICE) * candidates[chosen].predicted_error {
            chosen = i;
        }
    }
    chosen
}

/// The choice in words.
pub(super) fn reason(candidates: &[Candidate], chosen: usize, noise: f64) -> String {
    let percent = |e: f64| format!("{:.2}%", 100.0 * e);
    let winner = &candidates[chosen];
    let best = candidates.iter().min_by(|a, b| a.predicted_error.total_cmp(&b.predicted_error)).expect("candidates");
    let mut text = format!(
        "{} predicts held-out coefficients to {} of z_00 (noise {})",
        winner.model,
        percent(winner.predicted_error),
        percent(noise)
    );
    if let Some(simpler) = chosen.checked_sub(1).map(|i| &candidates[i]) {
        text += &format!("; {} to {}", simpler.model, percent(simpler.predicted_error));
    }
    if best.model != winner.model {
        text += &format!(
            "; {} is best with {}, less than {:.0}% better",
            best.model,
            percent(best.predicted_error),
            100.0 * PRICE
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ladder(errors: &[f64]) -> Vec<Candidate> {
        let models = [FitMethod::Lambert, FitMethod::Ggx, FitMethod::Ggx2, FitMethod::Mixture];
        let candidate = |(&model, &predicted_error): (&FitMethod, &f64)| Candidate {
            model,
            predicted_error,
            fitted_error: predicted_error,
            successful: true,
        };
        models.iter().zip(errors).map(candidate).collect()
    }

    #[test]
    fn richer_models_pay() {
        assert_eq!(choose(&ladder(&[0.01, 0.0099, 0.0098, 0.0097])), 0);
        assert_eq!(choose(&ladder(&[0.3, 0.01, 0.0099, 0.0097])), 1);
        assert_eq!(choose(&ladder(&[0.3, 0.1, 0.05, 0.01])), 3);
        // A step that does not pay does not bar a later one that does.
        assert_eq!(choose(&ladder(&[0.3, 0.1, 0.099, 0.05])), 3);
        let mut failed = ladder(&[0.3, 0.01, 0.05, 0.05]);
        failed[1].successful = false;
        assert_eq!(choose(&failed), 2);
        assert!(reason(&ladder(&[0.01, 0.0099]), 0, 0.001).contains("less than 5% better"));
    }
}
