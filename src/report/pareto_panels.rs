//! The picture of [`ParetoReport`].

use super::axis::Axis;
use super::chart::{Chart, Mark, Series};
use super::pareto::{ComputePoint, MAIN, ParetoReport, PlanPoint, Stage, known, undominated};
use super::sheet::Sheet;
use super::text::number;

/// Schemes, their styles, and what the legend says of them, in the order of the legend.
const SCHEMES: [(&str, usize, &str); 5] = [
    ("pairs", 1, "pairs: both signs of each lobe in turn"),
    ("offset", 3, "offset: lobes raised above zero"),
    ("multiplexed", 4, "multiplexed: many lobes in each frame"),
    ("isotropic", 5, "isotropic: for isotropic samples alone"),
    ("adaptive", 2, "adaptive: as many lobes as are needed"),
];
/// Style of a scheme that is not known here.
const OTHER: usize = 6;
/// Style of the front, and of the published method.
const FRONT: usize = 0;
/// Style of ways of computing; their baselines are hollow.
const OURS: usize = 1;
/// Cells of the main panel.
const MAIN_CELLS: [usize; 2] = [2, 2];
/// Orders named along a line are apart by this factor of time: twice a text's width in the main panel.
const APART: f64 = 1.5;
/// Room at the ends of axes.
const ROOM: f64 = 1.3;

pub(super) fn sheet(report: &ParetoReport) -> Sheet {
    let [conversion, fit, simulation] = Stage::ALL.map(|stage| Some(computing(report, stage)));
    let present = |scheme: &str| report.plans.iter().any(|p| p.scheme == scheme);
    let mut series: Vec<(usize, Mark, String)> =
        vec![(FRONT, Mark::Line, "front: nothing is as fast and as good".into())];
    let known = SCHEMES.into_iter().filter(|(scheme, ..)| present(scheme));
    series.extend(known.map(|(_, style, legend)| (style, Mark::Both, legend.to_owned())));
    series.extend(others(report).into_iter().map(|scheme| (OTHER, Mark::Both, scheme)));
    if !report.seed.is_empty() {
        series.push((FRONT, Mark::Points, "Ghosh 2007: time published, error of its fit".into()));
    }
    Sheet {
        title: "What time buys: seconds against the error they leave".into(),
        columns: 3,
        panels: vec![Some(plans(report)), conversion, fit, Some(prediction(report)), None, simulation],
        series,
        notes: vec![
            "line: predicted; L4: zonal order 4".into(),
            format!("mark: measured, {} materials on the simulated rig", report.materials.len()),
            "hollow: published methods".into(),
            "errors: medians, relative to the signal".into(),
        ],
    }
}

/// From the fastest to the slowest of a published time, as people say it.
pub(super) fn span([from, to]: [f64; 2]) -> String {
    let minutes = from >= 60.0;
    let said = |s: f64| number(if minutes { s / 60.0 } else { s }, 2).trim_end_matches(".0").to_owned();
    let unit = if minutes { "min" } else { "s" };
    if from == to { format!("{} {unit}", said(from)) } else { format!("{}–{} {unit}", said(from), said(to)) }
}

/// Schemes that are not known here.
fn others(report: &ParetoReport) -> Vec<String> {
    let unknown = |p: &&PlanPoint| SCHEMES.iter().all(|(scheme, ..)| *scheme != p.scheme);
    let mut schemes: Vec<String> = report.plans.iter().filter(unknown).map(|p| p.scheme.clone()).collect();
    schemes.sort();
    schemes.dedup();
    schemes
}

