//! Response curves of non-linear cameras beside OpenCV's: `bash tests/run.sh`, which sets ZONAL_PYTHON.
#![cfg(feature = "peers")]

mod common;

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::json;
use zonal::radiometry::{CameraResponse, Stack};

const EXPOSURES_S: [f64; 7] = [0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
const ROWS: usize = 60;
const COLUMNS: usize = 80;
const SMOOTHNESS: f64 = 10.0;
/// OpenCV takes so many pixels of the image, we take all: two estimates of the same curve from different noise.
const PEER_PIXELS: usize = 300;
const DEBEVEC: f64 = 0.03;
/// The same pixels and the same estimate; OpenCV's arithmetic is f32.
const ROBERTSON: f64 = 1e-3;
const JUDGED: [usize; 2] = [20, 235];

type Curve = fn(f64) -> f64;

fn images(response: Curve) -> Vec<Vec<u8>> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(2003);
    let light: Vec<f64> = (0..ROWS * COLUMNS).map(|_| (9.0 * (rng.random::<f64>() - 0.7)).exp()).collect();
    let mut code = |x: f64| {
        let noise: f64 = StandardNormal.sample(&mut rng);
        (response(x) + 0.5 * noise).round().clamp(0.0, 255.0) as u8
    };
    EXPOSURES_S.iter().map(|t| light.iter().map(|l| code(l * t)).collect()).collect()
}

#[test]
fn responses_agree_with_opencv() {
    let responses: [(&str, Curve); 2] =
        [("power law", |x| 255.0 * x.powf(1.0 / 2.2)), ("S-curve", |x| 300.0 / (1.0 + (0.15 / x).powf(1.3)))];
    let mut cases = Vec::new();
    for (name, response) in responses {
        let images = images(response);
        let slices: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
        let stack = Stack::new(&slices, &EXPOSURES_S, 0..=255).unwrap();
        let curves = [
            ("debevec", CameraResponse::debevec(&stack, SMOOTHNESS).unwrap(), DEBEVEC),
            ("robertson", CameraResponse::robertson(&stack).unwrap(), ROBERTSON),
        ];
        for (method, curve, tolerance) in curves {
            cases.push(json!({
                "name": format!("{name}, {method}"), "method": method, "images": images, "rows": ROWS,
                "exposures_s": EXPOSURES_S, "samples": PEER_PIXELS, "smoothness": SMOOTHNESS,
                "exposures": curve.exposures(), "tolerance": tolerance, "judged": JUDGED,
            }));
        }
    }
    common::ask("peer_response.py", &json!(cases));
}
