//! MERL `.binary` files: half-angle tables of measured materials (Matusik et al. 2003).

use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;

use super::error::read_file;
use super::half::HalfDifference;
use super::{Brdf, ReadError};
use crate::geometry::{Direction, Sample};

/// Cells in theta_h, theta_d and phi_d.
const CELLS: [usize; 3] = [90, 90, 180];
/// What turns stored values into 1/sr, per channel.
const SCALE: [f64; 3] = [1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0];
const HEADER: usize = 12;
const COUNT: usize = CELLS[0] * CELLS[1] * CELLS[2];

/// An isotropic material as a table over theta_h (square-root spacing), theta_d and phi_d (mod pi).
///
/// Matusik, Pfister, Brand, McMillan, "A data-driven reflectance model", ACM TOG 22(3), 2003. A value belongs to the
/// *centre* of its cell: each is the mean of the measurements in the cell, and the reference reader truncates to it.
/// Lookup is trilinear between centres, clamped at both ends of theta_h and theta_d and periodic in phi_d; cells marked
/// invalid (negative values) are left out and the other weights scaled up; 0 where all eight are invalid. Reciprocal by
/// construction.
#[derive(Debug, Clone)]
pub struct Merl {
    /// 1/sr; negative: invalid.
    cells: Vec<[f32; 3]>,
}

impl Merl {
    /// Reads a file.
    ///
    /// # Errors
    /// As [`Merl::parse`], and [`ReadError::Io`].
    pub fn read(path: impl AsRef<Path>) -> Result<Self, ReadError> {
        let (bytes, file) = read_file(path.as_ref())?;
        Self::parse(&bytes, &file)
    }

    /// Reads the bytes of a file: three i32 (90, 90, 180), then the planes R, G, B of f64, little-endian. `file` is the
    /// name errors use.
    ///
    /// # Errors
    /// [`ReadError::Invalid`] for another size and for values that are not finite, [`ReadError::NotSupported`] for
    /// another resolution.
    pub fn parse(bytes: &[u8], file: &str) -> Result<Self, ReadError> {
        let (header, values) = bytes.split_at_checked(HEADER).ok_or_else(|| {
            ReadError::invalid(file, "byte 0", "three resolutions of four bytes", format!("{} bytes", bytes.len()))
        })?;
        let resolution: Vec<i32> = header.as_chunks::<4>().0.iter().map(|&c| i32::from_le_bytes(c)).collect();
        if resolution != CELLS.map(|n| n as i32) {
            return Err(ReadError::NotSupported {
                file: file.into(),
                found: format!("a table of {resolution:?} cells"),
                remedy: "a MERL file has 90 x 90 x 180: get it again, or resample it",
            });
        }
        let expected_bytes = 3 * COUNT * size_of::<f64>();
        if values.len() != expected_bytes {
            let (expected, found) = (format!("{expected_bytes} bytes to the end"), format!("{}", values.len()));
            return Err(ReadError::invalid(file, format!("byte {HEADER}"), expected, found));
        }
        let mut cells = vec![[0f32; 3]; COUNT];
        for (i, &chunk) in values.as_chunks::<8>().0.iter().enumerate() {
            let value = f64::from_le_bytes(chunk);
            let scaled = (value * SCALE[i / COUNT]) as f32;
            if !scaled.is_finite() {
                return Err(ReadError::invalid(file, format!("byte {}", HEADER + 8 * i), "a finite number", value));
            }
            cells[i % COUNT][i / COUNT] = scaled;
        }
        Ok(Self { cells })
    }
}

impl Brdf for Merl {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        if wi.cos_theta() <= 0.0 || wo.cos_theta() <= 0.0 {
            return [0.0; 3];
        }
        let angles = HalfDifference::new(wi, wo);
        let h = clamped(CELLS[0] as f64 * (angles.theta_h() / FRAC_PI_2).sqrt(), CELLS[0]);
        let d = clamped(CELLS[1] as f64 * angles.theta_d() / FRAC_PI_2, CELLS[1]);
        let p = periodic(CELLS[2] as f64 * angles.phi_d() / PI, CELLS[2]);
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for (i, u) in h {
            for (j, v) in d {
                for (k, w) in p {
                    let cell = &self.cells[(i * CELLS[1] + j) * CELLS[2] + k];
                    if cell.iter().all(|&f| f >= 0.0) {
                        let weight = u * v * w;
                        total += weight;
                        sum.iter_mut().zip(cell).for_each(|(s, &f)| *s += weight * f64::from(f));
                    }
                }
            }
        }
        if total > 0.0 { sum.map(|s| s / total) } else { [0.0; 3] }
    }

    fn is_isotropic(&self) -> bool {
        true
    }
}

/// The two cells whose centres lie around `x` (in cells), and their weights; the first and last centre at the ends.
fn clamped(x: f64, cells: usize) -> [(usize, f64); 2] {
    let x = (x - 0.5).clamp(0.0, (cells - 1) as f64);
    let i = (x as usize).min(cells - 2);
    let t = x - i as f64;
    [(i, 1.0 - t), (i + 1, t)]
}

