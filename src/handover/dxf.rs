//! Sections as DXF of AutoCAD 2000 (AC1015): the oldest version that says its units.

use std::fmt::{Display, Write as _};

use super::{HandoverError, Part, Parts, SECTION_CHORD_MM};

/// Layers and their colours: red, black or white, green.
const LAYERS: [(&str, i32); 3] = [("MIRROR", 1), ("SECTION", 7), ("AXIS", 3)];
/// By how much the axis goes beyond the section, mm.
const BEYOND: f64 = 10.0;

/// The section of a part on one side of the axis as a DXF drawing in mm, scale 1:1: x is the distance from the optical axis and
/// y the height above the sample's plane.
///
/// The layer SECTION holds one closed polyline, MIRROR the mirror's curve as an open one, AXIS a line. Chords are off the
/// curves by less than [`SECTION_CHORD_MM`].
///
/// # Errors
/// [`HandoverError::TooFine`] for a dome of hundreds of metres.
pub fn dxf(parts: &Parts, part: Part) -> Result<String, HandoverError> {
    let section = parts.section(part, SECTION_CHORD_MM)?;
    let mirror = parts.mirror(part, SECTION_CHORD_MM)?;
    let ends = |pick: fn(f64, f64) -> f64| section.iter().map(|p| p[1]).reduce(pick).unwrap_or_default();
    let (bottom, top) = (ends(f64::min) - BEYOND, ends(f64::max) + BEYOND);

    let mut file = Dxf::default();
    // The file's code page is not Unicode.
    let name = super::one_line(&parts.rig().name).replace(|c: char| !c.is_ascii(), "?");
    file.put(999, format_args!("zonal {} of {name}: mm, scale 1:1", part.name()));
    file.head();
    file.tables();
    file.blocks();
    file.section("ENTITIES", |file| {
        file.polyline("SECTION", &section, true);
        file.polyline("MIRROR", &mirror, false);
        file.entity("LINE", "AXIS", "AcDbLine");
        for (code, value) in [(10, 0.0), (20, bottom), (30, 0.0), (11, 0.0), (21, top), (31, 0.0)] {
            file.length(code, value);
        }
    });
    file.objects();
    file.put(0, "EOF");
    Ok(file.text.replace(NEXT_HANDLE, &format!("{:X}", file.handles + 1)))
}

/// Owners are named before they are written.
const MODEL_SPACE: &str = "A1";
const PAPER_SPACE: &str = "A2";
const ROOT: &str = "A3";
const GROUPS: &str = "A4";
const FIRST_HANDLE: u32 = 0x100;
/// Stands in the header for a number known at the end.
const NEXT_HANDLE: &str = "<next handle>";

/// Pairs of group codes and values; each object has a handle of its own.
#[derive(Default)]
struct Dxf {
    text: String,
    handles: u32,
}

impl Dxf {
    fn put(&mut self, code: i32, value: impl Display) {
        writeln!(self.text, "{code:>3}\n{value}").expect("a string takes all text");
    }

    fn length(&mut self, code: i32, mm: f64) {
        self.put(code, format_args!("{mm:.9}"));
    }

    fn all(&mut self, pairs: &[(i32, &str)]) {
        for (code, value) in pairs {
            self.put(*code, value);
        }
    }

    /// A new handle.
    fn handle(&mut self) -> String {
        self.handles = self.handles.max(FIRST_HANDLE) + 1;
        format!("{:X}", self.handles)
    }

    fn section(&mut self, name: &str, body: impl FnOnce(&mut Self)) {
        self.all(&[(0, "SECTION"), (2, name)]);
        body(self);
        self.put(0, "ENDSEC");
    }

    fn head(&mut self) {
        self.section("HEADER", |file| {
            file.all(&[(9, "$ACADVER"), (1, "AC1015"), (9, "$DWGCODEPAGE"), (3, "ANSI_1252")]);
            file.all(&[(9, "$HANDSEED"), (5, NEXT_HANDLE)]);
            // Units of insertion: 4 is mm. Measurement: 1 is metric.
            file.all(&[(9, "$INSUNITS"), (70, "4"), (9, "$MEASUREMENT"), (70, "1")]);
        });
        self.section("CLASSES", |_| {});
    }

