//! `zonal demo`: everything once, ending in a page.

use std::path::PathBuf;
use std::sync::Arc;

use zonal::basis::{Method, lm};
use zonal::calibrate::CalibrationSet;
use zonal::capture::{Crop, RunFolder};
use zonal::export::ShMaterial;
use zonal::fit::{CalibrationUncertainty, FitMethod};
use zonal::measure::{Measurement, Provenance, Request, lobe_pairs, measure};
use zonal::optics::Rig;
use zonal::patterns::{Plan, Scheme};
use zonal::reflectance::{Brdf, ZoneErrors, open};
use zonal::render::Shape;
use zonal::report::{
    DemoReport, Fits, ParetoRuns, ParetoScan, Picture, accuracy, conversions, converted, pareto_plans, pattern_png,
    pictures, plane_png, slices, spectrum,
};
use zonal::store;
use zonal::twin::TwinConfig;

use crate::common::{self, Report};

#[derive(clap::Args)]
pub struct Args {
    /// Folder for the page, the run and the coefficients.
    #[arg(long, default_value = "zonal-demo")]
    out: PathBuf,
    /// Material to measure: a .bsdf, .binary or .dat file, or a name of `zonal materials`.
    #[arg(long, default_value = "red-plastic")]
    material: String,
    /// Seed of the simulated noise.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
}

const RIG: &str = include_str!("../../../optics/ghosh-2007-built.toml");
/// Order of the run the page is about.
const ORDER: usize = 4;
/// Largest order on the chart of speed against accuracy.
const CHART_ORDER: usize = 6;

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let started = std::time::Instant::now();
    common::makeable(&args.out)?;
    let truth = open(&args.material)?;
    let rig = Rig::from_toml(RIG)?;
    let config = TwinConfig::pinhole(args.seed);
    let run = (1..).map(|i| args.out.join(format!("run-{i}"))).find(|p| !p.exists()).expect("some number is free");
    let folder = RunFolder::create(&run, false)?;
    let calibration = common::calibration(None, &rig, Some(&config), None)?;

    let provenance = Provenance {
        sample: args.material.clone(),
        simulation: Some(serde_json::to_value(&config).expect("plain data")),
        started: Some(common::now()),
        ..Provenance::default()
    };
    let plan = Plan::of_order(ORDER);
    let mut bench = common::bench(&rig, &config, truth.clone());
    let mut bar = common::frames_bar("order 4");
    let control = common::steered();
    let request = Request {
        rig: &rig,
        plan: &plan,
        calibration: &calibration,
        provenance: &provenance,
        control: &control,
        adviser: None,
    };
    let measured = measure(&request, &mut bench, Some(&folder), &mut bar)?;
    let sh = converted(&measured.coefficients, Method::Parity, ORDER)?;
    let exr = run.join("sh-parity.exr");
    sh.write(&exr)?;

    // The chart's orders are the beginnings of one longer run; other schemes and the adaptive one stand beside it.
    let samples = [(args.material.clone(), truth.clone())];
    let scan = ParetoScan {
        rig: &rig,
        calibration: &calibration,
        config: &config,
        materials: &samples,
        pairs: CHART_ORDER,
        plans: pareto_plans().into_iter().filter(|p| matches!(p.scheme, Scheme::Pairs | Scheme::Isotropic)).collect(),
        computing: false,
    };
    let runs = scan.run(&mut common::frames_bar("other plans"))?;

    let errors = ZoneErrors::new(&sh, truth.as_ref(), rig.zone());
    let page = Results { args, rig, plan, config, calibration, measured, runs, truth, sh }.page()?;
    let html = args.out.join("index.html");
    store::write(&html, page.to_html().as_bytes())?;
    let record = &page.record;
    let fit = page.fits.of(FitMethod::Auto);
    let off = fit.errors.map(|e| e.mean);
    let off_percent = |error: Option<f64>| 100.0 * error.unwrap_or(f64::NAN);
    let text = format!(
        "{}: order {ORDER}, {} frames, {:.1} s on the rig; computed in {:.0} s\nerror of f_cos: spherical harmonics {:.1}% in the zone, {:.1}% outside; fit ({}) {:.1}% and {:.1}%\npage: {}\nrun:  {}\nSH:   {}",
        args.material,
        record.frames,
        record.rig_s,
        started.elapsed().as_secs_f64(),
        100.0 * errors.inside,
        100.0 * errors.outside,
        fit.report.model,
        off_percent(off.map(|e| e.rel_in)),
        off_percent(off.map(|e| e.rel_out)),
        html.display(),
        run.display(),
        exr.display()
    );
    let json = serde_json::json!({
        "page": common::said(&html), "run": common::said(&run), "sh": common::said(&exr), "measure": record, "seconds": started.elapsed().as_secs_f64(),
        "error_in": errors.inside, "error_out": errors.outside,
        "model": fit.report.model, "fit_errors": off,
    });
    Ok(Report { text, json })
}

