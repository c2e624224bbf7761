//! Solids of revolution as binary STL.

use std::f64::consts::{PI, TAU};

use super::parts::within;
use super::{HandoverError, Part, Parts};

/// More triangles than a slicer takes.
const MOST_TRIANGLES: f64 = 2e7;

/// A part as a closed solid in binary STL, mm, the optical axis +z and the sample's plane z = 0: normals outwards, each edge
/// shared by two triangles. Faces are off the surface by less than `chord_mm`, half of it along the meridian and half across;
/// 0.02 mm is usual, and at most 10 are taken.
///
/// # Errors
/// [`HandoverError::Length`], [`HandoverError::TooFine`].
pub fn stl(parts: &Parts, part: Part, chord_mm: f64) -> Result<Vec<u8>, HandoverError> {
    within("the chord error", chord_mm, 0.0, 10.0)?;
    let outline = parts.section(part, chord_mm / 2.0)?;
    let widest = outline.iter().map(|p| p[0]).fold(0.0, f64::max);
    // The chord of a circle's n-th part is off it by r (1 - cos(pi / n)).
    let segments = (PI / (1.0 - chord_mm / 2.0 / widest).max(0.5).acos()).ceil().max(12.0);
    let points = 2.0 * segments * outline.len() as f64;
    if points.is_nan() || points > MOST_TRIANGLES {
        return Err(HandoverError::TooFine { name: "the chord error", value: chord_mm, points });
    }
    let triangles = revolved(&outline, segments as usize);
    let mut bytes = vec![b' '; 80];
    // The word `solid` at the start would mean a text file.
    let title =
        format!("zonal {} of {}, mm, chord error {chord_mm} mm", part.name(), super::one_line(&parts.rig().name));
    for (byte, letter) in bytes.iter_mut().zip(title.bytes()) {
        *byte = letter;
    }
    bytes.extend((triangles.len() as u32).to_le_bytes());
    for triangle in &triangles {
        for x in normal(triangle).iter().chain(triangle.iter().flatten()) {
            bytes.extend(x.to_le_bytes());
        }
        bytes.extend([0; 2]);
    }
    Ok(bytes)
}

type Triangle = [[f32; 3]; 3];

/// The surface that a closed counterclockwise outline in (r, z) sweeps; corners are equal to the bit where they meet.
fn revolved(outline: &[[f64; 2]], segments: usize) -> Vec<Triangle> {
    let turns: Vec<(f64, f64)> = (0..segments).map(|i| (TAU * i as f64 / segments as f64).sin_cos()).collect();
    let corner = |[r, z]: [f64; 2], i: usize| {
        let (sin, cos) = turns[i % segments];
        [(r * cos) as f32, (r * sin) as f32, z as f32]
    };
    let mut triangles = Vec::with_capacity(2 * segments * outline.len());
    for (&a, &b) in outline.iter().zip(outline.iter().cycle().skip(1)) {
        for i in 0..segments {
            // On the axis all corners of a ring are one.
            if a[0] > 0.0 {
                triangles.push([corner(a, i), corner(a, i + 1), corner(b, i + 1)]);
            }
            if b[0] > 0.0 {
                triangles.push([corner(a, i), corner(b, i + 1), corner(b, i)]);
            }
        }
    }
    triangles
}

