//! An output of a graphics card that is open: frames in the card's memory, flipped at the start of a refresh.

use std::collections::VecDeque;
use std::io;
use std::time::Duration;

use drm::buffer::{Buffer, DrmFourcc};
use drm::control::dumbbuffer::DumbBuffer;
use drm::control::{Device as Control, Event, PageFlipFlags, crtc, framebuffer};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::display::{PIXEL_BYTES, cannot, check_size, failed, identity_ramp, is_identity, kept_ready, paint};
use super::kms::{Card, Chosen, refresh_hz};
use super::{MonotonicClock, Painter};
use crate::capture::{CaptureError, Clock, Projector};
use crate::patterns::Pattern;

/// Longest wait for a flip, s: some hundred refreshes; a display that is switched off never flips.
const FLIP_PATIENCE_S: f64 = 2.0;
/// Frames painted when they are shown take turns in this many buffers: one is on display.
const SPARE: usize = 2;

/// A buffer of the card that can be displayed.
struct Surface {
    buffer: DumbBuffer,
    handle: framebuffer::Handle,
}

/// What is put back.
struct Former {
    crtc: crtc::Info,
    gamma: Option<[Vec<u16>; 3]>,
}

/// An output that is open.
pub(super) struct KmsOutput {
    card: Card,
    chosen: Chosen,
    painter: Painter,
    former: Option<Former>,
    black: Surface,
    /// Frames of the sequence that are in the card's memory, from the first on.
    ready: Vec<Surface>,
    sequence: Vec<Pattern>,
    /// For the others.
    spare: VecDeque<Surface>,
}

impl Surface {
    /// A buffer with these pixels.
    fn new(card: &Card, (width, height): (usize, usize), pixels: &[u8]) -> io::Result<Self> {
        let size = (width as u32, height as u32);
        let buffer = card.create_dumb_buffer(size, DrmFourcc::Xrgb8888, 8 * PIXEL_BYTES as u32)?;
        let handle = match card.add_framebuffer(&buffer, 24, 8 * PIXEL_BYTES as u32) {
            Ok(handle) => handle,
            Err(error) => {
                card.destroy_dumb_buffer(buffer)?;
                return Err(error);
            }
        };
        let mut surface = Self { buffer, handle };
        if let Err(error) = surface.fill(card, width, pixels) {
            surface.destroy(card)?;
            return Err(error);
        }
        Ok(surface)
    }

    fn fill(&mut self, card: &Card, width: usize, pixels: &[u8]) -> io::Result<()> {
        let pitch = self.buffer.pitch() as usize;
        let mut map = card.map_dumb_buffer(&mut self.buffer)?;
        let rows = map.chunks_exact_mut(pitch).zip(pixels.chunks_exact(PIXEL_BYTES * width));
        rows.for_each(|(to, from)| to[..from.len()].copy_from_slice(from));
        Ok(())
    }

    fn destroy(self, card: &Card) -> io::Result<()> {
        card.destroy_framebuffer(self.handle)?;
        card.destroy_dumb_buffer(self.buffer)
    }
}

impl KmsOutput {
    /// Sets the mode, with a black frame and codes that reach the display as they are.
    pub fn new(card: Card, chosen: Chosen, painter: Painter) -> Result<Self, CaptureError> {
        let crtc = card.get_crtc(chosen.crtc).map_err(|e| failed("read its mode", e))?;
        let (width, height) = chosen.mode.size();
        let size = (usize::from(width), usize::from(height));
        let black = vec![0; PIXEL_BYTES * size.0 * size.1];
        let black = Surface::new(&card, size, &black).map_err(|e| failed("make a frame", e))?;
        let set = card.set_crtc(chosen.crtc, Some(black.handle), (0, 0), &[chosen.connector], Some(chosen.mode));
        set.map_err(|e| failed("set its mode", e))?;
        let former = Some(Former { crtc, gamma: None });
        let (ready, sequence, spare) = (Vec::new(), Vec::new(), VecDeque::new());
        let mut output = Self { card, chosen, painter, former, black, ready, sequence, spare };
        match output.level_gamma() {
            Ok(()) => Ok(output),
            Err(error) => {
                // The one to report.
                let _ = output.put_back();
                Err(error)
            }
        }
    }

    /// Makes the card's gamma ramp the identity, if it has one.
    fn level_gamma(&mut self) -> Result<(), CaptureError> {
        let crtc = self.chosen.crtc;
        let len = self.card.get_crtc(crtc).map_err(|e| failed("read its gamma ramp", e))?.gamma_length() as usize;
        if len < 2 {
            return Ok(());
        }
        let read = || -> io::Result<[Vec<u16>; 3]> {
            let mut ramps = [(); 3].map(|()| vec![0; len]);
            let [red, green, blue] = &mut ramps;
            self.card.get_gamma(crtc, red, green, blue)?;
            Ok(ramps)
        };
        let former = read().map_err(|e| failed("read its gamma ramp", e))?;
        self.former.iter_mut().for_each(|found| found.gamma = Some(former.clone()));
        let ramp = identity_ramp(len);
        // Also ends what a desktop's night light left in the card.
        self.card.set_gamma(crtc, &ramp, &ramp, &ramp).map_err(|e| failed("set its gamma ramp", e))?;
        let set = read().map_err(|e| failed("read its gamma ramp", e))?;
        if !set.iter().all(|ramp| is_identity(ramp)) {
            let remedy = "choose another card or driver = \"window\"";
            return Err(cannot(&self.chosen.name, "does not take an identity gamma ramp", remedy));
        }
        Ok(())
    }

