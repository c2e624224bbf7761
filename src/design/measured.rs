//! A dome as it was made: what the departure of its measured profile does.

use serde::Serialize;
use thiserror::Error;

use crate::optics::{Device, Figure, Mirrors, Misaligned, Misalignment, Rig};

/// Polar angles of the table of departures.
const NODES: usize = 128;

/// Why a measured profile says nothing of a rig.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum MeasuredError {
    /// It belongs to another dome.
    #[error(
        "the measured profile departs by {departure_mm:.2} mm at r = {r_mm:.2} mm, more than {MOST_MM} mm: it is of another dome, or \
         its heights are not above the sample's plane; shift it or name the right rig"
    )]
    Other {
        /// Radius of the point.
        r_mm: f64,
        /// Its distance from the nominal profile.
        departure_mm: f64,
    },
    /// It does not cover the zone.
    #[error(
        "the measured profile covers {from_deg:.2} to {to_deg:.2} deg, the zone is {zone_from_deg:.2} to {zone_to_deg:.2} deg: measure \
         all of the dome or shorten the zone"
    )]
    Short {
        /// Its first polar angle.
        from_deg: f64,
        /// Its last.
        to_deg: f64,
        /// The zone's first.
        zone_from_deg: f64,
        /// The zone's last.
        zone_to_deg: f64,
    },
}

/// A profile farther off is no dome of the rig, mm.
const MOST_MM: f64 = 2.0;

/// What a measured profile differs by, and what that does to chief rays.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeasuredProfile {
    /// Points used.
    pub points: usize,
    /// Largest departure along the normal, mm.
    pub departure_mm: f64,
    /// RMS departure, mm.
    pub departure_rms_mm: f64,
    /// Largest slope error of the smoothed departure over the zone, mrad.
    pub slope_mrad: f64,
    /// Largest distance from the sample's middle at which a chief ray arrives, mm.
    pub miss_mm: f64,
    /// RMS change of directions at the sample over the zone, degrees.
    pub direction_deg: f64,
}

impl MeasuredProfile {
    /// Of points (r, z) in mm of the dome's meridian, from the axis outwards.
    ///
    /// # Errors
    /// [`MeasuredError`].
    pub fn new(rig: &Rig, points: &[[f64; 2]]) -> Result<Self, MeasuredError> {
        let mirrors = rig.mirrors();
        let departures: Vec<[f64; 2]> = points.iter().map(|p| departure(&mirrors, p)).collect();
        if let Some((p, d)) = points.iter().zip(&departures).find(|(_, d)| d[1].is_nan() || d[1].abs() > MOST_MM) {
            return Err(MeasuredError::Other { r_mm: p[0], departure_mm: d[1] });
        }
        let zone = rig.zone();
        let [from, to] = [departures.first(), departures.last()].map(|d| d.map_or(f64::NAN, |d| d[0]));
        // A point at the very end is found a rounding error before it.
        if !(from <= zone.theta_min() + 1e-6 && to >= zone.theta_max() - 1e-6) {
            return Err(MeasuredError::Short {
                from_deg: from.to_degrees(),
                to_deg: to.to_degrees(),
                zone_from_deg: zone.theta_min().to_degrees(),
                zone_to_deg: zone.theta_max().to_degrees(),
            });
        }
        let step = to / (NODES - 1) as f64;
        let nodes = (0..NODES).map(|i| local_mean(&departures, step * i as f64, step)).collect();
        let figure = Figure::new(nodes, step).expect("finite departures");
        let device = Misaligned::new(rig, &Misalignment::none(), Device::Camera).with_figure(figure.clone());
        let (mut miss, mut square, mut slope) = (0.0f64, 0.0, 0.0f64);
        let angles: Vec<f64> = (0..=NODES)
            .map(|i| zone.theta_min() + (zone.theta_max() - zone.theta_min()) * i as f64 / NODES as f64)
            .collect();
        for theta in &angles {
            let arrived = device.nominal_image(*theta).and_then(|(u, v)| device.through(u, v, [0.0, 0.0]));
            let Some(arrived) = arrived else { continue };
            miss = miss.max(arrived.position_mm[0].hypot(arrived.position_mm[1]));
            square += (arrived.direction.theta() - theta).powi(2);
            let at = mirrors.rho_of(*theta, mirrors.edge_radius()).and_then(|rho| mirrors.profile_point(rho));
            let per_radian = at.map_or(f64::NAN, |p| p.r.hypot(p.z) / p.incidence_dome.cos());
            slope = slope.max((figure.at(*theta)[1] / per_radian).abs());
        }
        let n = departures.len() as f64;
        Ok(Self {
            points: points.len(),
            departure_mm: departures.iter().map(|d| d[1].abs()).fold(0.0, f64::max),
            departure_rms_mm: (departures.iter().map(|d| d[1] * d[1]).sum::<f64>() / n).sqrt(),
            slope_mrad: 1e3 * slope,
            miss_mm: miss,
            direction_deg: (square / angles.len() as f64).sqrt().to_degrees(),
        })
    }
}

