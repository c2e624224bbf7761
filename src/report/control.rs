//! Control charts of gray-card runs: picture, page and table.

use super::axis::Axis;
use super::chart::{Chart, Mark, Series};
use super::html::{document, heading, provenance};
use super::sheet::Sheet;
use super::text::{escape, percent, signed_percent};
use crate::measure::{ControlRun, ControlSeries, Signal, control_series};

const COEFFICIENTS: [&str; 3] = ["z₀₀", "z₁₀", "z₂₀"];
/// The same in files.
const COLUMNS: [&str; 3] = ["z_00", "z_10", "z_20"];
const CHANNELS: [&str; 3] = ["red", "green", "blue"];
/// Styles of the runs, their mean, and the limits at 2 and 3 sigma.
const STYLES: [(usize, &str); 4] =
    [(1, "gray-card runs, in order of time"), (3, "mean of the first runs"), (5, "± 2 σ"), (2, "± 3 σ")];
/// Runs numbered below an axis, at most.
const TICKS: usize = 8;

/// Gray-card runs over time.
#[derive(Debug, Clone, PartialEq)]
pub struct ControlReport {
    /// The runs, in order of time.
    pub runs: Vec<ControlRun>,
    /// How many of the first runs set mean and limits.
    pub baseline: usize,
    /// What is charted.
    pub series: Vec<ControlSeries>,
}

impl ControlReport {
    /// Puts runs in order of time (those without a date first, as given) and charts them.
    pub fn new(mut runs: Vec<ControlRun>, baseline: usize) -> Self {
        runs.sort_by(|a, b| a.started.cmp(&b.started));
        let series = control_series(&runs, baseline);
        Self { runs, baseline, series }
    }

    /// Runs with a signal: index, and what is wrong with which quantity.
    pub fn flagged(&self) -> Vec<(usize, String)> {
        let of = |i: usize| {
            let said = self.series.iter().flat_map(|s| {
                s.signals[i].iter().map(move |signal| {
                    format!("{} {}: {}", COEFFICIENTS[s.coefficient], CHANNELS[s.channel], said(*signal))
                })
            });
            (i, said.collect::<Vec<_>>().join("; "))
        };
        (0..self.runs.len()).map(of).filter(|(_, said)| !said.is_empty()).collect()
    }

    /// The picture: a row for each coefficient, a column for each channel.
    pub fn sheet(&self) -> Sheet {
        let mut panels: Vec<_> = self.series.iter().map(|s| Some(self.panel(s))).collect();
        panels.push(None);
        Sheet {
            title: format!("Gray card: errors relative to z₀₀ over {} runs", self.runs.len()),
            columns: 3,
            panels,
            series: STYLES.map(|(style, name)| (style, Mark::Both, name.to_owned())).into(),
            notes: vec![
                format!("limits from the moving range of the first {} runs", self.baseline),
                "hollow: out of control".into(),
                "1: beyond 3 σ; 2: two of three beyond 2 σ; 8: eight on one side".into(),
            ],
        }
    }

    fn panel(&self, series: &ControlSeries) -> (String, Chart) {
        let n = series.values.len();
        let [runs, mean, two, three] = STYLES.map(|s| s.0);
        let ends = |value: f64| vec![(0.5, 100.0 * value), (n as f64 + 0.5, 100.0 * value)];
        let level = |name: &str, sigmas: f64, style| {
            Series::new(name, ends(series.mean + sigmas * series.sigma), Mark::Line, style)
        };
        let points = series.values.iter().enumerate().map(|(i, v)| ((i + 1) as f64, 100.0 * v)).collect();
        let mut all = vec![level("mean", 0.0, mean)];
        for (sigmas, style) in [(-2.0, two), (2.0, two), (-3.0, three), (3.0, three)] {
            all.push(level("limit", sigmas, style));
        }
        all.push(Series {
            hollow: series.signals.iter().map(|s| !s.is_empty()).collect(),
            labels: series.signals.iter().map(|s| s.iter().map(|s| mark(*s)).collect::<Vec<_>>().join(" ")).collect(),
            ..Series::new("runs", points, Mark::Both, runs)
        });
        let title = format!("{}, {}", COEFFICIENTS[series.coefficient], CHANNELS[series.channel]);
        let ticks = (0..n).step_by(n.div_ceil(TICKS)).map(|i| ((i + 1) as f64, (i + 1).to_string())).collect();
        let x =
            Axis { ticks: Some(ticks), range: Some([0.5, n as f64 + 0.5]), ..Axis::linear("run, in order of time") };
        let description = format!("Error of {title} over gray-card runs with mean and limits");
        let y = Axis::linear("error (% of analytic z₀₀)");
        (title, Chart::new(description, x, y, all))
    }

