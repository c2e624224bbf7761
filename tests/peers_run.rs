//! A run folder and its conversion read by Python with OpenEXR and json alone: `bash tests/run.sh`, which sets ZONAL_PYTHON.
//!
//! The library evaluates f_cos from the converted file; tests/python/read_run.py evaluates it from what the header says.
#![cfg(feature = "peers")]

mod common;

use std::f64::consts::{FRAC_PI_2, PI};

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::json;
use zonal::basis::{Conversion, Method};
use zonal::capture::RunFolder;
use zonal::export::ShMaterial;
use zonal::geometry::{Direction, Sample};
use zonal::patterns::{Exitant, ExposureBracket, Plan};
use zonal::reflectance::open;
use zonal::twin::{TwinBench, TwinConfig};

/// Of the largest |f_cos|: planes are f32, both programs compute in f64.
const TOLERANCE: f64 = 1e-5;
const PAIRS: usize = 1000;

#[test]
fn a_run_is_read_by_python_and_means_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let (run, sh) = (folder.path().join("run"), folder.path().join("sh.exr"));
    let rig = common::rig("ghosh-2007-built");
    let config = TwinConfig::pinhole(11);
    let calibration = common::calibrated(&rig, &config);
    let plan = Plan {
        exposure: Some(ExposureBracket { count: 2, shortest_refreshes: 2, spacing: 8 }),
        exitant: Exitant { rings: 8, sectors: 12 },
        ..Plan::of_order(2)
    };
    let mut bench = TwinBench::new(&rig, config, open("ggx-0.1-0.4").unwrap());
    let record = RunFolder::create(&run, false).unwrap();
    let measured = common::measured(&rig, &plan, &mut bench, &calibration, Some(&record)).unwrap();
    let conversion = Conversion::new(Method::Parity, rig.zone(), plan.order).unwrap();
    ShMaterial::new(&measured.coefficients, &conversion).write(&sh).unwrap();

    let material = ShMaterial::read(&sh).unwrap();
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(1000);
    // All of the hemisphere: theta_o beyond the zone is clamped, phi_o passes its seam.
    let mut angles = || [rng.random_range(0.0..FRAC_PI_2), rng.random_range(-PI..PI)];
    let pairs: Vec<_> = (0..PAIRS)
        .map(|_| {
            let (i, o) = (angles(), angles());
            let [wi, wo] = [i, o].map(|[theta, phi]| Direction::<Sample>::from_angles(theta, phi));
            json!({ "wi": i, "wo": o, "f_cos": material.f_cos(&wi, &wo) })
        })
        .collect();
    common::ask("read_run.py", &json!({ "run": run, "sh": sh, "pairs": pairs, "tolerance": TOLERANCE }));
}
