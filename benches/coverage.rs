//! How often 95% intervals of the albedo hold the truth, over 200 rigs, calibrations and mounts.
#![allow(missing_docs)]

#[path = "../tests/coverage/mod.rs"]
mod coverage;

use coverage::coverage;

/// Three standard errors about 95% of 200 draws, nearly.
const COVERAGE: std::ops::RangeInclusive<f64> = 0.92..=0.98;

fn main() {
    let found = coverage(200);
    assert!(found.share.iter().all(|share| COVERAGE.contains(share)), "{:?}", found.share);
}
