//! The response of a camera that delivers codes of 8 bits, not samples in proportion to light.

use super::CalibrateError;
use crate::capture::{Bench, Crop, Placement, capture_frames};
use crate::optics::Rig;
use crate::patterns::{Pattern, Primary, Timing};
use crate::radiometry::{CODES, CameraResponse, Stack};

/// Exposures, each twice the one before, from one refresh period on.
const EXPOSURES: i32 = 9;
/// Pixels that are compared.
const PIXELS: usize = 4000;
/// Codes from the darkest and from the brightest there is that do not follow the light: they also stand for all beyond.
const ENDS: [u8; 2] = [2, 4];
/// How smooth Debevec's curve is.
const SMOOTHNESS: f64 = 10.0;

/// How a response is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResponseMethod {
    /// Debevec and Malik (1997): smooth.
    Debevec,
    /// Robertson, Borman and Stevenson (2003): maximum likelihood, rough.
    Robertson,
}

/// Measures what the codes of a camera mean: photographs of a ramp from black to white on the screen, with exposures that
/// double. An even light would show few codes.
///
/// Exposures of all 256 codes, relative to that of code 128. The coded patch cannot be read before, and a first frame that is
/// not used gives the projector time.
///
/// # Errors
/// [`CalibrateError::ManyCodes`] for samples above 255, [`CalibrateError::Stack`], and what capturing says.
pub fn camera_codes(rig: &Rig, bench: &mut dyn Bench, method: ResponseMethod) -> Result<Vec<f64>, CalibrateError> {
    bench.place(Placement::Screen)?;
    let mut rig = rig.clone();
    rig.projector.tag = false;
    rig.camera.codes_dn = None;
    let p = &rig.projector;
    let codes = (0..p.width_px * p.height_px).map(|i| (i % p.width_px * 255 / (p.width_px - 1).max(1)) as u8).collect();
    let ramp = Pattern { width: p.width_px, height: p.height_px, codes, light: Primary::White };
    let refresh_s = Timing::of(&rig).refresh_s;
    let longest_s = refresh_s * 2f64.powi(EXPOSURES - 1);
    let steps = (0..EXPOSURES).map(|i| refresh_s * 2f64.powi(i));
    let exposures_s: Vec<f64> = std::iter::once(longest_s).chain(steps).collect();
    let crop = Crop::of_zone(&rig);
    // Of a mosaic, one colour.
    let one = |&i: &usize| {
        let (column, row) = crop.sensor_pixel(i);
        rig.camera.mosaic.channels(column, row).contains(&1)
    };
    let pixels: Vec<usize> = (0..crop.len()).filter(one).collect();
    let pixels: Vec<usize> = pixels.iter().copied().step_by((pixels.len() / PIXELS).max(1)).collect();
    let (mut images, mut brightest) = (Vec::new(), 0);
    capture_frames(&rig, bench, &[ramp], &exposures_s, crop, &mut |_, shot, taken| {
        if shot > 0 {
            brightest = taken.samples.iter().copied().fold(brightest, u16::max);
            images.push(pixels.iter().map(|&i| taken.samples[i].min(255) as u8).collect::<Vec<u8>>());
        }
    })?;
    if usize::from(brightest) >= CODES {
        return Err(CalibrateError::ManyCodes { brightest });
    }
    let views: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
    // A full well may end below the last code.
    let usable = ENDS[0]..=(brightest as u8).saturating_sub(ENDS[1]);
    let stack = Stack::new(&views, &exposures_s[1..], usable)?;
    let response = match method {
        ResponseMethod::Debevec => CameraResponse::debevec(&stack, SMOOTHNESS)?,
        ResponseMethod::Robertson => CameraResponse::robertson(&stack)?,
    };
    Ok(response.exposures().to_vec())
}
