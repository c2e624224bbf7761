//! Exported `.bsdf` files in Mitsuba 3: `bash tests/run.sh`, which sets ZONAL_PYTHON.
//!
//! Values are compared with the source model, so that the errors are those of the file, of its reader and of nothing else.
//! By formula the other readers agree. With `camera` what indexes the table and `light` the other direction,
//! v = rgb ndf / (4 sigma):
//! - Mitsuba `measured`, eval(si.wi = camera, wo = light): v, the table's f cos(theta) of the light.
//! - powitacq `BRDF::eval(wi = camera, wo = light)`: v, so the cosine is that of its `wo`, which is our wi.
//! - pbrt-v4 `MeasuredBxDF::f(wo = camera, wi = light)`: v / cos(theta) of the light, our f. It reads files of the
//!   spectral variant only, and applies ndf / (4 sigma) whatever the flag `jacobian` says: it is 1 here.
#![cfg(feature = "peers")]

mod common;

use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::{Value, json};
use zonal::export::write_bsdf;
use zonal::fit::{FitMethod, FitOptions, fit};
use zonal::geometry::quadrature::polar_about_mirror;
use zonal::geometry::{Direction, ExitantGrid, Sample, Zone};
use zonal::reflectance::{Brdf, Dbrdf, Density, DensityTerm, Ggx, GgxLobe, Rgl, open};
use zonal::render::{Probe, Shape};

const PAIRS: usize = 3000;
/// Both directions lie within it: beyond, f_cos vanishes and relative errors mean little.
const THETA_MAX_DEG: f64 = 78.0;
/// Half vectors of the pairs in and round the lobe: theta_h from 0.1 deg to 10^1.3 = 20 deg, evenly in its logarithm.
const LOBE_DECADES: f64 = 1.3;
/// Relative errors of isotropic files: what the exporter promises (docs/limits.md has what it reaches).
const MEDIAN: f64 = 0.005;
const P95: f64 = 0.01;
/// The same in and round the lobe, where two lobes on a diffuser bend most within a cell; for anisotropic files too.
const LOBE_P95: f64 = 0.02;
/// The same for a mixture with lobes down to alpha = 0.006, far below what the table's cells resolve beside wide ones.
const MANY_LOBES_P95: f64 = 0.05;
/// The same for an anisotropic one, whose azimuths lie 15 deg apart.
const ANISOTROPIC_MEDIAN: f64 = 0.005;
const ANISOTROPIC_P95: f64 = 0.04;
/// Of the directional albedo, relative.
const ALBEDO: f64 = 0.005;
const ANISOTROPIC_ALBEDO: f64 = 0.01;
/// The same for lobes of low F0 beside others: their Fresnel term grows fivefold towards 70 deg, and lines between exitant
/// angles lie above it.
const TWO_LOBES_ALBEDO: f64 = 0.008;
/// Mitsuba computes in f32 and our reader in f64, relative to the larger of the value and 0.01; lobes multiply the rounding.
const F32: f64 = 2e-4;
/// Bytes.
const ISOTROPIC_SIZE: u64 = 1_000_000;

fn lobe(alpha: f64, f0: f64) -> GgxLobe {
    GgxLobe { alpha: [alpha; 2], f0: [f0; 3], f90: [1.0; 3] }
}

/// Fits whose files are checked: the name of the case, the sample, the family.
const FITTED: [(&str, &str, FitMethod); 6] = [
    ("fit of ggx-0.05", "ggx-0.05", FitMethod::Ggx),
    ("fit of ggx-0.1", "ggx-0.1", FitMethod::Auto),
    ("fit of ggx-0.4", "ggx-0.4", FitMethod::Auto),
    ("d-brdf of ggx-0.4", "ggx-0.4", FitMethod::Dbrdf),
    ("fit of violet-acrylic", "violet-acrylic", FitMethod::Auto),
    ("mixture of violet-acrylic", "violet-acrylic", FitMethod::Mixture),
];

/// The model fitted to a sample as order 4 and 1% noise show it.
fn fitted(sample: &str, method: FitMethod) -> Arc<dyn Brdf> {
    let zone = Zone::from_degrees(9.0, 57.0).unwrap();
    let exact = common::exact_coefficients(open(sample).unwrap().as_ref(), ExitantGrid::new(zone, 16, 16), 4, zone);
    let report = fit(&common::noisy(&exact, 0.01, 5), method, &FitOptions::default()).unwrap();
    assert!(report.successful);
    Arc::new(report.brdf)
}

fn materials() -> Vec<(&'static str, Arc<dyn Brdf>)> {
    let two_lobes = Ggx { kd: [0.3, 0.2, 0.1], lobes: vec![lobe(0.06, 0.03), lobe(0.3, 0.05)] };
    let terms = [(0.7, 0.1), (0.3, 0.4)].map(|(weight, alpha)| DensityTerm { weight, alpha: [alpha; 2] });
    let dbrdf = Dbrdf { kd: [0.1, 0.2, 0.3], c: [0.3; 3], r0: 0.1, p: Density::Mixture(terms.into()) };
    let named = ["ggx-0.05", "ggx-0.1", "ggx-0.4", "violet-acrylic", "alum-bronze", "ggx-0.1-0.4"];
    let mut all: Vec<(&str, Arc<dyn Brdf>)> = named.map(|name| (name, open(name).unwrap())).into();
    all.extend(FITTED.map(|(name, sample, method)| (name, fitted(sample, method))));
    all.push(("two lobes", Arc::new(two_lobes)));
    all.push(("d-brdf", Arc::new(dbrdf)));
    all
}

