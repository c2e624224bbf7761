//! The whole chain in a guest (`bash tests/vm/run.sh device_chain`): the engine shows lobes on a display by KMS; the host reads
//! what the display really shows, and the simulated rig turns it into frames of a USB camera that the kernel's own driver
//! reads. Nothing on the way knows what is measured.
#![cfg(all(feature = "kms", feature = "v4l"))]

mod common;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use zonal::calibrate::{CalibrationSet, GRAY_CARD_ALBEDO, GrayCardCheck};
use zonal::devices::{DeviceBench, DevicesFile, Operator};
use zonal::measure::Measurement;
use zonal::optics::Rig;
use zonal::patterns::{AutomaticBracket, ExposureBracket, Plan};

/// Of z_00, for the mean over directions of any coefficient in any channel.
const GRAY_CARD: f64 = 5e-3;
/// Time for the kernel to make a camera of what is plugged in.
const PLUGGED_IN: Duration = Duration::from_secs(30);

/// The host's camera, plugged in if it is not yet: its node.
fn camera() -> PathBuf {
    if let Some(node) = node() {
        return node;
    }
    let address = std::env::var("ZONAL_VM_CAMERA").expect("run this by `bash tests/vm/run.sh`");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/vm/uvc_camera.py");
    let plugged = Command::new("python3").args(["-B", script, "plug"]).args(address.split(' ')).status().unwrap();
    assert!(plugged.success(), "the camera cannot be plugged in");
    let begun = Instant::now();
    loop {
        if let Some(node) = node() {
            return node;
        }
        assert!(begun.elapsed() < PLUGGED_IN, "the kernel sees no camera");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// The simulated camera's node for frames; it has another one for what belongs to them.
fn node() -> Option<PathBuf> {
    let nodes = fs::read_dir("/sys/class/video4linux").unwrap().map(|entry| entry.unwrap().path());
    let is = |path: &Path, file: &str, what: &str| fs::read_to_string(path.join(file)).is_ok_and(|s| s.contains(what));
    let mut nodes = nodes.filter(|path| is(path, "name", "simulated camera") && is(path, "index", "0"));
    Some(Path::new("/dev").join(nodes.next()?.file_name()?)).filter(|node| node.exists())
}

/// The camera computes a picture it has not seen before in seconds: its frames are waited for that long.
fn bench(rig: &Rig, node: &Path) -> DeviceBench {
    let (c, p) = (&rig.camera, &rig.projector);
    let text = format!(
        "format = 1\n[camera]\ndriver = \"v4l\"\ndevice = {node:?}\nformat = \"Y12\"\nwidth_px = {}\nheight_px = {}\n\
         frame_rate_hz = 15.0\nslows_down = true\ntimestamp = \"end\"\nreadout_s = 20.0\nsettling_frames = 0\n\
         [projector]\ndriver = \"kms\"\nwidth_px = {}\nheight_px = {}\nrefresh_hz = {}\n",
        c.width_px, c.height_px, p.width_px, p.height_px, p.refresh_hz
    );
    DeviceBench::new(&DevicesFile::from_toml(&text).unwrap(), rig, Operator::Gone).unwrap()
}

/// The gray card, measured through the chain.
fn gray_card(plan: &Plan) -> (Measurement, GrayCardCheck) {
    let rig = common::rig("ghosh-2007-built");
    let folder = std::env::var_os("ZONAL_VM_CALIBRATION").expect("run this by `bash tests/vm/run.sh`");
    let calibration = CalibrationSet::read(Path::new(&folder), &rig).unwrap();
    let begun = Instant::now();
    let measured = common::measured(&rig, plan, &mut bench(&rig, &camera()), &calibration, None).unwrap();
    let check = GrayCardCheck::new(&measured.coefficients, GRAY_CARD_ALBEDO);
    println!("{check:?}\n{:?}\n{:.0} s", measured.record.capture, begun.elapsed().as_secs_f64());
    assert!(measured.record.capture.tagged, "the patch has told frames apart");
    (measured, check)
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn a_gray_card_of_order_2_matches_its_analytic_values() {
    let bracket = ExposureBracket { count: 1, shortest_refreshes: 16, spacing: 2 };
    let plan = Plan { exposure: Some(bracket), ..Plan::of_order(2) };
    let (measured, check) = gray_card(&plan);
    assert_eq!(measured.record.frames, plan.frames());
    assert!(check.worst_error < GRAY_CARD, "{check:?}");
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn exposures_are_chosen_by_what_the_camera_saw() {
    const NOISE_REL: f64 = 0.002;
    let automatic = AutomaticBracket { noise_rel: NOISE_REL, shortest_refreshes: 4, longest_refreshes: 64 };
    let (measured, check) = gray_card(&Plan { exposure: None, automatic: Some(automatic), ..Plan::of_order(0) });
    let sum = |values: &[f32]| values.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>();
    let noise = (sum(&measured.coefficients.sigma) / sum(&measured.coefficients.values)).sqrt();
    println!("{} frames, noise {noise:.2e} of z_00", measured.record.frames);
    // A dark and a lit one of the shortest, and what they asked for.
    assert!(measured.record.frames > 2, "the shortest alone has too much noise");
    assert!(noise < 1.1 * NOISE_REL, "{noise}");
    assert!(check.worst_error < GRAY_CARD, "{check:?}");
}
