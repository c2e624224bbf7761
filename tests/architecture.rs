//! The shape of the sources: who may use whom, and what pure modules must not touch.
//!
//! A module uses only those listed above it in src/lib.rs. Comments and literals do not count; tests inside modules do.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// Modules without a file, clock, device or random source of their own.
const PURE: [&str; 6] = ["geometry", "basis", "optics", "handover", "radiometry", "design"];

/// Parts of `std` that reach outside the program.
const WORLD: [&str; 6] = ["fs", "time", "net", "env", "process", "os"];

/// Names that draw randomness from the machine; randomness is passed in and seeded.
const ENTROPY: [&str; 5] = ["thread_rng", "ThreadRng", "OsRng", "SysRng", "from_os_rng"];

/// Macros that print; a pure module returns what it has to say.
const PRINTING: [&str; 5] = ["println", "eprintln", "print", "eprint", "dbg"];

/// A longer file holds more than one idea.
const MAX_LINES: usize = 600;

/// One source file.
struct Source {
    /// Path from the root of the package, with `/`.
    path: String,
    /// The file's text as written.
    raw: String,
    /// The text with comments and literals blanked; same length in lines.
    code: String,
}

impl Source {
    /// The top-level module this file belongs to; none for lib.rs and the binary.
    fn module(&self) -> Option<&str> {
        let inside = self.path.strip_prefix("src/")?;
        let first = inside.split('/').next()?.trim_end_matches(".rs");
        (!["lib", "main", "bin"].contains(&first)).then_some(first)
    }

    fn in_binary(&self) -> bool {
        self.path.starts_with("src/bin/") || self.path == "src/main.rs"
    }
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Every .rs file under src.
fn sources() -> Vec<Source> {
    let mut files = Vec::new();
    let mut folders = vec![root().join("src")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                files.push(path);
            }
        }
    }
    files.sort();
    assert!(files.len() > 10, "only {} files found under src", files.len());
    files.iter().map(source).collect()
}

fn source(path: &PathBuf) -> Source {
    let raw = fs::read_to_string(path).unwrap();
    let parts: Vec<_> = path.strip_prefix(root()).unwrap().iter().map(|p| p.to_str().unwrap()).collect();
    Source { path: parts.join("/"), code: blank(&raw), raw }
}

/// The modules of src/lib.rs in order. One that is commented out (not written yet) keeps its place.
fn module_order(lib: &str) -> Vec<String> {
    let mut order: Vec<String> = Vec::new();
    for line in lib.lines() {
        let line = line.trim_start_matches(['/', ' ']);
        if let Some(name) = line.strip_prefix("pub mod ").and_then(|rest| rest.split(';').next())
            && !order.iter().any(|known| known == name)
        {
            order.push(name.to_owned());
        }
    }
    order
}

/// Replaces comments, strings and characters by blanks, so that only code is searched.
fn blank(text: &str) -> String {
    let chars: Vec<char> = text.chars().collect();
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let mut out = String::with_capacity(text.len());
    let mut i = 0;
    while i < chars.len() {
        let end = if at(i) == '/' && at(i + 1) == '/' {
            (i..chars.len()).find(|&j| at(j) == '\n').unwrap_or(chars.len())
        } else if at(i) == '/' && at(i + 1) == '*' {
            end_of_block_comment(&chars, i)
        } else if let Some(hashes) = raw_string(&chars, i) {
            let close: Vec<char> = std::iter::once('"').chain(std::iter::repeat_n('#', hashes)).collect();
            let body = i + 2 + hashes;
            (body..chars.len()).find(|&j| chars[j..].starts_with(&close)).map_or(chars.len(), |j| j + close.len())
        } else if at(i) == '"' {
            let mut j = i + 1;
            while j < chars.len() && at(j) != '"' {
                j += if at(j) == '\\' { 2 } else { 1 };
            }
            (j + 1).min(chars.len())
        } else if at(i) == '\'' && at(i + 1) == '\\' {
            (i + 3..chars.len()).find(|&j| at(j) == '\'').map_or(chars.len(), |j| j + 1)
        } else if at(i) == '\'' && at(i + 2) == '\'' {
            i + 3
        } else {
            out.push(at(i));
            i += 1;
            continue;
        };
        out.extend(chars[i..end].iter().map(|&c| if c == '\n' { '\n' } else { ' ' }));
        i = end;
    }
    out
}

fn end_of_block_comment(chars: &[char], start: usize) -> usize {
    let (mut depth, mut i) = (0, start);
    while i + 1 < chars.len() {
        match (chars[i], chars[i + 1]) {
            ('/', '*') => (depth, i) = (depth + 1, i + 2),
            ('*', '/') => (depth, i) = (depth - 1, i + 2),
            _ => i += 1,
        }
        if depth == 0 {
            return i;
        }
    }
    chars.len()
}