/// The main panel: error against rig time.
fn plans(report: &ParetoReport) -> (String, Chart) {
    let styles = SCHEMES.map(|(scheme, style, _)| (scheme.to_owned(), style)).into_iter();
    let (front, mut series) = (report.front(), Vec::new());
    for (scheme, style) in styles.chain(others(report).into_iter().map(|scheme| (scheme, OTHER))) {
        let mut plans: Vec<&PlanPoint> = report.plans.iter().filter(|p| p.scheme == scheme).collect();
        plans.sort_by(|a, b| a.exposures.cmp(&b.exposures).then(a.rig_s.total_cmp(&b.rig_s)));
        series.push(line(&scheme, &plans, &front, style));
        series.push(marks(&scheme, &plans, style));
    }
    let mut seed = Series::new("Ghosh 2007", Vec::new(), Mark::Both, FRONT);
    for (i, s) in report.seed.iter().enumerate() {
        let who = if i == 0 { "Ghosh 2007: " } else { "" };
        // The two ends of a range are joined; nothing leads to the next.
        seed.points.extend([(s.rig_s[0], s.error), (s.rig_s[1], s.error), (f64::NAN, f64::NAN)]);
        seed.labels.extend([format!("{who}order {}, {}", s.order, span(s.rig_s)), String::new(), String::new()]);
    }
    series.push(seed);

    let x = spread(series.iter().flat_map(|s| s.points.iter()).map(|p| p.0));
    let y = spread(series.iter().flat_map(|s| s.points.iter()).map(|p| p.1));
    let corners: Vec<_> = front.iter().filter_map(|p| Some((p.rig_s, p.error()?))).collect();
    // Lowest, so that marks stay seen.
    series.insert(0, Series::new("front", stairs(&corners, x, y), Mark::Line, FRONT));

    let spans = report.seed.first().map_or(Vec::new(), |s| {
        let faster = report.as_good(s, |_| true).filter(|p| p.rig_s < s.rig_s[0]).map(|p| {
            let text = format!("{} times faster", number(s.rig_s[0] / p.rig_s, 2));
            ([(p.rig_s, s.error), (s.rig_s[0], s.error)], text)
        });
        let better = report.as_fast(s, |_| true).and_then(|p| p.error()).filter(|e| *e < s.error).map(|e| {
            let text = format!("{} times less error", number(s.error / e, 2));
            ([(s.rig_s[0], s.error), (s.rig_s[0], e)], text)
        });
        faster.into_iter().chain(better).collect()
    });
    let chart = Chart {
        spans,
        cells: MAIN_CELLS,
        ..Chart::new(
            "Error against rig time, a line for each scheme of patterns, the front, and the published method",
            Axis { range: x, ticks: x.map(ticks), ..Axis::log("time on the rig (s)") },
            Axis { range: y, ticks: y.map(ticks), ..Axis::log("final error (relative to the signal)") },
            series,
        )
    };
    ("Error against time on the rig: less and left is better".into(), chart)
}

/// What is predicted for a scheme: a line for each number of exposures. Runs bear the names of orders; where none was
/// run, plans of the front do.
fn line(scheme: &str, plans: &[&PlanPoint], front: &[&PlanPoint], style: usize) -> Series {
    let mut series = Series::new(scheme, Vec::new(), Mark::Line, style);
    let run = plans.iter().any(|p| known(p.measured).is_some());
    let mut namer = Namer::default();
    let mut exposures = None;
    for p in plans.iter().filter(|p| p.method == MAIN) {
        let Some(error) = known(p.predicted) else { continue };
        if exposures.is_some_and(|e| e != p.exposures) {
            series.points.push((f64::NAN, f64::NAN));
            series.labels.push(String::new());
        }
        exposures = Some(p.exposures);
        let telling = known(p.measured).is_none() && (!run || front.iter().any(|f| std::ptr::eq(*f, *p)));
        series.points.push((p.rig_s, error));
        series.labels.push(if telling { namer.name(p) } else { String::new() });
    }
    series
}

/// What runs measured; hollow where the fit is a published one.
fn marks(scheme: &str, plans: &[&PlanPoint], style: usize) -> Series {
    let mut series = Series::new(scheme, Vec::new(), Mark::Points, style);
    let (mut ours, mut published) = (Namer::default(), Namer::default());
    for (p, error) in plans.iter().filter_map(|p| Some((p, known(p.measured)?))) {
        let hollow = p.method != MAIN;
        series.points.push((p.rig_s, error));
        series.labels.push(if hollow { published.name(p) } else { ours.name(p) });
        series.hollow.push(hollow);
    }
    series
}

/// Names orders of plans where there is room: those of the fewest exposures, of ascending time.
#[derive(Default)]
struct Namer {
    last: Option<(usize, f64)>,
}

impl Namer {
    fn name(&mut self, p: &PlanPoint) -> String {
        if self.last.is_some_and(|(exposures, time)| p.exposures != exposures || p.rig_s < APART * time) {
            return String::new();
        }
        self.last = Some((p.exposures, p.rig_s));
        format!("L{}", p.order)
    }
}

