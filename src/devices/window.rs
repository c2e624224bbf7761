//! A borderless window over a whole monitor of an X11 desktop: exact pixels, without scaling.

use x11rb::connection::Connection;
use x11rb::protocol::randr::{ConnectionExt as _, Crtc, ModeFlag, ModeInfo, Rotation};
use x11rb::protocol::render::Transform;
use x11rb::protocol::xproto::{ConnectionExt as _, ImageOrder, VisualClass};
use x11rb::rust_connection::RustConnection;

use super::display::{cannot, failed};
use super::window_output::WindowOutput;
use super::{Driver, Found, Painter, ProjectorSettings, Role, WindowSettings};
use crate::capture::{CaptureError, Projector, ProjectorFactory, ProjectorLimits};

/// What can go wrong between here and the X server.
pub(super) type XError = Box<dyn std::error::Error>;

/// A connection to an X server, and the screen on it.
pub(super) struct Desktop {
    pub connection: RustConnection,
    screen: usize,
}

/// A part of a screen that is a monitor.
#[derive(Debug, Clone)]
pub(super) struct Monitor {
    pub name: String,
    primary: bool,
    /// First column and row on the screen.
    pub origin: (i16, i16),
    pub size: (u16, u16),
    /// The scanout engine, where the server knows one.
    pub crtc: Option<Crtc>,
    refresh_hz: Option<f64>,
    /// Scaled or turned by the server.
    transformed: bool,
}

impl Desktop {
    fn open(settings: &WindowSettings) -> Result<Self, CaptureError> {
        let name = settings.display.as_deref();
        let shown = name.map_or_else(|| std::env::var("DISPLAY").unwrap_or_default(), str::to_owned);
        let connected = RustConnection::connect(name).map_err(|e| {
            let problem = format!("is no X display that lets you in ({e})");
            let remedy =
                "run this on the desktop, or say `display` in the devices file; without a desktop use driver = \"kms\"";
            cannot(&format!("display \"{shown}\""), problem, remedy)
        });
        let (connection, screen) = connected?;
        let desktop = Self { connection, screen };
        let setup = desktop.connection.setup();
        let visual = desktop.screen().allowed_depths.iter().flat_map(|d| &d.visuals);
        let visual = visual.into_iter().find(|v| v.visual_id == desktop.screen().root_visual);
        let exact = visual.is_some_and(|v| {
            v.class == VisualClass::TRUE_COLOR && (v.red_mask, v.green_mask, v.blue_mask) == (0xff_0000, 0xff00, 0xff)
        });
        if !exact || desktop.screen().root_depth != 24 || setup.image_byte_order != ImageOrder::LSB_FIRST {
            let remedy = "set the desktop to 24-bit colour (`DefaultDepth 24`), or use driver = \"kms\"";
            return Err(cannot(&format!("display \"{shown}\""), "does not show 8 bits of each colour", remedy));
        }
        Ok(desktop)
    }

    pub fn screen(&self) -> &x11rb::protocol::xproto::Screen {
        &self.connection.setup().roots[self.screen]
    }

    fn monitors(&self) -> Result<Vec<Monitor>, XError> {
        let (c, root) = (&self.connection, self.screen().root);
        let resources = c.randr_get_screen_resources_current(root)?.reply()?;
        let mut monitors = Vec::new();
        for info in c.randr_get_monitors(root, true)?.reply()?.monitors {
            let name = String::from_utf8_lossy(&c.get_atom_name(info.name)?.reply()?.name).into_owned();
            let mut monitor = Monitor {
                name,
                primary: info.primary,
                origin: (info.x, info.y),
                size: (info.width, info.height),
                crtc: None,
                refresh_hz: None,
                transformed: false,
            };
            // One of several engines would say nothing of the others.
            if let [output] = info.outputs[..] {
                let crtc = c.randr_get_output_info(output, resources.config_timestamp)?.reply()?.crtc;
                if crtc != 0 {
                    let state = c.randr_get_crtc_info(crtc, resources.config_timestamp)?.reply()?;
                    let transform = c.randr_get_crtc_transform(crtc)?.reply()?.current_transform;
                    monitor.crtc = Some(crtc);
                    monitor.refresh_hz = resources.modes.iter().find(|m| m.id == state.mode).and_then(refresh_hz);
                    monitor.transformed = !is_identity(&transform) || state.rotation != Rotation::ROTATE0;
                }
            }
            monitors.push(monitor);
        }
        Ok(monitors)
    }
}

fn refresh_hz(mode: &ModeInfo) -> Option<f64> {
    let pixels = f64::from(mode.htotal) * f64::from(mode.vtotal);
    let interlaced = if mode.mode_flags.contains(ModeFlag::INTERLACE) { 2.0 } else { 1.0 };
    let doubled = if mode.mode_flags.contains(ModeFlag::DOUBLE_SCAN) { 0.5 } else { 1.0 };
    Some(f64::from(mode.dot_clock) / pixels * interlaced * doubled).filter(|hz| hz.is_finite() && *hz > 0.0)
}