/// Polar angle of the nominal point whose normal goes through `p`, and the distance along it into the dome, mm.
fn departure(mirrors: &Mirrors, p: &[f64; 2]) -> [f64; 2] {
    let start = mirrors.rho_of(p[0].atan2(p[1]), 1.1 * mirrors.edge_radius()).unwrap_or(mirrors.edge_radius());
    let mut rho = start;
    let mut found = [f64::NAN; 2];
    for _ in 0..6 {
        let Some(at) = mirrors.profile_point(rho) else { return found };
        let (dr, dz) = (p[0] - at.r, p[1] - at.z);
        found = [at.theta, dr * at.normal[0] + dz * at.normal[1]];
        // Way along the meridian that is left, in units of rho by a difference.
        let h = 1e-4 * mirrors.edge_radius();
        let Some(next) = mirrors.profile_point(rho + h) else { return found };
        let speed = (next.r - at.r).hypot(next.z - at.z) / h;
        rho += (dr * -at.normal[1] + dz * at.normal[0]) / speed;
    }
    found
}

/// Mean departure within a step of `theta`; linear between points where there is none so near.
fn local_mean(departures: &[[f64; 2]], theta: f64, step: f64) -> f64 {
    let first = departures.partition_point(|d| d[0] < theta - 0.5 * step);
    let last = departures.partition_point(|d| d[0] <= theta + 0.5 * step);
    if last > first {
        return departures[first..last].iter().map(|d| d[1]).sum::<f64>() / (last - first) as f64;
    }
    match (departures.get(first.wrapping_sub(1)), departures.get(first)) {
        (Some(a), Some(b)) => a[1] + (b[1] - a[1]) * (theta - a[0]) / (b[0] - a[0]),
        (Some(only), None) | (None, Some(only)) => only[1],
        (None, None) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig() -> Rig {
        Rig::from_toml(include_str!("../../optics/ghosh-2007-built.toml")).unwrap()
    }

    /// Points of the nominal profile, moved along its normal.
    fn moved(by: impl Fn(f64) -> f64) -> Vec<[f64; 2]> {
        let mirrors = rig().mirrors();
        (0..400)
            .map(|i| {
                let theta = (4.0 + 53.6 * f64::from(i) / 399.0).to_radians();
                let p = mirrors.profile_point(mirrors.rho_of(theta, mirrors.edge_radius()).unwrap()).unwrap();
                let d = by(p.theta);
                [p.r + d * p.normal[0], p.z + d * p.normal[1]]
            })
            .collect()
    }

    #[test]
    fn a_perfect_dome_departs_by_nothing_and_a_wavy_one_by_its_waves() {
        let perfect = MeasuredProfile::new(&rig(), &moved(|_| 0.0)).unwrap();
        assert!(perfect.departure_mm < 1e-9 && perfect.miss_mm < 1e-6 && perfect.direction_deg < 1e-6, "{perfect:?}");
        let wavy = MeasuredProfile::new(&rig(), &moved(|theta| 0.05 * (6.0 * theta).sin())).unwrap();
        assert!((wavy.departure_mm - 0.05).abs() < 1e-3, "{wavy:?}");
        // 0.3 mm per radian over some 140 mm of radius and the obliquity.
        assert!((1.0..3.0).contains(&wavy.slope_mrad), "{wavy:?}");
        // A slope error turns the ray by twice as much over the way to the sample.
        assert!(wavy.miss_mm > 0.1 && wavy.miss_mm < 1.0 && wavy.direction_deg > 0.01, "{wavy:?}");
    }

    #[test]
    fn other_domes_and_short_profiles_are_refused() {
        let scaled: Vec<[f64; 2]> = moved(|_| 0.0).iter().map(|p| [1.1 * p[0], p[1]]).collect();
        assert!(matches!(MeasuredProfile::new(&rig(), &scaled), Err(MeasuredError::Other { .. })));
        let short = &moved(|_| 0.0)[..300];
        assert!(matches!(MeasuredProfile::new(&rig(), short), Err(MeasuredError::Short { .. })));
    }
}
