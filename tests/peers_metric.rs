//! The error metric against NumPy: `bash tests/run.sh`, which sets ZONAL_PYTHON.
//!
//! tests/python/peer_metric.py has its own models, nodes and sums, and knows of each case only the parameters.
#![cfg(feature = "peers")]

mod common;

use serde_json::{Value, json};
use zonal::geometry::Zone;
use zonal::reflectance::{Brdf, Ggx, Lambert, Metric, Model, abc_materials};

/// Relative. Two programs that sum the same nodes agree to 1e-14; one node on the other side of a zone's edge is 1e-4.
const ERRORS: f64 = 1e-6;
/// Two rules for albedos, 7e-12 apart for GGX; the grooves of the ABC model have kinks, which cost 7e-5.
const ALBEDO: f64 = 2e-4;

fn case(name: &str, zone_deg: [f64; 2], truth: (&dyn Brdf, Value), model: (&dyn Brdf, Value)) -> Value {
    let zone = Zone::from_degrees(zone_deg[0], zone_deg[1]).unwrap();
    let errors = Metric::new(zone).errors(truth.0, model.0).unwrap();
    json!({ "name": name, "zone_deg": zone_deg, "truth": truth.1, "model": model.1, "errors": errors })
}

fn described(model: &Model) -> (&dyn Brdf, Value) {
    (model, serde_json::to_value(model).unwrap())
}

#[test]
fn errors_agree_with_numpy() {
    let sharp = Model::Ggx(Ggx::isotropic(0.05, [0.5, 0.3, 0.1]).on_lambert(0.8, [0.2, 0.1, 0.05]));
    let mut two = Ggx::isotropic(0.06, [0.4, 0.3, 0.2]).on_lambert(0.7, [0.15; 3]);
    two.lobes.extend(Ggx::isotropic(0.3, [0.1; 3]).on_lambert(0.2, [0.0; 3]).lobes);
    let two = Model::Ggx(two);
    let brushed = Model::Ggx(Ggx::anisotropic(0.1, 0.4, [0.9, 0.6, 0.3]));
    let round = Model::Ggx(Ggx::isotropic(0.2, [0.8; 3]).on_lambert(1.0, [0.02; 3]));
    let diffuse = Model::Lambert(Lambert { albedo: [0.3, 0.1, 0.1] });
    let plastic = abc_materials().iter().find(|m| m.name == "red-plastic").unwrap().brdf;
    let plastic_values =
        json!({ "abc": { "kd": plastic.kd, "a": plastic.a, "b": plastic.b, "c": plastic.c, "ior": plastic.ior } });
    let cases = [
        case("two lobes for a sharp one", [9.0, 57.0], described(&sharp), described(&two)),
        case("a diffuser for plastic", [9.0, 57.0], (&plastic, plastic_values), described(&diffuse)),
        case("a round lobe for a brushed one", [9.0, 90.0], described(&brushed), described(&round)),
    ];
    common::ask("peer_metric.py", &json!({ "tolerance": { "errors": ERRORS, "albedo": ALBEDO }, "cases": cases }));
}
