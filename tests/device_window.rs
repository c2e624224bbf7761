//! Projectors as windows, on an X server without a screen (Xvfb): what it shows is read back pixel by pixel.
#![cfg(feature = "window")]

mod common;

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use x11rb::connection::Connection;
use x11rb::protocol::randr::ConnectionExt as _;
use x11rb::protocol::xproto::{ConnectionExt, ImageFormat};
use x11rb::rust_connection::RustConnection;
use zonal::capture::Bench;
use zonal::devices::{DeviceBench, DevicesFile, Operator, Painter};
use zonal::optics::Rig;
use zonal::patterns::{Pattern, Plan, Primary, TagLayout};

/// Two monitors beside each other: what must stay as it is, and the projector.
const SCREEN: (u16, u16) = (1824, 768);
const PROJECTOR: (i16, i16, u16, u16) = (1024, 0, 800, 600);

/// An X server of its own, ended when this is dropped.
struct Desktop {
    server: Child,
    display: String,
}

impl Desktop {
    fn start() -> Self {
        let mut command = Command::new("Xvfb");
        command.args([
            "-displayfd",
            "1",
            "-nolisten",
            "tcp",
            "-noreset",
            "-screen",
            "0",
            &format!("{}x{}x24", SCREEN.0, SCREEN.1),
        ]);
        let spawned = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn();
        let mut server = spawned.expect("Xvfb is needed: apt install xvfb x11-xserver-utils");
        let mut number = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut number).unwrap();
        let desktop = Self { server, display: format!(":{}", number.trim()) };
        desktop.monitor("CAM", "1024/270x768/200+0+0", "screen");
        let (x, y, width, height) = PROJECTOR;
        desktop.monitor("PROJ", &format!("{width}/200x{height}/150+{x}+{y}"), "none");
        desktop
    }

    fn monitor(&self, name: &str, geometry: &str, output: &str) {
        let mut xrandr = Command::new("xrandr");
        xrandr.args(["--display", &self.display, "--setmonitor", name, geometry, output]);
        assert!(xrandr.status().expect("xrandr is needed: apt install x11-xserver-utils").success());
    }

    /// Red, green and blue of every pixel of the screen.
    fn pixels(&self) -> Vec<[u8; 3]> {
        let (connection, screen) = RustConnection::connect(Some(&self.display)).unwrap();
        let root = connection.setup().roots[screen].root;
        let image = connection.get_image(ImageFormat::Z_PIXMAP, root, 0, 0, SCREEN.0, SCREEN.1, !0).unwrap();
        image.reply().unwrap().data.chunks_exact(4).map(|p| [p[2], p[1], p[0]]).collect()
    }

    fn bench(&self, more: &str) -> DeviceBench {
        let text = format!(
            "format = 1\n[camera]\ndriver = \"files\"\nfolder = \"in\"\nwidth_px = 4\nheight_px = 4\n\
             [projector]\ndriver = \"window\"\ndisplay = \"{}\"\n{more}",
            self.display
        );
        DeviceBench::new(&DevicesFile::from_toml(&text).unwrap(), &rig(), Operator::Gone).unwrap()
    }
}