fn xyz(d: &Direction<Sample>) -> [f64; 3] {
    d.vector().into()
}

/// Everything Mitsuba is to evaluate of one file.
fn case(name: &str, brdf: &dyn Brdf, file: &Path) -> Value {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(3000);
    let mut any =
        || Direction::from_angles(rng.random_range(0.0..THETA_MAX_DEG.to_radians()), rng.random_range(-PI..PI));
    let back = Rgl::read(file).unwrap();
    let row = |(wi, wo): (Direction<Sample>, Direction<Sample>)| {
        json!([xyz(&wi), xyz(&wo), brdf.eval_cos(&wi, &wo), back.eval_cos(&wi, &wo)])
    };
    let pairs: Vec<_> = (0..PAIRS).map(|_| row((any(), any()))).collect();
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(3001);
    let lobe_pairs: Vec<_> = std::iter::repeat_with(|| {
        let theta_h = 10f64.powf(rng.random_range(-1.0..LOBE_DECADES)).to_radians();
        let h = Direction::<Sample>::from_angles(theta_h, rng.random_range(-PI..PI)).vector();
        let wo = Direction::from_angles(rng.random_range(0.0..THETA_MAX_DEG.to_radians()), rng.random_range(-PI..PI));
        (Direction::new(h * (2.0 * h.dot(&wo.vector())) - wo.vector()), wo)
    })
    .filter(|(wi, _)| wi.theta() < THETA_MAX_DEG.to_radians())
    .take(PAIRS)
    .map(row)
    .collect();
    let albedos: Vec<_> = [10.0f64, 45.0, 70.0]
        .iter()
        .map(|theta_deg| {
            let wo = Direction::from_angles(theta_deg.to_radians(), 0.3);
            let nodes: Vec<_> = polar_about_mirror(&wo, 96, 128, PI / 2.0)
                .into_iter()
                .map(|(wi, weight)| json!([xyz(&wi), weight, brdf.eval_cos(&wi, &wo)]))
                .collect();
            json!({ "theta_o_deg": theta_deg, "wo": xyz(&wo), "nodes": nodes })
        })
        .collect();
    let isotropic = brdf.is_isotropic();
    json!({
        "name": name,
        "file": file,
        "pairs": pairs,
        "lobe_pairs": lobe_pairs,
        "albedos": albedos,
        "median": if isotropic { MEDIAN } else { ANISOTROPIC_MEDIAN },
        "p95": if isotropic { P95 } else { ANISOTROPIC_P95 },
        "lobe_p95": if name == "mixture of violet-acrylic" { MANY_LOBES_P95 } else { LOBE_P95 },
        "albedo": match name {
            "two lobes" | "d-brdf of ggx-0.4" | "mixture of violet-acrylic" => TWO_LOBES_ALBEDO,
            _ if isotropic => ALBEDO,
            _ => ANISOTROPIC_ALBEDO,
        },
        "readers": F32,
    })
}

#[test]
fn mitsuba_evaluates_the_source_model() {
    let folder = tempfile::tempdir().unwrap();
    let cases: Vec<Value> = materials()
        .iter()
        .map(|(name, brdf)| {
            let file = folder.path().join(format!("{name}.bsdf"));
            write_bsdf(brdf.as_ref(), name, &file).unwrap();
            let size = std::fs::metadata(&file).unwrap().len();
            assert!(!brdf.is_isotropic() || size <= ISOTROPIC_SIZE, "{name}: {size} bytes");
            case(name, brdf.as_ref(), &file)
        })
        .collect();
    common::ask("peer_bsdf.py", &json!(cases));
}

/// Mean relative difference of pictures: Mitsuba's noise, pixels as areas against points, and the file's error.
const PICTURE: f64 = 0.02;
/// Side of a picture, pixels.
const SIDE: usize = 96;

#[test]
fn mitsuba_draws_the_picture_of_the_source_model() {
    let folder = tempfile::tempdir().unwrap();
    let light = Direction::new(Vector3::new(0.45, 0.55, 0.7));
    let furnace = Probe::constant([1.0; 3]);
    let cases: Vec<Value> = ["fit of ggx-0.1", "ggx-0.4", "fit of violet-acrylic"]
        .iter()
        .flat_map(|name| {
            let brdf = FITTED.iter().find(|f| f.0 == *name).map_or_else(|| open(name).unwrap(), |f| fitted(f.1, f.2));
            let file = folder.path().join(format!("{name}.bsdf"));
            write_bsdf(brdf.as_ref(), name, &file).unwrap();
            let directional = Shape::Sphere.directional(brdf.as_ref(), light, [PI; 3], SIDE);
            let mut cases = vec![json!({
                "name": format!("{name}, one light"),
                "file": file,
                "light": [0.45, 0.55, 0.7],
                "irradiance": PI,
                "pixels": directional.pixels,
            })];
            // The 512 lights of a probe resolve broad lobes.
            if *name == "ggx-0.4" {
                let pixels = Shape::Sphere.in_probe(brdf.as_ref(), &furnace, SIDE).pixels;
                cases.push(
                    json!({ "name": format!("{name}, furnace"), "file": file, "radiance": 1.0, "pixels": pixels }),
                );
            }
            cases
        })
        .collect();
    common::ask("peer_render.py", &json!({ "side": SIDE, "tolerance": PICTURE, "cases": cases }));
}
