//! A projector that is another program: it shows the picture that lies in a folder.

use std::fs::{self, OpenOptions};
use std::io::{Cursor, Write};
use std::path::Path;

use super::files::unusable;
use super::{FilesProjectorSettings, MonotonicClock, Painter};
use crate::capture::{CaptureError, Clock, Projector, ProjectorFactory, ProjectorLimits};
use crate::patterns::{Pattern, Primary};
use crate::store::{self, StoreError};

/// What was asked for: running number, frame of the sequence, its file, moment of the request on the monotonic clock. The
/// frame of a shot is the last one asked for before it.
const SHOWN: &str = "shown.csv";
/// The frame to show.
const CURRENT: &str = "current.png";
const PREFIX: &str = "frame-";

/// The folder before it is used.
pub(super) struct FilesProjectorFactory {
    settings: FilesProjectorSettings,
    painter: Painter,
}

impl FilesProjectorFactory {
    pub fn new(settings: &FilesProjectorSettings, painter: Painter) -> Self {
        Self { settings: settings.clone(), painter }
    }
}

impl ProjectorFactory for FilesProjectorFactory {
    fn limits(&self) -> Result<ProjectorLimits, CaptureError> {
        let s = &self.settings;
        Ok(ProjectorLimits {
            name: format!("files in {}", s.folder.display()),
            width: s.width_px,
            height: s.height_px,
            refresh_hz: s.refresh_hz,
            memory: None,
        })
    }

    fn open(&self) -> Result<Box<dyn Projector>, CaptureError> {
        let (settings, painter) = (self.settings.clone(), self.painter.clone());
        let ready = store::create_dir(&settings.folder)
            .and_then(|()| store::write_quickly(&settings.folder.join(SHOWN), b"request,frame,file,asked_s\n"));
        let remedy = "set projector.folder to one that can be written to";
        ready.map_err(|e| unusable("projector", &settings.folder, &e, remedy))?;
        Ok(Box::new(FilesProjector { settings, painter, frames: Vec::new(), requests: 0 }))
    }
}

struct FilesProjector {
    settings: FilesProjectorSettings,
    painter: Painter,
    /// The sequence as PNGs.
    frames: Vec<Vec<u8>>,
    requests: usize,
}

impl FilesProjector {
    fn failed(step: String, reason: String) -> CaptureError {
        CaptureError::Device { device: "projector", step, reason }
    }

    fn name(index: usize) -> String {
        format!("{PREFIX}{index:05}.png")
    }

    fn encoded(&self, pattern: &Pattern) -> Result<Vec<u8>, CaptureError> {
        let (w, h) = (pattern.width as u32, pattern.height as u32);
        let mut bytes = Cursor::new(Vec::new());
        let written = if pattern.light == Primary::White {
            let grey = image::GrayImage::from_raw(w, h, pattern.codes.to_vec()).expect("one code for each pixel");
            grey.write_to(&mut bytes, image::ImageFormat::Png)
        } else {
            let rgb =
                image::RgbImage::from_raw(w, h, self.painter.rgb(pattern).concat()).expect("three for each pixel");
            rgb.write_to(&mut bytes, image::ImageFormat::Png)
        };
        written.map_err(|e| Self::failed("load".into(), format!("cannot encode PNG: {e}")))?;
        Ok(bytes.into_inner())
    }

    /// Removes frames of an earlier, longer sequence.
    fn tidy(&self) {
        for index in self.frames.len().. {
            if fs::remove_file(self.settings.folder.join(Self::name(index))).is_err() {
                return;
            }
        }
    }
}

fn append(path: &Path, line: &str) -> Result<(), StoreError> {
    let written = OpenOptions::new().append(true).open(path).and_then(|mut file| file.write_all(line.as_bytes()));
    written.map_err(|source| StoreError::Write { path: path.to_owned(), source })
}

impl Projector for FilesProjector {
    fn load(&mut self, sequence: &[Pattern]) -> Result<(), CaptureError> {
        let (width, height) = (self.settings.width_px, self.settings.height_px);
        if let Some(bad) = sequence.iter().find(|p| (p.width, p.height) != (width, height)) {
            let reason = format!("a {} x {} frame for a panel of {width} x {height}", bad.width, bad.height);
            return Err(Self::failed("load".into(), reason));
        }
        self.frames = sequence.iter().map(|pattern| self.encoded(pattern)).collect::<Result<_, _>>()?;
        for (i, bytes) in self.frames.iter().enumerate() {
            store::write_quickly(&self.settings.folder.join(Self::name(i)), bytes)?;
        }
        self.tidy();
        Ok(())
    }

    fn show(&mut self, index: usize) -> Result<f64, CaptureError> {
        let folder = &self.settings.folder;
        let Some(bytes) = self.frames.get(index) else {
            let reason = format!("the sequence has {} frames", self.frames.len());
            return Err(Self::failed(format!("show frame {index}"), reason));
        };
        store::write_quickly(&folder.join(CURRENT), bytes)?;
        self.requests += 1;
        let now_s = MonotonicClock.now_s();
        append(&folder.join(SHOWN), &format!("{},{index},{},{now_s:.6}\n", self.requests, Self::name(index)))?;
        Ok(now_s + self.settings.settle_s)
    }

    fn restore(&mut self) -> Result<(), CaptureError> {
        Ok(())
    }
}
