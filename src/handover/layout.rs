//! Where the meridian section lies on its sheet.

use super::Parts;
use super::canvas::Place;

/// Sheets of ISO 5457 lying, mm.
const SHEETS: [[f64; 2]; 4] = [[420.0, 297.0], [594.0, 420.0], [841.0, 594.0], [1189.0, 841.0]];
/// Border of the frame: wider on the left, for the file.
pub(super) const BORDER: [f64; 2] = [20.0, 10.0];
/// Room on the left of the dome for ray names and heights, and on its right for notes and heights.
pub(super) const ROOM: [f64; 2] = [50.0, 72.0];
/// Width of the block of tables and titles.
pub(super) const BLOCK: f64 = 148.0;
/// Room under the sample's plane for diameters.
const UNDER: f64 = 42.0;
/// The axis is broken where it shows nothing: from so far above the dome to so far below C, if that saves some length.
const ABOVE_DOME: f64 = 30.0;
const BELOW_CENTRE: f64 = 20.0;
const LEAST_SAVED: f64 = 30.0;
/// Room that the break takes, and what C needs above it.
const BREAK: f64 = 6.0;
const ABOVE_CENTRE: f64 = 15.0;

/// The sheet, and where things lie on it.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    /// Width and height.
    pub sheet: [f64; 2],
    /// The axis in the sample's plane: the sample.
    pub origin: Place,
    /// Heights between which the axis is broken.
    pub broken: Option<[f64; 2]>,
    /// Greatest radius of the dome with its wall.
    pub half: f64,
}

impl Layout {
    /// For a section whose outline is given in (r, z).
    pub(super) fn new(parts: &Parts, outline: &[[f64; 2]]) -> Self {
        let most = |axis: usize| outline.iter().map(|p| p[axis]).fold(0.0, f64::max);
        let (half, top, centre) = (most(0), most(1), parts.mirrors().centre().z);
        let cut = [top + ABOVE_DOME, centre - BELOW_CENTRE];
        let broken = (cut[1] - cut[0] > LEAST_SAVED).then_some(cut);
        let saved = broken.map_or(0.0, |[lo, hi]| hi - lo - BREAK);
        let height = centre.max(top + ABOVE_DOME) - saved + ABOVE_CENTRE;
        let need = [BORDER[0] + BORDER[1] + ROOM[0] + 2.0 * half + ROOM[1] + BLOCK, 2.0 * BORDER[1] + height + UNDER];
        let sheet = SHEETS.into_iter().find(|s| need[0] <= s[0] && need[1] <= s[1]).unwrap_or(need.map(f64::ceil));
        let spare = [0, 1].map(|i| (sheet[i] - need[i]) / 2.0);
        let origin = [BORDER[0] + ROOM[0] + half + spare[0], sheet[1] - BORDER[1] - UNDER - spare[1]];
        Self { sheet, origin, broken, half }
    }

    /// The place of a point at the distance `x` right of the axis and the height `z`; none lie in the break.
    pub(super) fn at(&self, x: f64, z: f64) -> Place {
        let raised = match self.broken {
            Some([lo, hi]) if z > lo => z - (hi - lo - BREAK),
            _ => z,
        };
        [self.origin[0] + x, self.origin[1] - raised]
    }

    /// Right edge of the dome's figures, left edge of the block of tables.
    pub(super) fn block(&self) -> f64 {
        self.sheet[0] - BORDER[1] - BLOCK
    }
}
