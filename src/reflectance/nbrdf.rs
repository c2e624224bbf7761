//! Neural fits of MERL materials (Sztrajman et al. 2021).

use std::path::Path;

use super::error::read_file;
use super::half::HalfDifference;
use super::{Brdf, ReadError};
use crate::geometry::{Direction, Sample};

const INPUTS: usize = 6;
const HIDDEN: usize = 21;
/// Weights and biases of one material: 6 -> 21 -> 21 -> 3.
const ROW: usize = INPUTS * HIDDEN + HIDDEN + HIDDEN * HIDDEN + HIDDEN + HIDDEN * 3 + 3;

/// A network of 675 numbers that reproduces an isotropic material.
///
/// Sztrajman, Rainer, Ritschel, Weyrich, "Neural BRDF representation and importance sampling", CGF 40(6), 2021. Inputs
/// are the Rusinkiewicz half vector (phi_h = 0) and difference vector, two hidden layers are rectified, and
/// f = max(exp(output) - 1, 0) per channel. A file holds rows of 675 little-endian f32: the weights of the first layer
/// (6 x 21, one row per input), its 21 biases, those of the second (21 x 21, 21) and of the last (21 x 3, 3). Not
/// exactly reciprocal.
#[derive(Debug, Clone)]
pub struct NeuralBrdf {
    first: Layer<INPUTS, HIDDEN>,
    second: Layer<HIDDEN, HIDDEN>,
    last: Layer<HIDDEN, 3>,
}

#[derive(Debug, Clone)]
struct Layer<const I: usize, const O: usize> {
    weights: [[f64; O]; I],
    bias: [f64; O],
}

impl<const I: usize, const O: usize> Layer<I, O> {
    /// Takes its numbers from the front of `values`, which must hold enough.
    fn take(values: &mut impl Iterator<Item = f64>) -> Self {
        let mut next = || values.next().unwrap_or(0.0);
        let weights = std::array::from_fn(|_| std::array::from_fn(|_| next()));
        Self { weights, bias: std::array::from_fn(|_| next()) }
    }

    fn apply(&self, input: &[f64; I]) -> [f64; O] {
        let mut output = self.bias;
        for (x, row) in input.iter().zip(&self.weights) {
            output.iter_mut().zip(row).for_each(|(sum, w)| *sum += x * w);
        }
        output
    }
}

impl NeuralBrdf {
    /// Reads row `row` (from 0) of a file.
    ///
    /// # Errors
    /// As [`NeuralBrdf::parse`], and [`ReadError::Io`].
    pub fn read(path: impl AsRef<Path>, row: usize) -> Result<Self, ReadError> {
        let (bytes, file) = read_file(path.as_ref())?;
        Self::parse(&bytes, &file, row)
    }

    /// Reads row `row` (from 0) of a file's bytes; `file` is the name errors use.
    ///
    /// # Errors
    /// [`ReadError::Invalid`] if the length is not a multiple of a row's, there are fewer rows, or a number is not
    /// finite.
    pub fn parse(bytes: &[u8], file: &str, row: usize) -> Result<Self, ReadError> {
        let (rows, rest) = bytes.as_chunks::<{ 4 * ROW }>();
        if !rest.is_empty() || rows.is_empty() {
            let expected = format!("rows of {} bytes", 4 * ROW);
            return Err(ReadError::invalid(file, "its length", expected, format!("{} bytes", bytes.len())));
        }
        let chosen = rows.get(row).ok_or_else(|| {
            ReadError::invalid(file, format!("row {row}"), format!("a row below {}", rows.len()), "no such row")
        })?;
        let values: Vec<f64> = chosen.as_chunks::<4>().0.iter().map(|&c| f64::from(f32::from_le_bytes(c))).collect();
        if let Some(i) = values.iter().position(|v| !v.is_finite()) {
            let at = format!("byte {}", 4 * (row * ROW + i));
            return Err(ReadError::invalid(file, at, "a finite number", values[i]));
        }
        let mut values = values.into_iter();
        Ok(Self { first: Layer::take(&mut values), second: Layer::take(&mut values), last: Layer::take(&mut values) })
    }
}

impl Brdf for NeuralBrdf {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        if wi.cos_theta() <= 0.0 || wo.cos_theta() <= 0.0 {
            return [0.0; 3];
        }
        let HalfDifference { half: (sin_h, cos_h), difference: d } = HalfDifference::new(wi, wo);
        let rectified = |x: f64| x.max(0.0);
        let a = self.first.apply(&[sin_h, 0.0, cos_h, d.x, d.y, d.z]).map(rectified);
        let a = self.second.apply(&a).map(rectified);
        self.last.apply(&a).map(|y| y.exp_m1().clamp(0.0, f64::MAX))
    }

    fn is_isotropic(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_support::*;
    use super::*;
    use proptest::prelude::*;

    /// Numbers of no meaning, small enough for finite results.
    fn file(rows: usize) -> Vec<u8> {
        (0..rows * ROW).flat_map(|i| ((i * 7919 % 101) as f32 / 200.0 - 0.25).to_le_bytes()).collect()
    }

    #[test]
    fn a_network_of_biases_is_a_constant() {
        let mut bytes = vec![0u8; 4 * ROW];
        for (c, f) in [0.1f64, 0.2, 0.3].into_iter().enumerate() {
            bytes[4 * (ROW - 3 + c)..][..4].copy_from_slice(&(f.ln_1p() as f32).to_le_bytes());
        }
        let brdf = NeuralBrdf::parse(&bytes, "constant", 0).unwrap();
        let f = brdf.eval(&Direction::from_angles(0.3, 0.1), &Direction::from_angles(0.9, 2.0));
        assert!(f.into_iter().zip([0.1, 0.2, 0.3]).all(|(f, want)| (f - want).abs() < 1e-7));
        black_below(&brdf);
    }

    #[test]
    fn damaged_files_are_errors() {
        let bytes = file(2);
        assert_eq!(bytes.len(), 2 * 2700);
        assert!(NeuralBrdf::parse(&bytes, "two", 1).is_ok());
        assert!(NeuralBrdf::parse(&bytes, "two", 2).unwrap_err().to_string().contains("row 2"));
        assert!(NeuralBrdf::parse(&bytes[..2699], "cut", 0).is_err());
        assert!(NeuralBrdf::parse(&[], "empty", 0).is_err());
        let mut nan = bytes.clone();
        nan[2704..2708].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(NeuralBrdf::parse(&nan, "nan", 1).unwrap_err().to_string().contains("byte 2704"));
    }

    #[test]
    fn is_continuous() {
        continuous_over_the_wrap(&NeuralBrdf::parse(&file(1), "any", 0).unwrap());
    }

    proptest! {
        #[test]
        fn never_panics(bytes in proptest::collection::vec(any::<u8>(), 2700), wi in upper(), wo in upper()) {
            if let Ok(brdf) = NeuralBrdf::parse(&bytes, "random", 0) {
                let _ = brdf.eval(&wi, &wo);
            }
        }
    }
}
