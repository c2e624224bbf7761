//! Uncompressed formats of cameras, and what their bytes mean.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Columns and rows to leave out at the start so that the first pixel of a mosaic is red.
type Offset = [usize; 2];

const NONE: Offset = [0, 0];
const BGGR: Offset = [1, 1];
const GBRG: Offset = [0, 1];
const GRBG: Offset = [1, 0];
const RGGB: Offset = NONE;

/// What a code of four letters stands for. Samples of more than 8 bits lie in the low bits of 16, little end first.
#[derive(Debug, PartialEq, Eq)]
struct Meaning {
    name: &'static str,
    bits: u32,
    mosaic: bool,
    offset: Offset,
}

const fn grey(name: &'static str, bits: u32) -> Meaning {
    Meaning { name, bits, mosaic: false, offset: NONE }
}

const fn bayer(name: &'static str, bits: u32, offset: Offset) -> Meaning {
    Meaning { name, bits, mosaic: true, offset }
}

/// From `linux/videodev2.h`.
static MEANINGS: [Meaning; 20] = [
    grey("GREY", 8),
    grey("Y10", 10),
    grey("Y12", 12),
    grey("Y16", 16),
    bayer("BA81", 8, BGGR),
    bayer("GBRG", 8, GBRG),
    bayer("GRBG", 8, GRBG),
    bayer("RGGB", 8, RGGB),
    bayer("BG10", 10, BGGR),
    bayer("GB10", 10, GBRG),
    bayer("BA10", 10, GRBG),
    bayer("RG10", 10, RGGB),
    bayer("BG12", 12, BGGR),
    bayer("GB12", 12, GBRG),
    bayer("BA12", 12, GRBG),
    bayer("RG12", 12, RGGB),
    bayer("BYR2", 16, BGGR),
    bayer("GB16", 16, GBRG),
    bayer("GR16", 16, GRBG),
    bayer("RG16", 16, RGGB),
];

/// A format of uncompressed frames, named by the kernel's code of four letters without trailing blanks.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct PixelFormat(&'static Meaning);

impl PixelFormat {
    /// All that can be read.
    pub fn all() -> impl Iterator<Item = Self> {
        MEANINGS.iter().map(Self)
    }

    /// The kernel's code.
    pub fn fourcc(self) -> [u8; 4] {
        let mut code = [b' '; 4];
        code[..self.0.name.len()].copy_from_slice(self.0.name.as_bytes());
        code
    }

    /// The format of a code of the kernel's; `None` if it cannot be read.
    pub fn of_fourcc(code: [u8; 4]) -> Option<Self> {
        Self::all().find(|format| format.fourcc() == code)
    }

    /// Significant bits of a sample, unless the camera has fewer.
    pub fn bits(self) -> u32 {
        self.0.bits
    }

    /// Bits a sample takes in memory.
    pub fn container_bits(self) -> u32 {
        if self.0.bits > 8 { 16 } else { 8 }
    }

    /// Whether pixels lie under a mosaic of colour filters.
    pub fn is_mosaic(self) -> bool {
        self.0.mosaic
    }

    /// Size of a frame as it is delivered, for a sensor of this size: a mosaic begins with a red pixel and holds whole pairs of
    /// columns and rows, so that those of another order lose an edge.
    pub fn delivered(self, width: usize, height: usize) -> [usize; 2] {
        let side = |size: usize, offset: usize| if offset == 0 { size } else { (size - offset) / 2 * 2 };
        [side(width, self.0.offset[0]), side(height, self.0.offset[1])]
    }
}

impl fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0.name)
    }
}

impl fmt::Debug for PixelFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0.name)
    }
}

impl FromStr for PixelFormat {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::all().find(|format| format.0.name == name.trim_end()).ok_or_else(|| {
            let names: Vec<&str> = MEANINGS.iter().map(|m| m.name).collect();
            format!("`{name}` is no format that is read here: choose one of {}", names.join(", "))
        })
    }
}

impl TryFrom<String> for PixelFormat {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        name.parse()
    }
}

impl From<PixelFormat> for String {
    fn from(format: PixelFormat) -> Self {
        format.to_string()
    }
}

/// Why bytes are not samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum UnpackError {
    /// A sample is too large.
    #[error(
        "a sample of {largest} does not fit {bits} bits: set `bits` to what the camera has, and `shift` to the number of low \
         bits that are always zero"
    )]
    TooLarge {
        /// The sample, shifted.
        largest: u16,
        /// Significant bits as stated.
        bits: u32,
    },
}

/// Turns the bytes of frames into samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Unpacker {
    format: PixelFormat,
    width: usize,
    height: usize,
    /// Bytes from one row to the next.
    stride: usize,
    bits: u32,
    shift: u32,
}

impl Unpacker {
    /// For frames of `width` x `height` pixels whose rows begin `stride` bytes apart (at least a row's length). Samples are
    /// shifted right by `shift` bits and then have `bits` significant ones, by default the format's.
    pub fn new(format: PixelFormat, width: usize, height: usize, stride: usize, bits: Option<u32>, shift: u32) -> Self {
        let bits = bits.unwrap_or_else(|| format.bits().min(format.container_bits() - shift));
        let stride = stride.max(width * format.container_bits() as usize / 8);
        Self { format, width, height, stride, bits, shift }
    }

    /// Columns and rows of what [`Unpacker::unpack`] returns.
    pub fn size(&self) -> [usize; 2] {
        self.format.delivered(self.width, self.height)
    }

