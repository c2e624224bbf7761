//! Places for the texts of points: where they cover neither each other nor a mark, and no line if that can be.

/// Half the width of a mark and its surroundings, and of a line, user units.
const MARK: f64 = 5.0;
const LINE: f64 = 2.0;
/// Height of a text, and mean width of its characters.
const TEXT: f64 = 11.0;
const CHARACTER: f64 = 6.1;

/// A rectangle: left, top, right, bottom.
pub(super) type Area = [f64; 4];

/// Where a text starts or ends (its anchor) and its base line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// Class of the text: anchored in its `mid`dle, at its `end`, or at its start.
    pub class: &'static str,
    pub x: f64,
    pub y: f64,
}

/// Places for texts at points, in their order: above the point, else beside or below it, else further up; inside `plot`.
/// `lines` are points close together on what is drawn.
pub(super) fn places(
    labels: &[(f64, f64, &str)],
    marks: &[(f64, f64)],
    lines: &[(f64, f64)],
    plot: Area,
) -> Vec<Place> {
    let about = |points: &[(f64, f64)], r: f64| -> Vec<Area> {
        points.iter().map(|&(x, y)| [x - r, y - r, x + r, y + r]).collect()
    };
    let (mut taken, lines) = (about(marks, MARK), about(lines, LINE));
    labels
        .iter()
        .map(|&(x, y, text)| {
            let width = CHARACTER * text.chars().count() as f64;
            let beside = 2.0 + MARK;
            let candidates = [
                Place { class: "mid", x, y: y - 8.0 },
                Place { class: "", x: x + beside, y: y + 4.0 },
                Place { class: "end", x: x - beside, y: y + 4.0 },
                Place { class: "mid", x, y: y + 17.0 },
                Place { class: "", x: x + beside, y: y - 6.0 },
                Place { class: "end", x: x - beside, y: y - 6.0 },
                Place { class: "", x: x + beside, y: y + 14.0 },
                Place { class: "end", x: x - beside, y: y + 14.0 },
                Place { class: "mid", x, y: y - 21.0 },
                Place { class: "mid", x, y: y + 29.0 },
                Place { class: "end", x: x + MARK, y: y + 17.0 },
                Place { class: "", x: x - MARK, y: y + 17.0 },
            ];
            let free = |place: &&Place| {
                let area = place.area(width);
                let inside = area[0] >= plot[0] && area[1] >= plot[1] && area[2] <= plot[2] && area[3] <= plot[3];
                inside && taken.iter().all(|other| !overlap(&area, other))
            };
            let clear = |place: &&Place| free(place) && lines.iter().all(|line| !overlap(&place.area(width), line));
            let place = candidates.iter().find(clear).or(candidates.iter().find(free)).unwrap_or(&candidates[0]);
            let place = *place;
            taken.push(place.area(width));
            place
        })
        .collect()
}

impl Place {
    fn area(&self, width: f64) -> Area {
        let left = match self.class {
            "mid" => self.x - width / 2.0,
            "end" => self.x - width,
            _ => self.x,
        };
        [left, self.y - TEXT, left + width, self.y + 2.0]
    }
}

fn overlap(a: &Area, b: &Area) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_stay_inside_and_apart() {
        let plot = [50.0, 20.0, 350.0, 220.0];
        let near =
            [(60.0, 60.0, "first"), (64.0, 62.0, "second"), (340.0, 100.0, "a longer name"), (340.0, 104.0, "b")];
        let marks: Vec<(f64, f64)> = near.iter().map(|l| (l.0, l.1)).collect();
        let areas: Vec<Area> = places(&near, &marks, &[], plot)
            .iter()
            .zip(near)
            .map(|(p, l)| p.area(CHARACTER * l.2.chars().count() as f64))
            .collect();
        for (i, area) in areas.iter().enumerate() {
            assert!(area[0] >= plot[0] && area[2] <= plot[2] && area[1] >= plot[1], "{area:?}");
            assert!(areas[..i].iter().all(|other| !overlap(area, other)), "{areas:?}");
        }
    }

    #[test]
    fn a_lone_text_stands_above_its_point() {
        let (text, mark, plot) = ([(200.0, 100.0, "L4")], [(200.0, 100.0)], [50.0, 20.0, 350.0, 220.0]);
        assert_eq!(places(&text, &mark, &[], plot)[0], Place { class: "mid", x: 200.0, y: 92.0 });
        let rises: Vec<(f64, f64)> = (0..20).map(|i| (200.0, 100.0 - f64::from(i))).collect();
        assert_eq!(places(&text, &mark, &rises, plot)[0], Place { class: "", x: 207.0, y: 104.0 });
    }
}
