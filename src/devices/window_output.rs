//! A window that is open: frames in the X server's memory, each shown as the window's background, which the server repaints by
//! itself wherever something covered it.

use x11rb::connection::{Connection, RequestConnection};
use x11rb::protocol::randr::ConnectionExt as _;
use x11rb::protocol::xproto::{
    Blanking, ChangeWindowAttributesAux, ConfigureWindowAux, ConnectionExt as _, CreateGCAux, CreateWindowAux,
    Exposures, Gcontext, ImageFormat, Pixmap, StackMode, Window as WindowId, WindowClass,
};
use x11rb::wrapper::ConnectionExt as _;

use super::display::{PIXEL_BYTES, cannot, check_size, failed, identity_ramp, is_identity, kept_ready, paint};
use super::window::{Desktop, Monitor, XError};
use super::{MonotonicClock, Painter};
use crate::capture::{CaptureError, Clock, Projector};
use crate::patterns::Pattern;

const DEPTH: u8 = 24;
/// Bytes of a request beside the pixels it carries, at most.
const REQUEST_HEAD: usize = 64;

/// A window that is open.
pub(super) struct WindowOutput {
    desktop: Desktop,
    monitor: Monitor,
    refresh_hz: f64,
    painter: Painter,
    window: WindowId,
    gc: Gcontext,
    /// Frames of the sequence in the server's memory, from the first on.
    ready: Vec<Pixmap>,
    sequence: Vec<Pattern>,
    former: Option<Former>,
}

/// What is put back.
#[derive(Default)]
struct Former {
    gamma: Option<[Vec<u16>; 3]>,
    /// Seconds until the screen is saved, and between its pictures.
    saver: Option<(u16, u16, Blanking, Exposures)>,
}

impl WindowOutput {
    /// A black window over the whole monitor, above all others, without a cursor.
    pub fn new(desktop: Desktop, monitor: Monitor, refresh_hz: f64, painter: Painter) -> Result<Self, CaptureError> {
        let opened = (|| -> Result<(WindowId, Gcontext), XError> {
            let (c, screen) = (&desktop.connection, desktop.screen());
            let (window, gc, dot, cursor) = (c.generate_id()?, c.generate_id()?, c.generate_id()?, c.generate_id()?);
            c.create_pixmap(1, dot, screen.root, 1, 1)?;
            // A cursor whose mask has no pixel.
            let blank = c.generate_id()?;
            c.create_gc(blank, dot, &CreateGCAux::new().foreground(0))?;
            c.put_image(ImageFormat::Z_PIXMAP, dot, blank, 1, 1, 0, 0, 0, 1, &[0; 4])?;
            c.create_cursor(cursor, dot, dot, 0, 0, 0, 0, 0, 0, 0, 0)?;
            let look = CreateWindowAux::new().override_redirect(1).background_pixel(screen.black_pixel).cursor(cursor);
            let ((x, y), (width, height)) = (monitor.origin, monitor.size);
            let class = WindowClass::INPUT_OUTPUT;
            c.create_window(DEPTH, window, screen.root, x, y, width, height, 0, class, screen.root_visual, &look)?
                .check()?;
            c.create_gc(gc, window, &CreateGCAux::new().graphics_exposures(0))?;
            c.map_window(window)?;
            c.configure_window(window, &ConfigureWindowAux::new().stack_mode(StackMode::ABOVE))?;
            c.free_cursor(cursor)?;
            c.free_gc(blank)?;
            c.free_pixmap(dot)?;
            c.sync()?;
            Ok((window, gc))
        })();
        let (window, gc) = opened.map_err(|e| failed("open a window", e))?;
        let former = Some(Former::default());
        let (ready, sequence) = (Vec::new(), Vec::new());
        let mut output = Self { desktop, monitor, refresh_hz, painter, window, gc, ready, sequence, former };
        output.level_gamma()?;
        let saver = output.keep_awake().map_err(|e| failed("keep the screen on", e))?;
        output.former.iter_mut().for_each(|former| former.saver = saver);
        Ok(output)
    }

    /// Makes the monitor's gamma ramp the identity, if it has one.
    fn level_gamma(&mut self) -> Result<(), CaptureError> {
        let Some(crtc) = self.monitor.crtc else { return Ok(()) };
        let c = &self.desktop.connection;
        let read = || -> Result<[Vec<u16>; 3], XError> {
            let ramps = c.randr_get_crtc_gamma(crtc)?.reply()?;
            Ok([ramps.red, ramps.green, ramps.blue])
        };
        let former = read().map_err(|e| failed("read its gamma ramp", e))?;
        if former[0].len() < 2 || former.iter().all(|ramp| is_identity(ramp)) {
            return Ok(());
        }
        let ramp = identity_ramp(former[0].len());
        // Put back even if what follows is refused.
        self.former.iter_mut().for_each(|found| found.gamma = Some(former.clone()));
        let set = || -> Result<[Vec<u16>; 3], XError> {
            c.randr_set_crtc_gamma(crtc, &ramp, &ramp, &ramp)?.check()?;
            read()
        };
        let set = set().map_err(|e| failed("set its gamma ramp", e))?;
        if !set.iter().all(|ramp| is_identity(ramp)) {
            let remedy = "end colour management and night light, or use driver = \"kms\"";
            return Err(cannot(&self.monitor.name, "does not take an identity gamma ramp", remedy));
        }
        Ok(())
    }

