//! An output of a graphics card without a desktop on it (DRM/KMS): exact pixels, and the moment each frame is sent.

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use drm::control::{Device as Control, Mode, ModeFlags, ModeTypeFlags, connector, crtc};
use drm::{Device as Drm, DriverCapability};

use super::display::cannot;
use super::kms_output::KmsOutput;
use super::{Driver, Found, KmsSettings, Painter, ProjectorSettings, Role};
use crate::capture::{CaptureError, Projector, ProjectorFactory, ProjectorLimits};

/// Where cards are.
const CARDS: &str = "/dev/dri";
/// Relative difference of refresh rates that are taken for the same: modes of 60 Hz have 59.94 to 60.32. The nearest is chosen.
const SAME_RATE: f64 = 1e-2;

/// A graphics card's node.
#[derive(Debug)]
pub(super) struct Card(File);

impl AsFd for Card {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

impl Drm for Card {}
impl Control for Card {}

impl Card {
    fn open(path: &Path) -> Result<Self, CaptureError> {
        let name = path.display().to_string();
        let opened =
            OpenOptions::new().read(true).write(true).custom_flags(libc::O_NONBLOCK | libc::O_CLOEXEC).open(path);
        opened.map(Self).map_err(|e| match e.kind() {
            ErrorKind::NotFound => cannot(&name, "is not there", "`zonal devices` lists what is"),
            ErrorKind::PermissionDenied => cannot(
                &name,
                "may not be opened by you",
                "join the group that owns it (`sudo usermod -aG video $USER`) and log in again",
            ),
            _ => cannot(
                &name,
                format!("cannot be opened as a graphics card ({e})"),
                "`zonal devices` lists those there are",
            ),
        })
    }

    /// Whether flips are stamped by the clock of the bench.
    pub fn is_monotonic(&self) -> bool {
        self.get_driver_capability(DriverCapability::MonotonicTimestamp).is_ok_and(|cap| cap == 1)
    }

    /// What it is connected to.
    fn connected(&self) -> io::Result<Vec<connector::Info>> {
        let handles = self.resource_handles()?;
        let all = handles.connectors().iter().map(|&handle| self.get_connector(handle, true));
        let all: Vec<connector::Info> = all.collect::<io::Result<_>>()?;
        Ok(all.into_iter().filter(|c| c.state() == connector::State::Connected && !c.modes().is_empty()).collect())
    }

    /// A scanout engine for a connector: the one it has, or one that nobody uses.
    fn crtc(&self, connector: &connector::Info) -> io::Result<Option<crtc::Handle>> {
        if let Some(encoder) = connector.current_encoder()
            && let Some(crtc) = self.get_encoder(encoder)?.crtc()
        {
            return Ok(Some(crtc));
        }
        let handles = self.resource_handles()?;
        for &encoder in connector.encoders() {
            for crtc in handles.filter_crtcs(self.get_encoder(encoder)?.possible_crtcs()) {
                if self.get_crtc(crtc)?.mode().is_none() {
                    return Ok(Some(crtc));
                }
            }
        }
        Ok(None)
    }
}

/// A connector's name as the kernel writes it: `HDMI-A-1`.
fn name_of(connector: &connector::Info) -> String {
    format!("{}-{}", connector.interface().as_str(), connector.interface_id())
}

/// Refresh rate of a mode, Hz, to more digits than the kernel's whole numbers.
pub(super) fn refresh_hz(mode: &Mode) -> f64 {
    let (line, frame) = (f64::from(mode.hsync().2), f64::from(mode.vsync().2));
    let rate = 1e3 * f64::from(mode.clock()) / (line * frame);
    let interlaced = if mode.flags().contains(ModeFlags::INTERLACE) { 2.0 } else { 1.0 };
    let doubled = if mode.flags().contains(ModeFlags::DBLSCAN) { 0.5 } else { 1.0 };
    let repeated = 1.0 / f64::from(mode.vscan().max(1));
    let rate = rate * interlaced * doubled * repeated;
    if rate.is_finite() && rate > 0.0 { rate } else { f64::from(mode.vrefresh()) }
}

fn mode_text(mode: &Mode) -> String {
    let (width, height) = mode.size();
    format!("{width} x {height} px at {:.3} Hz", refresh_hz(mode))
}

/// What was chosen on a card.
pub(super) struct Chosen {
    /// Card and connector, for messages.
    pub name: String,
    pub connector: connector::Handle,
    pub crtc: crtc::Handle,
    pub mode: Mode,
}

/// An output before it is opened.
pub struct Kms {
    settings: KmsSettings,
    painter: Painter,
}

impl Kms {
    /// One of these settings; nothing is opened.
    pub fn new(settings: &KmsSettings, painter: Painter) -> Self {
        Self { settings: settings.clone(), painter }
    }

