//! Where camera and projector stand, from crosses on the optical axis at two heights.

use std::f64::consts::FRAC_PI_4;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::CalibrateError;
use super::crosses::{Cross, Sample, Shape, find};
use super::least_squares::minimise;
use crate::capture::{Bench, Crop, Placement, ResponseImage, capture_frames, sensor};
use crate::optics::{Device, Misaligned, Misalignment, Rig};
use crate::patterns::{Pattern, Primary, Timing};

/// Exposures of each frame, and their length in refresh periods: a screen lit directly is a thousand times darker than a
/// sample lit by the dome.
const SHOTS: usize = 12;
const SHOT_REFRESHES: f64 = 64.0;
/// Camera pixels along each side of a sample: whole cells of a Bayer mosaic.
const BIN: usize = 4;
/// Width of the lines the projector draws, px: they stay dark in spite of its blur.
const DRAWN_PX: f64 = 24.0;
/// Light on the screen may be uneven to this degree.
const UNEVEN: usize = 4;
/// Of the fully lit part of the screen, the share that is used: room for what is misaligned.
const USED: f64 = 0.88;

/// How far one device is off, and how sure that is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviceAlignment {
    /// Lateral displacement of its centre of projection (x, y).
    pub displacement_mm: [f64; 2],
    /// Standard error.
    pub displacement_error_mm: [f64; 2],
    /// Turn about x and y, as in [`Misalignment`].
    pub turn_deg: [f64; 2],
    /// Standard error.
    pub turn_error_deg: [f64; 2],
}

/// `align.json`: what both crosses tell of both devices. Axes are those of the rig as a device sees it, through the beam
/// splitter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisAlignment {
    /// The camera.
    pub camera: DeviceAlignment,
    /// The projector.
    pub projector: DeviceAlignment,
}

impl DeviceAlignment {
    /// What to do, in words; steps below a standard error or two are left out.
    pub fn instruction(&self, name: &str) -> String {
        let worth = |value: f64, error: f64| value.abs() > 2.0 * error;
        let towards = |value: f64, axis: &str| format!("{}{axis}", if value < 0.0 { '+' } else { '-' });
        let mut steps = Vec::new();
        for (axis, i) in [("x", 0), ("y", 1)] {
            let (value, error) = (self.displacement_mm[i], self.displacement_error_mm[i]);
            if worth(value, error) {
                steps.push(format!("move the {name} {:.2} mm towards {}", value.abs(), towards(value, axis)));
            }
        }
        // A positive turn about x looks towards +y, about y towards -x; undone, it looks the other way.
        for (axis, sight, i, sign) in [("x", "y", 0, 1.0), ("y", "x", 1, -1.0)] {
            let (value, error) = (self.turn_deg[i], self.turn_error_deg[i]);
            if worth(value, error) {
                let looks = towards(sign * value, sight);
                steps.push(format!("turn the {name} {:.2} deg about {axis}, to look towards {looks}", value.abs()));
            }
        }
        if steps.is_empty() { format!("the {name} is aligned") } else { steps.join("; ") }
    }
}

impl AxisAlignment {
    /// The same as a misalignment of the rig: of the devices alone.
    pub fn misalignment(&self) -> Misalignment {
        Misalignment {
            camera_displacement_mm: self.camera.displacement_mm,
            camera_turn_deg: self.camera.turn_deg,
            projector_displacement_mm: self.projector.displacement_mm,
            projector_turn_deg: self.projector.turn_deg,
            ..Misalignment::none()
        }
    }
}

/// The four crosses that the camera sees, in its pixels.
struct Seen {
    printed: Cross,
    drawn: Cross,
    wire: Cross,
    shadow: Cross,
}

/// Photographs the crosses and finds the displacement and turn of both devices.
///
/// The printed cross on the screen and the wire cross above it, seen by the camera, give its displacement (their parallax)
/// and its turn; the wires' shadow on the screen and a cross that the projector draws there give those of the projector.
///
/// # Errors
/// [`CalibrateError::NoCross`] and what capturing says.
pub fn align(rig: &Rig, bench: &mut dyn Bench) -> Result<AxisAlignment, CalibrateError> {
    solve(rig, &look(rig, bench)?).ok_or(CalibrateError::NoCross { which: "unambiguous" })
}

