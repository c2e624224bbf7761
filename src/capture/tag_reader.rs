//! Reads the coded patch in camera frames: which frame of the sequence was lit while the shutter was open, and how bright.

use thiserror::Error;

use super::Frame;
use crate::patterns::{Rect, TagLayout};
use crate::radiometry::Sensor;

/// A reading further than this many standard errors from what a code looks like is not that code.
const SIGMAS: f64 = 6.0;
/// ... beyond this share of its contrast, which a camera's last non-linearity may cost: of a linear one, ...
const LINEARITY: f64 = 1e-3;
/// ... and of one whose codes were made linear.
const LINEARITY_OF_CODES: f64 = 0.02;
/// Light of another pattern by this many standard errors is some...
const MIXTURE_SIGMAS: f64 = 5.0;
/// ... and by this share of the exposure over the camera's non-linearity, which may feign it.
const MIXTURE: f64 = 0.5;
/// A lamp does not change by more between two frames; an exposure that was dark for a part of its time does.
pub(super) const LIGHT_STEP: f64 = 0.01;
/// Crosstalk between bits below this many standard errors is noise, and taken for none.
const CROSSTALK_SIGMAS: f64 = 4.0;
/// A bit must stand out of the noise of one frame by this much to be of use.
const MIN_CONTRAST_SIGMAS: f64 = 8.0;

/// Why the patch cannot be learned.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum TagProblem {
    /// Samples reach the linear limit.
    #[error("it saturates")]
    Saturated,
    /// A bit is too dim for the exposure.
    #[error("bit {bit} changes by {change:.0} e-/s where noise is {noise:.0} e-/s")]
    Dim {
        /// Which one.
        bit: usize,
        /// By how much it changes, e-/s.
        change: f64,
        /// Standard error of that, e-/s.
        noise: f64,
    },
    /// A bit reaches over to others.
    #[error("bit {bit} cannot be told from its neighbours: it is out of focus")]
    Blurred {
        /// Which one.
        bit: usize,
    },
    /// All cells together are not what each of them is.
    #[error("its cells do not add up: the light is not steady, or the projector is late now and then")]
    Unsteady,
    /// New frames hold old samples.
    #[error("the same frame comes again and again")]
    Repeated,
}

/// Contrast of every bit of the patch in one frame, electrons per second, with variances.
#[derive(Debug, Clone, PartialEq)]
pub struct TagReading {
    /// Mean rate of the first cell less that of the second, per bit.
    pub contrast: Vec<f64>,
    /// Its variance.
    pub variance: Vec<f64>,
    /// Brightest sample, DN.
    pub brightest_dn: u16,
}

impl TagReading {
    /// Reads a frame.
    pub fn of(layout: &TagLayout, sensor: &Sensor, frame: &Frame) -> Self {
        let mut brightest_dn = 0;
        let mut mean = |rect: Rect| {
            let mut sum = 0u64;
            for row in rect.v0..rect.v0 + rect.height {
                let samples = &frame.samples[row * frame.width + rect.u0..][..rect.width];
                sum += samples.iter().map(|&s| u64::from(s)).sum::<u64>();
                brightest_dn = samples.iter().copied().fold(brightest_dn, u16::max);
            }
            sum as f64 / (rect.width * rect.height) as f64
        };
        let (mut contrast, mut variance) = (Vec::new(), Vec::new());
        for bit in layout.bits() {
            let electrons = bit.sensor.map(|rect| (mean(rect) - sensor.black_level_dn) / sensor.gain_dn_per_e);
            let pixels = (bit.sensor[0].width * bit.sensor[0].height) as f64;
            let floor = sensor.dark_noise_e.powi(2) + 1.0 / (12.0 * sensor.gain_dn_per_e.powi(2));
            contrast.push((electrons[0] - electrons[1]) / frame.exposure_s);
            let shot = electrons[0].max(0.0) + electrons[1].max(0.0);
            variance.push((shot + 2.0 * floor) / (pixels * frame.exposure_s.powi(2)));
        }
        Self { contrast, variance, brightest_dn }
    }
}