    /// The table: a row for each run and quantity.
    pub fn to_csv(&self) -> Vec<u8> {
        let mut csv = csv::Writer::from_writer(Vec::new());
        let head = ["number", "run", "started", "coefficient", "channel", "error", "mean", "sigma", "signals"];
        csv.write_record(head).expect("memory takes any table");
        for (i, run) in self.runs.iter().enumerate() {
            for s in &self.series {
                let signals = s.signals[i].iter().map(|s| said(*s)).collect::<Vec<_>>().join("; ");
                let row = [
                    (i + 1).to_string(),
                    run.run.clone(),
                    run.started.clone().unwrap_or_default(),
                    COLUMNS[s.coefficient].into(),
                    CHANNELS[s.channel].into(),
                    s.values[i].to_string(),
                    s.mean.to_string(),
                    s.sigma.to_string(),
                    signals,
                ];
                csv.write_record(row).expect("memory takes any table");
            }
        }
        csv.into_inner().expect("memory takes any table")
    }

    /// The page.
    pub fn to_html(&self) -> String {
        let flagged = self.flagged();
        let summary = match flagged.len() {
            0 => format!("All {} gray-card runs are in control.", self.runs.len()),
            n => format!(
                "{n} of {} gray-card runs are out of control: recalibrate, or find out what changed.",
                self.runs.len()
            ),
        };
        let rows = self.runs.iter().enumerate().map(|(i, run)| {
            let signals = flagged.iter().find(|f| f.0 == i).map_or("in control", |f| &f.1);
            let errors = run.errors.map(|e| signed_percent(e.iter().sum::<f64>() / 3.0));
            format!(
                "<tr><th scope=\"row\">{}: {}</th><td>{}</td><td>{}</td><td>{}</td></tr>\n",
                i + 1,
                escape(&run.run),
                escape(run.started.as_deref().unwrap_or("no date")),
                errors.join(", "),
                escape(signals)
            )
        });
        let table = "<table>\n<thead><tr><th scope=\"col\">Run</th><th scope=\"col\">Began (UTC)</th>\
                     <th scope=\"col\">Errors of z₀₀, z₁₀, z₂₀, mean of the channels</th><th scope=\"col\">Signals</th></tr></thead>\n<tbody>\n"
            .to_owned()
            + &rows.collect::<String>()
            + "</tbody>\n</table>\n";
        let spread =
            self.series.iter().filter(|s| s.coefficient == 0).map(|s| percent(s.sigma)).collect::<Vec<_>>().join(", ");
        let facts = [
            ("Runs that set the limits", self.baseline.to_string()),
            ("Standard deviation of z₀₀ (red, green, blue)", spread),
            ("Chart", "individuals, mean moving range of two over 1.128 (Shewhart)".into()),
            ("Software", concat!("zonal ", env!("CARGO_PKG_VERSION")).into()),
        ];
        let files = "<p class=\"note\">As files: <a href=\"control.png\">control.png</a>, <a href=\"control.svg\">control.svg</a>, \
                     <a href=\"control.csv\">control.csv</a>.</p>\n";
        let body = format!("<p class=\"summary\">{}</p>\n", escape(&summary))
            + &heading("Charts")
            + files
            + &self.sheet().to_html()
            + &heading("Runs")
            + &table
            + &provenance(facts.iter().map(|(name, value)| (*name, value.as_str())));
        document("Control chart of the gray card", &body)
    }
}

fn said(signal: Signal) -> &'static str {
    match signal {
        Signal::BeyondThree => "beyond 3 sigma",
        Signal::TwoOfThree => "two of three beyond 2 sigma",
        Signal::EightOnOneSide => "eight on one side",
    }
}

fn mark(signal: Signal) -> &'static str {
    match signal {
        Signal::BeyondThree => "1",
        Signal::TwoOfThree => "2",
        Signal::EightOnOneSide => "8",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report() -> ControlReport {
        let run = |i: usize, off: f64| ControlRun {
            run: format!("<run {i}>"),
            started: Some(format!("2026-01-{:02}T08:00:00Z", i + 1)),
            errors: [[off; 3], [off / 10.0; 3], [f64::NAN; 3]],
        };
        let mut runs: Vec<_> = (0..10).map(|i| run(i, if i % 2 == 0 { 1e-3 } else { -1e-3 })).collect();
        runs.push(run(10, 0.02));
        runs.reverse();
        ControlReport::new(runs, 10)
    }

    #[test]
    fn a_lamp_that_ages_is_flagged() {
        let report = report();
        assert_eq!((report.runs[0].run.as_str(), report.series.len()), ("<run 0>", 6));
        let flagged = report.flagged();
        assert_eq!((flagged.len(), flagged[0].0), (1, 10));
        assert!(flagged[0].1.contains("z₀₀ green: beyond 3 sigma"), "{}", flagged[0].1);
    }

    #[test]
    fn picture_page_and_table_are_whole() {
        let report = report();
        let svg = report.sheet().to_svg();
        assert!(svg.starts_with("<svg xmlns") && svg.contains("class=\"hollow s1\"") && !svg.contains("NaN"));
        assert!(image::load_from_memory(&report.sheet().to_png()).is_ok());
        let page = report.to_html();
        assert!(page.contains("1 of 11 gray-card runs are out of control") && page.contains("&lt;run 10&gt;"));
        let csv = String::from_utf8(report.to_csv()).unwrap();
        assert_eq!(csv.lines().count(), 1 + 11 * 6);
        assert!(csv.lines().last().unwrap().contains("z_10,blue") && csv.contains("beyond 3 sigma"));
    }
}
