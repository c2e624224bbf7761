//! Relative light of the projector's pixels.

/// Light of every projector pixel at one code, relative to the brightest: 1 where the projector is at its best.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatField {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Values in (0, 1], row by row.
    pub values: Vec<f32>,
}

impl FlatField {
    /// A projector without fall-off.
    pub fn uniform(width: usize, height: usize) -> Self {
        Self { width, height, values: vec![1.0; width * height] }
    }

    /// A flat field from light in any linear unit: scaled to a maximum of 1.
    ///
    /// `None` if sizes disagree or a value is not positive and finite.
    pub fn from_light(width: usize, height: usize, mut values: Vec<f32>) -> Option<Self> {
        let brightest = values.iter().copied().fold(0.0, f32::max);
        let good = values.len() == width * height && values.iter().all(|v| v.is_finite() && *v > 0.0);
        good.then(|| {
            values.iter_mut().for_each(|v| *v /= brightest);
            Self { width, height, values }
        })
    }
}