fn look(rig: &Rig, bench: &mut dyn Bench) -> Result<Seen, CalibrateError> {
    let (w, h) = (rig.projector.width_px, rig.projector.height_px);
    let [white, black] = [255, 0].map(|code| Pattern::full(w, h, code));
    bench.place(Placement::PrintedCross)?;
    let screen = shots(rig, bench, &[white.clone(), black.clone(), drawn_cross(w, h)])?;
    bench.place(Placement::Crosses)?;
    let wires = shots(rig, bench, &[white, black])?;

    let scale = Scale::of(rig);
    let lens = rig.camera.lens();
    let at = (lens.centre_u, lens.centre_v);
    let lit = |image: &ResponseImage, dark: &ResponseImage| binned(rig, image, dark);
    let (bare, drawn, wired) = (lit(&screen[0], &screen[1]), lit(&screen[2], &screen[1]), lit(&wires[0], &wires[1]));
    let radius = scale.region_px;
    let one = |samples: &[Sample], at, shape, degree, which| {
        let found = find(samples, &[shape], at, radius, degree).ok_or(CalibrateError::NoCross { which })?;
        Ok::<Cross, CalibrateError>(found[0])
    };
    let printed = one(&bare, at, scale.printed, UNEVEN, "printed")?;
    // From here on about the middle of the screen itself: all that is used of it must be lit by the whole pupil.
    let at = (printed.u, printed.v);
    let drawn = one(&ratio(&drawn, &bare), at, scale.drawn, 0, "projected")?;
    let both = find(&ratio(&wired, &bare), &[scale.wire, scale.shadow], at, radius, 0);
    let both = both.ok_or(CalibrateError::NoCross { which: "wire" })?;
    Ok(Seen { printed, drawn, wire: both[0], shadow: both[1] })
}

/// Photographs of patterns on the screen.
///
/// The screen is out of the projector's focus, so that light of the pattern spreads into the coded patch. Without it, a first
/// shot that is not used gives the projector all the time it can need.
fn shots(rig: &Rig, bench: &mut dyn Bench, patterns: &[Pattern]) -> Result<Vec<ResponseImage>, CalibrateError> {
    let mut rig = rig.clone();
    rig.projector.tag = false;
    let exposures = [SHOT_REFRESHES * Timing::of(&rig).refresh_s; SHOTS + 1];
    let mut taken = vec![Vec::with_capacity(SHOTS); patterns.len()];
    let crop = Crop::whole(&rig);
    capture_frames(&rig, bench, patterns, &exposures, crop, &mut |pattern, shot, frame| {
        if shot > 0 {
            taken[pattern].push(frame);
        }
    })?;
    let sensor = sensor(&rig);
    Ok(taken.iter().map(|frames| ResponseImage::merge(&sensor, None, crop, frames)).collect())
}

/// A dark cross on white through the middle of the panel.
fn drawn_cross(width: usize, height: usize) -> Pattern {
    let on = |x: usize, n: usize| (x as f64 + 0.5 - n as f64 / 2.0).abs() < DRAWN_PX / 2.0;
    let code = |p: usize| if on(p % width, width) || on(p / width, height) { 0 } else { 255 };
    Pattern { width, height, light: Primary::White, codes: (0..width * height).map(code).collect() }
}

/// What crosses look like to the camera, from the rig's nominal dimensions, in camera pixels.
struct Scale {
    printed: Shape,
    drawn: Shape,
    wire: Shape,
    shadow: Shape,
    /// Radius of the screen that all of the projector's pupil lights.
    region_px: f64,
}

impl Scale {
    fn of(rig: &Rig) -> Self {
        let a = &rig.alignment;
        let (to_wire, to_screen) = (rig.centre_height_mm - a.wire_height_mm, rig.centre_height_mm - a.screen_height_mm);
        let px = rig.camera.lens().focal_px;
        // Disc that a point becomes: pupil times the difference of the inverse distances to it and to the focus.
        let blur = |pupil: f64, focus: f64, distance: f64| pupil * (1.0 / distance - 1.0 / focus).abs() * px;
        let camera = |distance: f64| blur(rig.camera.pupil_mm(), rig.camera.focus_mm, distance);
        let pupil = rig.projector.pupil_mm();
        let magnified = to_screen / to_wire;
        let shadow_blur = pupil * (magnified - 1.0) / to_screen * px;
        let drawn_blur = blur(pupil, rig.projector.focus_mm, to_screen);
        let sum = |a: f64, b: f64| a.hypot(b);
        let cone = pupil * (to_screen - to_wire) / to_screen;
        let region = (a.opening_radius_mm - cone) * magnified;
        Self {
            printed: Shape { angle: 0.0, width_px: a.line_width_mm / to_screen * px, blur_px: camera(to_screen) },
            drawn: Shape {
                angle: 0.0,
                width_px: DRAWN_PX * px / rig.projector.lens().focal_px,
                blur_px: sum(drawn_blur, camera(to_screen)),
            },
            wire: Shape { angle: FRAC_PI_4, width_px: a.wire_width_mm / to_wire * px, blur_px: camera(to_wire) },
            shadow: Shape {
                angle: FRAC_PI_4,
                width_px: a.wire_width_mm * magnified / to_screen * px,
                blur_px: sum(shadow_blur, camera(to_screen)),
            },
            region_px: USED * region / to_screen * px,
        }
    }
}

