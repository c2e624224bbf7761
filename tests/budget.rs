//! The uncertainty budget holds what it promises: over rigs, calibrations and mounts drawn from what it takes for granted, its
//! 95% intervals hold the true albedo about 95% of the time. `cargo bench --bench coverage` draws 200.

mod coverage;

use coverage::coverage;

/// What takes half a minute on two cores.
const DRAWS: u64 = 60;
/// The binomial distribution of 60 draws at 95% lies below with a probability of 0.3%; nothing lies above.
const COVERAGE: std::ops::RangeInclusive<f64> = 0.86..=1.0;
/// Four standard errors of the spread of 60 draws.
const SPREAD: std::ops::Range<f64> = 0.64..1.36;

#[test]
#[cfg_attr(not(feature = "thorough"), ignore = "takes long: --features thorough")]
fn intervals_of_the_albedo_hold_the_truth() {
    let found = coverage(DRAWS);
    for c in 0..3 {
        assert!(COVERAGE.contains(&found.share[c]), "channel {c}: {}", found.share[c]);
        assert!(SPREAD.contains(&found.spread[c]), "channel {c}: {}", found.spread[c]);
    }
}
