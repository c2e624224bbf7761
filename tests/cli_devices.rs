//! Devices files, and devices that are not there or cannot do what is asked: found out before anything is written.

#[allow(dead_code)]
mod program;

use std::fs;
use std::path::{Path, PathBuf};

use program::{json, refused, zonal};
use tempfile::TempDir;

const RIG: &str = "optics/ghosh-2007-built.toml";
const PLAN: &str = "patterns/order-0.toml";
const FILES: &str = "driver = \"files\"\nfolder = \"FOLDER\"\nwidth_px = WIDTH\nheight_px = HEIGHT\n";

/// A devices file in a folder of its own.
struct Desk(TempDir);

impl Desk {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// A file with these tables.
    fn file(&self, camera: &str, projector: &str) -> String {
        let path = self.path("devices.toml");
        fs::write(&path, format!("format = 1\n[camera]\n{camera}\n[projector]\n{projector}\n")).unwrap();
        path.display().to_string()
    }

    fn folder(&self, name: &str, width: usize, height: usize) -> String {
        let folder = self.path(name).display().to_string();
        FILES.replace("FOLDER", &folder).replace("WIDTH", &width.to_string()).replace("HEIGHT", &height.to_string())
    }

    fn camera(&self) -> String {
        self.folder("frames", 1360, 1024)
    }

    fn projector(&self) -> String {
        self.folder("patterns", 800, 600) + "refresh_hz = 60\n"
    }

    /// Neither command may do anything with these devices.
    fn refuses(&self, file: &str, said: &[&str]) {
        let out = self.path("out").display().to_string();
        refused(&["measure", RIG, PLAN, "--devices", file, "--yes", "--out", &out], said);
        refused(&["calibrate", "response", RIG, "--devices", file, "--yes", "--out", &out], said);
        let left: Vec<_> = fs::read_dir(self.0.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert!(left.iter().all(|name| Path::new(name).extension().is_some()), "{left:?}");
    }
}

#[test]
fn a_file_that_is_none_is_refused() {
    let desk = Desk::new();
    desk.refuses("no-such-file.toml", &["no-such-file.toml", "check the path"]);
    let file = desk.file("driver = \"webcam\"", &desk.projector());
    desk.refuses(&file, &["devices.toml", "webcam", "v4l", "zonal devices"]);
    let file = desk.file(&desk.camera(), &(desk.projector() + "gamma = 2\n"));
    desk.refuses(&file, &["gamma"]);
    let file = desk.file(&(desk.camera() + "timeout_s = -1\n"), &desk.projector());
    desk.refuses(&file, &["camera.timeout_s = -1", "above 0"]);
}

#[test]
fn devices_that_do_not_fit_the_rig_are_refused() {
    let desk = Desk::new();
    let file = desk.file(&desk.camera(), &(desk.folder("patterns", 640, 480) + "refresh_hz = 60\n"));
    desk.refuses(&file, &["projector", "640 x 480", "800 x 600", "native mode"]);
    let file = desk.file(&desk.camera(), &(desk.folder("patterns", 800, 600) + "refresh_hz = 75\n"));
    desk.refuses(&file, &["75 Hz", "60"]);
    let file = desk.file(&desk.folder("frames", 640, 480), &desk.projector());
    desk.refuses(&file, &["camera", "640 x 480", "1360 x 1024"]);
    let file = desk.file(&(desk.camera() + "longest_s = 0.1\n"), &desk.projector());
    let out = desk.path("out").display().to_string();
    refused(&["measure", RIG, PLAN, "--devices", &file, "--yes", "--out", &out], &["100 ms", "266.667 ms"]);
    assert!(!desk.path("out").exists());
}

#[test]
fn folders_and_times_that_cannot_be_are_refused() {
    let desk = Desk::new();
    let file = desk.file(&desk.camera(), &(desk.projector() + "settle_s = 1e30\n"));
    desk.refuses(&file, &["projector.settle_s", "up to 3600"]);
    let out = desk.path("out").display().to_string();
    let calibrate = |file: &str, said: &[&str]| {
        refused(&["calibrate", "response", RIG, "--devices", file, "--yes", "--out", &out], said);
        assert!(!desk.path("out").exists());
    };
    fs::write(desk.path("taken.txt"), "a file").unwrap();
    let taken = desk.folder("taken.txt", 1360, 1024);
    calibrate(&desk.file(&taken, &desk.projector()), &["taken.txt", "set camera.folder"]);
    let taken = desk.folder("taken.txt", 800, 600) + "refresh_hz = 60\n";
    calibrate(&desk.file(&desk.camera(), &taken), &["taken.txt", "set projector.folder"]);
}

/// What a driver says if it is built in, its device not being there, and if not.
fn said<'a>(built_in: bool, device: &'a str, needs: &'a [&'a str]) -> Vec<&'a str> {
    if built_in { vec![device] } else { needs.to_vec() }
}