/// What the patch looks like for every code: linear in the bits, with the crosstalk that blur brings.
#[derive(Debug, Clone, PartialEq)]
pub struct TagModel {
    layout: TagLayout,
    sensor: Sensor,
    /// Contrasts of code 0 and their variances.
    base: TagReading,
    /// What a bit that is set adds to every contrast.
    columns: Vec<Vec<f64>>,
    /// Relative deviation of the camera from a straight line.
    linearity: f64,
}

/// What a frame shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Verdict {
    /// The code that was expected, the whole exposure long.
    Expected {
        /// Light relative to that of the frames the model was learned from.
        light: f64,
        /// Its standard error.
        sigma: f64,
    },
    /// The code that was expected, in another light: dark for a part of the time, or after a lamp has changed.
    OtherLight {
        /// Light relative to that of the frames the model was learned from.
        light: f64,
        /// Its standard error.
        sigma: f64,
    },
    /// Something else: an earlier frame, or two of them in one exposure.
    Other,
    /// Too bright or too dark to be read.
    Unreadable,
}

impl TagModel {
    /// Learns from a frame of code 0 and one of each code with a single bit set, in the order of the bits.
    ///
    /// # Errors
    /// [`TagProblem`].
    pub fn learn(layout: TagLayout, sensor: Sensor, frames: &[Frame]) -> Result<Self, TagProblem> {
        let readings: Vec<TagReading> = frames.iter().map(|f| TagReading::of(&layout, &sensor, f)).collect();
        assert_eq!(readings.len(), layout.bits().len() + 1, "one frame for each bit, and one for code 0");
        if readings.iter().any(|r| f64::from(r.brightest_dn) >= sensor.limit_dn) {
            return Err(TagProblem::Saturated);
        }
        let (base, columns) = model(&readings);
        for (i, column) in columns.iter().enumerate() {
            let noise = base.variance[i].sqrt();
            // Negated so that NaN fails.
            let clear = column[i] > MIN_CONTRAST_SIGMAS * noise;
            let own = column.iter().enumerate().all(|(j, x)| j == i || x.abs() < 0.5 * column[i]);
            if !clear {
                return Err(TagProblem::Dim { bit: i, change: column[i], noise });
            }
            if !own {
                return Err(TagProblem::Blurred { bit: i });
            }
        }
        Ok(Self { layout, sensor, base, columns, linearity: LINEARITY })
    }

    /// The same for a camera whose codes were made linear: less is asked of contrasts, and less believed of the lamp.
    pub fn of_codes(self) -> Self {
        Self { linearity: LINEARITY_OF_CODES, ..self }
    }

    /// Reads a frame.
    pub fn read(&self, frame: &Frame) -> TagReading {
        TagReading::of(&self.layout, &self.sensor, frame)
    }

    /// Where the patch lies.
    pub fn layout(&self) -> &TagLayout {
        &self.layout
    }

    /// Contrasts of a code.
    fn contrast(&self, code: usize) -> Vec<f64> {
        let mut sum = self.base.contrast.clone();
        for (i, column) in self.columns.iter().enumerate().filter(|(i, _)| code >> i & 1 == 1) {
            debug_assert!(i < self.columns.len());
            sum.iter_mut().zip(column).for_each(|(s, c)| *s += c);
        }
        sum
    }

    /// The whole contrast: what a later session of the same run compares its light with.
    pub fn total(&self) -> f64 {
        self.columns.iter().enumerate().map(|(i, column)| column[i]).sum()
    }

    /// Standard error of [`TagModel::total`].
    pub fn total_sigma(&self) -> f64 {
        2f64.sqrt() * self.base.variance.iter().sum::<f64>().sqrt()
    }

