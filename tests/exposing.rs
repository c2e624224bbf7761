//! Automatic exposures, from black velvet to foil: nothing saturates, the noise target is met, and hardly a frame is wasted.

mod common;

use std::sync::{Arc, LazyLock};

use zonal::basis::size;
use zonal::calibrate::CalibrationSet;
use zonal::capture::{Crop, ResponseImage, RunFolder, sensor};
use zonal::geometry::ExitantGrid;
use zonal::optics::Rig;
use zonal::patterns::{AutomaticBracket, Exitant, Lobe, Plan, Sign};
use zonal::reduce::{CHANNEL_NAMES, CellMap, Coefficients};
use zonal::reflectance::{Brdf, Ggx, GgxLobe, Lambert, open};
use zonal::twin::{TwinBench, TwinConfig};

static COARSE: LazyLock<Rig> = LazyLock::new(|| common::coarse(common::rig("ghosh-2007-built"), 4));
static CALIBRATION: LazyLock<CalibrationSet> = LazyLock::new(|| common::calibrated(&COARSE, &TwinConfig::pinhole(1)));

const NOISE: f64 = 0.01;
const LONGEST: u32 = 256;

fn plan() -> Plan {
    Plan {
        exposure: None,
        automatic: Some(AutomaticBracket { noise_rel: NOISE, shortest_refreshes: 1, longest_refreshes: LONGEST }),
        exitant: Exitant { rings: 6, sectors: 12 },
        ..Plan::of_order(2)
    }
}

fn foil() -> Ggx {
    let lobe = GgxLobe { alpha: [0.08; 2], f0: [0.92; 3], f90: [1.0; 3] };
    Ggx { kd: [0.0; 3], lobes: vec![lobe] }
}

fn materials() -> [(&'static str, Arc<dyn Brdf>); 6] {
    [
        ("black velvet", Arc::new(Lambert::gray(0.004))),
        ("black rubber", Arc::new(Lambert::gray(0.03))),
        ("red plastic", open("red-plastic").unwrap()),
        ("white", open("white").unwrap()),
        ("polished metal", open("ggx-0.1").unwrap()),
        ("foil", Arc::new(foil())),
    ]
}

/// RMS standard error of every function's coefficients over RMS z_00.
fn noise_of(coefficients: &Coefficients, k: usize) -> f64 {
    let n = coefficients.grid.len();
    let rms = |values: &[f32]| (values.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>() / values.len() as f64).sqrt();
    rms(&coefficients.sigma[3 * n * k..][..3 * n]) / rms(&coefficients.values[..3 * n])
}

/// The least number of exposures with which noiseless rates reach the target: all sets of a fine ladder are tried.
fn least(rates: &[[f64; 2]], weights: &[f64], gain: f64, limit: f64) -> usize {
    let camera = sensor(&COARSE);
    let floor = camera.dark_noise_e.powi(2) + 1.0 / (12.0 * camera.gain_dn_per_e.powi(2));
    let range = (camera.limit_dn - camera.black_level_dn) / camera.gain_dn_per_e;
    let ladder: Vec<f64> = (0..=24).map(|i| 2f64.powf(f64::from(i) / 3.0).round() / 60.0).collect();
    let sigma = |set: &[f64]| {
        let pixel = |rate: f64| {
            let usable = set.iter().filter(|&&t| rate * t < range);
            usable.map(|&t| t * t / (rate.max(0.0) * t + floor)).sum::<f64>().recip()
        };
        let power: f64 = rates.iter().zip(weights).map(|(r, w)| w * (pixel(r[0]) + pixel(r[1]))).sum();
        power.sqrt() / gain
    };
    if ladder.iter().any(|&a| sigma(&[a]) <= limit) {
        return 1;
    }
    if ladder.iter().any(|&a| ladder.iter().any(|&b| sigma(&[a, b]) <= limit)) {
        return 2;
    }
    3
}

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn six_materials_get_what_they_need() {
    let crop = Crop::of_zone(&COARSE);
    let plan = plan();
    let grid = ExitantGrid::new(COARSE.zone(), plan.exitant.rings, plan.exitant.sectors);
    let cells = CellMap::new(&COARSE, &COARSE.camera_map(), crop, grid).unwrap();
    let weights = cells.noise_weights(&CALIBRATION.scale);
    for (name, brdf) in materials() {
        let dir = tempfile::tempdir().unwrap();
        let (path, truth) = (dir.path().join("run"), dir.path().join("truth"));
        let mut bench = TwinBench::new(&COARSE, TwinConfig::pinhole(8), brdf.clone());
        let folder = RunFolder::create(&path, false).unwrap();
        let measured = common::measured(&COARSE, &plan, &mut bench, &CALIBRATION, Some(&folder)).unwrap();
        let mut quiet = TwinBench::new(&COARSE, TwinConfig::pinhole(8).noiseless(), brdf);
        let true_folder = RunFolder::create(&truth, false).unwrap();
        let fixed = Plan { exitant: plan.exitant, ..Plan::of_order(2) };
        let exact = common::measured(&COARSE, &fixed, &mut quiet, &CALIBRATION, Some(&true_folder)).unwrap();
        let journal = std::fs::read_to_string(path.join("journal.jsonl")).unwrap();
        let n = 3 * grid.len();
        let constant =
            (exact.coefficients.values[..n].iter().map(|z| f64::from(*z).powi(2)).sum::<f64>() / n as f64).sqrt();
        let (mut taken, mut fewest, mut worst) = (0, 0, 0.0f64);
        for k in 0..size(2) {
            let response = |sign| {
                ResponseImage::read(&true_folder.response_path(&Lobe { k, sign, mixed: false }, 0)).unwrap().rate
            };
            let [positive, negative] = [Sign::Positive, Sign::Negative].map(response);
            let rates: Vec<[f64; 2]> =
                positive.iter().zip(&negative).map(|(&p, &q)| [f64::from(p), f64::from(q)]).collect();
            let needed = least(&rates, &weights, exact.record.gains[k], NOISE * constant);
            let line = format!("\"k\":{k},\"sign\":\"positive\"");
            let used = journal.lines().filter(|l| l.contains("\"event\":\"frame\"") && l.contains(&line)).count();
            assert!(used <= needed + 1, "{name}, k = {k}: {used} exposures where {needed} do");
            let noise = noise_of(&measured.coefficients, k);
            assert!(noise <= NOISE, "{name}, k = {k}: noise {noise}");
            (taken, fewest, worst) = (taken + used, fewest + needed, worst.max(noise));
        }
        eprintln!(
            "{name}: {taken} exposures, {fewest} the least, noise at most {:.2}% in {:?}, {} channels",
            100.0 * worst,
            measured.record.frames,
            CHANNEL_NAMES.len()
        );
        assert_eq!(measured.record.saturated_fraction, 0.0, "{name}");
    }
}
