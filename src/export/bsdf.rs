//! Any BRDF as an RGL `.bsdf` file, which renderers load.
//!
//! Dupuy & Jakob, "An adaptive parameterization for efficient material acquisition and rendering", ACM TOG 37(6), 2018.
//! For a camera `wo` a table holds f_cos 4 sigma(wo) / ndf(h) over half vectors h, on a square that a density of half
//! vectors (`vndf`) warps. Readers interpolate all of that linearly, so the file holds what makes it smooth:
//! - `ndf` is the backscatter f(w, w) cos(theta_w), for microfacets their distribution with the diffuse part under it.
//! - `sigma` is its projected area, the integral of ndf(h) max(wo . h, 0) dh.
//! - `vndf` gives every azimuth of h half of its columns for the lobe and half for the visible lights, so that neither the
//!   peak nor the flat rest is left with few of them.
//! - exitant angles lie closer towards grazing, where a lobe grows fastest.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use nalgebra::Vector3;
use rayon::prelude::*;
use thiserror::Error;

use crate::geometry::{Direction, Sample};
use crate::radiometry::ColourSpace;
use crate::reflectance::{Brdf, Flattening, Table, Taps, TensorWriter, reflect, theta_of_u, u_of_theta};
use crate::store::{self, StoreError};

/// A BRDF that does not become a `.bsdf` file.
#[derive(Debug, Error)]
pub enum BsdfError {
    /// The file cannot be written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The BRDF has no value somewhere.
    #[error(
        "the model has no finite value at theta_i {theta_i_deg:.1}, theta_o {theta_o_deg:.1} deg: convert the run with fewer \
         rings and sectors, or fit a model to it"
    )]
    NotFinite {
        /// Polar angle of the light, degrees.
        theta_i_deg: f64,
        /// Polar angle of the camera, degrees.
        theta_o_deg: f64,
    },
}

/// What readers must know and the format does not say.
const CONVENTION: &str = "The camera indexes the table; values hold f cos(theta) of the light. Mitsuba: si.wi is the camera, \
eval's wo the light, the result f cos. pbrt: f divides by cos. Linear RGB, 1/sr.";

/// The camera's last angle: beyond it tables are constant, and f_cos grows too fast for a line between angles.
const THETA_MAX_DEG: f64 = 86.0;
/// Exponent of the spacing of exitant angles, below 1 for angles that lie closer towards grazing.
const THETA_SPACING: f64 = 0.6;
/// Backscatter is asked for up to here: beyond, 1 / cos(theta) runs away.
const BACKSCATTER_MAX_DEG: f64 = 88.0;
/// Share of the mean that `ndf` never falls below, since values are divided by it.
const NDF_FLOOR: f64 = 1e-3;
/// Share of a row's columns spread evenly, below the horizon too: the warp stays invertible.
const EVEN_SHARE: f64 = 0.02;
/// Share of the mean that the table for sampling never falls below: nothing visible is left out.
const LUMINANCE_FLOOR: f64 = 1e-3;
/// What stands for the lobe where there is none, relative to its peak.
const LOBE_FLOOR: f64 = 1e-6;

/// Numbers of nodes.
struct Resolution {
    /// Azimuths and polar angles of the camera.
    exitant: [usize; 2],
    /// Side of the square of values.
    side: usize,
    /// Azimuths and polar angles of the half vectors of `vndf`, of `ndf`, and of the directions of `sigma`.
    vndf: [usize; 2],
    ndf: [usize; 2],
    sigma: [usize; 2],
}

/// 0.97 MB. Maps that do not depend on an azimuth have two equal rows, the fewest a reader takes: Mitsuba 3.9 may turn an
/// isotropic file's camera by half a turn (mitsuba-renderer/mitsuba3#1850), which then changes nothing.
const ISOTROPIC: Resolution = Resolution { exitant: [1, 30], side: 40, vndf: [20, 80], ndf: [2, 512], sigma: [2, 64] };
/// 12 MB. All azimuths, since pbrt and powitacq refuse files reduced by symmetry.
const ANISOTROPIC: Resolution =
    Resolution { exitant: [25, 16], side: 32, vndf: [48, 64], ndf: [256, 256], sigma: [48, 48] };

/// Writes a BRDF as an RGL `.bsdf` file, RGB variant, whole or not at all.
///
/// `description` goes into the file, with the conventions behind it. Negative values become 0. Renderers sample the file
/// by its own tables; [`crate::reflectance::Rgl`] reads it back. Isotropic BRDFs take 1 MB and a fraction of a second,
/// others 12 MB. What is lost on the way stands in `docs/limits.md`.
///
/// # Errors
/// [`BsdfError`].
pub fn write_bsdf(brdf: &dyn Brdf, description: &str, path: &Path) -> Result<(), BsdfError> {
    Ok(store::write(path, &bsdf_bytes(brdf, description)?)?)
}

