mod fits;
mod pareto;

use super::*;
use crate::measure::Provenance;
use crate::patterns::Plan;

const HOSTILE: &str = "<script>alert('x')</script>\" onload=\"y\" & \u{1}</svg>";

fn record(text: &str) -> RunRecord {
    let plan = Plan::of_order(4);
    let items =
        plan.rig_time(&crate::patterns::Timing { refresh_s: 1.0 / 60.0, min_frame_s: 1.0 / 15.0, readout_s: 0.0 });
    RunRecord {
        format: 1,
        software: text.into(),
        status: text.into(),
        rig: text.into(),
        plan: text.into(),
        provenance: Provenance { sample: text.into(), simulation: None, ..Default::default() },
        order: 4,
        images: plan.images(),
        frames: plan.frames(),
        rig_s: items.total_s(),
        rig_s_items: items,
        compute_s: 3.0,
        post_s: 0.1,
        zone_deg: [9.0, 57.0],
        noise_rel: 0.01,
        saturated_fraction: 0.0,
        gains: vec![1.0; 25],
        steps: (0..25).collect(),
        isotropic: false,
        anisotropy: 0.0,
        decisions: Vec::new(),
        colour_space: crate::radiometry::ColourSpace::Camera,
        capture: Default::default(),
        budget: None,
    }
}

fn report(text: &str) -> DemoReport {
    let picture = || Picture { caption: text.into(), png: plane_png(2, 2, &[0.0, 1.0, f32::NAN, 2.0], false) };
    let curve: Vec<(f64, f64)> = (-90..=90).map(|t| (f64::from(t), 0.1 + f64::from(t) * 1e-3)).collect();
    DemoReport {
        title: text.into(),
        material: text.into(),
        record: record(text),
        gray_card: GrayCardCheck {
            z_10_error: 0.002,
            z_20_error: -0.001,
            worst_error: 0.004,
            white_balance: [1.1, 1.0, 0.9],
            scale_sigma_rel: [0.0; 3],
        },
        patterns: vec![picture(), picture()],
        response: picture(),
        spectrum: (0..25)
            .map(|k| SpectrumPoint { k, rms: 0.1 / (k + 1) as f64, noise: 1e-4, predicted: 0.1 })
            .collect(),
        slices: vec![Slice {
            theta_o_deg: 30.0,
            truth: Some(curve.clone()),
            methods: vec![(text.into(), curve)],
            zone_deg: [9.0, 57.0],
        }],
        spheres: vec![picture()],
        accuracy: [2, 4].map(|order| AccuracyPoint { order, rig_s: 20.0, error_in: 0.1, error_out: 0.2 }).into(),
        pareto: None,
        methods: [None, Some(text.to_owned())]
            .map(|refused| MethodRow {
                method: text.into(),
                order: 4,
                condition: 1.1e9,
                noise_gain_in: 1.0,
                noise_gain_out: f64::INFINITY,
                error_in: Some(0.1),
                error_out: None,
                refused,
            })
            .into(),
        fits: fits::FITS.clone(),
        provenance: vec![(text.into(), text.into())],
    }
}

/// Every element is closed in its turn, every attribute quoted, and no stray `<`, `>` or `&` is left in a page.
fn check_markup(page: &str) {
    let body = page.strip_prefix("<!DOCTYPE html>").unwrap_or(page);
    let mut open: Vec<&str> = Vec::new();
    let mut rest = body;
    while let Some(start) = rest.find('<') {
        check_text(&rest[..start]);
        let end = start + rest[start..].find('>').expect("a tag ends");
        let tag = &rest[start + 1..end];
        rest = &rest[end + 1..];
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name));
            continue;
        }
        let (head, closed) = tag.strip_suffix('/').map_or((tag, false), |head| (head, true));
        let (name, attributes) = head.split_once(' ').unwrap_or((head, ""));
        assert!(!name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric()), "<{tag}>");
        check_attributes(attributes.trim());
        if !closed {
            open.push(name);
        }
    }
    check_text(rest);
    assert!(open.is_empty(), "{open:?} are not closed");
}

