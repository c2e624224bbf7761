//! `parity` on the full zone at order 6 with the default devices' noise, for all 100 ABC materials.

mod common;

use std::f64::consts::{FRAC_PI_2, TAU};

use common::{Reconstruction, gray, median};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use zonal::basis::{Conversion, Harmonics, Method, lm, size};
use zonal::geometry::Direction;
use zonal::geometry::quadrature::polar_about_mirror;
use zonal::optics::Rig;
use zonal::patterns::{Plan, Timing};
use zonal::radiometry::Sensor;
use zonal::reflectance::{Brdf, EXITANT_DEG, ZoneErrors, abc_materials};
use zonal::twin::TwinConfig;

const ORDER: usize = 6;

/// Median over materials of parity's error over that of projecting the truth itself, the same noise in both.
const AT_MOST: f64 = 1.1;

/// Integrals of one material towards one direction, mean of the channels.
struct Integrals {
    /// Responses to both lobes of every zonal function.
    lobes: Vec<[f64; 2]>,
    /// SH coefficients of the truth over the hemisphere, odd ones doubled (their norm there), others 0.
    projection: Vec<f64>,
}

fn integrals(brdf: &dyn Brdf, rig: &Rig, wo: &Direction) -> Integrals {
    let (zone, sh_order) = (rig.zone(), ORDER + 1);
    let zonal = Harmonics::zonal(zone, ORDER).unwrap();
    let sh = Harmonics::spherical(sh_order).unwrap();
    let (mut z, mut y) = (vec![0.0; zonal.len()], vec![0.0; sh.len()]);
    let mut lobes = vec![[0.0; 2]; zonal.len()];
    let mut projection = vec![0.0; sh.len()];
    for (wi, w) in polar_about_mirror(wo, 256, 256, FRAC_PI_2) {
        let f = gray(&brdf.eval_cos(&wi, wo))[0] * w;
        sh.eval_direction_into(&wi, &mut y);
        for (k, (sum, y)) in projection.iter_mut().zip(&y).enumerate() {
            let (l, m) = lm(k);
            if (l as i32 + m) % 2 != 0 {
                *sum += 2.0 * f * y;
            }
        }
        if zone.contains(wi.theta()) {
            zonal.eval_direction_into(&wi, &mut z);
            for (sum, z) in lobes.iter_mut().zip(&z) {
                sum[usize::from(*z < 0.0)] += f * z.abs();
            }
        }
    }
    Integrals { lobes, projection }
}

/// Standard errors of z_k in an exitant cell at `theta_o`, from the sensor's figures and the lamp of the default rig.
fn sigma(rig: &Rig, lobes: &[[f64; 2]], theta_o: f64) -> Vec<f64> {
    let c = &rig.camera;
    let plan = Plan::of_order(ORDER);
    let exposures = plan.exposures_s(&Timing::of(rig));
    let sensor = Sensor {
        gain_dn_per_e: c.gain_dn_per_e,
        dark_noise_e: c.dark_noise_e,
        black_level_dn: c.black_level_dn,
        limit_dn: c.linear_limit_dn,
    };
    let zone = rig.zone();
    let card = 0.18 / std::f64::consts::PI * zone.projected_solid_angle();
    let lamp = 0.5 * c.full_well_e / TwinConfig::pinhole(0).half_well_exposure_s / card;
    let width = (zone.theta_max() - zone.theta_min()) / plan.exitant.rings as f64;
    let radius = |theta: f64| rig.camera_map().radius_px(theta).unwrap();
    let (inner, outer) = (radius(theta_o - width / 2.0), radius(theta_o + width / 2.0));
    let pixels = (outer * outer - inner * inner) * TAU / 2.0 / plan.exitant.sectors as f64;
    // A mean of red (n/4 pixels), green (n/2) and blue (n/4) has the variance of 9/10 n pixels.
    let pixels = 0.9 * pixels;
    let zonal = Harmonics::zonal(zone, ORDER).unwrap();
    let mut peaks = vec![0.0f64; zonal.len()];
    for (d, _) in zonal::geometry::quadrature::zone_product(&zone, 60, 120) {
        for (peak, z) in peaks.iter_mut().zip(zonal.eval(&d)) {
            *peak = peak.max(z.abs());
        }
    }
    let variance = |rate: f64| {
        let sample = |&t: &f64| ((c.black_level_dn + c.gain_dn_per_e * rate * t).min(4095.0) as u16, t);
        sensor.merge(exposures.iter().map(sample).collect::<Vec<_>>().into_iter()).map_or(f64::NAN, |e| e.variance)
    };
    lobes
        .iter()
        .zip(&peaks)
        .map(|(lobes, peak)| {
            let both: f64 = lobes.iter().map(|r| variance(lamp * r / peak)).sum();
            peak / lamp * (both / pixels).sqrt()
        })
        .collect()
}

#[test]
fn parity_is_as_good_as_projecting_the_truth() {
    let rig = common::rig("ghosh-2007-full");
    let conversion = Conversion::new(Method::Parity, rig.zone(), ORDER).unwrap();
    let errors: Vec<(f64, f64)> = abc_materials()
        .par_iter()
        .enumerate()
        .map(|(i, material)| {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(i as u64);
            let (mut measured, mut ideal) = (Vec::new(), Vec::new());
            for theta in EXITANT_DEG {
                let wo = Direction::from_angles(theta.to_radians(), 0.0);
                let of = integrals(&material.brdf, &rig, &wo);
                let noise: Vec<f64> = sigma(&rig, &of.lobes, theta.to_radians())
                    .into_iter()
                    .map(|s| {
                        let unit: f64 = StandardNormal.sample(&mut rng);
                        s * unit
                    })
                    .collect();
                let z: Vec<f64> = of.lobes.iter().zip(&noise).map(|(l, n)| l[0] - l[1] + n).collect();
                let of_noise = conversion.apply(&noise);
                measured.push(conversion.apply(&z));
                ideal.push(of.projection.iter().zip(of_noise).map(|(p, n)| p + n).collect());
            }
            let outside = |y: Vec<Vec<f64>>| {
                let r = Reconstruction { sh: Harmonics::spherical(ORDER + 1).unwrap(), y };
                ZoneErrors::of(|wi, wo| r.f_cos(wi, wo), &material.brdf, rig.zone()).outside
            };
            (outside(measured), outside(ideal))
        })
        .collect();
    assert_eq!(size(ORDER + 1), 64);
    let ratios = median(errors.iter().map(|(m, i)| m / i).collect());
    let (of_measured, of_ideal) =
        (median(errors.iter().map(|e| e.0).collect()), median(errors.iter().map(|e| e.1).collect()));
    eprintln!(
        "error outside 9.15..90 deg, median of 100: measured {of_measured:.4}, projected truth {of_ideal:.4}, median ratio {ratios:.4}"
    );
    assert!(ratios <= AT_MOST, "{ratios}");
}