/// The bytes of [`write_bsdf`].
///
/// # Errors
/// [`BsdfError::NotFinite`].
pub fn bsdf_bytes(brdf: &dyn Brdf, description: &str) -> Result<Vec<u8>, BsdfError> {
    let resolution = if brdf.is_isotropic() { ISOTROPIC } else { ANISOTROPIC };
    let Resolution { exitant: [n_phi, n_theta], side, .. } = resolution;
    let phi: Vec<f64> = match n_phi {
        1 => vec![0.0],
        n => (0..n).map(|i| phi_of_v(node(i, n))).collect(),
    };
    let theta: Vec<f64> =
        (0..n_theta).map(|i| THETA_MAX_DEG.to_radians() * node(i, n_theta).powf(THETA_SPACING)).collect();

    let surface = Surface::new(brdf, &resolution)?;
    let cameras: Vec<Direction<Sample>> =
        phi.iter().flat_map(|&phi| theta.iter().map(move |&theta| Direction::from_angles(theta, phi))).collect();
    let slices = cameras
        .par_iter()
        .map(|wo| Slice::new(brdf, &surface, wo, resolution.vndf, side))
        .collect::<Result<Vec<_>, _>>()?;
    let all = |part: fn(&Slice) -> &[f32]| slices.iter().flat_map(part).copied().collect::<Vec<f32>>();
    let f32s = |values: &[f64]| values.iter().map(|&v| v as f32).collect::<Vec<_>>();

    let [rows, columns] = resolution.vndf;
    let mut file = TensorWriter::default();
    let colours = ColourSpace::of_history(description).label();
    let version = env!("CARGO_PKG_VERSION");
    let description = format!("{description}\nzonal_colour_space: {colours}\n{CONVENTION}\nzonal {version}");
    file.u8("description", description.as_bytes());
    file.u8("jacobian", &[1]);
    file.f32("phi_i", &[n_phi], &f32s(&phi));
    file.f32("theta_i", &[n_theta], &f32s(&theta));
    file.f32("ndf", &resolution.ndf, &surface.ndf.values);
    file.f32("sigma", &resolution.sigma, &surface.sigma.values);
    file.f32("vndf", &[n_phi, n_theta, rows, columns], &all(|s| &s.vndf));
    file.f32("luminance", &[n_phi, n_theta, side, side], &all(|s| &s.luminance));
    file.f32("rgb", &[n_phi, n_theta, 3, side, side], &all(|s| &s.rgb));
    Ok(file.to_bytes())
}

/// Position of node `i` of `n` >= 2 on 0..=1.
fn node(i: usize, n: usize) -> f64 {
    i as f64 / (n - 1) as f64
}

fn phi_of_v(v: f64) -> f64 {
    (2.0 * v - 1.0) * PI
}

/// The direction at (u, v) of the unit square: theta = u^2 pi / 2, phi = (2 v - 1) pi.
fn direction(u: f64, v: f64) -> Direction<Sample> {
    Direction::from_angles(theta_of_u(u), phi_of_v(v))
}

/// Solid angle over area on the unit square of [`direction`], sr.
fn jacobian(u: f64) -> f64 {
    TAU * PI * u * theta_of_u(u).sin()
}

/// A function on the unit square of [`direction`], as readers see it: nodes, bilinear between them.
struct Map {
    values: Vec<f32>,
    table: Table<1>,
}

impl Map {
    fn new([rows, columns]: [usize; 2], value: impl Fn(f64, f64) -> f64 + Sync) -> Self {
        let at = |k: usize| value(node(k % columns, columns), node(k / columns, rows)) as f32;
        let values: Vec<f32> = (0..rows * columns).into_par_iter().map(at).collect();
        let table = Table::new(columns, rows, values.iter().map(|&v| [v]).collect());
        Self { values, table }
    }

    fn at(&self, u: f64, v: f64) -> f64 {
        self.table.at(&Taps::SINGLE, u, v)[0]
    }
}

/// What the file says of the surface for all cameras.
struct Surface {
    ndf: Map,
    sigma: Map,
    /// The backscatter above its least value: the lobe without the diffuse part, relative to its peak.
    lobe: Map,
}

