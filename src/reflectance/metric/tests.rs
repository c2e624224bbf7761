//! The metric against values known beforehand.

use super::*;
use crate::reflectance::{Ggx, Lambert, Towards, open};

fn built() -> Zone {
    Zone::from_degrees(9.0, 57.0).unwrap()
}

/// A material by its formula, f_cos in gray.
struct Formula(fn(&Direction<Sample>) -> f64);

impl Brdf for Formula {
    fn eval(&self, wi: &Direction<Sample>, _wo: &Direction<Sample>) -> [f64; 3] {
        [self.0(wi); 3]
    }

    fn towards<'a>(&'a self, _wo: &Direction<Sample>) -> Towards<'a> {
        Box::new(|wi| [self.0(wi) * wi.cos_theta(); 3])
    }

    fn is_isotropic(&self) -> bool {
        true
    }
}

#[test]
fn a_scaled_diffuser_errs_by_its_scale() {
    // Sums of some 10^4 terms.
    const ROUNDING: f64 = 1e-12;
    let errors = Metric::new(Zone::from_degrees(0.0, 90.0).unwrap())
        .errors(&Lambert { albedo: [0.5; 3] }, &Lambert { albedo: [0.4, 0.6, 0.8] })
        .unwrap();
    let pi = std::f64::consts::PI;
    for (e, albedo) in errors.per_channel.iter().chain([&errors.mean]).zip([0.4, 0.6, 0.8, 0.6]) {
        let relative: f64 = albedo / 0.5 - 1.0;
        let log = ((albedo / pi + 1e-3) / (0.5 / pi + 1e-3)).ln().abs();
        assert!((e.rel_in - relative.abs()).abs() < ROUNDING && (e.log_in - log).abs() < ROUNDING, "{e:?}");
        assert!(e.albedo_error.iter().all(|a| (a - relative).abs() < ROUNDING), "{e:?}");
        assert!(e.rel_out.is_nan() && e.log_out.is_nan());
    }
}

/// rel_in and rel_out share one denominator, the RMS at all nodes: both follow from integrals of cos^2.
#[test]
fn parts_of_a_diffuser_follow_from_its_cosine() {
    // Midpoints on parts with sharp edges.
    const EDGES: f64 = 5e-3;
    let e = Metric::new(built()).errors(&Lambert::gray(0.5), &Lambert::gray(0.6)).unwrap().mean;
    // Mean of cos^2 over the solid angle between two polar angles.
    let square = |lo: f64, hi: f64| {
        let (a, b) = (lo.to_radians().cos(), hi.to_radians().cos());
        (a.powi(3) - b.powi(3), 3.0 * (a - b))
    };
    let (all, inside) = (square(0.0, 85.0), square(9.0, 57.0));
    let all_mean = all.0 / all.1;
    let rel_in = 0.2 * (inside.0 / inside.1 / all_mean).sqrt();
    let beside = 0.2 * ((all.0 - inside.0) / (all.1 - inside.1) / all_mean).sqrt();
    // theta_o = 20, 35, 50 see both parts; 5, 65, 78 lie outside with all their pairs.
    let rel_out = (3.0 * beside + 3.0 * 0.2) / 6.0;
    assert!((e.rel_in / rel_in - 1.0).abs() < EDGES, "{} against {rel_in}", e.rel_in);
    assert!((e.rel_out / rel_out - 1.0).abs() < EDGES, "{} against {rel_out}", e.rel_out);
}

#[test]
fn a_truth_agrees_with_itself() {
    for name in ["gray-card", "ggx-0.05", "ggx-0.1-0.4", "red-plastic"] {
        let brdf = open(name).unwrap();
        let errors = Metric::new(built()).errors(brdf.as_ref(), brdf.as_ref()).unwrap();
        for e in errors.per_channel.iter().chain([&errors.mean]) {
            assert_eq!([e.rel_in, e.rel_out, e.log_in, e.log_out], [0.0; 4], "{name}");
            assert_eq!(e.albedo_error, [0.0; 3], "{name}");
        }
    }
}