    /// Whether `reading` is that of `code` at a light of about `light`, without light of `others`, the codes shown before
    /// and after it.
    pub fn judge(&self, reading: &TagReading, code: usize, others: &[usize], light: f64) -> Verdict {
        if f64::from(reading.brightest_dn) >= self.sensor.limit_dn {
            return Verdict::Unreadable;
        }
        let expected = self.contrast(code);
        // The model's own noise counts too: a bit that is set was learned from one frame.
        let own = 2.0 * light * light;
        let variance: Vec<f64> =
            reading.variance.iter().zip(&self.base.variance).map(|(v, base)| v + own * base).collect();
        let (mut information, mut sum) = (0.0, 0.0);
        for ((e, r), v) in expected.iter().zip(&reading.contrast).zip(&variance) {
            information += e * e / v;
            sum += e * r / v;
        }
        let mut sigma = information.sqrt().recip();
        let seen = sum / information;
        if self.linearity > LINEARITY {
            sigma = sigma.hypot(self.linearity);
        }
        let fits = expected
            .iter()
            .zip(&reading.contrast)
            .zip(&variance)
            .all(|((e, r), v)| (r - seen * e).abs() <= SIGMAS * v.sqrt() + self.linearity * e.abs());
        let pure = others.iter().filter(|&&other| other != code).all(|&other| {
            let (share, sigma) = share_of(&self.contrast(other), &expected, &reading.contrast, &variance);
            share <= MIXTURE_SIGMAS * sigma + MIXTURE * self.linearity
        });
        let readable = information.is_finite() && information > 0.0;
        let steady = (seen / light - 1.0).abs() <= LIGHT_STEP + SIGMAS * sigma;
        match (readable, fits && pure, steady) {
            (false, ..) => Verdict::Unreadable,
            (true, false, _) => Verdict::Other,
            (true, true, true) => Verdict::Expected { light: seen, sigma },
            (true, true, false) => Verdict::OtherLight { light: seen, sigma },
        }
    }
}

/// Share of the light that was of a code with the contrasts `other` and not of the one with those `expected`, with its
/// standard error: least squares in both.
fn share_of(other: &[f64], expected: &[f64], contrast: &[f64], variance: &[f64]) -> (f64, f64) {
    let (mut ee, mut ed, mut dd, mut er, mut dr) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (((e, s), r), v) in expected.iter().zip(other).zip(contrast).zip(variance) {
        let d = s - e;
        ee += e * e / v;
        ed += e * d / v;
        dd += d * d / v;
        er += e * r / v;
        dr += d * r / v;
    }
    let determinant = ee * dd - ed * ed;
    let light = (dd * er - ed * dr) / determinant;
    ((ee * dr - ed * er) / determinant / light, (ee / determinant).sqrt() / light)
}

/// Contrasts of code 0 with their variances, and what each bit adds, from readings of code 0 and of every single bit.
fn model(readings: &[TagReading]) -> (TagReading, Vec<Vec<f64>>) {
    let n = readings.len() - 1;
    let [first, singles @ ..] = readings else { unreachable!("code 0 was read") };
    let mut columns = vec![vec![0.0; n]; n];
    let mut base = first.clone();
    for i in 0..n {
        let noise = (2.0 * first.variance[i]).sqrt();
        // Where the other bits do not reach over, their frames are as good as the one of code 0.
        let reach = |j: usize| singles[j].contrast[i] - first.contrast[i];
        let alike: Vec<usize> = (0..n).filter(|&j| j != i && reach(j).abs() < CROSSTALK_SIGMAS * noise).collect();
        let sum = first.contrast[i] + alike.iter().map(|&j| singles[j].contrast[i]).sum::<f64>();
        base.contrast[i] = sum / (1 + alike.len()) as f64;
        for (j, column) in columns.iter_mut().enumerate().filter(|(j, _)| !alike.contains(j)) {
            column[i] = singles[j].contrast[i] - base.contrast[i];
        }
    }
    (base, columns)
}