    fn size(&self) -> (usize, usize) {
        let (width, height) = self.chosen.mode.size();
        (usize::from(width), usize::from(height))
    }

    /// Shows a buffer from the next refresh on; returns when that is over, s.
    fn flip(&self, to: framebuffer::Handle) -> io::Result<f64> {
        self.card.page_flip(self.chosen.crtc, to, PageFlipFlags::EVENT, None)?;
        let deadline_s = MonotonicClock.now_s() + FLIP_PATIENCE_S;
        loop {
            let left_s = deadline_s - MonotonicClock.now_s();
            if left_s <= 0.0 {
                return Err(io::Error::new(io::ErrorKind::TimedOut, "it does not refresh: is it switched off?"));
            }
            let timeout = Timespec { tv_sec: left_s as i64, tv_nsec: (1e9 * left_s.fract()) as i64 };
            match poll(&mut [PollFd::new(&self.card, PollFlags::IN)], Some(&timeout)) {
                Ok(0) | Err(rustix::io::Errno::INTR) => continue,
                Ok(_) => {}
                Err(error) => return Err(error.into()),
            }
            let flips = self.card.receive_events()?.filter_map(|event| match event {
                Event::PageFlip(flip) if flip.crtc == self.chosen.crtc => Some(flip.duration),
                _ => None,
            });
            if let Some(began) = flips.last() {
                // A refresh period takes the frame from its first line to its last.
                return Ok(self.began_s(began) + 1.0 / refresh_hz(&self.chosen.mode));
            }
        }
    }

    fn began_s(&self, stamp: Duration) -> f64 {
        let now_s = MonotonicClock.now_s();
        if self.card.is_monotonic() && !stamp.is_zero() { stamp.as_secs_f64().min(now_s) } else { now_s }
    }

    /// Takes the sequence out of the card's memory; black is shown.
    fn clear(&mut self) -> io::Result<()> {
        self.flip(self.black.handle)?;
        self.sequence.clear();
        self.ready.drain(..).chain(self.spare.drain(..)).try_for_each(|surface| surface.destroy(&self.card))
    }

    fn put_back(&mut self) -> Result<(), CaptureError> {
        let Some(former) = self.former.take() else { return Ok(()) };
        let crtc = self.chosen.crtc;
        let gamma = former.gamma.map_or(Ok(()), |[r, g, b]| self.card.set_gamma(crtc, &r, &g, &b));
        let mode = former.crtc.mode();
        let connectors: &[_] = if mode.is_some() { &[self.chosen.connector] } else { &[] };
        let before = former.crtc.framebuffer().filter(|_| mode.is_some());
        let mode = self.card.set_crtc(crtc, before, former.crtc.position(), connectors, mode);
        // Without a mode it stays dark until another program takes the card over.
        gamma.and(mode).map_err(|e| failed("put back its mode", e))
    }
}

impl Projector for KmsOutput {
    /// Frames that find no room in the card's memory are painted when they are shown, which makes those later.
    fn load(&mut self, sequence: &[Pattern]) -> Result<(), CaptureError> {
        let (width, height) = self.size();
        check_size(sequence, width, height)?;
        self.clear().map_err(|e| failed("load", e))?;
        let ready = kept_ready(sequence.len(), PIXEL_BYTES * width * height);
        for pattern in &sequence[..ready] {
            match Surface::new(&self.card, (width, height), &paint(&self.painter, pattern)) {
                Ok(surface) => self.ready.push(surface),
                // Its memory is full.
                Err(_) => break,
            }
        }
        if self.ready.len() < sequence.len() {
            // Room for the spare ones, if there is none left.
            for _ in 0..SPARE {
                let blank = vec![0; PIXEL_BYTES * width * height];
                let spare = Surface::new(&self.card, (width, height), &blank);
                let spare = spare.or_else(|e| self.ready.pop().ok_or(e)).map_err(|e| failed("load", e))?;
                self.spare.push_back(spare);
            }
        }
        self.sequence = sequence.to_vec();
        Ok(())
    }

    /// Waits for the refresh that the frame begins with, since only then is its time known.
    fn show(&mut self, index: usize) -> Result<f64, CaptureError> {
        let step = format!("show frame {index}");
        if let Some(surface) = self.ready.get(index) {
            return self.flip(surface.handle).map_err(|e| failed(&step, e));
        }
        let frames = self.sequence.len();
        let outside = || failed(&step, format!("the sequence has {frames} frames"));
        let pixels = paint(&self.painter, self.sequence.get(index).ok_or_else(outside)?);
        let width = self.size().0;
        // The front one has been off the display for longest.
        let mut surface = self.spare.pop_front().ok_or_else(outside)?;
        let filled = surface.fill(&self.card, width, &pixels).and_then(|()| self.flip(surface.handle));
        self.spare.push_back(surface);
        filled.map_err(|e| failed(&step, e))
    }

    fn restore(&mut self) -> Result<(), CaptureError> {
        self.put_back()
    }
}

impl Drop for KmsOutput {
    fn drop(&mut self) {
        // Closing the card frees its buffers; what fails here has nobody left to be told.
        let _ = self.put_back();
    }
}