impl Drop for Desktop {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

fn rig() -> Rig {
    common::rig("ghosh-2007-built")
}

/// Pixels of the projector's monitor that are not `wanted`, and pixels lit beside it.
fn wrong(found: &[[u8; 3]], wanted: &[[u8; 3]]) -> (usize, usize) {
    let (x, y, width, height) = PROJECTOR;
    let (x, y, width, height) = (x as usize, y as usize, usize::from(width), usize::from(height));
    let (mut wrong, mut beside) = (0, 0);
    for (at, pixel) in found.iter().enumerate() {
        let (u, v) = (at % usize::from(SCREEN.0), at / usize::from(SCREEN.0));
        if (x..x + width).contains(&u) && (y..y + height).contains(&v) {
            wrong += usize::from(*pixel != wanted[(v - y) * width + u - x]);
        } else {
            beside += usize::from(*pixel != [0; 3]);
        }
    }
    (wrong, beside)
}

/// Lobes with the coded patch, and one in green.
fn sequence(rig: &Rig) -> Vec<Pattern> {
    let layout = TagLayout::of(rig).unwrap();
    let lobes = common::lobe_frames(rig, &Plan::of_order(2));
    let coded = lobes.iter().enumerate().map(|(i, p)| layout.draw(p, layout.code(i), 200));
    let mut frames: Vec<Pattern> = coded.step_by(3).collect();
    frames.push(frames[2].clone().in_light(Primary::Green));
    frames
}

#[test]
fn the_chosen_monitor_shows_every_pixel_and_no_other_shows_any() {
    let desktop = Desktop::start();
    let (rig, painter) = (rig(), Painter::of(&rig()));
    let bench = desktop.bench("monitor = \"PROJ\"\nrefresh_hz = 60\n");
    let limits = bench.projector().limits().unwrap();
    assert_eq!((limits.name.as_str(), limits.width, limits.height), ("PROJ", 800, 600));
    let mut projector = bench.projector().open().unwrap();
    let frames = sequence(&rig);
    projector.load(&frames).unwrap();
    let black = vec![[0; 3]; 800 * 600];
    assert_eq!(wrong(&desktop.pixels(), &black), (0, 0), "nothing is shown before it is asked for");
    for (i, frame) in frames.iter().enumerate().rev() {
        let clock = bench.clock();
        let asked_s = clock.now_s();
        let lit_s = projector.show(i).unwrap();
        assert!(lit_s > asked_s && lit_s < asked_s + 2.0);
        assert_eq!(wrong(&desktop.pixels(), &painter.rgb(frame)), (0, 0), "frame {i}");
    }
    assert!(projector.show(frames.len()).is_err());
    assert!(projector.load(&[Pattern::full(640, 480, 0)]).is_err(), "nothing is scaled");
    projector.restore().unwrap();
    assert_eq!(wrong(&desktop.pixels(), &black), (0, 0), "the desktop is back");
}

#[test]
fn a_bent_gamma_ramp_is_levelled_and_put_back() {
    let desktop = Desktop::start();
    let (connection, screen) = RustConnection::connect(Some(&desktop.display)).unwrap();
    let root = connection.setup().roots[screen].root;
    let crtc = connection.randr_get_screen_resources_current(root).unwrap().reply().unwrap().crtcs[0];
    let ramps = || {
        let ramps = connection.randr_get_crtc_gamma(crtc).unwrap().reply().unwrap();
        [ramps.red, ramps.green, ramps.blue]
    };
    let size = ramps()[0].len();
    assert!(size > 2, "the server has no gamma ramp");
    let level: Vec<u16> = (0..size).map(|i| (i * 65_535 / (size - 1)) as u16).collect();
    let bent: Vec<u16> = level.iter().map(|&x| (u32::from(x).pow(2) / 65_535) as u16).collect();
    connection.randr_set_crtc_gamma(crtc, &bent, &level, &bent).unwrap().check().unwrap();
    let found = ramps();
    assert_eq!(found[0], bent);
    let bench = desktop.bench("monitor = \"CAM\"\nrefresh_hz = 60\n");
    let mut projector = bench.projector().open().unwrap();
    let off = |ramp: &[u16]| ramp.iter().zip(&level).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
    assert!(ramps().iter().all(|ramp| off(ramp) <= 1), "{:?}", ramps()[0]);
    projector.restore().unwrap();
    assert_eq!(ramps(), found);
}

#[test]
fn what_is_missing_is_said_with_what_helps() {
    let desktop = Desktop::start();
    let message = |more: &str| desktop.bench(more).projector().limits().unwrap_err().to_string();
    let error = message("monitor = \"HDMI-9\"\nrefresh_hz = 60\n");
    assert!(error.contains("no monitor HDMI-9, but") && error.contains("PROJ"), "{error}");
    let error = message("monitor = \"PROJ\"\n");
    assert!(error.contains("say `refresh_hz`"), "{error}");
    let text = "format = 1\n[camera]\ndriver = \"files\"\nfolder = \"in\"\nwidth_px = 4\nheight_px = 4\n\
                [projector]\ndriver = \"window\"\ndisplay = \":4711\"\n";
    let bench = DeviceBench::new(&DevicesFile::from_toml(text).unwrap(), &rig(), Operator::Gone).unwrap();
    let error = bench.projector().limits().unwrap_err().to_string();
    assert!(error.contains(":4711") && error.contains("kms"), "{error}");
}
