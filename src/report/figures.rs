//! The charts of the page.

use super::axis::Axis;
use super::chart::{Chart, Mark, Series};
use super::polar::{polar_legend, polar_svg};
use super::text::{degrees, escape};
use super::{AccuracyPoint, Fits, MethodFit, Slice, SpectrumPoint};
use crate::basis::lm;
use crate::fit::FitMethod;

/// What the rig of the thesis needs for order 4, s (Ghosh 2007, chapter 3).
const THESIS_RIG_S: f64 = 60.0;

/// Error against rig time, both logarithmic, labelled by order.
pub fn accuracy_chart(points: &[AccuracyPoint]) -> Chart {
    let mut points = points.to_vec();
    points.sort_by(|a, b| a.rig_s.total_cmp(&b.rig_s));
    let curve = |error: fn(&AccuracyPoint) -> f64| points.iter().map(|p| (p.rig_s, error(p))).collect();
    // One label for each order, above the higher of its two points.
    let labels = |is_higher: fn(&AccuracyPoint) -> bool| {
        points.iter().map(|p| if is_higher(p) { format!("L{}", p.order) } else { String::new() }).collect()
    };
    let outside = Series {
        labels: labels(|p| p.error_out >= p.error_in),
        ..Series::new("outside the zone", curve(|p| p.error_out), Mark::Both, 2)
    };
    let inside = Series {
        labels: labels(|p| p.error_in > p.error_out),
        ..Series::new("inside the zone", curve(|p| p.error_in), Mark::Both, 1)
    };
    Chart {
        markers: vec![(THESIS_RIG_S, "thesis rig: order 4 in about 60 s".into())],
        ..Chart::new(
            "Relative error inside and outside the zone against rig time, one point for each zonal order",
            Axis::log("rig time (s)"),
            Axis::log("relative error (RMS, no unit)"),
            vec![inside, outside],
        )
    }
}

/// Size, noise and prediction of every coefficient; each degree l has a band of the same width, m runs from -l (or from 0,
/// where there are no others) to l inside it.
pub fn spectrum_chart(points: &[SpectrumPoint]) -> Chart {
    let signed = points.iter().any(|p| lm(p.k).1 < 0);
    let place = |k: usize| {
        let (l, m) = lm(k);
        let (first, count) = if signed { (-(l as f64), 2 * l + 1) } else { (0.0, l + 1) };
        l as f64 + (f64::from(m) - first + 0.5) / count as f64
    };
    let degrees = points.iter().map(|p| lm(p.k).0 + 1).max().unwrap_or(1);
    let curve = |value: fn(&SpectrumPoint) -> f64| points.iter().map(|p| (place(p.k), value(p))).collect();
    let from = if signed { "−l" } else { "0" };
    let x = Axis {
        ticks: Some((0..degrees).map(|l| (l as f64 + 0.5, l.to_string())).collect()),
        range: Some([0.0, degrees as f64]),
        ..Axis::linear(format!("degree l (inside a band: m = {from} to l)"))
    };
    let series = vec![
        Series::new("noise, standard error", curve(|p| p.noise), Mark::Line, 2),
        Series::new("predicted by the model", curve(|p| p.predicted), Mark::Line, 3),
        Series::new("measured |z|", curve(|p| p.rms), Mark::Points, 1),
    ];
    let description = "RMS over exitant directions of each zonal coefficient, of its noise and of what the model \
                       predicts, grouped by degree";
    Chart {
        bands: (0..degrees).skip(1).step_by(2).map(|l| [l as f64, l as f64 + 1.0]).collect(),
        ..Chart::new(description, x, Axis::log("RMS over wo (1/√sr)"), series)
    }
}

/// Error of every method against the time its fit took, both logarithmic: against the truth, or where none is known the
/// misfit to the coefficients.
pub fn fits_chart(fits: &Fits) -> Chart {
    let compared = fits.all.iter().any(|f| f.errors.is_some());
    let error = |f: &MethodFit| match &f.errors {
        Some(errors) => errors.mean.rel_in,
        None if compared => f64::NAN,
        None => f.report.misfit_rel,
    };
    let series = |name: &str, style: usize, has: &dyn Fn(FitMethod) -> bool| {
        let of: Vec<&MethodFit> = fits.all.iter().filter(|f| has(f.report.requested)).collect();
        Series {
            labels: of.iter().map(|f| short(f.report.requested).into()).collect(),
            ..Series::new(name, of.iter().map(|f| (f.report.fit_s, error(f))).collect(), Mark::Points, style)
        }
    };
    let baseline = |m: FitMethod| matches!(m, FitMethod::Thesis | FitMethod::GgxToReconstruction);
    let what = if compared { "error in the zone" } else { "misfit over z₀₀" };
    Chart::new(
        format!("{what} of every model against the time its fit took"),
        Axis::log("time of the fit (s)"),
        Axis::log(format!("{what} (RMS, no unit)")),
        vec![
            series("fitted to a reconstruction", 2, &baseline),
            series("fitted in the measured space", 1, &|m| !baseline(m) && m != FitMethod::Auto),
            series("auto: tries all of these", 3, &|m| m == FitMethod::Auto),
        ],
    )
}

/// A name short enough to stand in a chart.
fn short(method: FitMethod) -> &'static str {
    match method {
        FitMethod::GgxToReconstruction => "ggx to rec.",
        other => other.name(),
    }
}

/// A chart as a figure, its legend below.
pub fn chart_figure(chart: &Chart, caption: &str) -> String {
    let caption = escape(caption);
    format!(
        "<figure class=\"wide\">{}<figcaption>{}<p>{caption}</p></figcaption></figure>\n",
        chart.to_svg(),
        chart.legend()
    )
}

/// A slice as a figure, its legend below.
pub fn slice_figure(slice: &Slice) -> String {
    let caption = format!("Camera at θₒ = {}°", degrees(slice.theta_o_deg));
    format!("<figure>{}{}<figcaption>{caption}</figcaption></figure>\n", polar_svg(slice), polar_legend(slice))
}