impl Surface {
    fn new(brdf: &dyn Brdf, resolution: &Resolution) -> Result<Self, BsdfError> {
        let backscatter = |u: f64, v: f64| {
            let theta = theta_of_u(u).min(BACKSCATTER_MAX_DEG.to_radians());
            let w = Direction::from_angles(theta, phi_of_v(v));
            (mean(brdf.eval(&w, &w)), theta)
        };
        let plain = Map::new(resolution.ndf, |u, v| backscatter(u, v).0);
        if let Some(i) = plain.values.iter().position(|f| !f.is_finite()) {
            let theta_deg = theta_of_u(node(i % resolution.ndf[1], resolution.ndf[1])).to_degrees();
            return Err(BsdfError::NotFinite { theta_i_deg: theta_deg, theta_o_deg: theta_deg });
        }
        let extreme = |of: fn(f64, f64) -> f64, start| plain.values.iter().fold(start, |e, &f| of(e, f.into()));
        let (least, most) = (extreme(f64::min, f64::MAX), extreme(f64::max, 0.0));
        let range = (most - least).max(f64::MIN_POSITIVE);
        let lobe = Map::new(resolution.ndf, |u, v| (plain.at(u, v) - least) / range);

        // Midpoints: twice as many as nodes in theta; azimuths need few where nothing depends on them.
        let [rows, columns] = [resolution.ndf[0].max(64), 2 * resolution.ndf[1]];
        let nodes: Vec<(f64, f64, f64)> = (0..rows * columns)
            .map(|k| (((k % columns) as f64 + 0.5) / columns as f64, ((k / columns) as f64 + 0.5) / rows as f64))
            .map(|(u, v)| (u, v, jacobian(u) / (rows * columns) as f64))
            .collect();
        let shape = Map::new(resolution.ndf, |u, v| {
            let (f, theta) = backscatter(u, v);
            f * theta.cos()
        });
        let integral: f64 = nodes.iter().map(|&(u, v, w)| w * shape.at(u, v)).sum();
        let floor = (NDF_FLOOR * integral / TAU).max(f64::MIN_POSITIVE.sqrt());
        let projected: f64 = nodes.iter().map(|&(u, v, w)| w * (shape.at(u, v) + floor) * theta_of_u(u).cos()).sum();
        let ndf = Map::new(resolution.ndf, |u, v| (shape.at(u, v) + floor) / projected);

        let facets: Vec<(Vector3<f64>, f64)> =
            nodes.iter().map(|&(u, v, w)| (direction(u, v).vector(), w * ndf.at(u, v))).collect();
        // Isotropic surfaces are looked at from one azimuth, so that both rows of the map are equal to the last bit.
        let turns = resolution.exitant[0] > 1;
        let sigma = Map::new(resolution.sigma, |u, v| {
            let w = direction(u, if turns { v } else { 0.5 }).vector();
            facets.iter().map(|(h, facet)| facet * h.dot(&w).max(0.0)).sum()
        });
        Ok(Self { ndf, sigma, lobe })
    }
}

/// What the file says for one camera.
struct Slice {
    vndf: Vec<f32>,
    luminance: Vec<f32>,
    rgb: Vec<f32>,
}

impl Slice {
    fn new(
        brdf: &dyn Brdf,
        surface: &Surface,
        wo: &Direction<Sample>,
        vndf: [usize; 2],
        side: usize,
    ) -> Result<Self, BsdfError> {
        let density = density(surface, wo, vndf);
        let warp = Flattening::new(vndf[1], vndf[0], &density.values).expect("every row has an even share");
        let sigma = surface.sigma.at(u_of_theta(wo.theta()), 0.5 + wo.phi() / TAU);
        let f_cos_of = brdf.towards(wo);
        let cells = side * side;
        let (mut rgb, mut luminance) = (vec![0.0; 3 * cells], vec![0.0; cells]);
        for k in 0..cells {
            let (u, v) = warp.unflatten(node(k % side, side), node(k / side, side));
            let h = direction(u, v).vector();
            let Some(wi) = reflect(wo, &h) else { continue };
            let f_cos = f_cos_of(&wi);
            if f_cos.iter().any(|f| !f.is_finite()) {
                let [theta_i_deg, theta_o_deg] = [wi.theta(), wo.theta()].map(f64::to_degrees);
                return Err(BsdfError::NotFinite { theta_i_deg, theta_o_deg });
            }
            for (c, f_cos) in f_cos.into_iter().enumerate() {
                rgb[c * cells + k] = (f_cos.max(0.0) * 4.0 * sigma / surface.ndf.at(u, v)) as f32;
            }
            // Over (s, t): dwi = 4 wo.h dh, dh = jacobian du dv, and the warp's density is ds dt / (du dv).
            luminance[k] = (mean(f_cos) * 4.0 * h.dot(&wo.vector()) * jacobian(u) / density.at(u, v)) as f32;
        }
        let floor = LUMINANCE_FLOOR as f32 * luminance.iter().sum::<f32>() / cells as f32;
        luminance.iter_mut().for_each(|l| *l += floor.max(f32::MIN_POSITIVE));
        Ok(Self { vndf: density.values, luminance, rgb })
    }
}

