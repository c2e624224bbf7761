//! A real 12-bit sensor's figures from its frames (EMVA 1288).
#![cfg(feature = "corpus")]

use zonal::calibrate::EmvaDescription;

/// Of gain and saturation: every sixth level of the published measurement is at hand.
const FIGURES: f64 = 0.02;
/// Of the dark noise.
const DARK_NOISE: f64 = 0.1;
/// Published figures of the sensor.
const GAIN_DN_PER_E: f64 = 0.280;
const DARK_NOISE_E: f64 = 10.9;
const SATURATION_E: f64 = 14_008.0;
const QUANTUM_EFFICIENCY: f64 = 0.45;

fn corpus() -> std::path::PathBuf {
    std::env::var_os("ZONAL_CORPUS")
        .expect("feature `corpus` needs ZONAL_CORPUS, the folder of the measured data")
        .into()
}

#[test]
fn a_real_sensor_has_its_published_figures() {
    let folder = corpus().join("noise/emva1288_ccd");
    let described = EmvaDescription::read(&folder.join("EMVA1288_Data.txt")).unwrap();
    assert_eq!(described.groups.iter().map(|g| g.images.len()).sum::<usize>(), 36);
    let got = described.photon_transfer(&folder).unwrap();
    println!("{got:?}");
    let near = |got: f64, want: f64, share: f64| assert!((got / want - 1.0).abs() < share, "{got} for {want}");
    near(got.gain_dn_per_e, GAIN_DN_PER_E, FIGURES);
    near(got.saturation_e, SATURATION_E, FIGURES);
    near(got.dark_noise_e, DARK_NOISE_E, DARK_NOISE);
    near(got.responsivity_dn / got.gain_dn_per_e, QUANTUM_EFFICIENCY, FIGURES);
    assert!((got.dark_signal_dn - 14.7).abs() < 0.1);
    // The published table deviates by less than this between 5% and 95%.
    assert!(got.linearity_error_rel < 0.01);
}
