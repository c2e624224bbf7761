//! The simulated rig's quadrature against twice of everything.

mod common;

use std::sync::Arc;

use zonal::geometry::{Direction, Zone};
use zonal::optics::{Device, Misaligned};
use zonal::patterns::{Lobes, Scheme};
use zonal::radiometry::{FlatField, Response};
use zonal::reflectance::{Brdf, open};
use zonal::twin::{Accuracy, InverseMap, PatternLight, ResponseField, TwinConfig};

/// RMS over patterns, directions and channels, of the RMS response to the constant pattern.
const CONVERGED: f64 = 1e-3;
const ORDER: usize = 4;

/// Lobes of order 4 on the default projector, as light; and the way back from directions to its pixels.
struct Scene {
    light: PatternLight,
    inverse: InverseMap,
    dome: Zone,
}

fn scene() -> Scene {
    let rig = common::rig("ghosh-2007-built");
    let config = TwinConfig::pinhole(0);
    let (w, h) = (rig.projector.width_px, rig.projector.height_px);
    let lobes =
        Lobes::new(&rig.projector_map(), rig.zone(), Scheme::Pairs.steps(rig.zone(), ORDER).unwrap(), w, h).unwrap();
    let flat = FlatField::uniform(w, h);
    let shown = [(0, 0), (2, 0), (3, 1), (6, 0), (8, 1), (12, 0), (20, 1), (24, 0)];
    let patterns = shown.map(|(k, sign)| lobes.encode(k, &Response::linear(), &flat).patterns[sign].clone());
    let light = PatternLight::new([200, 100], [400, 400], patterns.len(), |pattern, column, row| {
        f32::from(patterns[pattern].codes[row * w + column]) / 255.0
    });
    let projector = Misaligned::new(&rig, &config.perturbation, Device::Projector);
    let theta_max = rig.dome.theta_max_deg.to_radians();
    let dome = Zone::new(rig.mirrors().shadow(rig.paraboloid_radius_mm()), theta_max).unwrap();
    Scene { light, inverse: InverseMap::new(&projector, theta_max), dome }
}

fn change_when_doubled(scene: &Scene, brdf: &dyn Brdf) -> f64 {
    let field = |accuracy| ResponseField::new(brdf, &scene.light, &scene.inverse, scene.dome, &accuracy);
    let (usual, doubled) = (field(Accuracy::default()), field(Accuracy::doubled()));
    let (mut difference, mut dc) = (0.0, 0.0);
    for i in 0..300 {
        let wo = Direction::from_angles((9.5 + 47.0 * f64::from(i) / 300.0).to_radians(), 2.399 * f64::from(i));
        for channel in 0..3 {
            let (mut a, mut b) = ([0.0f32; 8], [0.0f32; 8]);
            usual.add_radiance(&wo, channel, 1.0, &mut a);
            doubled.add_radiance(&wo, channel, 1.0, &mut b);
            difference += a.iter().zip(&b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / 8.0;
            dc += f64::from(b[0]).powi(2);
        }
    }
    (difference / dc).sqrt()
}

fn assert_converged(names: &[String]) {
    let scene = scene();
    for name in names {
        let brdf: Arc<dyn Brdf> = open(name).unwrap();
        let change = change_when_doubled(&scene, brdf.as_ref());
        eprintln!("{name}: {:.3}% of DC when doubled", 100.0 * change);
        assert!(change < CONVERGED, "{name}: {change}");
    }
}

#[test]
fn built_in_materials_are_converged() {
    assert_converged(&["gray-card", "red-plastic", "aventurnine"].map(String::from));
}

#[cfg(feature = "corpus")]
#[test]
fn rgl_materials_are_converged() {
    let folder = common::corpus();
    let mut names: Vec<String> = std::fs::read_dir(folder.join("rgl"))
        .unwrap()
        .map(|f| f.unwrap().path().to_str().unwrap().to_owned())
        .collect();
    names.sort();
    assert_eq!(names.len(), 9);
    let some: Vec<String> = names.into_iter().step_by(3).collect();
    assert_converged(&some);
}