    /// Turns the screen saver off; returns how it was.
    fn keep_awake(&self) -> Result<Option<(u16, u16, Blanking, Exposures)>, XError> {
        let c = &self.desktop.connection;
        let was = c.get_screen_saver()?.reply()?;
        c.set_screen_saver(0, 0, was.prefer_blanking, was.allow_exposures)?.check()?;
        Ok(Some((was.timeout, was.interval, was.prefer_blanking, was.allow_exposures)))
    }

    fn size(&self) -> (usize, usize) {
        (usize::from(self.monitor.size.0), usize::from(self.monitor.size.1))
    }

    /// A frame in the server's memory.
    fn upload(&self, pattern: &Pattern) -> Result<Pixmap, XError> {
        let c = &self.desktop.connection;
        let (columns, rows) = self.monitor.size;
        let pixels = paint(&self.painter, pattern);
        let pixmap = c.generate_id()?;
        c.create_pixmap(DEPTH, pixmap, self.window, columns, rows)?.check()?;
        let row_bytes = PIXEL_BYTES * usize::from(columns);
        let at_once = ((c.maximum_request_bytes() - REQUEST_HEAD) / row_bytes).max(1);
        for (i, part) in pixels.chunks(at_once * row_bytes).enumerate() {
            let (first, count) = ((i * at_once) as i16, (part.len() / row_bytes) as u16);
            c.put_image(ImageFormat::Z_PIXMAP, pixmap, self.gc, columns, count, 0, first, 0, DEPTH, part)?;
        }
        Ok(pixmap)
    }

    /// Makes a frame the window's background; returns when the server has drawn it.
    fn display(&self, pixmap: Pixmap) -> Result<(), XError> {
        let c = &self.desktop.connection;
        c.change_window_attributes(self.window, &ChangeWindowAttributesAux::new().background_pixmap(pixmap))?;
        c.configure_window(self.window, &ConfigureWindowAux::new().stack_mode(StackMode::ABOVE))?;
        c.clear_area(false, self.window, 0, 0, 0, 0)?;
        Ok(c.sync()?)
    }

    fn free(&mut self) -> Result<(), XError> {
        for pixmap in self.ready.drain(..) {
            self.desktop.connection.free_pixmap(pixmap)?;
        }
        Ok(self.desktop.connection.flush()?)
    }

    fn put_back(&mut self) -> Result<(), XError> {
        let Some(former) = self.former.take() else { return Ok(()) };
        self.free()?;
        let c = &self.desktop.connection;
        if let (Some([red, green, blue]), Some(crtc)) = (former.gamma, self.monitor.crtc) {
            c.randr_set_crtc_gamma(crtc, &red, &green, &blue)?;
        }
        if let Some((timeout, interval, blanking, exposures)) = former.saver {
            c.set_screen_saver(timeout as i16, interval as i16, blanking, exposures)?;
        }
        c.destroy_window(self.window)?;
        Ok(c.sync()?)
    }
}

impl Projector for WindowOutput {
    /// Frames that find no room in the server's memory are sent to it when they are shown, which makes those later.
    fn load(&mut self, sequence: &[Pattern]) -> Result<(), CaptureError> {
        let (width, height) = self.size();
        check_size(sequence, width, height)?;
        self.free().map_err(|e| failed("load", e))?;
        for pattern in &sequence[..kept_ready(sequence.len(), PIXEL_BYTES * width * height)] {
            match self.upload(pattern) {
                Ok(pixmap) => self.ready.push(pixmap),
                // Its memory is full.
                Err(_) => break,
            }
        }
        self.desktop.connection.sync().map_err(|e| failed("load", e))?;
        self.sequence = sequence.to_vec();
        Ok(())
    }

    /// What comes after the server, a compositor and the scanout, it does not know.
    fn show(&mut self, index: usize) -> Result<f64, CaptureError> {
        let step = format!("show frame {index}");
        let frames = self.sequence.len();
        let shown = match (self.ready.get(index), self.sequence.get(index)) {
            (Some(&pixmap), _) => self.display(pixmap),
            (None, Some(pattern)) => self.upload(pattern).and_then(|pixmap| {
                self.display(pixmap)?;
                Ok(self.desktop.connection.free_pixmap(pixmap).map(drop)?)
            }),
            (None, None) => return Err(failed(&step, format!("the sequence has {frames} frames"))),
        };
        shown.map_err(|e| failed(&step, e))?;
        Ok(MonotonicClock.now_s() + 1.0 / self.refresh_hz)
    }

    fn restore(&mut self) -> Result<(), CaptureError> {
        self.put_back().map_err(|e| failed("put back the desktop", e))
    }
}

impl Drop for WindowOutput {
    fn drop(&mut self) {
        // Closing the connection removes the window; what fails here has nobody left to be told.
        let _ = self.put_back();
    }
}