fn normal([a, b, c]: &Triangle) -> [f32; 3] {
    let side = |p: &[f32; 3]| [0, 1, 2].map(|i| f64::from(p[i]) - f64::from(a[i]));
    let (u, v) = (side(b), side(c));
    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    let length = n.iter().map(|x| x * x).sum::<f64>().sqrt();
    n.map(|x| if length > 0.0 { (x / length) as f32 } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::super::samples::thesis;
    use super::*;

    /// Normals and corners as the file has them.
    fn read(bytes: &[u8]) -> Vec<([f32; 3], Triangle)> {
        let count = u32::from_le_bytes(bytes[80..84].try_into().unwrap()) as usize;
        assert_eq!(bytes.len(), 84 + 50 * count);
        let vector = |b: &[u8]| [0, 4, 8].map(|i| f32::from_le_bytes(b[i..i + 4].try_into().unwrap()));
        let facet = |b: &[u8]| (vector(b), [12, 24, 36].map(|i| vector(&b[i..i + 12])));
        bytes[84..].chunks(50).map(facet).collect()
    }

    /// By the divergence theorem.
    fn volume(facets: &[([f32; 3], Triangle)]) -> f64 {
        let tetrahedron = |t: &Triangle| {
            let [a, b, c] = t.map(|p| nalgebra::Vector3::from(p.map(f64::from)));
            a.dot(&b.cross(&c)) / 6.0
        };
        facets.iter().map(|f| tetrahedron(&f.1)).sum()
    }

    /// Every edge belongs to two triangles, which run along it in opposite directions.
    #[test]
    fn solids_are_closed_and_oriented() {
        for parts in thesis() {
            for part in Part::ALL {
                let facets = read(&stl(&parts, part, 0.2).unwrap());
                let mut edges: HashMap<[[u32; 3]; 2], usize> = HashMap::new();
                for (n, t) in &facets {
                    let length = n.iter().map(|x| x * x).sum::<f32>();
                    assert!((length - 1.0).abs() < 1e-5, "{part:?}: a normal of length {length}");
                    for i in 0..3 {
                        let edge = [t[i], t[(i + 1) % 3]].map(|p| p.map(|x| (x + 0.0).to_bits()));
                        *edges.entry(edge).or_default() += 1;
                    }
                }
                for (&[a, b], &count) in &edges {
                    assert!(a != b && count == 1 && edges.get(&[b, a]) == Some(&1), "{part:?}");
                }
            }
        }
    }

    /// Shell: Steiner's formula, the sum over the mirror of w + w^2 (1/Rm + 1/Rs) / 2 + w^3 / (3 Rm Rs). Solids: slices.
    #[test]
    fn volumes_are_those_of_the_profile() {
        for parts in thesis() {
            let (points, wall) = (parts.profile(0.05).unwrap(), parts.wall_mm());
            let (mut shell, mut slices, mut area) = (0.0, 0.0, 0.0);
            for w in points.windows(2) {
                let band = PI * (w[0].r + w[1].r) * (w[1].r - w[0].r).hypot(w[1].z - w[0].z);
                let [k, kk] =
                    [0, 1].map(|i| (1.0 / w[i].meridional_radius, 1.0 / w[i].sagittal_radius)).map(|(m, s)| [m, s]);
                let depth = |[m, s]: [f64; 2]| wall + wall * wall * (m + s) / 2.0 + wall.powi(3) * m * s / 3.0;
                shell += band * 0.5 * (depth(k) + depth(kk));
                slices += PI * 0.5 * (w[0].r.powi(2) + w[1].r.powi(2)) * (w[0].z - w[1].z);
                area += band;
            }
            let conic = parts.mirrors().convex();
            let edge = parts.rig().paraboloid_radius_mm();
            // A paraboloid fills half of its cylinder.
            let cap = PI / 2.0 * edge * edge * (conic.vertex_height - conic.height(edge));
            for (part, want) in [(Part::Dome, shell), (Part::Mandrel, slices), (Part::ConvexMirror, cap)] {
                let chord_mm = 0.02;
                let got = volume(&read(&stl(&parts, part, chord_mm).unwrap()));
                // Faces lie inside their surfaces by less than the chord error.
                assert!((got - want).abs() < chord_mm * area, "{part:?}: {got} {want}");
                assert!(
                    (got / want - 1.0).abs() < if part == Part::ConvexMirror { 3e-3 } else { 4e-4 },
                    "{part:?} {got} {want}"
                );
            }
        }
    }

    #[test]
    fn what_makes_too_many_triangles_is_refused() {
        let [parts, _] = thesis();
        assert!(matches!(stl(&parts, Part::Dome, 1e-5), Err(HandoverError::TooFine { .. })));
        assert!(matches!(stl(&parts, Part::Dome, 0.0), Err(HandoverError::Length { .. })));
    }
}
