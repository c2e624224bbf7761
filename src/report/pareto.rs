//! What time buys: seconds on the rig and of computing against the error they leave. Picture, page and table.

use serde::Serialize;

use super::html::{document, heading, number_cells, provenance, table_head};
use super::sheet::Sheet;
use super::text::{escape, number, seconds};
use super::{pareto_panels, pareto_panels::span};

/// The method the predictions are of, and whose runs are drawn filled.
pub(super) const MAIN: &str = "auto";
/// The scheme that serves isotropic samples alone.
const ISOTROPIC: &str = "isotropic";

/// One plan on the plane of rig time against final error.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlanPoint {
    /// Scheme of its patterns: `pairs`, `offset`, `multiplexed`, `isotropic`, or `adaptive`.
    pub scheme: String,
    /// Zonal order; the highest reached, for adaptive plans.
    pub order: usize,
    /// Exposures of each frame, at least 1.
    pub exposures: usize,
    /// Camera frames.
    pub frames: usize,
    /// Rig time, s; positive.
    pub rig_s: f64,
    /// What becomes of the coefficients: a method of fitting, e.g. `auto` or `thesis`.
    pub method: String,
    /// Median error expected over the class, no unit (1: as large as the signal); none where nothing is predicted.
    pub predicted: Option<f64>,
    /// Median error of runs on the simulated rig, no unit; none where it was not run.
    pub measured: Option<f64>,
}

impl PlanPoint {
    /// The error that counts: measured, or else predicted; none that is not positive and finite.
    pub fn error(&self) -> Option<f64> {
        known(self.measured).or(known(self.predicted))
    }

    /// Scheme and order in words, with what is not usual: several exposures, another method.
    fn name(&self) -> String {
        let mut name = format!("{}, order {}", self.scheme, self.order);
        if self.exposures > 1 {
            name += &format!(", {} exposures", self.exposures);
        }
        if self.method != MAIN {
            name += &format!(", fit {}", self.method);
        }
        name
    }
}

/// What the published method needs and leaves.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SeedPoint {
    /// Zonal order.
    pub order: usize,
    /// Rig time as published, from and to, s; equal where one number is.
    pub rig_s: [f64; 2],
    /// Median error of its own method on the simulated rig, no unit.
    pub error: f64,
}

/// A step of computing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// From zonal coefficients to spherical harmonics.
    Conversion,
    /// From zonal coefficients to a model.
    Fit,
    /// From a material and a rig to camera frames.
    Simulation,
}

impl Stage {
    /// All stages, in the order of picture and tables.
    pub const ALL: [Stage; 3] = [Stage::Conversion, Stage::Fit, Stage::Simulation];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Conversion => "conversion",
            Stage::Fit => "fit",
            Stage::Simulation => "simulation",
        }
    }
}

/// One way of computing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComputePoint {
    /// What it computes.
    pub stage: Stage,
    /// Its name.
    pub method: String,
    /// Computing time, s; positive.
    pub seconds: f64,
    /// Error of its result, no unit; the picture shows positive ones alone.
    pub error: f64,
    /// Whether it is a published baseline.
    pub baseline: bool,
}

/// All that the picture and the page show.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParetoReport {
    /// Names of the materials run.
    pub materials: Vec<String>,
    /// Plans tried, in any order.
    pub plans: Vec<PlanPoint>,
    /// Ways of computing.
    pub computing: Vec<ComputePoint>,
    /// What the published method (Ghosh 2007) needs, fastest first.
    pub seed: Vec<SeedPoint>,
    /// Rows of provenance for the page: names and texts.
    pub provenance: Vec<(String, String)>,
}

/// Columns of the table.
const COLUMNS: [&str; 13] = [
    "kind",
    "scheme",
    "order",
    "exposures",
    "frames",
    "method",
    "seconds",
    "seconds_to",
    "error",
    "predicted",
    "measured",
    "front",
    "baseline",
];

impl ParetoReport {
    /// The picture: the plane of rig time and error, and what is computed beside it.
    pub fn sheet(&self) -> Sheet {
        pareto_panels::sheet(self)
    }

    /// Plans that no other beats: none is both as fast and as good. The fastest comes first, and errors fall.
    pub fn front(&self) -> Vec<&PlanPoint> {
        // A forecast beside runs would stand where nobody has been.
        let run = self.plans.iter().any(|p| known(p.measured).is_some());
        let error = |p: &PlanPoint| if run { known(p.measured) } else { p.error() };
        undominated(self.plans.iter(), |p| Some((p.rig_s, error(p)?)))
    }