#[test]
fn the_nodes_have_converged() {
    // What the documentation of the constant says.
    const CONVERGED: f64 = 0.02;
    let (truth, model) = (open("ggx-0.05").unwrap(), open("ggx-0.1").unwrap());
    let [half, full, double] = [0.5, 1.0, 2.0].map(|factor| {
        let nodes = NODES.map(|n| (n as f64 * factor) as usize);
        let e = Metric::with_nodes(built(), nodes).errors(truth.as_ref(), model.as_ref()).unwrap().mean;
        [e.rel_in, e.rel_out, e.log_in, e.log_out]
    });
    for other in [half, double] {
        for (a, b) in other.into_iter().zip(full) {
            assert!((a / b - 1.0).abs() < CONVERGED, "{other:?} against {full:?}");
        }
    }
}

#[test]
fn anisotropic_truths_are_seen_from_both_sides() {
    let (truth, turned) = (Ggx::anisotropic(0.1, 0.4, [0.5; 3]), Ggx::anisotropic(0.4, 0.1, [0.5; 3]));
    // Error of the rule for albedos.
    const ALBEDO_RULE: f64 = 1e-5;
    let metric = Metric::new(built());
    let (a, b) = (metric.errors(&truth, &turned).unwrap().mean, metric.errors(&turned, &truth).unwrap().mean);
    // Turned by a right angle each is the other: the same pairs, and the same albedos over both azimuths.
    const ROUNDING: f64 = 1e-9;
    for (x, y) in [(a.log_in, b.log_in), (a.log_out, b.log_out), (a.rel_out, b.rel_out)] {
        assert!((x / y - 1.0).abs() < ROUNDING, "{a:?} {b:?}");
    }
    assert!(a.albedo_error.iter().all(|e| e.abs() < ALBEDO_RULE), "{a:?}");
    assert!(a.rel_in > 0.5 && b.rel_in > 0.5, "{a:?} {b:?}");
    assert_eq!(metric.reference(&truth).unwrap().exitants.len(), 12);
    assert_eq!(metric.reference(&Lambert::gray(0.5)).unwrap().exitants.len(), 6);
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let metric = Metric::new(built());
    let gray = Lambert::gray(0.5);
    let error = |truth: &dyn Brdf, model: &dyn Brdf| metric.errors(truth, model).unwrap_err();
    let ringing = Formula(|wi| 0.1 - 0.002 * f64::from(u8::from(wi.theta() > 1.4)) * 60.0);
    let negative = error(&ringing, &gray);
    assert!(matches!(negative, MetricError::Negative { at, .. } if at.wi[0] > 80.0 && at.wo == [5.0, 0.0]));
    assert!(negative.to_string().contains("a reconstruction is no truth"), "{negative}");
    // As a model it may ring, and rounding is no fault.
    assert!(metric.errors(&gray, &ringing).is_ok());
    assert!(metric.errors(&Formula(|wi| if wi.theta() > 1.4 { -1e-9 } else { 0.1 }), &gray).is_ok());
    let pole = Formula(|wi| if wi.theta() < 0.3 { f64::NAN } else { 0.1 });
    assert!(matches!(error(&pole, &gray), MetricError::NotFinite { side: Side::Truth, .. }));
    assert!(matches!(error(&gray, &pole), MetricError::NotFinite { side: Side::Model, .. }));
    let horizon = Formula(|wi| if wi.theta() > 1.52 { f64::INFINITY } else { 0.1 });
    assert!(matches!(error(&gray, &horizon), MetricError::AlbedoNotFinite { side: Side::Model, .. }));
    assert_eq!(error(&Lambert::gray(0.0), &gray), MetricError::Black { theta_o_deg: 5.0 });
    let red = Lambert { albedo: [0.5, 0.0, 0.0] };
    let errors = metric.errors(&red, &gray).unwrap();
    assert!(errors.per_channel[1].rel_in.is_nan() && errors.mean.rel_in.is_finite());
}
