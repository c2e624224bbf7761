use super::super::list;
use super::*;

const BENCH: &str = r#"
format = 1

[camera]
driver = "v4l"
device = "/dev/video2"
format = "Y16"
width_px = 1360
height_px = 1024
bits = 12
shift = 4

[projector]
driver = "kms"
connector = "HDMI-A-1"
"#;

/// It must be refused with these words.
fn refused(text: &str, said: &[&str]) {
    let error = DevicesFile::from_toml(text).unwrap_err().to_string();
    assert!(said.iter().all(|s| error.contains(s)), "{error}\n{text}");
}

#[test]
fn what_is_not_said_has_a_default() {
    let file = DevicesFile::from_toml(BENCH).unwrap();
    let CameraSettings::V4l(camera) = &file.camera else { panic!("{:?}", file.camera) };
    assert_eq!((camera.bits, camera.shift, camera.settling_frames, camera.buffers), (Some(12), 4, 2, 4));
    assert_eq!((camera.timestamp, camera.slows_down), (Stamp::Auto, false));
    let ProjectorSettings::Kms(projector) = &file.projector else { panic!("{:?}", file.projector) };
    assert_eq!((projector.card.as_path(), projector.width_px), (Path::new("/dev/dri/card0"), None));
    assert_eq!((file.camera.driver(), file.projector.driver()), (Driver::V4l, Driver::Kms));
}

#[test]
fn what_is_written_is_read_again() {
    let file = DevicesFile::from_toml(BENCH).unwrap();
    assert_eq!(DevicesFile::from_toml(&file.to_toml()).unwrap(), file);
}

#[test]
fn what_is_listed_can_be_pasted() {
    let listed = list().found;
    let table = |role| {
        let found = listed.iter().find(|f| f.role == role && f.driver == Driver::Files).unwrap();
        found.toml.clone().unwrap()
    };
    let text = format!("format = 1\n{}\n{}", table(super::super::Role::Camera), table(super::super::Role::Projector));
    DevicesFile::from_toml(&text).unwrap();
}

#[test]
fn all_drivers_can_be_named_in_any_build() {
    let camera = ["driver = \"aravis\"\npixel_format = \"Mono12\"", "driver = \"files\"\nfolder = \"in\""];
    let projector = [
        "driver = \"window\"\nmonitor = \"HDMI-1\"",
        "driver = \"files\"\nfolder = \"out\"\nwidth_px = 800\nheight_px = 600\nrefresh_hz = 60",
    ];
    for camera in camera {
        for projector in projector {
            let size = "width_px = 4\nheight_px = 4";
            let text = format!("format = 1\n[camera]\n{camera}\n{size}\n[projector]\n{projector}\n");
            DevicesFile::from_toml(&text).unwrap();
        }
    }
}

#[test]
fn mistakes_are_named() {
    let with = |from: &str, to: &str| {
        assert!(BENCH.contains(from));
        BENCH.replacen(from, to, 1)
    };
    refused("", &["format", "zonal devices"]);
    refused(&with("format = 1", "format = 2"), &["format = 2", "format 1"]);
    refused(&with("\"v4l\"", "\"vfl\""), &["vfl", "v4l", "aravis", "files"]);
    refused(&with("\"kms\"", "\"v4l\""), &["v4l", "kms", "window"]);
    refused(&with("\"Y16\"", "\"MJPG\""), &["MJPG", "GREY", "RG16"]);
    refused(&with("width_px = 1360", "width = 1360"), &["width"]);
    refused(&with("width_px = 1360", "width_px = 1"), &["camera.width_px = 1", "2..="]);
    refused(&with("width_px = 1360", "width_px = -3"), &["-3"]);
    refused(&with("bits = 12", "bits = 13"), &["camera.bits = 13", "1..=12"]);
    refused(&with("shift = 4", "shift = 16"), &["camera.bits = 12"]);
    refused(&with("bits = 12\nshift = 4", "shift = 16"), &["camera.shift = 16", "0..=15"]);
    refused(&with("shift = 4", "buffers = 1"), &["camera.buffers = 1", "2..=32"]);
    refused(&with("shift = 4", "settling_frames = 99"), &["camera.settling_frames = 99"]);
    refused(&with("shift = 4", "frame_rate_hz = 0"), &["camera.frame_rate_hz = 0", "above 0"]);
    refused(&with("shift = 4", "readout_s = nan"), &["camera.readout_s = NaN"]);
    refused(&with("shift = 4", "fixed_exposure_s = inf"), &["camera.fixed_exposure_s = inf"]);
    refused(&with("connector = \"HDMI-A-1\"", "width_px = 800"), &["projector.width_px", "both"]);
    refused(&with("[projector]", "[projektor]"), &["projektor"]);
    refused(&format!("{BENCH}\n[sample]\n"), &["sample"]);
}