/// The number of hashes if a raw string starts at `i` (at its `r`).
fn raw_string(chars: &[char], i: usize) -> Option<usize> {
    // Plain identifiers may end in r; b and c may stand before it.
    let starts = i == 0 || !is_word(chars[i - 1]) || "bc".contains(chars[i - 1]);
    if chars[i] != 'r' || !starts {
        return None;
    }
    let hashes = chars[i + 1..].iter().take_while(|&&c| c == '#').count();
    (chars.get(i + 1 + hashes) == Some(&'"')).then_some(hashes)
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Byte offsets of `word` where it is a whole identifier.
fn words<'a>(code: &'a str, word: &'a str) -> impl Iterator<Item = usize> + 'a {
    code.match_indices(word)
        .map(|(at, _)| at)
        .filter(move |&at| !code[..at].ends_with(is_word) && !code[at + word.len()..].starts_with(is_word))
}

/// What follows `root::` everywhere in `code`, one entry per branch of a brace: (byte offset, first name).
fn first_names<'a>(code: &'a str, root: &'a str) -> Vec<(usize, &'a str)> {
    let mut names = Vec::new();
    for at in words(code, root) {
        let Some(rest) = code[at + root.len()..].trim_start().strip_prefix("::") else { continue };
        branches(code, code.len() - rest.len(), &mut names);
    }
    names
}

/// The first names of the path or of the brace at `from`.
fn branches<'a>(code: &'a str, from: usize, names: &mut Vec<(usize, &'a str)>) {
    let start = code.len() - code[from..].trim_start().len();
    let rest = &code[start..];
    if !rest.starts_with('{') {
        let length = rest.find(|c| !is_word(c)).unwrap_or(rest.len());
        names.push((start, if rest.starts_with('*') { "*" } else { &rest[..length] }));
        return;
    }
    let mut depth = 0;
    for (i, c) in rest.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return;
        }
        let opens = i == 0 || (depth == 1 && c == ',');
        let ends = rest[i + 1..].trim_start().starts_with('}');
        if opens && !ends {
            branches(code, start + i + 1, names);
        }
    }
}

/// Collects what is wrong, then fails once with all of it.
#[derive(Default)]
struct Faults(String);

impl Faults {
    fn at(&mut self, source: &Source, offset: usize, what: &str) {
        let line = source.code[..offset].matches('\n').count() + 1;
        writeln!(self.0, "{}:{line}: {what}", source.path).unwrap();
    }

    fn none(self) {
        assert!(self.0.is_empty(), "\n{}", self.0);
    }
}

/// What `source` uses against the order of `modules`.
fn order_faults(source: &Source, modules: &[String], faults: &mut Faults) {
    let Some(own) = source.module() else { return };
    let place = |name: &str| modules.iter().position(|m| m == name);
    let Some(own_place) = place(own) else {
        faults.at(source, 0, &format!("the module `{own}` is not listed in src/lib.rs: give it a place there"));
        return;
    };
    for (offset, name) in first_names(&source.code, "crate") {
        match place(name) {
            Some(other) if other > own_place => {
                faults.at(source, offset, &format!("`{own}` uses `{name}`, which src/lib.rs lists below it"));
            }
            Some(_) => {}
            None if name == "self" => {}
            None => faults.at(source, offset, &format!("`crate::{name}` is not a module listed in src/lib.rs")),
        }
    }
    // `super::super::x` may climb to the root as well; a child of the own folder with the same name is no fault.
    for (offset, name) in first_names(&source.code, "super") {
        let folder = root().join("src").join(own);
        let child = folder.join(name).is_dir() || folder.join(format!("{name}.rs")).is_file();
        if !child && place(name).is_some_and(|other| other > own_place) {
            faults.at(source, offset, &format!("`{own}` uses `{name}` by `super::`; src/lib.rs lists it below"));
        }
    }
}

/// What of the outside world `source` touches.
fn world_faults(source: &Source, faults: &mut Faults) {
    let own = source.module().unwrap_or_default();
    for (offset, name) in first_names(&source.code, "std") {
        if WORLD.contains(&name) {
            faults.at(source, offset, &format!("the pure module `{own}` uses `std::{name}`"));
        }
    }
    for (offset, name) in first_names(&source.code, "rand") {
        if name == "rng" || name == "random" {
            faults.at(source, offset, &format!("the pure module `{own}` uses `rand::{name}`: take a seeded `Rng`"));
        }
    }
    for name in ENTROPY {
        for offset in words(&source.code, name) {
            faults.at(source, offset, &format!("the pure module `{own}` uses `{name}`: take a seeded `Rng`"));
        }
    }
    for name in PRINTING {
        for offset in words(&source.code, name) {
            if source.code[offset + name.len()..].starts_with('!') {
                faults.at(source, offset, &format!("the pure module `{own}` prints with `{name}!`"));
            }
        }
    }
}

#[test]
fn modules_use_only_those_above_them() {
    let modules = module_order(&fs::read_to_string(root().join("src/lib.rs")).unwrap());
    assert!(modules.len() > 5, "src/lib.rs lists only {modules:?}");
    let mut faults = Faults::default();
    for source in sources() {
        order_faults(&source, &modules, &mut faults);
    }
    faults.none();
}