fn is_identity(t: &Transform) -> bool {
    let ones = t.matrix11 == t.matrix22 && t.matrix22 == t.matrix33 && t.matrix11 != 0;
    let zeros = [t.matrix12, t.matrix13, t.matrix21, t.matrix23, t.matrix31, t.matrix32];
    ones && zeros.iter().all(|&x| x == 0)
}

/// A window before it is opened.
pub struct Window {
    settings: WindowSettings,
    painter: Painter,
}

impl Window {
    /// One of these settings; nothing is opened.
    pub fn new(settings: &WindowSettings, painter: Painter) -> Self {
        Self { settings: settings.clone(), painter }
    }

    fn choose(&self, desktop: &Desktop) -> Result<(Monitor, f64), CaptureError> {
        let monitors = desktop.monitors().map_err(|e| failed("look for monitors", e))?;
        let names: Vec<&str> = monitors.iter().map(|m| m.name.as_str()).collect();
        let names = names.join(", ");
        let others: Vec<&Monitor> = monitors.iter().filter(|m| !m.primary).collect();
        let monitor = match (&self.settings.monitor, &monitors[..], &others[..]) {
            (Some(wanted), ..) => monitors.iter().find(|m| m.name == *wanted).ok_or_else(|| {
                let problem = format!("has no monitor {wanted}, but {names}");
                cannot("the desktop", problem, "correct `monitor` in the devices file, or plug the projector in")
            })?,
            (None, [only], _) => only,
            (None, _, [only]) => *only,
            _ => {
                let problem = format!("has the monitors {names}");
                return Err(cannot("the desktop", problem, "say which with `monitor` in the devices file"));
            }
        };
        if monitor.transformed {
            let remedy = "show pixels as they are: `xrandr --output NAME --scale 1x1 --rotate normal`";
            return Err(cannot(&monitor.name, "is scaled or turned by the desktop", remedy));
        }
        let refresh_hz = self.settings.refresh_hz.or(monitor.refresh_hz).ok_or_else(|| {
            let remedy = "say `refresh_hz` in the devices file";
            cannot(&monitor.name, "refreshes at a rate that the desktop does not know", remedy)
        })?;
        Ok((monitor.clone(), refresh_hz))
    }
}

impl ProjectorFactory for Window {
    fn limits(&self) -> Result<ProjectorLimits, CaptureError> {
        let (monitor, refresh_hz) = self.choose(&Desktop::open(&self.settings)?)?;
        let (width, height) = (usize::from(monitor.size.0), usize::from(monitor.size.1));
        Ok(ProjectorLimits { name: monitor.name, width, height, refresh_hz, memory: None })
    }

    fn open(&self) -> Result<Box<dyn Projector>, CaptureError> {
        let desktop = Desktop::open(&self.settings)?;
        let (monitor, refresh_hz) = self.choose(&desktop)?;
        Ok(Box::new(WindowOutput::new(desktop, monitor, refresh_hz, self.painter.clone())?))
    }
}

/// Every monitor of the desktop; none where there is no desktop.
///
/// # Errors
/// [`CaptureError`] if there is a desktop and it cannot be used.
pub(super) fn list() -> Result<Vec<Found>, CaptureError> {
    let settings = WindowSettings { display: None, monitor: None, refresh_hz: None };
    if std::env::var_os("DISPLAY").is_none() {
        return Ok(Vec::new());
    }
    let monitors = Desktop::open(&settings)?.monitors().map_err(|e| failed("look for monitors", e))?;
    Ok(monitors.iter().map(found).collect())
}

fn found(monitor: &Monitor) -> Found {
    let ((width, height), (x, y)) = (monitor.size, monitor.origin);
    let rate = monitor.refresh_hz.map_or("at a rate to be said".into(), |hz| format!("at {hz:.3} Hz"));
    let place = if monitor.primary { "the primary monitor" } else { "a monitor" };
    let details = vec![format!("{place}, {width} x {height} px {rate}, at ({x}, {y})")];
    if monitor.transformed {
        let problem = "it is scaled or turned: `xrandr --output NAME --scale 1x1 --rotate normal`";
        return Found::unusable(Role::Projector, Driver::Window, monitor.name.clone(), problem.into());
    }
    let refresh_hz = if monitor.refresh_hz.is_some() { None } else { Some(60.0) };
    let settings = WindowSettings { display: None, monitor: Some(monitor.name.clone()), refresh_hz };
    Found::projector(monitor.name.clone(), details, &ProjectorSettings::Window(settings))
}