/// Light above black in squares of pixels, with standard errors.
fn binned(rig: &Rig, image: &ResponseImage, dark: &ResponseImage) -> Vec<Sample> {
    let (columns, rows) = (rig.camera.width_px / BIN, rig.camera.height_px / BIN);
    let bin = |b: usize| {
        let (u0, v0) = (b % columns * BIN, b / columns * BIN);
        let (mut value, mut variance) = (0.0, 0.0);
        for i in 0..BIN * BIN {
            let p = (v0 + i / BIN) * rig.camera.width_px + u0 + i % BIN;
            value += f64::from(image.rate[p] - dark.rate[p]);
            variance += f64::from(image.variance[p] + dark.variance[p]);
        }
        let middle = BIN as f64 / 2.0;
        Sample { u: u0 as f64 + middle, v: v0 as f64 + middle, value, sigma: variance.sqrt() }
    };
    (0..columns * rows).map(bin).collect()
}

/// One photograph over another: what is even in both is 1. Places that were dark in the other say nothing.
fn ratio(above: &[Sample], below: &[Sample]) -> Vec<Sample> {
    let sound = |(a, b): &(&Sample, &Sample)| a.value.is_finite() && b.value > 5.0 * b.sigma;
    let divide = |(a, b): (&Sample, &Sample)| {
        let value = a.value / b.value;
        Sample { value, sigma: a.sigma.hypot(value * b.sigma) / b.value, ..*a }
    };
    above.iter().zip(below).filter(sound).map(divide).collect()
}

/// The eight numbers that the eight coordinates of four crosses determine.
fn solve(rig: &Rig, seen: &Seen) -> Option<AxisAlignment> {
    // Parameters in mm and tenths of a degree.
    let unpack = |p: &[f64]| Misalignment {
        camera_displacement_mm: [p[0], p[1]],
        camera_turn_deg: [0.1 * p[2], 0.1 * p[3]],
        projector_displacement_mm: [p[4], p[5]],
        projector_turn_deg: [0.1 * p[6], 0.1 * p[7]],
        ..Misalignment::none()
    };
    let a = &rig.alignment;
    let residuals = |p: &[f64]| {
        let m = unpack(p);
        let camera = Misaligned::new(rig, &m, Device::Camera);
        let projector = Misaligned::new(rig, &m, Device::Projector);
        let wire = Point3::new(0.0, 0.0, a.wire_height_mm);
        let lamp = projector.centre();
        let shadow = lamp + (wire - lamp) * ((lamp.z - a.screen_height_mm) / (lamp.z - wire.z));
        let lens = rig.projector.lens();
        let drawn = projector.on_plane(lens.centre_u, lens.centre_v, a.screen_height_mm);
        let expected = [
            (Point3::new(0.0, 0.0, a.screen_height_mm), &seen.printed),
            (wire, &seen.wire),
            (shadow, &seen.shadow),
            (drawn, &seen.drawn),
        ];
        let off = |(point, cross): (Point3<f64>, &Cross)| {
            let (u, v) = camera.image(&point);
            [(u - cross.u) / cross.sigma[0], (v - cross.v) / cross.sigma[1]]
        };
        expected.into_iter().flat_map(off).collect()
    };
    let found = minimise(vec![0.0; 8], &residuals)?;
    let error = |i: usize| found.covariance[(i, i)].sqrt();
    let device = |i: usize| DeviceAlignment {
        displacement_mm: [found.x[i], found.x[i + 1]],
        displacement_error_mm: [error(i), error(i + 1)],
        turn_deg: [0.1 * found.x[i + 2], 0.1 * found.x[i + 3]],
        turn_error_deg: [0.1 * error(i + 2), 0.1 * error(i + 3)],
    };
    Some(AxisAlignment { camera: device(0), projector: device(4) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instructions_undo_what_is_off() {
        let off = DeviceAlignment {
            displacement_mm: [0.48, -0.001],
            displacement_error_mm: [0.01; 2],
            turn_deg: [-0.2, 0.11],
            turn_error_deg: [0.005; 2],
        };
        let said = off.instruction("camera");
        assert_eq!(
            said,
            "move the camera 0.48 mm towards -x; turn the camera 0.20 deg about x, to look towards +y; \
             turn the camera 0.11 deg about y, to look towards +x"
        );
    }
}
