//! A camera that is another program: it saves frames into a folder, in order of name, one for each shot asked for.

use std::collections::{HashSet, VecDeque};
use std::ffi::OsString;
use std::fs::{self, OpenOptions};
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use super::grey_image::{GreyError, GreyImage};
use super::{FilesCameraSettings, MonotonicClock};
use crate::capture::{
    Camera, CameraFactory, CameraLimits, CaptureError, Clock, Control, Frame, FrameFlags, Triggering,
};
use crate::store::{self, StoreError};

/// How often the folder is looked at.
const POLL: Duration = Duration::from_millis(10);
/// What the program is asked for: number of the shot, exposure time, moment of the request on the monotonic clock.
const SHOTS: &str = "shots.csv";

/// The folder before it is used.
pub(super) struct FilesCameraFactory(FilesCameraSettings, Control);

impl FilesCameraFactory {
    pub fn new(settings: &FilesCameraSettings, control: &Control) -> Self {
        Self(settings.clone(), control.clone())
    }
}

impl CameraFactory for FilesCameraFactory {
    fn limits(&self) -> Result<CameraLimits, CaptureError> {
        let s = &self.0;
        Ok(CameraLimits {
            name: format!("files in {}", s.folder.display()),
            width: s.width_px,
            height: s.height_px,
            shortest_s: s.shortest_s,
            longest_s: s.longest_s,
            exposure_step_s: 0.0,
            settling_frames: 0,
            triggering: Triggering::Triggered,
            frame_s: 0.0,
            readout_s: 0.0,
        })
    }

    fn open(&self) -> Result<Box<dyn Camera>, CaptureError> {
        let settings = self.0.clone();
        let ready = store::create_dir(&settings.folder)
            .and_then(|()| store::write_quickly(&settings.folder.join(SHOTS), b"shot,exposure_s,asked_s\n"));
        ready
            .map_err(|e| unusable("camera", &settings.folder, &e, "set camera.folder to one that can be written to"))?;
        let seen = names(&settings.folder).into_iter().collect();
        let exposure_s = settings.shortest_s;
        let control = self.1.clone();
        Ok(Box::new(FilesCamera { settings, control, seen, exposure_s, shot: 0, sequence: 0, ready: VecDeque::new() }))
    }
}

/// Why a folder will not do.
pub(super) fn unusable(device: &'static str, folder: &Path, e: &StoreError, remedy: &'static str) -> CaptureError {
    let why = std::error::Error::source(e).map_or_else(|| e.to_string(), ToString::to_string);
    let (name, problem) = (format!("files in {}", folder.display()), format!("cannot be used: {why}"));
    CaptureError::Limits { device, name, problem, remedy }
}

struct FilesCamera {
    settings: FilesCameraSettings,
    control: Control,
    /// Files that are of no interest any more.
    seen: HashSet<OsString>,
    exposure_s: f64,
    shot: u64,
    sequence: u64,
    ready: VecDeque<Frame>,
}

impl FilesCamera {
    fn failed(&self, step: &str, reason: String) -> CaptureError {
        CaptureError::Device { device: "camera", step: step.into(), reason }
    }

    /// Asks for a shot.
    fn ask(&mut self) -> Result<f64, CaptureError> {
        self.shot += 1;
        let asked_s = MonotonicClock.now_s();
        let line = format!("{},{},{asked_s:.6}\n", self.shot, self.exposure_s);
        let path = self.settings.folder.join(SHOTS);
        let written = OpenOptions::new().append(true).open(&path).and_then(|mut f| f.write_all(line.as_bytes()));
        written.map_err(|e| self.failed("ask for a shot", format!("cannot write {}: {e}", path.display())))?;
        if std::io::stderr().is_terminal() {
            let folder = self.settings.folder.display();
            eprintln!("shot {}: expose {:.4} s and save the frame into {folder}", self.shot, self.exposure_s);
        }
        Ok(asked_s)
    }

    /// The next file, as soon as it is whole.
    fn wait(&mut self) -> Result<GreyImage, CaptureError> {
        let deadline_s = MonotonicClock.now_s() + self.settings.timeout_s;
        let mut unfinished = None;
        loop {
            if self.control.aborted() {
                return Err(CaptureError::Stopped { done: 0, total: 0 });
            }
            let mut fresh = names(&self.settings.folder);
            fresh.retain(|name| !self.seen.contains(name));
            fresh.sort();
            if let Some(name) = fresh.first() {
                let path = self.settings.folder.join(name);
                match fs::read(&path).map_err(|e| GreyError::Unfinished(e.to_string())).and_then(|b| GreyImage::of(&b))
                {
                    Ok(image) => {
                        self.seen.insert(name.clone());
                        return Ok(image);
                    }
                    Err(GreyError::Unfinished(why)) => unfinished = Some((path, why)),
                    Err(error) => {
                        return Err(self.failed("read a frame", format!("{}: {error}", path.display())));
                    }
                }
            }
            if MonotonicClock.now_s() > deadline_s {
                return Err(self.late(unfinished));
            }
            thread::sleep(POLL);
        }
    }

    fn late(&self, unfinished: Option<(PathBuf, String)>) -> CaptureError {
        let (shot, s) = (self.shot, &self.settings);
        let found = match unfinished {
            Some((path, why)) => format!("{} is not whole ({why})", path.display()),
            None => format!("no new .png or .pgm in {}", s.folder.display()),
        };
        let reason = format!(
            "{found} {} s after it was asked for: does the program run that saves them? Raise camera.timeout_s if it is \
             slow, then resume the run",
            s.timeout_s
        );
        self.failed(&format!("shot {shot}"), reason)
    }
}

/// Names of the frames in a folder.
fn names(folder: &Path) -> Vec<OsString> {
    let frame = |name: &OsString| {
        let path = Path::new(name);
        let hidden = name.to_string_lossy().starts_with('.');
        let kind = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        !hidden && kind.is_some_and(|kind| kind == "png" || kind == "pgm")
    };
    // A folder that is gone has none.
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name()).filter(frame).collect()
}

impl Camera for FilesCamera {
    fn set_exposure(&mut self, exposure_s: f64) -> Result<f64, CaptureError> {
        self.exposure_s = exposure_s;
        Ok(exposure_s)
    }

    fn set_gain(&mut self, _: f64) -> Result<f64, CaptureError> {
        Ok(1.0)
    }

    fn start(&mut self, first: u64) -> Result<(), CaptureError> {
        self.ready.clear();
        self.sequence = first;
        Ok(())
    }

    /// Returns with the frame: nobody says when the program exposes, so nothing may change before.
    fn trigger(&mut self) -> Result<(), CaptureError> {
        let timestamp_s = self.ask()?;
        let GreyImage { width, height, samples } = self.wait()?;
        self.ready.push_back(Frame {
            width,
            height,
            samples,
            exposure_s: self.exposure_s,
            gain: 1.0,
            sequence: self.sequence,
            timestamp_s,
            flags: FrameFlags::default(),
        });
        self.sequence += 1;
        Ok(())
    }

    fn receive(&mut self, timeout_s: f64) -> Result<Option<Frame>, CaptureError> {
        let frame = self.ready.pop_front();
        if frame.is_none() {
            MonotonicClock.sleep_until_s(MonotonicClock.now_s() + timeout_s);
        }
        Ok(frame)
    }

    fn restore(&mut self) -> Result<(), CaptureError> {
        Ok(())
    }
}
