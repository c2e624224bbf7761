//! Colours of the projector as the camera's channels see them.

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The colours that values of three channels stand for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ColourSpace {
    /// The camera's own channels under the projector's white light.
    #[default]
    Camera,
    /// Reflectance in the light of each of the projector's primaries.
    Projector,
}

impl ColourSpace {
    /// Its name in files.
    pub fn label(self) -> &'static str {
        match self {
            ColourSpace::Camera => "camera RGB, white-balanced on the gray card",
            ColourSpace::Projector => "projector primaries RGB",
        }
    }

    /// The space that a history names; the camera's where it names none.
    pub fn of_history(history: &str) -> Self {
        if history.contains(Self::Projector.label()) { Self::Projector } else { Self::Camera }
    }
}

/// Why light of three colours gives no matrix.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum ColourError {
    /// A channel sees nothing.
    #[error("channel {channel} (0 red, 1 green, 2 blue) sees no light: is the lamp on and the gray card in place?")]
    Dark {
        /// The channel.
        channel: usize,
    },
    /// The channels do not tell the primaries apart.
    #[error(
        "the camera's channels do not tell the projector's primaries apart (condition {condition:.0}, at most \
         {MAX_CONDITION}): keep the camera's colours"
    )]
    Alike {
        /// Condition of the matrix.
        condition: f64,
    },
}

/// Above this noise grows too much to be of use.
const MAX_CONDITION: f64 = 100.0;

/// What each camera channel gets from each primary of the projector, a share of what it gets from white.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColourMatrix {
    /// `[channel][primary]`; rows sum to 1, so that white light gives (1, 1, 1).
    pub matrix: [[f64; 3]; 3],
    /// Standard errors, indexed alike.
    pub sigma: [[f64; 3]; 3],
    /// Ratio of the largest singular value to the smallest.
    pub condition: f64,
}

impl ColourMatrix {
    /// The matrix from light above black and its variance, `[channel][primary]`, in any linear unit.
    ///
    /// # Errors
    /// [`ColourError`].
    pub fn of(light: [[f64; 3]; 3], variance: [[f64; 3]; 3]) -> Result<Self, ColourError> {
        let mut matrix = [[0.0; 3]; 3];
        let mut sigma = [[0.0; 3]; 3];
        for c in 0..3 {
            let white: f64 = light[c].iter().sum();
            // Written so that NaN fails.
            if !(white > 0.0 && white.is_finite()) {
                return Err(ColourError::Dark { channel: c });
            }
            for p in 0..3 {
                matrix[c][p] = light[c][p] / white;
                // m_p = l_p / (l_0 + l_1 + l_2)
                let slope = |q: usize| (f64::from(u8::from(p == q)) - matrix[c][p]) / white;
                sigma[c][p] = (0..3).map(|q| slope(q).powi(2) * variance[c][q]).sum::<f64>().sqrt();
            }
        }
        let singular = from_rows(&matrix).singular_values();
        let condition = singular.max() / singular.min();
        if condition.is_nan() || condition > MAX_CONDITION {
            return Err(ColourError::Alike { condition });
        }
        Ok(Self { matrix, sigma, condition })
    }

    /// Takes values of the camera's channels to the projector's primaries: `[primary][channel]`.
    ///
    /// # Errors
    /// [`ColourError::Alike`]; what [`ColourMatrix::of`] made is never that.
    pub fn inverse(&self) -> Result<[[f64; 3]; 3], ColourError> {
        let inverse = from_rows(&self.matrix).try_inverse().ok_or(ColourError::Alike { condition: self.condition })?;
        Ok([0, 1, 2].map(|p| [0, 1, 2].map(|c| inverse[(p, c)])))
    }
}

fn from_rows(rows: &[[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|c, p| rows[c][p])
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIGHT: [[f64; 3]; 3] = [[80.0, 16.0, 4.0], [20.0, 160.0, 20.0], [1.0, 9.0, 40.0]];

    #[test]
    fn white_stays_white_and_colours_come_back() {
        let colours = ColourMatrix::of(LIGHT, [[0.0; 3]; 3]).unwrap();
        let inverse = colours.inverse().unwrap();
        let seen = |albedo: [f64; 3]| colours.matrix.map(|row| (0..3).map(|p| row[p] * albedo[p]).sum::<f64>());
        for albedo in [[1.0; 3], [0.6, 0.05, 0.02]] {
            let seen = seen(albedo);
            for p in 0..3 {
                let back: f64 = (0..3).map(|c| inverse[p][c] * seen[c]).sum();
                assert!((back - albedo[p]).abs() < 1e-12, "{back} {albedo:?}");
            }
        }
        assert!(seen([1.0; 3]).iter().all(|w| (w - 1.0).abs() < 1e-12));
        assert!((1.0..3.0).contains(&colours.condition), "{}", colours.condition);
    }

    /// Of the standard error: a finite step instead of the slope.
    #[test]
    fn standard_errors_follow_the_slopes() {
        let variance = [[4.0, 1.0, 0.25], [0.0; 3], [0.0; 3]];
        let colours = ColourMatrix::of(LIGHT, variance).unwrap();
        let mut sum = 0.0;
        for q in 0..3 {
            let mut moved = LIGHT;
            moved[0][q] += 1e-3;
            let slope = (ColourMatrix::of(moved, variance).unwrap().matrix[0][1] - colours.matrix[0][1]) / 1e-3;
            sum += slope * slope * variance[0][q];
        }
        assert!((colours.sigma[0][1] / sum.sqrt() - 1.0).abs() < 1e-3, "{} {}", colours.sigma[0][1], sum.sqrt());
        assert_eq!(colours.sigma[1], [0.0; 3]);
    }

    #[test]
    fn channels_that_see_nothing_or_the_same_are_refused() {
        let alike = ColourMatrix::of([[1.0, 2.0, 3.0]; 3], [[0.0; 3]; 3]).unwrap_err();
        assert!(matches!(alike, ColourError::Alike { .. }), "{alike}");
        let dark = [LIGHT[0], [0.0; 3], LIGHT[2]];
        assert_eq!(ColourMatrix::of(dark, [[0.0; 3]; 3]), Err(ColourError::Dark { channel: 1 }));
    }
}