/// What the page is made from.
struct Results<'a> {
    args: &'a Args,
    rig: Rig,
    plan: Plan,
    config: TwinConfig,
    calibration: CalibrationSet,
    measured: Measurement,
    runs: ParetoRuns,
    truth: Arc<dyn Brdf>,
    sh: ShMaterial,
}

impl Results<'_> {
    fn page(&self) -> anyhow::Result<DemoReport> {
        let (coefficients, truth) = (&self.measured.coefficients, self.truth.as_ref());
        let fits =
            Fits::new(coefficients, FitMethod::Auto, Some(truth), CalibrationUncertainty::of(&self.measured.record))?;
        let response = &self.measured.first_response;
        Ok(DemoReport {
            title: format!("{} measured by {}", self.args.material, self.rig.name),
            material: self.args.material.clone(),
            record: self.measured.record.clone(),
            gray_card: self.calibration.check.clone(),
            patterns: patterns(&self.rig, &self.plan, &self.calibration)?,
            response: Picture {
                caption:
                    "HDR response to the constant pattern: the sample seen from every direction of the zone, e-/s, \
                          log scale"
                        .into(),
                png: plane_png(response.crop.width, response.crop.height, &response.rate, true),
            },
            spectrum: spectrum(coefficients, &fits.chosen().brdf)?,
            slices: slices(coefficients, Some(truth), &fits.curves())?,
            spheres: pictures(&[Shape::Sphere], "measured", &self.sh, Some(truth)),
            accuracy: accuracy(&self.rig, &self.runs.pairs[0], truth)?,
            pareto: Some(self.runs.report.clone()),
            methods: conversions(coefficients, truth)?,
            fits,
            provenance: vec![
                ("Source of the rig".into(), self.rig.source.clone()),
                ("Source of the material".into(), source(&self.args.material)),
                ("Simulated rig".into(), serde_json::to_string(&self.config)?.replace(',', ", ")),
                ("Conversion".into(), "parity (odd spherical harmonics, least squares over the zone)".into()),
            ],
        })
    }
}

fn source(material: &str) -> String {
    let known = zonal::reflectance::built_in().into_iter().find(|m| m.name == material);
    known.map_or_else(|| material.to_owned(), |m| format!("{} ({}, {})", m.name, m.family, m.source))
}

fn patterns(rig: &Rig, plan: &Plan, calibration: &CalibrationSet) -> anyhow::Result<Vec<Picture>> {
    let p = &rig.projector;
    let [u0, v0, u1, v1] =
        rig.projector_map().bounding_box(&rig.zone(), p.width_px, p.height_px).expect("a checked rig shows its zone");
    let crop = Crop { u0, v0, width: u1 - u0, height: v1 - v0 };
    let pairs = lobe_pairs(rig, plan, calibration)?;
    let shown = [0, 2, 3, 6, 8, 12, 16, 24].into_iter().filter(|&k| k < pairs.len());
    Ok(shown
        .flat_map(|k| {
            let (l, m) = lm(k);
            let lobe = |i: usize, sign: &str| Picture {
                caption: format!("l = {l}, m = {m}, {sign} lobe"),
                png: pattern_png(&pairs[k].patterns[i], crop),
            };
            if k == 0 { vec![lobe(0, "constant")] } else { vec![lobe(0, "positive"), lobe(1, "negative")] }
        })
        .collect())
}
