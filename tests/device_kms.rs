//! Projectors by KMS, in a guest whose display the host can read: `bash tests/vm/run.sh device_kms`.
#![cfg(feature = "kms")]

mod common;

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use zonal::capture::Bench;
use zonal::devices::{DeviceBench, DevicesFile, Operator, Painter};
use zonal::optics::Rig;
use zonal::patterns::{Pattern, Plan, Primary, TagLayout};

fn rig() -> Rig {
    common::rig("ghosh-2007-built")
}

fn bench(more: &str) -> DeviceBench {
    let text = format!(
        "format = 1\n[camera]\ndriver = \"files\"\nfolder = \"in\"\nwidth_px = 4\nheight_px = 4\n\
         [projector]\ndriver = \"kms\"\n{more}"
    );
    DeviceBench::new(&DevicesFile::from_toml(&text).unwrap(), &rig(), Operator::Gone).unwrap()
}

/// What the guest's display shows: width, height, and red, green and blue of every pixel.
fn displayed(name: &str) -> (usize, usize, Vec<[u8; 3]>) {
    let folder = PathBuf::from(std::env::var_os("ZONAL_VM").expect("run this by `bash tests/vm/run.sh`"));
    let picture = folder.join(name);
    // The host takes a question away as soon as it sees it.
    let asked = folder.join("question");
    fs::write(&asked, "").unwrap();
    fs::rename(asked, folder.join(format!("{name}.wanted"))).unwrap();
    let begun = Instant::now();
    while !picture.exists() {
        assert!(begun.elapsed() < Duration::from_secs(20), "the host does not answer");
        std::thread::sleep(Duration::from_millis(10));
    }
    let bytes = fs::read(picture).unwrap();
    let head: Vec<&[u8]> = bytes.splitn(4, |&b| b == b'\n').collect();
    let [b"P6", size, b"255", pixels] = head[..] else { panic!("the host's picture is no PPM") };
    let size: Vec<usize> = std::str::from_utf8(size).unwrap().split(' ').map(|n| n.parse().unwrap()).collect();
    (size[0], size[1], pixels.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect())
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn the_display_shows_every_pixel_of_every_frame() {
    let rig = rig();
    let (painter, layout) = (Painter::of(&rig), TagLayout::of(&rig).unwrap());
    let bench = bench("width_px = 800\nheight_px = 600\n");
    let limits = bench.projector().limits().unwrap();
    assert_eq!((limits.width, limits.height), (800, 600));
    let mut projector = bench.projector().open().unwrap();
    let lobes = common::lobe_frames(&rig, &Plan::of_order(2));
    let coded = lobes.iter().enumerate().map(|(i, p)| layout.draw(p, layout.code(i), 200));
    let mut frames: Vec<Pattern> = coded.step_by(3).collect();
    frames.push(frames[2].clone().in_light(Primary::Blue));
    projector.load(&frames).unwrap();
    let (clock, period_s) = (bench.clock(), 1.0 / limits.refresh_hz);
    for (i, frame) in frames.iter().enumerate().rev() {
        let asked_s = clock.now_s();
        let lit_s = projector.show(i).unwrap();
        // Flips are stamped by this clock, and come with one of the next refreshes.
        assert!(lit_s > asked_s + 0.5 * period_s && lit_s < clock.now_s() + 2.0 * period_s, "{asked_s} {lit_s}");
        let (width, height, found) = displayed(&format!("lobe-{i}"));
        assert_eq!((width, height), (800, 600));
        let wrong = found.iter().zip(painter.rgb(frame)).filter(|(found, wanted)| *found != wanted).count();
        assert_eq!(wrong, 0, "frame {i}");
    }
    assert!(projector.show(frames.len()).is_err());
    assert!(projector.load(&[Pattern::full(640, 480, 0)]).is_err(), "nothing is scaled");
    // Another sequence in the place of the first.
    let white = Pattern::full(800, 600, 255);
    projector.load(std::slice::from_ref(&white)).unwrap();
    projector.show(0).unwrap();
    assert!(displayed("white").2.iter().all(|p| *p == [255; 3]));
    projector.restore().unwrap();
    drop(projector);
    bench.projector().open().unwrap().restore().unwrap();
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn a_larger_mode_can_be_chosen() {
    let bench = bench("width_px = 1024\nheight_px = 768\n");
    let limits = bench.projector().limits().unwrap();
    assert_eq!((limits.width, limits.height), (1024, 768));
    let mut projector = bench.projector().open().unwrap();
    let codes = (0..1024 * 768).map(|i| (i % 251) as u8).collect();
    let frame = Pattern { codes, ..Pattern::full(1024, 768, 0) };
    projector.load(std::slice::from_ref(&frame)).unwrap();
    projector.show(0).unwrap();
    let (width, height, found) = displayed("larger");
    assert_eq!((width, height), (1024, 768));
    assert!(found.iter().zip(frame.codes.iter()).all(|(found, &code)| *found == [code; 3]));
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn what_is_missing_is_said_with_what_helps() {
    let message = |more: &str| bench(more).projector().limits().unwrap_err().to_string();
    let error = message("card = \"/dev/dri/card9\"\n");
    assert!(error.contains("card9") && error.contains("zonal devices"), "{error}");
    let error = message("connector = \"HDMI-A-7\"\n");
    assert!(error.contains("no display at HDMI-A-7, only at Virtual-1"), "{error}");
    let error = message("width_px = 801\nheight_px = 600\n");
    assert!(error.contains("800 x 600 px") && error.contains("change width_px"), "{error}");
    // One program has the card.
    let first = bench("");
    let open = first.projector().open().unwrap();
    let error = first.projector().open().err().unwrap().to_string();
    assert!(error.contains("belongs to another program") && error.contains("window"), "{error}");
    drop(open);
}

#[test]
#[ignore = "needs the devices of tests/vm/run.sh"]
fn the_display_is_listed_with_a_table_that_opens_it() {
    let found = zonal::devices::list().found;
    let display = found.iter().find(|f| f.name.contains("Virtual-1")).expect("the guest has a display");
    let table = display.toml.clone().unwrap();
    let camera = "format = 1\n[camera]\ndriver = \"files\"\nfolder = \"in\"\nwidth_px = 4\nheight_px = 4\n";
    let file = DevicesFile::from_toml(&format!("{camera}{table}")).unwrap();
    DeviceBench::new(&file, &rig(), Operator::Gone).unwrap().projector().limits().unwrap();
}