#[test]
fn drivers_that_are_not_built_in_say_what_they_need() {
    let desk = Desk::new();
    let size = "width_px = 1360\nheight_px = 1024\n";
    let v4l = format!("driver = \"v4l\"\ndevice = \"/dev/none\"\nformat = \"Y16\"\n{size}");
    let needs = said(cfg!(feature = "v4l"), "/dev/none", &["--features v4l", "libclang"]);
    desk.refuses(&desk.file(&v4l, &desk.projector()), &needs);
    let aravis = format!("driver = \"aravis\"\ncamera = \"none-such\"\npixel_format = \"Mono12\"\n{size}");
    let needs = said(cfg!(feature = "aravis"), "none-such", &["--features aravis", "libaravis-dev"]);
    desk.refuses(&desk.file(&aravis, &desk.projector()), &needs);
    let needs = said(cfg!(feature = "kms"), "/dev/dri/none", &["--features kms"]);
    desk.refuses(&desk.file(&desk.camera(), "driver = \"kms\"\ncard = \"/dev/dri/none\""), &needs);
    let needs = said(cfg!(feature = "window"), ":99", &["--features window"]);
    desk.refuses(&desk.file(&desk.camera(), "driver = \"window\"\ndisplay = \":99\""), &needs);
}

#[test]
#[cfg(feature = "v4l")]
fn a_camera_that_is_not_there_is_refused() {
    let desk = Desk::new();
    let camera = |device: &str| {
        format!("driver = \"v4l\"\ndevice = \"{device}\"\nformat = \"Y16\"\nwidth_px = 1360\nheight_px = 1024\n")
    };
    let file = desk.file(&camera("/dev/no-such-camera"), &desk.projector());
    desk.refuses(&file, &["/dev/no-such-camera", "is not there", "zonal devices"]);
    let file = desk.file(&camera("/dev/null"), &desk.projector());
    desk.refuses(&file, &["/dev/null", "no camera"]);
    let file = desk.file(&camera("/tmp"), &desk.projector());
    desk.refuses(&file, &["/tmp", "cannot be opened as a camera"]);
}

#[test]
#[cfg(feature = "kms")]
fn a_card_that_is_none_is_refused() {
    let desk = Desk::new();
    for card in ["/tmp", "/dev/null"] {
        let file = desk.file(&desk.camera(), &format!("driver = \"kms\"\ncard = \"{card}\""));
        desk.refuses(&file, &[card, "zonal devices"]);
    }
}

#[test]
fn options_that_contradict_each_other_are_refused() {
    let desk = Desk::new();
    let file = desk.file(&desk.camera(), &desk.projector());
    let out = desk.path("out").display().to_string();
    let measure = ["measure", RIG, PLAN, "--out", &out];
    refused(&measure, &["--devices", "--simulate"]);
    refused(&["calibrate", "map", RIG, "--out", &out], &["--devices", "--simulate"]);
    refused(&[&measure[..], &["--devices", &file, "--simulate", "red-plastic"]].concat(), &["--simulate"]);
    refused(&[&measure[..], &["--devices", &file, "--yes", "--twin", "finite"]].concat(), &["--twin"]);
    let list = desk.path("list.toml");
    fs::write(&list, "[[sample]]\nname = \"one\"\n").unwrap();
    let batch = ["--devices", &file, "--batch", list.to_str().unwrap()];
    refused(&[&measure[..], &batch].concat(), &["nobody"]);
    // No terminal is there in a test.
    refused(&[&measure[..], &["--devices", &file]].concat(), &["nobody", "--yes"]);
    refused(&["calibrate", "align", RIG, "--devices", &file, "--yes", "--out", &out], &["one thing after the other"]);
    // Calibrations of the simulated rig are none of a real one.
    refused(&[&measure[..], &["--devices", &file, "--yes"]].concat(), &["must be calibrated", "--calibration"]);
    assert!(!desk.path("out").exists());
}

#[test]
fn devices_lists_every_driver_with_what_can_be_pasted() {
    let listed = json(&["devices"]);
    let text = listed.to_string();
    assert!(listed["found"].as_array().unwrap().iter().any(|f| f["driver"] == "files" && f["role"] == "projector"));
    assert!(["v4l", "aravis", "kms", "window"].iter().all(|driver| text.contains(driver)), "{text}");
    let output = zonal(&["devices"]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && said.contains("[camera]") && said.contains("format = 1"), "{said}");
}

#[test]
fn first_light_fails_plainly() {
    let desk = Desk::new();
    let file = desk.file(&(desk.camera() + "timeout_s = 0.1\n"), &desk.projector());
    let output = zonal(&["--json", "first-light", RIG, &file]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(found["findings"].as_array().is_some_and(|f| !f.is_empty()), "{found}");
    assert!(
        said.contains("good  projector") && said.contains("FAILS camera") && said.contains("no new .png"),
        "{said}"
    );
}
