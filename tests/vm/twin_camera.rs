//! `twin_camera RIG MATERIAL`: what the simulated rig's camera sees of a display.
//!
//! For each frame stdin holds a line `EXPOSURE_S WIDTH HEIGHT` and the display's pixels, red, green and blue; stdout gets the
//! sensor's samples, 16 bits each, little-endian. It knows no plan and no basis: only rig, sample and what is displayed.

use std::io::{self, BufRead, Write};
use std::sync::Arc;

use anyhow::{Context, Result, bail, ensure};
use zonal::capture::{Bench, Camera, Clock, Projector};
use zonal::optics::Rig;
use zonal::patterns::Pattern;
use zonal::reflectance;
use zonal::twin::{TwinBench, TwinConfig};

/// Time given to the simulated projector before an exposure, s: longer than its latency.
const SETTLED_S: f64 = 1.0;
/// Seed of the sensor's noise.
const SEED: u64 = 1;

/// The simulated rig, with one frame on its display.
struct Twin {
    camera: Box<dyn Camera>,
    projector: Box<dyn Projector>,
    clock: Arc<dyn Clock>,
    shown: Option<Vec<u8>>,
}

impl Twin {
    fn new(rig: &Rig, material: &str) -> Result<Self> {
        let bench = TwinBench::new(rig, TwinConfig::pinhole(SEED), reflectance::open(material)?);
        let mut camera = bench.camera().open()?;
        camera.start(0)?;
        Ok(Self { camera, projector: bench.projector().open()?, clock: bench.clock(), shown: None })
    }

    fn expose(&mut self, display: Pattern, exposure_s: f64) -> Result<Vec<u16>> {
        if self.shown.as_deref() != Some(&*display.codes) {
            self.projector.load(std::slice::from_ref(&display))?;
            self.projector.show(0)?;
            self.clock.sleep_until_s(self.clock.now_s() + SETTLED_S);
            self.shown = Some(display.codes.to_vec());
        }
        self.camera.set_exposure(exposure_s)?;
        self.camera.trigger()?;
        Ok(self.camera.receive(SETTLED_S)?.context("the simulated camera is silent")?.samples)
    }
}

/// The next display and exposure time, or `None` at the end of input.
fn asked(input: &mut impl BufRead) -> Result<Option<(Pattern, f64)>> {
    let mut line = String::new();
    if input.read_line(&mut line)? == 0 {
        return Ok(None);
    }
    let words: Vec<&str> = line.split_whitespace().collect();
    let [exposure_s, width, height] = words[..] else { bail!("not a line `EXPOSURE_S WIDTH HEIGHT`: {line:?}") };
    let (exposure_s, width, height) = (exposure_s.parse()?, width.parse()?, height.parse()?);
    let mut rgb = vec![0; 3 * width * height];
    input.read_exact(&mut rgb)?;
    ensure!(rgb.chunks_exact(3).all(|p| p[0] == p[1] && p[1] == p[2]), "the display is coloured: show frames in white");
    let codes = rgb.chunks_exact(3).map(|p| p[0]).collect();
    Ok(Some((Pattern { codes, ..Pattern::full(width, height, 0) }, exposure_s)))
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [rig, material] = &arguments[..] else { bail!("usage: twin_camera RIG MATERIAL") };
    let rig = Rig::from_toml(&std::fs::read_to_string(rig).with_context(|| format!("cannot read {rig}"))?)?;
    let mut twin = Twin::new(&rig, material)?;
    let (mut input, mut output) = (io::stdin().lock(), io::stdout().lock());
    while let Some((display, exposure_s)) = asked(&mut input)? {
        let samples = twin.expose(display, exposure_s)?;
        output.write_all(&samples.iter().flat_map(|s| s.to_le_bytes()).collect::<Vec<u8>>())?;
        output.flush()?;
    }
    Ok(())
}
