//! What several integration tests need: rigs, calibrated twins, converged integrals of the truth.
#![allow(dead_code)]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use zonal::basis::{Harmonics, index, lm, size};
use zonal::calibrate::{
    CalibrationSet, Known, Reference, black_trap, gray_card, gray_card_coefficients, gray_card_plan,
};
use zonal::capture::{Bench, Control, RunFolder};
use zonal::fit::{Fineness, Forward, Observations};
use zonal::forecast::FitAdviser;
use zonal::geometry::quadrature::polar_about_mirror;
use zonal::geometry::{Direction, ExitantGrid, Zone};
use zonal::measure::{MeasureError, Measurement, Provenance, Request, measure};
use zonal::optics::{Misalignment, Rig};
use zonal::patterns::{Lobes, Pattern, Plan};
use zonal::radiometry::{FlatField, Response};
use zonal::reduce::Coefficients;
use zonal::reflectance::{Brdf, NeuralBrdf, open};
use zonal::twin::{TwinBench, TwinConfig};

pub fn rig(name: &str) -> Rig {
    let path = format!("{}/optics/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    Rig::from_toml(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// All calibrations, made on the same twin.
pub fn calibrated(rig: &Rig, config: &TwinConfig) -> CalibrationSet {
    let mut bench = TwinBench::new(rig, config.clone(), open("gray-card").unwrap());
    CalibrationSet::make(rig, &mut bench, None, &mut |_, _| ()).unwrap()
}

/// The same with what a black trap tells of the stray light of a plan.
pub fn with_black_trap(rig: &Rig, config: &TwinConfig, set: CalibrationSet, plan: &Plan) -> CalibrationSet {
    let mut bench = TwinBench::new(rig, config.clone(), open("gray-card").unwrap());
    let known = Known { response: &set.response, flat: &set.flat, sensor: None, trap: None, map: set.map.as_ref() };
    let trap = black_trap(rig, &mut bench, plan, known, &mut |_, _| ()).unwrap();
    let known = Known { trap: Some(&trap), ..known };
    let card = Plan { exitant: plan.exitant, ..gray_card_plan(rig) };
    let (scale, check) = gray_card(rig, &mut bench, &card, known, &Reference::default(), &mut |_, _| ()).unwrap();
    CalibrationSet { scale, check, black_trap: Some(trap), ..set }
}

/// The simulated rig with each thing that is out of place drawn anew, as large in RMS.
pub fn rig_out_of_place(seed: u64) -> TwinConfig {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut drawn = |pair: [f64; 2]| -> [f64; 2] {
        let rms = (0.5 * (pair[0] * pair[0] + pair[1] * pair[1])).sqrt();
        std::array::from_fn(|_| rms * rng.sample::<f64, _>(StandardNormal))
    };
    let config = TwinConfig::pinhole(seed);
    let left = config.perturbation;
    let perturbation = Misalignment {
        camera_offset_px: drawn(left.camera_offset_px),
        projector_offset_px: drawn(left.projector_offset_px),
        paraboloid_offset_mm: drawn(left.paraboloid_offset_mm),
        dome_offset_mm: drawn(left.dome_offset_mm),
        sample_tilt_deg: drawn(left.sample_tilt_deg),
        ..left
    };
    TwinConfig { perturbation, ..config }
}

pub fn run(
    rig: &Rig,
    plan: &Plan,
    config: &TwinConfig,
    calibration: &CalibrationSet,
    sample: Arc<dyn Brdf>,
) -> Measurement {
    let mut bench = TwinBench::new(rig, config.clone(), sample);
    measured(rig, plan, &mut bench, calibration, None).unwrap()
}

/// A measurement on any bench, in silence.
pub fn measured(
    rig: &Rig,
    plan: &Plan,
    bench: &mut dyn Bench,
    calibration: &CalibrationSet,
    folder: Option<&RunFolder>,
) -> Result<Measurement, MeasureError> {
    let provenance = Provenance { sample: "test".into(), simulation: None, ..Default::default() };
    let control = Control::default();
    let adviser = FitAdviser::default();
    let request =
        Request { rig, plan, calibration, provenance: &provenance, control: &control, adviser: Some(&adviser) };
    measure(&request, bench, folder, &mut |_, _| ())
}

/// The frames of a plan, both of each step, for a linear and even projector and without the coded patch.
pub fn lobe_frames(rig: &Rig, plan: &Plan) -> Vec<Pattern> {
    let p = &rig.projector;
    let steps = plan.steps(rig.zone());
    let lobes = Lobes::new(&rig.projector_map(), rig.zone(), steps, p.width_px, p.height_px).unwrap();
    let pairs = lobes.encode_all(&Response::linear(), &FlatField::uniform(p.width_px, p.height_px));
    pairs.into_iter().flat_map(|pair| pair.patterns).collect()
}

/// A rig with sensor and panel of fewer, larger pixels: what does not depend on their number is tested faster.
pub fn coarse(mut rig: Rig, factor: usize) -> Rig {
    let size = factor as f64;
    rig.camera.pitch_um *= size;
    rig.camera.width_px /= factor;
    rig.camera.height_px /= factor;
    rig.projector.pitch_um *= size;
    rig.projector.width_px /= factor;
    rig.projector.height_px /= factor;
    rig.name += &format!("-{factor}");
    rig
}

/// z_k(wo) of a material by direct, converged quadrature: index `k * 3 + channel`.
///
/// Polar nodes about the mirror direction, clipped to the zone.
pub fn true_coefficients(brdf: &dyn Brdf, zone: Zone, order: usize, wo: &Direction) -> Vec<f64> {
    let basis = Harmonics::zonal(zone, order).unwrap();
    let mut z = vec![0.0; basis.len()];
    let mut sums = vec![0.0; 3 * basis.len()];
    for (wi, w) in polar_about_mirror(wo, 384, 512, zone.theta_max()) {
        if !zone.contains(wi.theta()) {
            continue;
        }
        basis.eval_direction_into(&wi, &mut z);
        let f = brdf.eval_cos(&wi, wo);
        for (k, z) in z.iter().enumerate() {
            for c in 0..3 {
                sums[k * 3 + c] += w * z * f[c];
            }
        }
    }
    sums
}

/// f_cos rebuilt from SH coefficients known only at the exitant directions of [`zonal::reflectance::EXITANT_DEG`].
pub struct Reconstruction {
    pub sh: Harmonics,
    /// Per exitant direction, mean of the channels.
    pub y: Vec<Vec<f64>>,
}

impl Reconstruction {
    pub fn f_cos(&self, wi: &Direction, wo: &Direction) -> f64 {
        let theta = wo.theta().to_degrees();
        let i = zonal::reflectance::EXITANT_DEG.iter().position(|t| (t - theta).abs() < 1e-6).unwrap();
        self.sh.eval(wi).iter().zip(&self.y[i]).map(|(f, y)| f * y).sum()
    }
}

/// Mean of the colour channels of coefficients indexed `k * 3 + channel`.
pub fn gray(z: &[f64]) -> Vec<f64> {
    z.chunks(3).map(|c| c.iter().sum::<f64>() / 3.0).collect()
}

pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Runs a script of tests/python on `cases` and fails with what it says; returns what it prints.
pub fn ask(script: &str, cases: &serde_json::Value) -> String {
    let python = std::env::var_os("ZONAL_PYTHON")
        .expect("set ZONAL_PYTHON to a Python with tests/python/requirements.txt installed: `bash tests/run.sh` does");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cases.json");
    std::fs::write(&file, cases.to_string()).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python").join(script);
    let output = Command::new(&python).arg("-B").arg(&script).arg(&file).output();
    let output = output.unwrap_or_else(|e| panic!("ZONAL_PYTHON = {}: {e}", python.display()));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    println!("{said}");
    assert!(output.status.success(), "{}:\n{said}{}", script.display(), String::from_utf8_lossy(&output.stderr));
    said
}

/// Coefficients of an isotropic material without error: `predicted` holds those of each ring at phi_o = 0 by channel, as
/// [`Forward::predict`] gives them for folded observations; sigma is 0.
pub fn unfolded(grid: ExitantGrid, order: usize, predicted: &[Vec<f64>; 3]) -> Coefficients {
    let terms: Vec<usize> = (0..size(order)).filter(|&k| lm(k).1 >= 0).collect();
    let n = size(order) * 3 * grid.len();
    let mut values = vec![0.0; n];
    for (c, predicted) in predicted.iter().enumerate() {
        for k in 0..size(order) {
            let (l, m) = lm(k);
            let term = terms.iter().position(|&t| t == index(l, m.abs())).unwrap();
            for cell in 0..grid.len() {
                let phi = f64::from(m) * grid.phi(cell % grid.sectors());
                let z = predicted[cell / grid.sectors() * terms.len() + term];
                let turned = if m >= 0 { z * phi.cos() } else { -z * phi.sin() };
                values[(k * 3 + c) * grid.len() + cell] = turned as f32;
            }
        }
    }
    Coefficients { grid, order, values, sigma: vec![0.0; n], history: "exact integrals".into() }
}

/// Exact coefficients of an isotropic material over `lit`, as a rig with the zone of `grid` would take them: the gray card
/// sets their scale.
pub fn exact_coefficients(brdf: &dyn Brdf, grid: ExitantGrid, order: usize, lit: Zone) -> Coefficients {
    let n = size(order) * 3 * grid.len();
    let blank = Coefficients { grid, order, values: vec![1.0; n], sigma: vec![1.0; n], history: String::new() };
    let folded = Observations::folded(&blank);
    let forward = Forward::over(&folded, lit, Fineness { radial: 48, around: 96 }).unwrap();
    let card = |zone: Zone| gray_card_coefficients(zone, 0, 1.0)[0];
    let scale = card(grid.zone()) / card(lit);
    unfolded(grid, order, &forward.predict(brdf).map(|z| z.iter().map(|z| z * scale).collect()))
}

/// The same measurement with noise added until every standard error is `noise_rel` of RMS z_00.
pub fn noisy(coefficients: &Coefficients, noise_rel: f64, seed: u64) -> Coefficients {
    let mut noisy = coefficients.clone();
    let dc: Vec<f64> = coefficients.values[..3 * coefficients.grid.len()].iter().map(|z| f64::from(*z)).collect();
    let dc: Vec<f64> = dc.into_iter().filter(|z| z.is_finite()).collect();
    let dc = (dc.iter().map(|z| z * z).sum::<f64>() / dc.len() as f64).sqrt();
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    for (z, sigma) in noisy.values.iter_mut().zip(&mut noisy.sigma) {
        let add = ((noise_rel * dc).powi(2) - f64::from(*sigma).powi(2)).max(0.0).sqrt();
        let e: f64 = StandardNormal.sample(&mut rng);
        *z += (add * e) as f32;
        *sigma = f64::from(*sigma).hypot(add) as f32;
    }
    noisy
}

/// The folder of measured data.
pub fn corpus() -> PathBuf {
    std::env::var_os("ZONAL_CORPUS")
        .expect("feature `corpus` needs ZONAL_CORPUS, the folder of the measured data")
        .into()
}

/// The nine RGL files and the neural fits of MERL rows 0, 5, ..., 95 (their names begin with `merl`).
pub fn measured_materials() -> Vec<(String, Arc<dyn Brdf>)> {
    let mut files: Vec<_> = std::fs::read_dir(corpus().join("rgl")).unwrap().map(|f| f.unwrap().path()).collect();
    files.sort();
    let rgl = files.iter().map(|f| {
        let name = f.file_stem().unwrap().to_string_lossy().into_owned();
        (name, open(f.to_str().unwrap()).unwrap())
    });
    let merl = (0..100).step_by(5).map(|row| {
        let brdf = NeuralBrdf::read(corpus().join("merl/nbrdf_merl_f32le.bin"), row).unwrap();
        (format!("merl-{row}"), Arc::new(brdf) as Arc<dyn Brdf>)
    });
    rgl.chain(merl).collect()
}