/// Whether runs bear the prediction out.
fn prediction(report: &ParetoReport) -> (String, Chart) {
    let both = |p: &PlanPoint| Some((known(p.predicted)?, known(p.measured)?));
    let pairs = |scheme: &str| {
        report.plans.iter().filter(|p| p.scheme == scheme && p.method == MAIN).filter_map(both).collect::<Vec<_>>()
    };
    let styles = SCHEMES.map(|(scheme, style, _)| (scheme.to_owned(), style)).into_iter();
    let styles = styles.chain(others(report).into_iter().map(|scheme| (scheme, OTHER)));
    let mut series: Vec<Series> =
        styles.map(|(scheme, style)| Series::new(&scheme, pairs(&scheme), Mark::Points, style)).collect();
    let all: Vec<(f64, f64)> = series.iter().flat_map(|s| s.points.iter().copied()).collect();
    let range = spread(all.iter().flat_map(|p| [p.0, p.1]));
    if let Some([lo, hi]) = range {
        series.insert(0, Series::new("equal", vec![(lo, lo), (hi, hi)], Mark::Line, FRONT));
    }
    let [least, most] = all.iter().map(|(x, y)| y / x).fold([f64::MAX, 0.0], |[a, b], r| [r.min(a), r.max(b)]);
    let title = match all.is_empty() {
        true => "Measured against predicted error".into(),
        false => format!("Measured: {} to {} times the prediction", number(least, 2), number(most, 2)),
    };
    let axis = |label: &str| Axis { range, ticks: range.map(ticks), ..Axis::log(label) };
    let chart = Chart::new(
        "Errors measured on the simulated rig against those predicted; on the line they are equal",
        axis("error predicted (relative to the signal)"),
        axis("error measured"),
        series,
    );
    (title, chart)
}

/// Error against computing time of one stage; every point has its name.
fn computing(report: &ParetoReport, stage: Stage) -> (String, Chart) {
    let place = |c: &ComputePoint| Some((known(Some(c.seconds))?, known(Some(c.error))?));
    let points: Vec<&ComputePoint> =
        report.computing.iter().filter(|c| c.stage == stage && place(c).is_some()).collect();
    let series = Series {
        labels: points.iter().map(|c| c.method.clone()).collect(),
        hollow: points.iter().map(|c| c.baseline).collect(),
        ..Series::new("methods", points.iter().map(|c| (c.seconds, c.error)).collect(), Mark::Points, OURS)
    };
    let (mut x, mut y) = (Axis::log("computing time (s)"), Axis::log("error (no unit)"));
    x.range = (!points.is_empty()).then(|| x.fit(points.iter().flat_map(|c| [c.seconds / ROOM, c.seconds * ROOM])));
    y.range = (!points.is_empty()).then(|| y.fit(points.iter().flat_map(|c| [c.error / ROOM, c.error * ROOM])));
    let corners: Vec<_> = undominated(points.iter().copied(), place).into_iter().filter_map(place).collect();
    let front = Series::new("front", stairs(&corners, x.range, y.range), Mark::Line, FRONT);
    let (title, what) = match stage {
        Stage::Conversion => ("Conversion: error against time", "conversion"),
        Stage::Fit => ("Fit of a model: error against time", "fits"),
        Stage::Simulation => ("Simulation: error against time", "simulation"),
    };
    (title.into(), Chart::new(format!("Error of {what} against computing time"), x, y, vec![front, series]))
}

/// The stepped line below which nothing lies: down to each corner, then on at its height; from the upper edge to the right one.
fn stairs(corners: &[(f64, f64)], x: Option<[f64; 2]>, y: Option<[f64; 2]>) -> Vec<(f64, f64)> {
    let (Some(x), Some(y)) = (x, y) else { return Vec::new() };
    let mut height = y[1];
    let mut line = Vec::new();
    for &(at, to) in corners {
        line.extend([(at, height), (at, to)]);
        height = to;
    }
    line.extend(corners.last().map(|_| (x[1], height)));
    line
}

/// The range of values a logarithmic axis can show, with room; none without values.
fn spread(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let values: Vec<f64> = values.filter_map(|v| known(Some(v))).collect();
    let ends = values.iter().fold([f64::MAX, 0.0], |[lo, hi], &v| [v.min(lo), v.max(hi)]);
    (!values.is_empty()).then(|| [ends[0] / ROOM, ends[1] * ROOM])
}

/// Ticks at few times the powers of ten, more where these are few: a small chart has no room for as many.
fn ticks([lo, hi]: [f64; 2]) -> Vec<(f64, String)> {
    let mantissas: &[f64] = if hi / lo < 20.0 { &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0] } else { &[1.0, 2.0, 5.0] };
    let decades = lo.log10().floor() as i32..=hi.log10().floor() as i32;
    let all = decades.flat_map(|e| mantissas.iter().map(move |m| m * 10f64.powi(e)));
    let label = |t: f64| {
        let text = number(t, 2);
        let whole = text.contains('.').then(|| text.trim_end_matches('0').trim_end_matches('.').to_owned());
        whole.unwrap_or(text)
    };
    all.filter(|t| (lo..=hi).contains(t)).map(|t| (t, label(t))).collect()
}
