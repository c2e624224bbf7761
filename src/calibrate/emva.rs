//! Frames described as for the EMVA 1288 reference programs: a text file that lists pairs of PNG images.
//!
//! Lines begin with a letter: `v` version, `n` bits width height, `b` exposure in ns and photons for each pixel of the bright
//! images that follow, `d` exposure of dark ones, `i` an image's path relative to the text. `#` begins a comment.

use std::io::Cursor;
use std::path::{Component, Path, PathBuf};

use thiserror::Error;

use crate::radiometry::{Level, PairMoments, PhotonTransfer, TransferError};
use crate::store::{self, StoreError};

/// Why a description or its images cannot be used.
#[derive(Debug, Error)]
pub enum EmvaError {
    /// A line of the description is wrong.
    #[error("line {line}: `{found}` {fault}")]
    Line {
        /// Line, from 1.
        line: usize,
        /// The line's beginning.
        found: String,
        /// What is wrong and what to do.
        fault: &'static str,
    },
    /// Something is missing that has no line.
    #[error("the description {fault}")]
    Incomplete {
        /// What is missing and what to do.
        fault: &'static str,
    },
    /// Bright images without dark ones.
    #[error(
        "line {line}: no two dark images were taken with {exposure_ns} ns: add a line `d {exposure_ns}` with two images"
    )]
    NoDark {
        /// Line of the bright group.
        line: usize,
        /// Its exposure.
        exposure_ns: f64,
    },
    /// An image is not as described.
    #[error("line {line}: {path}: {reason}", path = path.display())]
    Image {
        /// Line that names it.
        line: usize,
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        reason: String,
    },
    /// The images give no figures.
    #[error(transparent)]
    Transfer(#[from] TransferError),
    /// A file could not be read.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Images taken alike.
#[derive(Debug, Clone, PartialEq)]
pub struct EmvaGroup {
    /// Line that begins it, from 1.
    pub line: usize,
    /// Exposure.
    pub exposure_ns: f64,
    /// Mean photons for each pixel in one exposure; `None` in darkness.
    pub photons: Option<f64>,
    /// Line and path of each image, relative to the description.
    pub images: Vec<(usize, PathBuf)>,
}

/// A description of frames for EMVA 1288.
#[derive(Debug, Clone, PartialEq)]
pub struct EmvaDescription {
    /// Bits of a sample, 1..=16.
    pub bits: u32,
    /// Columns of every image.
    pub width: usize,
    /// Rows of every image.
    pub height: usize,
    /// Groups as listed.
    pub groups: Vec<EmvaGroup>,
}

/// Pixels of an image at most: what a sensor may have, and what memory bears.
const MAX_PIXELS: usize = 1 << 28;

impl EmvaDescription {
    /// Reads a description's text.
    ///
    /// # Errors
    /// [`EmvaError::Line`], [`EmvaError::Incomplete`].
    pub fn parse(text: &str) -> Result<Self, EmvaError> {
        let mut size = None;
        let mut groups: Vec<EmvaGroup> = Vec::new();
        for (index, raw) in text.lines().enumerate() {
            let line = index + 1;
            let content = raw.trim();
            let fault = |fault| EmvaError::Line { line, found: content.chars().take(60).collect(), fault };
            let mut words = content.split_whitespace();
            let Some(kind) = words.next().filter(|kind| !kind.starts_with('#')) else { continue };
            match kind {
                "v" => {}
                "n" => {
                    let numbers: Vec<usize> = words.map_while(|w| w.parse().ok()).collect();
                    let &[bits, width, height] = &numbers[..] else {
                        return Err(fault("gives no size: write `n BITS WIDTH HEIGHT`"));
                    };
                    let pixels = width.saturating_mul(height);
                    if !(1..=16).contains(&bits) || !(2..=MAX_PIXELS).contains(&pixels) {
                        return Err(fault("is no sensor's size: bits are 1 to 16, pixels 2 to 2^28"));
                    }
                    size = Some((bits as u32, width, height));
                }
                "b" | "d" => {
                    let count = if kind == "b" { 2 } else { 1 };
                    let numbers: Vec<f64> = words.map_while(|w| w.parse().ok()).collect();
                    if numbers.len() != count || numbers.iter().any(|x| !x.is_finite() || *x < 0.0) {
                        return Err(fault(
                            "begins no group: write `b EXPOSURE_NS PHOTONS` or `d EXPOSURE_NS`, not negative",
                        ));
                    }
                    let photons = numbers.get(1).copied();
                    groups.push(EmvaGroup { line, exposure_ns: numbers[0], photons, images: Vec::new() });
                }
                "i" => {
                    let Some(group) = groups.last_mut() else {
                        return Err(fault("belongs to no group: begin one with a line `b` or `d` above it"));
                    };
                    // Some programs write paths with backslashes.
                    let path = PathBuf::from(content[1..].trim().replace('\\', "/"));
                    let inside = path.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
                    if path.as_os_str().is_empty() || !inside {
                        return Err(fault("leads out of the description's folder: put the images into it"));
                    }
                    group.images.push((line, path));
                }
                _ => return Err(fault("is of an unknown kind: lines begin with v, n, b, d, i or #")),
            }
        }
        let Some((bits, width, height)) = size else {
            return Err(EmvaError::Incomplete { fault: "has no size: add a line `n BITS WIDTH HEIGHT`" });
        };
        if !groups.iter().any(|g| g.photons.is_some()) {
            return Err(EmvaError::Incomplete { fault: "has no bright images: add lines `b EXPOSURE_NS PHOTONS`" });
        }
        Ok(Self { bits, width, height, groups })
    }

    /// Reads a description.
    ///
    /// # Errors
    /// [`EmvaError`].
    pub fn read(path: &Path) -> Result<Self, EmvaError> {
        Self::parse(&store::read_text(path)?)
    }

    /// The first two images of each bright group, with the dark group of the same exposure. Images lie in `folder`, that of
    /// the description; two of them are in memory at a time.
    ///
    /// # Errors
    /// [`EmvaError`].
    pub fn levels(&self, folder: &Path) -> Result<Vec<Level>, EmvaError> {
        let bright = self.groups.iter().filter_map(|g| g.photons.map(|photons| (g, photons)));
        bright
            .map(|(group, light)| {
                let alike =
                    |d: &&EmvaGroup| d.photons.is_none() && d.exposure_ns == group.exposure_ns && d.images.len() > 1;
                let no_dark = EmvaError::NoDark { line: group.line, exposure_ns: group.exposure_ns };
                let dark = self.groups.iter().find(alike).ok_or(no_dark)?;
                Ok(Level { light, bright: self.pair(folder, group)?, dark: self.pair(folder, dark)? })
            })
            .collect()
    }

    /// The figures of the sensor; light is counted in photons, so that responsivity over gain is the quantum efficiency.
    ///
    /// # Errors
    /// [`EmvaError`].
    pub fn photon_transfer(&self, folder: &Path) -> Result<PhotonTransfer, EmvaError> {
        Ok(PhotonTransfer::of(&self.levels(folder)?)?)
    }

    fn pair(&self, folder: &Path, group: &EmvaGroup) -> Result<PairMoments, EmvaError> {
        let [first, second, ..] = &group.images[..] else {
            return Err(EmvaError::Line {
                line: group.line,
                found: format!("{} images", group.images.len()),
                fault: "are no pair: list two images below this line",
            });
        };
        Ok(PairMoments::of(&self.image(folder, first)?, &self.image(folder, second)?)?)
    }

    /// Samples of one image in DN.
    fn image(&self, folder: &Path, (line, path): &(usize, PathBuf)) -> Result<Vec<u16>, EmvaError> {
        let path = folder.join(path);
        let fault = |reason: String| EmvaError::Image { line: *line, path: path.clone(), reason };
        let bytes = store::read(&path)?;
        let mut reader = image::ImageReader::with_format(Cursor::new(bytes), image::ImageFormat::Png);
        let mut limits = image::Limits::default();
        (limits.max_image_width, limits.max_image_height) = (Some(self.width as u32), Some(self.height as u32));
        reader.limits(limits);
        let decoded =
            reader.decode().map_err(|e| fault(format!("{e}; the image must be a PNG of the size in line `n`")))?;
        if (decoded.width() as usize, decoded.height() as usize) != (self.width, self.height) {
            let size = format!("{} x {} pixels", decoded.width(), decoded.height());
            return Err(fault(format!("{size}, described as {} x {}: correct line `n`", self.width, self.height)));
        }
        let samples = match decoded {
            image::DynamicImage::ImageLuma8(image) => image.into_raw().into_iter().map(u16::from).collect(),
            image::DynamicImage::ImageLuma16(image) => image.into_raw(),
            _ => return Err(fault("it has colours: write gray PNG images of 8 or 16 bits".into())),
        };
        let highest = samples.iter().copied().max().unwrap_or(0);
        if u32::from(highest) >> self.bits != 0 {
            return Err(fault(format!("it holds {highest}, more than {} bits: correct line `n`", self.bits)));
        }
        Ok(samples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const GOOD: &str = "# text\nv 3.0\nn 12 4 2\nb 40 120\ni a b.png\ni b\\c.png\nd 40\ni d.png\ni e.png\n";

    #[test]
    fn a_description_is_read() {
        let got = EmvaDescription::parse(GOOD).unwrap();
        assert_eq!((got.bits, got.width, got.height, got.groups.len()), (12, 4, 2, 2));
        assert_eq!(got.groups[0].photons, Some(120.0));
        assert_eq!(got.groups[0].images, [(5, "a b.png".into()), (6, "b/c.png".into())]);
        assert_eq!((got.groups[1].line, got.groups[1].photons), (7, None));
    }

    #[test]
    fn faults_name_their_line_and_the_remedy() {
        let told = |text: &str| EmvaDescription::parse(text).unwrap_err().to_string();
        for (text, line, remedy) in [
            ("n 12 4", 1, "BITS WIDTH HEIGHT"),
            ("n 12 4294967295 4294967295", 1, "2^28"),
            ("\nb 1 -1", 2, "EXPOSURE_NS"),
            ("b nan 1", 1, "not negative"),
            ("i a.png", 1, "line `b` or `d`"),
            ("d 1\ni ../../secret.png", 2, "folder"),
            ("d 1\ni /secret.png", 2, "folder"),
            ("x", 1, "unknown kind"),
        ] {
            let said = told(text);
            assert!(said.starts_with(&format!("line {line}: ")) && said.contains(remedy), "{said}");
        }
        assert!(told("b 1 1").contains("n BITS WIDTH HEIGHT"));
        assert!(told("n 8 2 2\nd 1").contains("no bright images"));
    }

    #[test]
    fn images_that_are_not_as_described_are_told_with_their_line() {
        let folder = tempfile::tempdir().unwrap();
        let save = |name: &str, width: u32, value: u16| {
            let image = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(width, 2, image::Luma([value]));
            image.save(folder.path().join(name)).unwrap();
        };
        save("good.png", 4, 4095);
        save("small.png", 2, 1);
        save("wide.png", 5, 1);
        save("high.png", 4, 4096);
        std::fs::write(folder.path().join("broken.png"), [0x89, b'P', b'N', b'G']).unwrap();
        let said = |bright: &str, dark: &str| {
            let text = format!("n 12 4 2\nb 40 120\ni {bright}\ni good.png\nd {dark}\ni good.png\ni good.png\n");
            EmvaDescription::parse(&text).unwrap().levels(folder.path()).map_err(|e| e.to_string())
        };
        assert_eq!(said("good.png", "40").unwrap()[0].bright, PairMoments { mean_dn: 4095.0, variance_dn2: 0.0 });
        for (name, part) in
            [("small.png", "2 x 2"), ("wide.png", "line `n`"), ("high.png", "4096"), ("broken.png", "PNG")]
        {
            let said = said(name, "40").unwrap_err();
            assert!(said.starts_with("line 3: ") && said.contains(part), "{said}");
        }
        assert!(said("none.png", "40").unwrap_err().contains("cannot read"));
        assert!(said("good.png", "41").unwrap_err().contains("add a line `d 40`"));
    }

    proptest! {
        #[test]
        fn no_text_makes_it_panic(text in "([vnbdi# ][0-9eE.\\- /\\\\a-z\u{e9}]{0,20}\n){0,12}", any in "\\PC*") {
            let _ = EmvaDescription::parse(&text);
            let _ = EmvaDescription::parse(&any);
        }

        #[test]
        fn damaged_descriptions_do_not_panic(at in 0..GOOD.len(), with in any::<char>()) {
            let damaged: String = GOOD.chars().enumerate().map(|(i, c)| if i == at { with } else { c }).collect();
            let _ = EmvaDescription::parse(&damaged);
        }
    }
}