/// The density on the unit square of half vectors that spreads the nodes of a slice. Integrates to about 1.
fn density(surface: &Surface, wo: &Direction<Sample>, [rows, columns]: [usize; 2]) -> Map {
    // The lobe, and lights spread over the visible solid angle; densities of wi become those of h by dwi = 4 wo.h dh.
    let parts = |k: usize| {
        let (u, v) = (node(k % columns, columns), node(k / columns, rows));
        let h = direction(u, v).vector();
        let seen = if reflect(wo, &h).is_some() { h.dot(&wo.vector()).max(0.0) * jacobian(u) } else { 0.0 };
        [seen * (surface.lobe.at(u, v) + LOBE_FLOOR), seen]
    };
    let nodes: Vec<[f64; 2]> = (0..rows * columns).map(parts).collect();
    let sum = |of: &[[f64; 2]]| of.iter().fold([0.0; 2], |sum, part| [sum[0] + part[0], sum[1] + part[1]]);
    let total = sum(&nodes);
    let mut values = Vec::with_capacity(nodes.len());
    for row in nodes.chunks_exact(columns) {
        let [lobe, lights] = sum(row);
        let of_row = 0.5 * rows as f64 * (lobe / total[0] + lights / total[1]);
        // At grazing a row may see nothing but its first node, whose area is 0.
        let share = |[l, s]: [f64; 2]| if lobe > 0.0 { 0.5 * (l / lobe + s / lights) } else { 1.0 / columns as f64 };
        let even = |share: f64| EVEN_SHARE + (1.0 - EVEN_SHARE) * share * columns as f64;
        values.extend(row.iter().map(|&part| (of_row.max(EVEN_SHARE) * even(share(part))) as f32));
    }
    let table = Table::new(columns, rows, values.iter().map(|&v| [v]).collect());
    Map { values, table }
}

/// Mean of the channels, negative ones as 0.
fn mean(rgb: [f64; 3]) -> f64 {
    rgb.iter().map(|v| if v.is_nan() { f64::NAN } else { v.max(0.0) }).sum::<f64>() / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::{Ggx, Lambert, Rgl};

    /// Between the nodes; the tests with Mitsuba bound the errors of glossy surfaces.
    const INTERPOLATION: f64 = 0.01;

    struct Broken;

    impl Brdf for Broken {
        fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
            [if wi == wo || wo.theta() < 1.0 { 0.1 } else { f64::NAN }; 3]
        }

        fn is_isotropic(&self) -> bool {
            true
        }
    }

    #[test]
    fn a_diffuser_with_a_broad_lobe_comes_back() {
        let brdf = Ggx::isotropic(0.5, [0.04, 0.05, 0.06]).on_lambert(1.0, [0.1, 0.3, 0.5]);
        let back = Rgl::parse(&bsdf_bytes(&brdf, "a broad lobe").unwrap(), "a.bsdf").unwrap();
        assert!(back.is_isotropic() && back.description().starts_with("a broad lobe\n"));
        for (theta_i, theta_o, dphi) in [(0.1, 0.2, 0.0), (0.6, 0.3, 2.0), (1.0, 0.9, -3.0), (0.3, 1.2, 1.0)] {
            let (wi, wo) = (Direction::from_angles(theta_i, dphi), Direction::from_angles(theta_o, 0.0));
            for (got, want) in back.eval(&wi, &wo).into_iter().zip(brdf.eval(&wi, &wo)) {
                assert!((got / want - 1.0).abs() < INTERPOLATION, "{got} instead of {want} at {theta_i} {theta_o}");
            }
        }
    }

    #[test]
    fn maps_of_isotropic_files_do_not_depend_on_the_azimuth() {
        let surface = Surface::new(&Ggx::isotropic(0.2, [0.5; 3]), &ISOTROPIC).unwrap();
        for map in [&surface.ndf, &surface.sigma] {
            let (first, second) = map.values.split_at(map.values.len() / 2);
            assert!(first.iter().zip(second).all(|(a, b)| (a / b - 1.0).abs() < 1e-6));
        }
    }

    #[test]
    fn black_is_written_and_missing_values_are_named() {
        let back = Rgl::parse(&bsdf_bytes(&Lambert::gray(0.0), "black").unwrap(), "black.bsdf").unwrap();
        assert_eq!(back.eval(&Direction::from_angles(0.4, 0.0), &Direction::from_angles(0.5, 1.0)), [0.0; 3]);
        let error = bsdf_bytes(&Broken, "broken").unwrap_err();
        let BsdfError::NotFinite { theta_o_deg, .. } = &error else { panic!("{error}") };
        assert!(*theta_o_deg > 57.0, "{error}");
    }
}