    /// The samples row by row, those that `bytes` does not hold as 0, and whether it holds all.
    pub fn unpack(&self, bytes: &[u8]) -> (Vec<u16>, bool) {
        let [width, height] = self.size();
        let [left, top] = self.format.0.offset;
        let bytes_each = self.format.container_bits() as usize / 8;
        let mut samples = Vec::with_capacity(width * height);
        for row in top..top + height {
            let start = (row * self.stride + left * bytes_each).min(bytes.len());
            let line = &bytes[start..bytes.len().min(start + width * bytes_each)];
            let end = samples.len() + width;
            if bytes_each == 1 {
                samples.extend(line.iter().map(|&b| u16::from(b) >> self.shift));
            } else {
                samples.extend(line.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]) >> self.shift));
            }
            samples.resize(end, 0);
        }
        let needed = (self.height - 1) * self.stride + self.width * bytes_each;
        (samples, bytes.len() >= needed)
    }

    /// Checks that samples have no more bits than was said.
    ///
    /// # Errors
    /// [`UnpackError::TooLarge`].
    pub fn check(&self, samples: &[u16]) -> Result<(), UnpackError> {
        let largest = samples.iter().copied().max().unwrap_or(0);
        if u32::from(largest) >> self.bits != 0 {
            return Err(UnpackError::TooLarge { largest, bits: self.bits });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// What a camera would send: samples of the whole sensor, rows `stride` bytes apart.
    fn packed(format: PixelFormat, width: usize, stride: usize, shift: u32, samples: &[u16]) -> Vec<u8> {
        let mut bytes = Vec::new();
        for row in samples.chunks(width) {
            let start = bytes.len();
            for &sample in row {
                let sample = sample << shift;
                match format.container_bits() {
                    8 => bytes.push(sample as u8),
                    _ => bytes.extend(sample.to_le_bytes()),
                }
            }
            bytes.resize(start + stride, 0xAA);
        }
        bytes
    }

    proptest! {
        #[test]
        fn every_format_comes_back(
            which in 0..MEANINGS.len(), half in (1usize..9, 1usize..9), padding in 0usize..5, zeros in 0u32..4, seed: u64,
        ) {
            let format = PixelFormat(&MEANINGS[which]);
            let (width, height) = (2 * half.0, 2 * half.1);
            let bits = format.bits() - zeros;
            let shift = format.container_bits() - bits;
            let stride = width * format.container_bits() as usize / 8 + padding;
            let mut state = seed | 1;
            let samples: Vec<u16> = (0..width * height).map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 48) as u16 >> (16 - bits)
            }).collect();
            let unpacker = Unpacker::new(format, width, height, stride, Some(bits), shift);
            let bytes = packed(format, width, stride, shift, &samples);
            let (seen, whole) = unpacker.unpack(&bytes);
            let [w, h] = unpacker.size();
            let [left, top] = format.0.offset;
            prop_assert!(whole);
            prop_assert!(unpacker.check(&seen).is_ok());
            prop_assert_eq!(seen.len(), w * h);
            for v in 0..h {
                for u in 0..w {
                    prop_assert_eq!(seen[v * w + u], samples[(v + top) * width + u + left]);
                }
            }
            // The padding of the last row may be missing, its samples not.
            prop_assert!(unpacker.unpack(&bytes[..bytes.len() - padding]).1);
            prop_assert!(!unpacker.unpack(&bytes[..bytes.len() - padding - 1]).1);
        }

        #[test]
        fn no_length_of_bytes_is_too_much(which in 0..MEANINGS.len(), bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let unpacker = Unpacker::new(PixelFormat(&MEANINGS[which]), 6, 4, 13, None, 0);
            let [w, h] = unpacker.size();
            prop_assert_eq!(unpacker.unpack(&bytes).0.len(), w * h);
        }
    }

    #[test]
    fn every_mosaic_begins_with_red() {
        // A sensor on which red is 1, green 2 and blue 3, in the order of each format.
        let orders = [("BA81", [3, 2, 2, 1]), ("GBRG", [2, 3, 1, 2]), ("GRBG", [2, 1, 3, 2]), ("RGGB", [1, 2, 2, 3])];
        for (name, [a, b, c, d]) in orders {
            let unpacker = Unpacker::new(name.parse().unwrap(), 4, 4, 4, None, 0);
            let bytes: Vec<u8> = [[a, b, a, b], [c, d, c, d], [a, b, a, b], [c, d, c, d]].concat();
            let [width, height] = unpacker.size();
            let (samples, whole) = unpacker.unpack(&bytes);
            assert!(whole && width % 2 == 0 && height % 2 == 0);
            for (i, sample) in samples.iter().enumerate() {
                assert_eq!(usize::from(*sample), 1 + i % width % 2 + i / width % 2, "{name}");
            }
        }
    }

    #[test]
    fn samples_with_more_bits_than_said_are_noticed() {
        let unpacker = Unpacker::new("Y16".parse().unwrap(), 2, 1, 4, Some(12), 0);
        let (samples, _) = unpacker.unpack(&[0xFF, 0x0F, 0x00, 0x10]);
        let error = unpacker.check(&samples).unwrap_err();
        assert_eq!(error, UnpackError::TooLarge { largest: 0x1000, bits: 12 });
        assert!(error.to_string().contains("`shift`"));
        assert!(Unpacker::new("Y16".parse().unwrap(), 2, 1, 4, Some(12), 4).check(&[0x0FFF]).is_ok());
    }

    #[test]
    fn names_are_the_kernels_codes() {
        let y16: PixelFormat = "Y16 ".parse().unwrap();
        assert_eq!((y16.fourcc(), y16.to_string()), (*b"Y16 ", "Y16".to_owned()));
        assert!(PixelFormat::all().all(|f| PixelFormat::of_fourcc(f.fourcc()) == Some(f)));
        assert_eq!(PixelFormat::of_fourcc(*b"MJPG"), None);
        assert!("MJPG".parse::<PixelFormat>().unwrap_err().contains("GREY, Y10"));
    }
}