/// As [`clamped`], but the last cell is followed by the first.
fn periodic(x: f64, cells: usize) -> [(usize, f64); 2] {
    let x = (x - 0.5).rem_euclid(cells as f64);
    let i = (x as usize).min(cells - 1);
    let t = x - i as f64;
    [(i, 1.0 - t), ((i + 1) % cells, t)]
}

#[cfg(test)]
mod tests {
    use super::super::test_support::*;
    use super::*;
    use proptest::prelude::*;
    use std::sync::LazyLock;

    /// A file whose values at the cell centres are those of `f(theta_h, theta_d, phi_d)` in 1/sr, times 1, 2, 3.
    fn file(f: impl Fn(f64, f64, f64) -> f64) -> Vec<u8> {
        let mut bytes: Vec<u8> = CELLS.iter().flat_map(|&n| (n as i32).to_le_bytes()).collect();
        for (c, scale) in SCALE.iter().enumerate() {
            for i in 0..CELLS[0] {
                for j in 0..CELLS[1] {
                    for k in 0..CELLS[2] {
                        let theta_h = ((i as f64 + 0.5) / 90.0).powi(2) * FRAC_PI_2;
                        let value = f(theta_h, (j as f64 + 0.5).to_radians(), (k as f64 + 0.5).to_radians());
                        bytes.extend(((c + 1) as f64 * value / scale).to_le_bytes());
                    }
                }
            }
        }
        bytes
    }

    fn smooth(theta_h: f64, theta_d: f64, phi_d: f64) -> f64 {
        (-4.0 * theta_h).exp() + 0.3 * theta_d.sin() * (1.0 + 0.5 * (2.0 * phi_d).cos())
    }

    static SMOOTH: LazyLock<Merl> = LazyLock::new(|| Merl::parse(&file(smooth), "smooth").unwrap());

    #[test]
    fn cells_of_one_degree_resolve_a_smooth_function() {
        // Second-order interpolation error of cells up to 2 deg wide, and half a cell of clamping at the ends.
        const INTERPOLATION: f64 = 3e-3;
        for (ti, to, dphi) in [(0.3, 0.9, 2.5), (0.1, 0.2, 0.4), (1.2, 0.7, -1.9), (0.5, 0.5, 3.1)] {
            let (wi, wo) = (Direction::from_angles(ti, 0.3), Direction::from_angles(to, 0.3 + dphi));
            let angles = HalfDifference::new(&wi, &wo);
            let want = smooth(angles.theta_h(), angles.theta_d(), angles.phi_d());
            for (c, got) in SMOOTH.eval(&wi, &wo).into_iter().enumerate() {
                assert!((got / (c + 1) as f64 / want - 1.0).abs() < INTERPOLATION, "{got} instead of {want}");
            }
        }
    }

    #[test]
    fn invalid_cells_are_left_out() {
        let patchy =
            file(|h, d, p| if (d.to_degrees() as usize).is_multiple_of(2) { 0.25 } else { -1.0 + 0.0 * h * p });
        let merl = Merl::parse(&patchy, "patchy").unwrap();
        let f = merl.eval(&Direction::from_angles(0.4, 0.2), &Direction::from_angles(0.8, 2.0));
        assert!((f[0] - 0.25).abs() < 1e-7);
        let nothing = Merl::parse(&file(|_, _, _| -1.0), "nothing").unwrap();
        assert_eq!(nothing.eval(&Direction::from_angles(0.4, 0.2), &Direction::from_angles(0.8, 2.0)), [0.0; 3]);
    }

    #[test]
    fn is_black_below_and_continuous() {
        black_below(&*SMOOTH);
        continuous_over_the_wrap(&*SMOOTH);
    }

    #[test]
    fn damaged_files_are_errors() {
        let whole = file(|_, _, _| 0.1);
        for length in [0, 11, 12, 13, whole.len() - 1] {
            assert!(matches!(Merl::parse(&whole[..length], "cut"), Err(ReadError::Invalid { .. })), "{length}");
        }
        let mut other = whole.clone();
        other[0] = 91;
        assert!(matches!(Merl::parse(&other, "other"), Err(ReadError::NotSupported { .. })));
        let mut nan = whole.clone();
        nan[HEADER + 80..HEADER + 88].copy_from_slice(&f64::NAN.to_le_bytes());
        let error = Merl::parse(&nan, "nan.binary").unwrap_err().to_string();
        assert!(error.contains("nan.binary") && error.contains("byte 92"), "{error}");
    }

    proptest! {
        #[test]
        fn is_reciprocal(wi in upper(), wo in upper()) {
            reciprocal(&*SMOOTH, &wi, &wo, 1e-6)?;
        }

        #[test]
        fn never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
            prop_assert!(Merl::parse(&bytes, "random").is_err());
        }
    }
}
