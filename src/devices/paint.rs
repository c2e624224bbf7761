//! A frame of codes as a colour display shows it.

use crate::optics::Rig;
use crate::patterns::{Pattern, Primary, Rect, TagLayout};

/// Turns frames into colours: the coded patch is white in whatever light the rest of a frame is.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Painter {
    patch: Vec<Rect>,
}

impl Painter {
    /// One for frames that carry the patch of `rig`, if it has one.
    pub fn of(rig: &Rig) -> Self {
        let layout = if rig.projector.tag { TagLayout::of(rig) } else { None };
        Self { patch: layout.iter().flat_map(TagLayout::bits).flat_map(|bit| bit.panel).collect() }
    }

    /// Red, green and blue of every pixel, row by row.
    pub fn rgb(&self, pattern: &Pattern) -> Vec<[u8; 3]> {
        let colour = |light: Primary, code: u8| [0, 1, 2].map(|p| if light.lights(p) { code } else { 0 });
        let mut pixels: Vec<[u8; 3]> = pattern.codes.iter().map(|&code| colour(pattern.light, code)).collect();
        for (u, v) in self.patch.iter().flat_map(|rect| rect.pixels()) {
            let at = v * pattern.width + u;
            pixels[at] = colour(Primary::White, pattern.codes[at]);
        }
        pixels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_patch_stays_white_in_a_coloured_frame() {
        let painter = Painter { patch: vec![Rect { u0: 1, v0: 0, width: 1, height: 2 }] };
        let frame = Pattern { codes: (1..=6).collect(), ..Pattern::full(3, 2, 0) };
        let pixels = painter.rgb(&frame.clone().in_light(Primary::Green));
        assert_eq!(pixels, [[0, 1, 0], [2, 2, 2], [0, 3, 0], [0, 4, 0], [5, 5, 5], [0, 6, 0]]);
        assert!(painter.rgb(&frame).iter().zip(frame.codes.iter()).all(|(p, &code)| *p == [code; 3]));
    }
}