    /// A table whose records are of one class; each record is a name and what follows it.
    fn table(&mut self, name: &str, class: &str, records: &[(&str, Vec<(i32, String)>)]) {
        let owner = self.handle();
        self.all(&[(0, "TABLE"), (2, name), (5, &owner), (330, "0"), (100, "AcDbSymbolTable")]);
        self.put(70, records.len());
        if name == "DIMSTYLE" {
            self.put(100, "AcDbDimStyleTable");
        }
        for (record, values) in records {
            let handle = match *record {
                "*Model_Space" => MODEL_SPACE.to_owned(),
                "*Paper_Space" => PAPER_SPACE.to_owned(),
                _ => self.handle(),
            };
            // Dimension styles alone have their handle under another code.
            self.put(0, name);
            self.put(if name == "DIMSTYLE" { 105 } else { 5 }, handle);
            self.all(&[(330, &owner), (100, "AcDbSymbolTableRecord"), (100, class), (2, record)]);
            if name != "BLOCK_RECORD" {
                self.put(70, 0);
            }
            for (code, value) in values {
                self.put(*code, value);
            }
        }
        self.put(0, "ENDTAB");
    }

    fn tables(&mut self) {
        let pairs = |pairs: &[(i32, &str)]| pairs.iter().map(|(code, value)| (*code, (*value).to_owned())).collect();
        let line_type = |dashes: &[&str], about: &str, length: &str| {
            let mut values = vec![(3, about.to_owned()), (72, "65".into()), (73, dashes.len().to_string())];
            values.push((40, length.to_owned()));
            values.extend(dashes.iter().flat_map(|d| [(49, (*d).to_owned()), (74, "0".into())]));
            values
        };
        let layer = |(name, colour): (&'static str, i32)| {
            let line = if name == "AXIS" { "CENTER" } else { "Continuous" };
            (name, vec![(62, colour.to_string()), (6, line.into())])
        };
        let layers: Vec<_> = std::iter::once(("0", 7)).chain(LAYERS).map(layer).collect();
        let style = pairs(&[(40, "0"), (41, "1"), (50, "0"), (71, "0"), (42, "2.5"), (3, "txt"), (4, "")]);
        let centre = line_type(&["8", "-2", "1", "-2"], "Center ____ _ ____", "13");
        self.section("TABLES", |file| {
            file.table("VPORT", "AcDbViewportTableRecord", &[]);
            let plain = |name| (name, line_type(&[], "", "0"));
            let lines = [plain("ByBlock"), plain("ByLayer"), plain("Continuous"), ("CENTER", centre)];
            file.table("LTYPE", "AcDbLinetypeTableRecord", &lines);
            file.table("LAYER", "AcDbLayerTableRecord", &layers);
            file.table("STYLE", "AcDbTextStyleTableRecord", &[("Standard", style)]);
            file.table("VIEW", "AcDbViewTableRecord", &[]);
            file.table("UCS", "AcDbUCSTableRecord", &[]);
            file.table("APPID", "AcDbRegAppTableRecord", &[("ACAD", vec![])]);
            file.table("DIMSTYLE", "AcDbDimStyleTableRecord", &[("Standard", vec![])]);
            let spaces = ["*Model_Space", "*Paper_Space"].map(|name| (name, vec![]));
            file.table("BLOCK_RECORD", "AcDbBlockTableRecord", &spaces);
        });
    }

    fn blocks(&mut self) {
        self.section("BLOCKS", |file| {
            for (name, owner) in [("*Model_Space", MODEL_SPACE), ("*Paper_Space", PAPER_SPACE)] {
                for (kind, class) in [("BLOCK", "AcDbBlockBegin"), ("ENDBLK", "AcDbBlockEnd")] {
                    let handle = file.handle();
                    file.all(&[(0, kind), (5, &handle), (330, owner), (100, "AcDbEntity"), (8, "0"), (100, class)]);
                    if kind == "BLOCK" {
                        file.all(&[(2, name), (70, "0"), (10, "0"), (20, "0"), (30, "0"), (3, name), (1, "")]);
                    }
                }
            }
        });
    }

    /// The beginning of an entity in model space.
    fn entity(&mut self, kind: &str, layer: &str, class: &str) {
        let handle = self.handle();
        self.all(&[(0, kind), (5, &handle), (330, MODEL_SPACE), (100, "AcDbEntity"), (8, layer), (100, class)]);
    }

