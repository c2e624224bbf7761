//! Readers of measured reflectance on measured files: `ZONAL_CORPUS=folder cargo test --release --features corpus`.
#![cfg(feature = "corpus")]

mod common;

use std::collections::BTreeMap;
use std::path::PathBuf;

use zonal::geometry::{Direction, Zone};
use zonal::reflectance::{Alta, Brdf, Metric, NeuralBrdf, Rgl, abc_materials, open};

/// Mitsuba computes in f32, where the polar angle of a half vector errs by some 1e-7 rad; the inverse warp of a glossy
/// material turns that into this much near its peak ...
const MITSUBA_F32_WORST: f64 = 5e-4;
/// ... and into this much of a typical value.
const MITSUBA_F32_TYPICAL: f64 = 2e-6;

/// A path inside of the corpus.
fn corpus(path: &str) -> PathBuf {
    common::corpus().join(path)
}

/// Rows of theta_i, phi_i, theta_o, phi_o and three values.
fn golden(json: &str) -> BTreeMap<String, Vec<[f64; 7]>> {
    serde_json::from_str(json).unwrap()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Names of the RGL files with golden values.
fn rgl_rows() -> Vec<(String, Vec<[f64; 7]>)> {
    golden(include_str!("golden/rgl_mitsuba.json")).into_iter().filter(|(name, _)| name.ends_with(".bsdf")).collect()
}

#[test]
fn rgl_files_agree_with_mitsuba() {
    let files = rgl_rows();
    assert_eq!(files.len(), 9);
    for (name, rows) in files {
        let rgl = Rgl::read(corpus("rgl").join(&name)).unwrap();
        let mut errors = Vec::new();
        for [theta_i, phi_i, theta_o, phi_o, want @ ..] in rows {
            let (wi, wo) = (Direction::from_angles(theta_i, phi_i), Direction::from_angles(theta_o, phi_o));
            // Relative to the brightest channel: others may cancel to nothing.
            let scale = want.iter().fold(1e-6f64, |m, v| m.max(*v));
            for (got, want) in rgl.eval_cos(&wi, &wo).into_iter().zip(want) {
                errors.push((got - want.max(0.0)).abs() / scale);
            }
        }
        let worst = errors.iter().fold(0f64, |m, e| m.max(*e));
        let typical = median(errors);
        assert!(worst < MITSUBA_F32_WORST, "{name}: worst {worst:e}, median {typical:e}");
        assert!(typical < MITSUBA_F32_TYPICAL, "{name}: median {typical:e}");
    }
}

#[test]
fn rgl_files_conserve_energy_and_are_named() {
    for (name, _) in rgl_rows() {
        let path = corpus("rgl").join(&name);
        let rgl = Rgl::read(&path).unwrap();
        assert!(rgl.is_isotropic() && rgl.description().len() > 20, "{name}");
        for theta in [10f64, 45.0, 70.0] {
            let albedo = rgl.albedo(&Direction::from_angles(theta.to_radians(), 0.3));
            assert!(albedo.iter().all(|a| (0.0..=0.97).contains(a)), "{name} at {theta} deg: {albedo:?}");
        }
        assert!(open(path.to_str().unwrap()).is_ok());
    }
}

/// The rule against negative truths must not send measured files away.
#[test]
fn measured_files_and_fits_pass_as_truths() {
    let metric = Metric::new(Zone::from_degrees(9.0, 57.0).unwrap());
    for (name, _) in rgl_rows() {
        metric.reference(&Rgl::read(corpus("rgl").join(&name)).unwrap()).unwrap_or_else(|e| panic!("{name}: {e}"));
    }
    for (row, material) in abc_materials().iter().enumerate() {
        let neural = NeuralBrdf::read(corpus("merl/nbrdf_merl_f32le.bin"), row).unwrap();
        let reference = metric.reference(&neural).unwrap_or_else(|e| panic!("row {row}: {e}"));
        let errors = reference.errors(&material.brdf).unwrap_or_else(|e| panic!("{}: {e}", material.name));
        assert!(errors.mean.rel_in.is_finite() && errors.mean.log_out.is_finite(), "{}: {errors:?}", material.name);
    }
}

#[test]
fn neural_fits_agree_with_the_published_formula() {
    // Both compute in f64; exp amplifies rounding, and the golden values have 12 digits.
    const ROUNDING: f64 = 1e-9;
    for (row, rows) in golden(include_str!("golden/nbrdf_numpy.json")) {
        let brdf = NeuralBrdf::read(corpus("merl/nbrdf_merl_f32le.bin"), row.parse().unwrap()).unwrap();
        for [theta_i, phi_i, theta_o, phi_o, want @ ..] in rows {
            let (wi, wo) = (Direction::from_angles(theta_i, phi_i), Direction::from_angles(theta_o, phi_o));
            for (got, want) in brdf.eval(&wi, &wo).into_iter().zip(want) {
                assert!((got - want).abs() <= ROUNDING * want.max(1e-3), "row {row}: {got} instead of {want}");
            }
        }
    }
}

#[test]
fn abc_fits_resemble_the_neural_fits_of_the_same_materials() {
    // Two fits of one measurement: a wrong cosine, scale or argument shows as more than this.
    const RATIO: f64 = 2.0;
    let mut ratios_of_all = Vec::new();
    for (row, material) in abc_materials().iter().enumerate() {
        let neural = NeuralBrdf::read(corpus("merl/nbrdf_merl_f32le.bin"), row).unwrap();
        let mut ratios = Vec::new();
        for (theta_i, theta_o, dphi) in
            (0..60).map(|k| (0.1 + 0.02 * f64::from(k), 1.2 - 0.017 * f64::from(k), 0.1 + 0.05 * f64::from(k)))
        {
            let (wi, wo) = (Direction::from_angles(theta_i, 0.0), Direction::from_angles(theta_o, dphi));
            let (f, g) = (material.brdf.eval(&wi, &wo)[1], neural.eval(&wi, &wo)[1]);
            if g > 1e-4 {
                ratios.push(f / g);
            }
        }
        if ratios.len() > 20 {
            ratios_of_all.push(median(ratios));
        }
    }
    assert!(ratios_of_all.len() > 90);
    let close = ratios_of_all.iter().filter(|r| (1.0 / RATIO..=RATIO).contains(*r)).count();
    assert!(close * 10 > ratios_of_all.len() * 8, "{close} of {}", ratios_of_all.len());
    assert!((0.8..1.25).contains(&median(ratios_of_all)));
}

/// Share of the light from (theta_i, 0) that leaves within ten degrees of a direction of its plane, by ring and sector.
fn lobe_share(tape: &Alta, theta_i_deg: f64, centre_deg: f64) -> f64 {
    let wi = Direction::from_angles(theta_i_deg.to_radians(), 0.0);
    let centre = Direction::<zonal::geometry::Sample>::from_angles(centre_deg.to_radians(), 0.0).vector();
    let (along, across) = (nalgebra::Vector3::new(centre.z, 0.0, -centre.x), nalgebra::Vector3::y());
    let (rings, sectors) = (40, 72);
    let mut share = 0.0;
    for (ring, sector) in (0..rings).flat_map(|r| (0..sectors).map(move |s| (r, s))) {
        let chi = 10f64.to_radians() * (f64::from(ring) + 0.5) / f64::from(rings);
        let (sin, cos) = (std::f64::consts::TAU * f64::from(sector) / f64::from(sectors)).sin_cos();
        let wo = Direction::new(centre * chi.cos() + (along * cos + across * sin) * chi.sin());
        let omega = chi.sin() * 10f64.to_radians() / f64::from(rings) * std::f64::consts::TAU / f64::from(sectors);
        share += tape.eval(&wi, &wo)[0] * wo.cos_theta().max(0.0) * omega;
    }
    share
}

/// The tape sends far more back than its coat reflects, and the coat obeys Fresnel: that fixes the azimuth and the cosine.
#[test]
fn the_retro_reflective_tape_sends_light_back() {
    let tape = Alta::read(corpus("retro/retro-3M-jaune.dat")).unwrap();
    assert_eq!(tape.theta_i().map(|t| t.to_degrees().round()).collect::<Vec<_>>(), [15.0, 30.0, 60.0]);
    let lobes = [15.0, 22.0, 30.0, 45.0, 60.0].map(|t| (t, lobe_share(&tape, t, t), lobe_share(&tape, t, -t)));
    for (theta, back, mirror) in lobes {
        println!("theta_i {theta} deg: {back:.4} back, {mirror:.4} to the mirror direction");
        assert!(back > 2.0 * mirror, "{theta} deg: {back} back, {mirror} to the mirror direction");
    }
    // A coat of index 1.5 reflects 4.0% at 15 deg and 8.9% at 60 deg; taken for f, the values would give less at 60.
    assert!((0.03..0.07).contains(&lobes[0].2) && lobes[4].2 > 1.1 * lobes[0].2, "{lobes:?}");
    // Values hold the camera's cosine: only without it they are the same when light and camera change places.
    const RECIPROCITY: f64 = 0.05;
    for (a, b) in [(15.0f64, 30.0f64), (15.0, 60.0), (30.0, 60.0)] {
        let [p, q] = [a, b].map(|theta| Direction::from_angles(theta.to_radians(), 0.0));
        let (f, g) = (tape.eval(&p, &q)[0], tape.eval(&q, &p)[0]);
        println!("{a} and {b} deg: {f:.4} and {g:.4} 1/sr");
        assert!((f / g - 1.0).abs() < RECIPROCITY, "{a} and {b} deg: {f} and {g}");
    }
    // Sums over the points of the file itself give 0.69..0.75.
    for theta_o in [10.0f64, 45.0, 70.0] {
        let albedo = tape.albedo(&Direction::from_angles(theta_o.to_radians(), 0.3))[0];
        println!("theta_o {theta_o} deg: albedo {albedo:.3}");
        assert!((0.65..0.8).contains(&albedo), "{theta_o} deg: {albedo}");
    }
    // What docs/limits.md says about angles that the file does not hold.
    let [normal, grazing] =
        [0.5f64, 85.0].map(|theta_o| tape.albedo(&Direction::from_angles(theta_o.to_radians(), 0.3))[0]);
    println!("albedo {normal:.3} at the normal, {grazing:.3} at 85 deg");
    assert!((0.45..0.6).contains(&normal) && (1.0..1.15).contains(&grazing), "{normal} {grazing}");
    Metric::new(Zone::from_degrees(9.0, 57.0).unwrap()).reference(&tape).unwrap();
    let grid = || (0..30).map(|k| (f64::from(k) * 3.1).to_radians());
    for (theta_i, theta_o, dphi) in grid().flat_map(|i| grid().flat_map(move |o| [0.0, 1.0, 3.0].map(|d| (i, o, d)))) {
        let f = tape.eval(&Direction::from_angles(theta_i, 0.0), &Direction::from_angles(theta_o, dphi))[0];
        assert!(f.is_finite() && f >= 0.0, "{theta_i} {theta_o} {dphi}: {f}");
    }
    assert!(open(corpus("retro/retro-3M-jaune.dat").to_str().unwrap()).is_ok());
}