    fn choose(&self, card: &Card) -> Result<Chosen, CaptureError> {
        let path = self.settings.card.display().to_string();
        let no_kms = |e: io::Error| {
            cannot(&path, format!("cannot be asked for its displays ({e})"), "`zonal devices` lists cards that can")
        };
        let connected = card.connected().map_err(no_kms)?;
        let names: Vec<String> = connected.iter().map(name_of).collect();
        let connector = match (&self.settings.connector, &connected[..]) {
            (_, []) => {
                return Err(cannot(&path, "is connected to no display", "plug the projector in and switch it on"));
            }
            (Some(wanted), _) => connected.iter().find(|c| name_of(c) == *wanted).ok_or_else(|| {
                let problem = format!("has no display at {wanted}, only at {}", names.join(", "));
                cannot(&path, problem, "correct `connector` in the devices file, or plug the projector in")
            })?,
            (None, [only]) => only,
            (None, _) => {
                let problem = format!("has displays at {}", names.join(", "));
                return Err(cannot(&path, problem, "say which with `connector` in the devices file"));
            }
        };
        let name = format!("{} of {path}", name_of(connector));
        let mode = self.mode(connector.modes()).ok_or_else(|| {
            let modes: Vec<String> = connector.modes().iter().map(mode_text).collect();
            let problem = format!("has no such mode, but {}", modes.join(", "));
            cannot(&name, problem, "change width_px, height_px and refresh_hz in the devices file")
        })?;
        let crtc = card.crtc(connector).map_err(no_kms)?;
        let crtc = crtc.ok_or_else(|| cannot(&name, "is left without a scanout engine", "unplug another display"))?;
        Ok(Chosen { name, connector: connector.handle(), crtc, mode })
    }

    /// The mode that is asked for; of several the one nearest to the rate, then the preferred one, then the fastest.
    fn mode(&self, modes: &[Mode]) -> Option<Mode> {
        let s = &self.settings;
        let preferred = |mode: &Mode| mode.mode_type().contains(ModeTypeFlags::PREFERRED);
        let wanted = match (s.width_px, s.height_px) {
            (Some(width), Some(height)) => (width, height),
            _ => modes.iter().find(|m| preferred(m)).or(modes.first()).map(size)?,
        };
        let fits = |mode: &&Mode| {
            size(mode) == wanted && s.refresh_hz.is_none_or(|hz| (refresh_hz(mode) / hz - 1.0).abs() < SAME_RATE)
        };
        let off = |mode: &Mode| s.refresh_hz.map_or(0.0, |hz| (refresh_hz(mode) / hz - 1.0).abs());
        let better = |a: &&Mode, b: &&Mode| {
            let nearer = off(b).total_cmp(&off(a));
            nearer.then(preferred(a).cmp(&preferred(b))).then(refresh_hz(a).total_cmp(&refresh_hz(b)))
        };
        modes.iter().filter(fits).max_by(better).copied()
    }
}

fn size(mode: &Mode) -> (u32, u32) {
    let (width, height) = mode.size();
    (u32::from(width), u32::from(height))
}

impl ProjectorFactory for Kms {
    fn limits(&self) -> Result<ProjectorLimits, CaptureError> {
        let Chosen { name, mode, .. } = self.choose(&Card::open(&self.settings.card)?)?;
        let (width, height) = mode.size();
        let (width, height) = (usize::from(width), usize::from(height));
        Ok(ProjectorLimits { name, width, height, refresh_hz: refresh_hz(&mode), memory: None })
    }

    fn open(&self) -> Result<Box<dyn Projector>, CaptureError> {
        let card = Card::open(&self.settings.card)?;
        let chosen = self.choose(&card)?;
        card.acquire_master_lock().map_err(|_| {
            cannot(
                &chosen.name,
                "belongs to another program, a desktop most likely",
                "use driver = \"window\" on the desktop, or leave it (Ctrl-Alt-F3, or `sudo systemctl isolate \
                 multi-user.target`) and run this from the console",
            )
        })?;
        Ok(Box::new(KmsOutput::new(card, chosen, self.painter.clone())?))
    }
}

/// Every display that is connected, and every card that cannot be used.
///
/// # Errors
/// None: a card that fails is listed as one.
pub(super) fn list() -> Result<Vec<Found>, CaptureError> {
    let entries = fs::read_dir(CARDS).into_iter().flatten().filter_map(Result::ok);
    let is_card = |path: &PathBuf| path.file_name().is_some_and(|n| n.to_string_lossy().starts_with("card"));
    let mut cards: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(is_card).collect();
    cards.sort();
    Ok(cards.iter().flat_map(|path| of_card(path)).collect())
}

fn of_card(path: &Path) -> Vec<Found> {
    let unusable = |why| vec![Found::unusable(Role::Projector, Driver::Kms, path.display().to_string(), why)];
    let card = match Card::open(path) {
        Ok(card) => card,
        Err(error) => return unusable(error.to_string()),
    };
    match card.connected() {
        Ok(connected) => connected.iter().map(|connector| of_connector(path, connector)).collect(),
        Err(error) => unusable(format!("{error}: it has no displays")),
    }
}

fn of_connector(path: &Path, connector: &connector::Info) -> Found {
    let mut settings = KmsSettings {
        card: path.to_owned(),
        connector: Some(name_of(connector)),
        width_px: None,
        height_px: None,
        refresh_hz: None,
    };
    if let Some(mode) = (Kms { settings: settings.clone(), painter: Painter::default() }).mode(connector.modes()) {
        let (width, height) = size(&mode);
        (settings.width_px, settings.height_px) = (Some(width), Some(height));
    }
    let details = connector.modes().iter().map(mode_text).collect();
    let name = format!("{} of {}", name_of(connector), path.display());
    Found::projector(name, details, &ProjectorSettings::Kms(settings))
}