    fn polyline(&mut self, layer: &str, points: &[[f64; 2]], closed: bool) {
        self.entity("LWPOLYLINE", layer, "AcDbPolyline");
        self.put(90, points.len());
        self.put(70, i32::from(closed));
        for &[x, y] in points {
            self.length(10, x);
            self.length(20, y);
        }
    }

    /// The dictionary every file has.
    fn objects(&mut self) {
        self.section("OBJECTS", |file| {
            file.all(&[(0, "DICTIONARY"), (5, ROOT), (330, "0"), (100, "AcDbDictionary"), (281, "1")]);
            file.all(&[(3, "ACAD_GROUP"), (350, GROUPS)]);
            file.all(&[(0, "DICTIONARY"), (5, GROUPS), (330, ROOT), (100, "AcDbDictionary"), (281, "1")]);
        });
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::super::samples::thesis;
    use super::*;

    fn groups(text: &str) -> Vec<(i32, &str)> {
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len() % 2, 0);
        lines.chunks(2).map(|w| (w[0].trim().parse().unwrap(), w[1])).collect()
    }

    /// The entities: kind and what belongs to it.
    fn entities<'a>(groups: &'a [(i32, &'a str)]) -> Vec<&'a [(i32, &'a str)]> {
        let from = groups.iter().position(|g| *g == (2, "ENTITIES")).unwrap() + 1;
        let to = from + groups[from..].iter().position(|g| *g == (0, "ENDSEC")).unwrap();
        groups[from..to].chunk_by(|_, next| next.0 != 0).collect()
    }

    #[test]
    fn a_drawing_holds_one_closed_section_its_mirror_and_the_axis() {
        for parts in thesis() {
            for part in Part::ALL {
                let text = dxf(&parts, part).unwrap();
                let groups = groups(&text);
                assert_eq!(groups.last(), Some(&(0, "EOF")));
                let count = |group| groups.iter().filter(|g| **g == group).count();
                assert_eq!((count((0, "SECTION")), count((0, "ENDSEC"))), (6, 6));
                assert_eq!((count((0, "TABLE")), count((0, "ENDTAB"))), (9, 9));
                let after = |name| groups[groups.iter().position(|g| *g == (9, name)).unwrap() + 1];
                assert_eq!((after("$ACADVER"), after("$INSUNITS")), ((1, "AC1015"), (70, "4")));
                let all = entities(&groups);
                let found: Vec<_> = all.iter().map(|e| (e[0].1, e.iter().find(|g| g.0 == 8).unwrap().1)).collect();
                assert_eq!(found, [("LWPOLYLINE", "SECTION"), ("LWPOLYLINE", "MIRROR"), ("LINE", "AXIS")]);
                let wants = [
                    (parts.section(part, SECTION_CHORD_MM).unwrap(), "1"),
                    (parts.mirror(part, SECTION_CHORD_MM).unwrap(), "0"),
                ];
                for (entity, (want, closed)) in all.iter().zip(wants) {
                    let values = |code| entity.iter().filter(move |g| g.0 == code).map(|g| g.1);
                    assert!(values(70).eq([closed]) && values(90).eq([want.len().to_string().as_str()]));
                    let lengths = |code| values(code).map(|x| x.parse::<f64>().unwrap());
                    assert_eq!(lengths(10).count(), want.len());
                    assert!(
                        lengths(10).zip(lengths(20)).zip(&want).all(|((x, y), p)| (x - p[0]).hypot(y - p[1]) < 1e-8)
                    );
                }
            }
        }
    }

    #[test]
    fn handles_are_unique_and_below_the_next() {
        let [parts, _] = thesis();
        let text = dxf(&parts, Part::Dome).unwrap();
        let groups = groups(&text);
        let seed = groups.iter().position(|g| *g == (9, "$HANDSEED")).unwrap() + 1;
        let next = u32::from_str_radix(groups[seed].1, 16).unwrap();
        let handles = groups[seed + 1..].iter().filter(|g| g.0 == 5 || g.0 == 105);
        let mut seen = HashSet::new();
        for (_, handle) in handles {
            assert!(seen.insert(*handle) && u32::from_str_radix(handle, 16).unwrap() < next, "{handle}");
        }
    }
}
