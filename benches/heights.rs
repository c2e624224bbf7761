//! Whole measurements of samples that lie too high, on the simulated rig with finite pupils and everything else on: calibrated
//! with a card at the right height, order 2, the recommended projector and one like the seed's.
//!
//! `cargo bench --bench heights`. Prints the gray card's worst coefficient over z_00, and what the fit of `ggx-0.1` errs.
#![allow(missing_docs)]

#[path = "../tests/common/mod.rs"]
mod common;

use zonal::calibrate::{GRAY_CARD_ALBEDO, GrayCardCheck};
use zonal::fit::{FitMethod, FitOptions, fit};
use zonal::optics::Misalignment;
use zonal::patterns::Plan;
use zonal::reflectance::{Metric, open};
use zonal::twin::TwinConfig;

const HEIGHTS_MM: [f64; 6] = [0.0, 0.05, 0.1, 0.2, 1.0, 2.0];

fn main() {
    let (card, glossy) = (open("gray-card").unwrap(), open("ggx-0.1").unwrap());
    let plan = Plan::of_order(2);
    println!("rig\tdz, mm\tcard, worst of z_00\tggx-0.1: fit and its error");
    for name in ["ghosh-2007-built", "ghosh-2007-seed-projector"] {
        let rig = common::rig(name);
        let metric = Metric::new(rig.zone());
        let at = |height_mm: f64, seed: u64| {
            let usual = TwinConfig::finite(seed);
            let perturbation = Misalignment { sample_height_mm: height_mm, ..usual.perturbation };
            TwinConfig { perturbation, ..usual }
        };
        let calibration = common::calibrated(&rig, &at(0.0, 1));
        for height_mm in HEIGHTS_MM {
            let config = at(height_mm, 2);
            let run = |sample| common::run(&rig, &plan, &config, &calibration, sample).coefficients;
            let check = GrayCardCheck::new(&run(card.clone()), GRAY_CARD_ALBEDO);
            let fitted = fit(&run(glossy.clone()), FitMethod::Auto, &FitOptions::default());
            let said = fitted.map_or_else(
                |e| e.to_string(),
                |report| {
                    let error = metric.errors(glossy.as_ref(), &report.brdf).map_or(f64::NAN, |e| e.mean.overall());
                    format!("{} {error:.4}", report.model)
                },
            );
            println!("{name}\t{height_mm}\t{:.4}\t{said}", check.worst_error);
        }
    }
}
