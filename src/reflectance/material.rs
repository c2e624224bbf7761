//! Materials by name or path.

use std::path::Path;
use std::sync::Arc;

use thiserror::Error;

use super::{Alta, Brdf, Ggx, Lambert, Merl, ReadError, Rgl, abc_materials};

/// A material that cannot be opened.
#[derive(Debug, Error)]
pub enum MaterialError {
    /// Its file cannot be used.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A path of a kind no reader handles.
    #[error(
        "{path} is no material file: give a .bsdf (RGL), .binary (MERL) or .dat (ALTA) file, or a name from `zonal materials`"
    )]
    UnknownKind {
        /// The path asked for.
        path: String,
    },
    /// No built-in material of this name.
    #[error("there is no material `{name}`; did you mean {}? `zonal materials` lists all", .nearest.join(", "))]
    UnknownName {
        /// The name asked for.
        name: String,
        /// The most similar names, best first.
        nearest: Vec<String>,
    },
}

/// A built-in material.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MaterialInfo {
    /// What [`open`] takes.
    pub name: String,
    /// The model: `lambert`, `ggx` or `abc`.
    pub family: &'static str,
    /// Where its numbers come from.
    pub source: &'static str,
}

/// How many names an error suggests.
const SUGGESTIONS: usize = 3;
const ABC_SOURCE: &str = "Löw et al. 2012, fit of the MERL material of this name";
const GGX_SOURCE: &str = "demonstration: kd 0.2, ks 0.8, f0 0.5, roughness in the name";

/// Name, source and albedo of the diffusers. The 99% is what sintered PTFE reference whites reach.
const DIFFUSERS: [(&str, &str, f64); 2] = [
    ("gray-card", "ideal photographic gray card, albedo 0.18", 0.18),
    ("white", "ideal reference white, albedo 0.99", 0.99),
];

/// Name and roughness along and across the grain of the demonstration materials.
const GGX: [(&str, [f64; 2]); 6] = [
    ("ggx-0.4", [0.4, 0.4]),
    ("ggx-0.2", [0.2, 0.2]),
    ("ggx-0.1", [0.1, 0.1]),
    ("ggx-0.05", [0.05, 0.05]),
    ("ggx-0.02", [0.02, 0.02]),
    ("ggx-0.1-0.4", [0.1, 0.4]),
];

/// Opens a material: a path that ends in `.bsdf` (RGL), `.binary` (MERL) or `.dat` (ALTA), or the name of a built-in one.
///
/// # Errors
/// [`MaterialError`]: a file that cannot be used, or a name that is not known, with the names most like it.
pub fn open(name_or_path: &str) -> Result<Arc<dyn Brdf>, MaterialError> {
    if let Some(brdf) = by_name(name_or_path) {
        return Ok(brdf);
    }
    let path = Path::new(name_or_path);
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    match extension.as_deref() {
        Some("bsdf") => Ok(Arc::new(Rgl::read(path)?)),
        Some("binary") => Ok(Arc::new(Merl::read(path)?)),
        Some("dat") => Ok(Arc::new(Alta::read(path)?)),
        _ if path.components().count() > 1 || path.is_file() => {
            Err(MaterialError::UnknownKind { path: name_or_path.into() })
        }
        _ => Err(MaterialError::UnknownName { name: name_or_path.into(), nearest: nearest(name_or_path) }),
    }
}

/// All built-in materials, in the order of a listing.
pub fn built_in() -> Vec<MaterialInfo> {
    let diffusers = DIFFUSERS.iter().map(|&(name, source, _)| (name, "lambert", source));
    let ggx = GGX.iter().map(|&(name, _)| (name, "ggx", GGX_SOURCE));
    let abc = abc_materials().iter().map(|m| (m.name.as_str(), "abc", ABC_SOURCE));
    let all = diffusers.chain(ggx).chain(abc);
    all.map(|(name, family, source)| MaterialInfo { name: name.into(), family, source }).collect()
}

fn by_name(name: &str) -> Option<Arc<dyn Brdf>> {
    if let Some(&(.., albedo)) = DIFFUSERS.iter().find(|m| m.0 == name) {
        return Some(Arc::new(Lambert::gray(albedo)));
    }
    if let Some(&(_, alpha)) = GGX.iter().find(|m| m.0 == name) {
        return Some(Arc::new(Ggx::anisotropic(alpha[0], alpha[1], [0.5; 3]).on_lambert(0.8, [0.2; 3])));
    }
    let material = abc_materials().iter().find(|m| m.name == name)?;
    Some(Arc::new(material.brdf))
}

/// The built-in names with the smallest edit distance to `name`.
fn nearest(name: &str) -> Vec<String> {
    most_alike(name, built_in().into_iter().map(|m| m.name))
}

/// Of the names known, those most like `name`, best first.
pub(crate) fn most_alike(name: &str, known: impl Iterator<Item = String>) -> Vec<String> {
    let mut names: Vec<_> = known.map(|k| (edit_distance(name, &k), k)).collect();
    names.sort();
    names.into_iter().take(SUGGESTIONS).map(|(_, name)| name).collect()
}

/// Levenshtein distance, capital letters and underscores taken as small letters and hyphens.
fn edit_distance(a: &str, b: &str) -> usize {
    // Longer names than any built-in one need no exact distance: the cost stays bounded.
    const LONGEST: usize = 64;
    let plain = |s: &str| -> Vec<char> {
        s.chars().take(LONGEST).map(|c| if c == '_' || c == ' ' { '-' } else { c.to_ascii_lowercase() }).collect()
    };
    let (a, b) = (plain(a), plain(b));
    let mut previous: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.iter().enumerate() {
        let mut current = vec![i + 1];
        for (j, y) in b.iter().enumerate() {
            current.push((previous[j] + usize::from(x != y)).min(previous[j + 1] + 1).min(current[j] + 1));
        }
        previous = current;
    }
    previous[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Direction;

    #[test]
    fn every_name_opens_and_is_unique() {
        let all = built_in();
        assert_eq!(all.len(), 108);
        let (wi, wo) = (Direction::from_angles(0.4, 0.1), Direction::from_angles(0.9, 2.9));
        for material in &all {
            let f = open(&material.name).unwrap().eval(&wi, &wo);
            assert!(f.iter().all(|f| f.is_finite() && *f >= 0.0), "{}: {f:?}", material.name);
            assert_eq!(all.iter().filter(|m| m.name == material.name).count(), 1);
        }
        assert!(!open("ggx-0.1-0.4").unwrap().is_isotropic());
        let gray = open("gray-card").unwrap().eval(&wi, &wo)[0];
        assert!((gray * std::f64::consts::PI - 0.18).abs() < 1e-15);
    }

    #[test]
    fn a_wrong_name_gets_the_nearest_ones() {
        let Err(MaterialError::UnknownName { nearest, .. }) = open("Gray_Crad") else { panic!("no suggestion") };
        assert_eq!(nearest[0], "gray-card");
        let Err(error) = open("ggx-0.15") else { panic!("no such material") };
        assert!(error.to_string().contains("zonal materials"), "{error}");
        assert!(open("").is_err());
        assert!(open(&"x".repeat(100_000)).is_err());
    }

    #[test]
    fn a_missing_file_is_named() {
        let Err(error) = open("no/such/file.bsdf") else { panic!("no such file") };
        assert!(matches!(error, MaterialError::Read(ReadError::Io { .. })));
        assert!(error.to_string().contains("no/such/file.bsdf"));
        assert!(matches!(open("some/table.txt"), Err(MaterialError::UnknownKind { .. })));
    }
}