fn check_attributes(mut attributes: &str) {
    while !attributes.is_empty() {
        let (name, rest) = attributes.split_once("=\"").expect("a value in quotes");
        assert!(name.bytes().all(|b| b.is_ascii_alphabetic() || b == b'-'), "{name}");
        let (value, rest) = rest.split_once('"').expect("a closed value");
        check_text(value);
        attributes = rest.trim_start();
    }
}

fn check_text(text: &str) {
    assert!(!text.contains('>'), "{text}");
    for entity in text.split('&').skip(1) {
        let name = entity.split(';').next().unwrap_or_default();
        assert!(["amp", "lt", "gt", "quot", "#39"].contains(&name), "&{name};");
    }
}

#[test]
fn the_page_is_well_formed_and_self_contained() {
    let page = report("alum-bronze").to_html();
    check_markup(&page);
    for outside in ["http:", "https:", "<script", "url(", "@import", "href"] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert_eq!(page.matches("<img ").count(), page.matches("<img alt=\"").count());
    for heading in
        ["Speed against accuracy", "Gray-card check", "Rig time, itemised", "Methods of fitting", "Provenance"]
    {
        assert!(page.contains(heading));
    }
}

#[test]
fn hostile_text_is_escaped() {
    let page = report(HOSTILE).to_html();
    check_markup(&page);
    assert!(!page.contains("<script") && !page.contains("\" onload") && !page.contains('\u{1}'));
}

#[test]
fn an_empty_report_is_a_page() {
    let mut report = report("x");
    report.patterns.clear();
    report.spectrum.clear();
    report.slices.clear();
    report.spheres.clear();
    report.accuracy.clear();
    report.methods.clear();
    report.response.png.clear();
    check_markup(&report.to_html());
}

fn chart(points: Vec<(f64, f64)>) -> String {
    let series = Series { labels: vec!["L".into(); 9], ..Series::new("a", points, Mark::Both, 1) };
    let svg = Chart {
        markers: vec![(60.0, "m".into())],
        ..Chart::new("d", Axis::log("x (s)"), Axis::log("y"), vec![series])
    }
    .to_svg();
    check_markup(&svg);
    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    svg
}

#[test]
fn charts_take_no_point_one_point_and_impossible_points() {
    assert_eq!(chart(vec![]).matches("class=\"mark").count(), 1, "the marker alone");
    let marks = |points| chart(points).matches("class=\"mark s1").count();
    assert_eq!(marks(vec![(1.0, 1.0)]), 1);
    let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -1.0, f64::MAX, f64::MIN_POSITIVE];
    assert_eq!(marks(bad.iter().map(|&x| (x, 1.0)).chain([(2.0, 0.1)]).chain(bad.map(|y| (1.0, y))).collect()), 1);
}

#[test]
fn spectra_are_grouped_by_degree_and_noise_free_ones_are_drawn() {
    let points: Vec<SpectrumPoint> =
        (0..121).map(|k| SpectrumPoint { k, rms: 1e-3, noise: 0.0, predicted: 1e-3 }).collect();
    let svg = figures::spectrum_chart(&points).to_svg();
    check_markup(&svg);
    assert_eq!(svg.matches("class=\"mark s1").count(), 121);
    assert_eq!(svg.matches("class=\"band").count(), 5);
    check_markup(&figures::spectrum_chart(&[]).to_svg());
}

#[test]
fn polar_plots_take_any_curve() {
    let bad = [f64::NAN, f64::INFINITY, -1e300, 1e300, 0.0];
    let curves = [vec![], vec![(0.0, 1.0)], bad.map(|f| (10.0, f)).into(), bad.map(|t| (t, 1.0)).into()];
    for truth in curves.clone().map(Some).into_iter().chain([None]) {
        for theta_o_deg in [0.0, 57.0, f64::NAN, 1e9] {
            let methods = curves.clone().map(|c| ("m".to_owned(), c)).into();
            let slice = Slice { theta_o_deg, truth: truth.clone(), methods, zone_deg: [9.0, f64::NAN] };
            let svg = polar::polar_svg(&slice);
            check_markup(&svg);
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
    }
}