    /// The table: a row for each plan, point of the published method, and way of computing. `error` is what the picture
    /// compares; of a plan the measured one, or else the predicted.
    pub fn to_csv(&self) -> Vec<u8> {
        let front = self.front();
        let cell = |x: Option<f64>| x.filter(|x| x.is_finite()).map_or(String::new(), |x| x.to_string());
        let mut csv = csv::Writer::from_writer(Vec::new());
        let mut write = |row: [String; COLUMNS.len()]| csv.write_record(row).expect("memory takes any table");
        write(COLUMNS.map(str::to_owned));
        for p in &self.plans {
            write([
                "plan".into(),
                p.scheme.clone(),
                p.order.to_string(),
                p.exposures.to_string(),
                p.frames.to_string(),
                p.method.clone(),
                cell(Some(p.rig_s)),
                String::new(),
                cell(p.error()),
                cell(p.predicted),
                cell(p.measured),
                front.iter().any(|f| std::ptr::eq(*f, p)).to_string(),
                false.to_string(),
            ]);
        }
        for s in &self.seed {
            let mut row: [String; COLUMNS.len()] = Default::default();
            (row[0], row[2], row[5]) = ("seed".into(), s.order.to_string(), "thesis".into());
            (row[6], row[7], row[8]) = (cell(Some(s.rig_s[0])), cell(Some(s.rig_s[1])), cell(Some(s.error)));
            (row[10], row[12]) = (cell(Some(s.error)), true.to_string());
            write(row);
        }
        for c in &self.computing {
            let mut row: [String; COLUMNS.len()] = Default::default();
            (row[0], row[5]) = (c.stage.name().into(), c.method.clone());
            (row[6], row[8], row[10]) = (cell(Some(c.seconds)), cell(Some(c.error)), cell(Some(c.error)));
            row[12] = c.baseline.to_string();
            write(row);
        }
        csv.into_inner().expect("memory takes any table")
    }

    /// The page: charts, the plans of the front, and the ways of computing.
    pub fn to_html(&self) -> String {
        let sentences = self.seed.iter().filter_map(|s| self.against(s)).collect::<Vec<_>>().join(" ");
        let said = if sentences.is_empty() { "Seconds against the error they leave.".into() } else { sentences };
        let summary = format!(
            "<p class=\"summary\">{}</p>\n<p>Errors are medians over materials, relative to the signal: at 1 the error is as large as the \
             signal. Plans on the front are those that no other beats in both time and error.</p>\n",
            escape(&said)
        );
        let files = "<p class=\"note\">As files: <a href=\"pareto.png\">pareto.png</a>, <a href=\"pareto.svg\">pareto.svg</a>, and all \
                     numbers in <a href=\"pareto.csv\">pareto.csv</a>.</p>\n";
        let materials = match self.materials.len() {
            0 => "none".into(),
            n => format!("{n}: {}", self.materials.join(", ")),
        };
        let facts = [("Materials", materials.as_str())]
            .into_iter()
            .chain(self.provenance.iter().map(|(name, text)| (name.as_str(), text.as_str())))
            .chain([("Software", concat!("zonal ", env!("CARGO_PKG_VERSION")))]);
        let body = summary
            + &heading("Time and error")
            + files
            + &self.sheet().to_html()
            + &self.plans_table()
            + &self.computing_table()
            + &provenance(facts);
        document("What time buys", &body)
    }

