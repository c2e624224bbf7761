//! Rays through conics, against optiland: where they go, and how fast. `bash tests/run.sh`, which sets ZONAL_PYTHON.
#![cfg(feature = "peers")]

mod common;

use std::time::Instant;

use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use zonal::optics::{Conic, Mirrors, PlacedMirrors, Ray};

const RAYS: usize = 10_000;
/// Lists of as many rays are timed: those that are compared, and more than any cache holds.
const TIMED: [usize; 2] = [RAYS, 1_000_000];
const REPEATS: [usize; 2] = [500, 20];
const CENTRE_MM: f64 = 405.0;
/// Within the zone above the dome's widest circle: below it the sheet that optiland follows ends.
const CONVEX_APERTURE_MM: f64 = 10.5;
/// Times as fast as optiland's compiled loops, at the least: 23 and 26 on two quiet cores, of which a short list leaves one waiting
/// where others work as well.
const FASTER: [f64; 2] = [5.0, 15.0];
/// Both are right to rounding.
const AGREE_MM: f64 = 1e-6;

/// Of a pupil of 12.5 mm towards the convex mirror, one in ten past its edge.
fn rays(convex: &Conic) -> Vec<Ray> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(7);
    (0..RAYS)
        .map(|_| {
            let [r, a, s, b]: [f64; 4] = std::array::from_fn(|_| rng.random());
            let origin = Point3::new(12.5 * r.sqrt() * (6.3 * a).cos(), 12.5 * r.sqrt() * (6.3 * a).sin(), CENTRE_MM);
            let rho = 4.0 + 1.1 * (CONVEX_APERTURE_MM - 4.0) * s;
            let target = Point3::new(rho * (6.3 * b).cos(), rho * (6.3 * b).sin(), convex.height(rho));
            Ray { origin: origin.into(), direction: (target - origin).normalize().into() }
        })
        .collect()
}

#[test]
fn rays_go_where_optiland_sends_them_and_faster() {
    let convex = Conic::hyperboloid(135.0, 8.0, CENTRE_MM);
    let mirrors = Mirrors::new(CENTRE_MM, convex, 126.5).unwrap();
    let placed = PlacedMirrors::nominal(mirrors);
    // The dome's ellipsoid about the near focus and the sample, from its rim alone.
    let near = 135.0 - convex.foci()[0];
    let sum = (Point3::new(126.5, 0.0, 0.0) - Point3::new(0.0, 0.0, near)).norm() + 126.5;
    let (major, half) = (0.5 * sum, 0.5 * near);
    let dome = Conic {
        vertex_height: half + major,
        radius: (major * major - half * half) / major,
        constant: -(half / major).powi(2),
    };
    let rays = rays(&convex);
    let conic = |c: &Conic, aperture: f64| {
        serde_json::json!({
            "vertex_height": c.vertex_height, "radius": c.radius, "constant": c.constant, "aperture": aperture,
        })
    };
    let mut task = serde_json::json!({
        "centre_height": CENTRE_MM,
        "convex": conic(&convex, CONVEX_APERTURE_MM),
        "dome": conic(&dome, 145.0),
        "rays": rays.iter().map(|r| [r.origin, r.direction].concat()).collect::<Vec<_>>(),
        "timed": TIMED,
        "repeats": REPEATS,
    });
    let traced = |r: &Ray| placed.trace(&Point3::from(r.origin), &Vector3::from(r.direction)).expect("both are met");
    let traced: Vec<_> = rays.iter().map(traced).collect();
    for (one, many) in traced.iter().zip(placed.trace_many(&rays)) {
        assert!(
            (one.dome - Point3::from(many.dome)).norm() < 1e-9 && (one.out - Vector3::from(many.out)).norm() < 1e-9
        );
    }
    let points: Vec<[[f64; 3]; 3]> =
        traced.iter().map(|t| [t.convex, t.dome, t.at_height(0.0)].map(Into::into)).collect();
    task["points"] = serde_json::json!(points);
    task["stopped"] = serde_json::json!(traced.iter().map(|t| t.rho > CONVEX_APERTURE_MM).collect::<Vec<_>>());
    let answer: serde_json::Value = serde_json::from_str(&common::ask("peer_optics.py", &task)).unwrap();
    let (worst, stopped) = (answer["worst_mm"].as_f64().unwrap(), answer["stopped"].as_u64().unwrap());
    println!("{} rays agree to {worst:.1e} mm, {stopped} stopped by the aperture", rays.len());
    assert!(worst < AGREE_MM && (100..5000).contains(&stopped));
    let paraboloid = Conic { constant: -1.0, ..convex };
    let any_dome = PlacedMirrors::nominal(Mirrors::new(CENTRE_MM, paraboloid, 126.5).unwrap());
    for (i, count) in TIMED.into_iter().enumerate() {
        let timed: Vec<Ray> = rays.iter().copied().cycle().take(count).collect();
        let ours = seconds_per_ray(&placed, &timed, REPEATS[i]);
        let ratio = answer["seconds_per_ray"][i].as_f64().unwrap() / ours;
        println!(
            "{count} rays: {:.1} million per second, {ratio:.1} times as fast as optiland's vectorised trace; {:.1} million \
             through a dome that is no conic",
            1e-6 / ours,
            1e-6 / seconds_per_ray(&any_dome, &timed, REPEATS[i])
        );
        assert!(ratio > FASTER[i], "{ratio}");
    }
}

fn seconds_per_ray(placed: &PlacedMirrors, rays: &[Ray], repeats: usize) -> f64 {
    let mut leaving = placed.trace_many(rays);
    let timed = (0..repeats).map(|_| {
        let started = Instant::now();
        placed.trace_many_into(std::hint::black_box(rays), &mut leaving);
        started.elapsed().as_secs_f64() / rays.len() as f64
    });
    timed.fold(f64::INFINITY, f64::min)
}