#[test]
fn pure_modules_do_not_touch_the_world() {
    let mut faults = Faults::default();
    let mut files = 0;
    for source in sources() {
        if source.module().is_some_and(|m| PURE.contains(&m)) {
            files += 1;
            world_faults(&source, &mut faults);
        }
    }
    assert!(files >= PURE.len(), "only {files} files of pure modules found");
    faults.none();
}

#[test]
fn no_unsafe_code() {
    let mut faults = Faults::default();
    for source in sources() {
        for offset in words(&source.code, "unsafe") {
            faults.at(&source, offset, "`unsafe` is not used in this project");
        }
    }
    faults.none();
}

#[test]
fn files_stay_short() {
    let mut faults = Faults::default();
    for source in sources() {
        let lines = source.raw.lines().count();
        if lines > MAX_LINES {
            let end = source.code.trim_end().len();
            faults.at(&source, end, &format!("{lines} lines, more than {MAX_LINES}: split it"));
        }
    }
    faults.none();
}

#[test]
fn the_library_has_typed_errors_only() {
    let mut faults = Faults::default();
    for source in sources().iter().filter(|s| !s.in_binary()) {
        for offset in words(&source.code, "anyhow") {
            faults.at(source, offset, "`anyhow` belongs in the binary; a library error is an enum of its concern");
        }
    }
    faults.none();
}

/// The checks above would pass if the search found nothing; so the search is checked too.
mod search {
    use super::*;

    fn sample(path: &str, raw: &str) -> Source {
        Source { path: path.to_owned(), code: blank(raw), raw: raw.to_owned() }
    }

    fn names(code: &str, root: &str) -> Vec<String> {
        first_names(&blank(code), root).into_iter().map(|(_, name)| name.to_owned()).collect()
    }

    #[test]
    fn finds_paths_in_lines_in_nested_braces_and_in_expressions() {
        assert_eq!(names("use crate::a::b;", "crate"), ["a"]);
        assert_eq!(names("use crate::{a::{x, y}, b, c::{self, z::{q, r}},\n};", "crate"), ["a", "b", "c"]);
        assert_eq!(names("use {crate::a, std::fs};", "crate"), ["a"]);
        assert_eq!(names("fn f(x: crate::a::X) -> $crate::b::Y { crate::c::g(x) }", "crate"), ["a", "b", "c"]);
        assert_eq!(names("use crate::*; my_crate::x(); crates::y();", "crate"), ["*"]);
        assert_eq!(names("use std::{collections::HashMap, fs::{self, File}};", "std"), ["collections", "fs"]);
        assert_eq!(names("super::super::a::b()", "super"), ["super", "a"]);
    }

    #[test]
    fn passes_over_comments_and_literals() {
        let code = "/* crate::a /* crate::b */ */ // crate::c\nlet s = \"\\\"crate::d\"; let q = '\"'; let l: &'a str = \
                    r#\"crate::e \"quoted\" \"#; let c = '\\''; crate::f";
        assert_eq!(names(code, "crate"), ["f"]);
        assert_eq!(blank(code).matches('\n').count(), 1);
    }

    #[test]
    fn reads_the_order_of_modules_written_or_not() {
        let lib = "//! Text.\npub mod a;\n// pub mod b;\npub mod c; // why\nmod hidden {}\n";
        assert_eq!(module_order(lib), ["a", "b", "c"]);
    }

    #[test]
    fn faults_name_file_and_line() {
        let modules = ["geometry".to_owned(), "basis".to_owned(), "twin".to_owned()];
        let mut faults = Faults::default();
        let text = "use crate::geometry::X;\nuse crate::{\n    basis::Y,\n    twin::Z,\n};\nmod tests { use crate::gone::A; }\n";
        order_faults(&sample("src/basis/deep/file.rs", text), &modules, &mut faults);
        order_faults(
            &sample("src/geometry/zone.rs", "fn f() {\n    super::super::twin::g()\n}\n"),
            &modules,
            &mut faults,
        );
        order_faults(&sample("src/new.rs", ""), &modules, &mut faults);
        order_faults(&sample("src/bin/zonal/main.rs", "use crate::twin;"), &modules, &mut faults);
        let lines: Vec<_> = faults.0.lines().map(|l| l.split(": ").next().unwrap()).collect();
        assert_eq!(
            lines,
            ["src/basis/deep/file.rs:4", "src/basis/deep/file.rs:6", "src/geometry/zone.rs:2", "src/new.rs:1"],
            "{}",
            faults.0
        );
    }

    #[test]
    fn finds_what_a_pure_module_must_not_touch() {
        let text = "use std::{fmt, fs};\nlet t = std::time::Instant::now();\nlet mut r = rand::rng();\nprintln!(\"\");\n\
                    use rand::Rng;\nrand::thread_rng();\n";
        let mut faults = Faults::default();
        world_faults(&sample("src/optics/map.rs", text), &mut faults);
        let mut lines: Vec<_> = faults.0.lines().map(|l| l.split(": ").next().unwrap()).collect();
        lines.sort_unstable();
        assert_eq!(lines, [1, 2, 3, 4, 6].map(|n| format!("src/optics/map.rs:{n}")), "{}", faults.0);
    }
}