    /// The fastest plan that errs no more than the published method.
    pub(super) fn as_good<'a>(&'a self, s: &SeedPoint, serves: impl Fn(&PlanPoint) -> bool) -> Option<&'a PlanPoint> {
        let plans = undominated(self.plans.iter().filter(|p| serves(p)), |p| Some((p.rig_s, p.error()?)));
        plans.into_iter().find(|p| p.error().is_some_and(|e| e <= s.error))
    }

    /// The best plan that takes no longer than the published method at its fastest.
    pub(super) fn as_fast<'a>(&'a self, s: &SeedPoint, serves: impl Fn(&PlanPoint) -> bool) -> Option<&'a PlanPoint> {
        let plans = undominated(self.plans.iter().filter(|p| serves(p)), |p| Some((p.rig_s, p.error()?)));
        plans.into_iter().rfind(|p| p.rig_s <= s.rig_s[0])
    }

    /// The front against the published method, in a few sentences.
    fn against(&self, s: &SeedPoint) -> Option<String> {
        let error = |p: &PlanPoint| number(p.error().unwrap_or(f64::NAN), 2);
        let faster = |p: &PlanPoint| {
            let times = number(s.rig_s[0] / p.rig_s, 2);
            format!("a plan ({}) errs by {} in {}, {times} times faster", p.name(), error(p), seconds(p.rig_s))
        };
        let better = |p: &PlanPoint| {
            let times = number(s.error / p.error().unwrap_or(f64::NAN), 2);
            format!("a plan ({}) errs by {} in no more time, {times} times less", p.name(), error(p))
        };
        // Isotropic plans serve some samples only: what serves all is told too.
        let any = |p: &PlanPoint| p.scheme != ISOTROPIC;
        let told = |best: Option<&PlanPoint>, of_any: Option<&PlanPoint>, say: &dyn Fn(&PlanPoint) -> String| {
            let general = of_any.filter(|_| best.is_some_and(|p| !any(p)));
            let general = general.map_or(String::new(), |p| format!("; for samples of any kind {}", say(p)));
            best.map_or(String::new(), |p| format!("; {}{general}", say(p)))
        };
        let fast = told(Some(self.as_good(s, |_| true)?), self.as_good(s, any), &faster);
        let good = told(self.as_fast(s, |_| true), self.as_fast(s, any), &better);
        let (time, error) = (span(s.rig_s), number(s.error, 2));
        Some(format!("Ghosh 2007 at order {} takes {time} and errs by {error}{fast}{good}.", s.order))
    }

    fn plans_table(&self) -> String {
        const COLUMNS: [&str; 4] = ["Frames", "Seconds on the rig", "Error predicted", "Error measured"];
        let error = |x: Option<f64>| known(x).map_or("–".into(), |x| number(x, 3));
        let row = |p: &PlanPoint| {
            let values = [p.frames.to_string(), number(p.rig_s, 3), error(p.predicted), error(p.measured)];
            format!("<tr><th scope=\"row\">{}</th>{}</tr>\n", escape(&p.name()), number_cells(&COLUMNS, &values))
        };
        heading("Plans on the front")
            + "<p class=\"note\">Compared by what runs on the simulated rig measured, or by the prediction where none was run.</p>\n\
               <table class=\"cards\">\n"
            + &table_head("Plan", &COLUMNS, None)
            + &format!("<tbody>\n{}</tbody>\n</table>\n", self.front().into_iter().map(row).collect::<String>())
    }

    fn computing_table(&self) -> String {
        const COLUMNS: [&str; 2] = ["Time", "Error"];
        let row = |c: &ComputePoint| {
            let published = if c.baseline { " (published)" } else { "" };
            let name = escape(&format!("{}: {}{published}", c.stage.name(), c.method));
            let cells = number_cells(&COLUMNS, &[seconds(c.seconds), number(c.error, 3)]);
            format!("<tr><th scope=\"row\">{name}</th>{cells}</tr>\n")
        };
        let of = |stage| self.computing.iter().filter(move |c| c.stage == stage);
        let rows: String = Stage::ALL.into_iter().flat_map(of).map(row).collect();
        heading("Ways of computing")
            + "<table class=\"cards\">\n"
            + &table_head("Method", &COLUMNS, None)
            + &format!("<tbody>\n{rows}</tbody>\n</table>\n")
    }
}

/// An error a logarithmic axis can show.
pub(super) fn known(error: Option<f64>) -> Option<f64> {
    error.filter(|e| e.is_finite() && *e > 0.0)
}

/// Items that no other beats in both coordinates; the first coordinate ascends, the second falls. Of equals the first stays.
pub(super) fn undominated<'a, T>(
    items: impl Iterator<Item = &'a T>,
    at: impl Fn(&T) -> Option<(f64, f64)>,
) -> Vec<&'a T> {
    let placed = items.filter_map(|item| Some((at(item).filter(|(x, y)| x.is_finite() && y.is_finite())?, item)));
    let mut placed: Vec<_> = placed.collect();
    placed.sort_by(|(a, _), (b, _)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut least = f64::INFINITY;
    placed.retain(|((_, y), _)| {
        let better = *y < least;
        least = least.min(*y);
        better
    });
    placed.into_iter().map(|(_, item)| item).collect()
}
