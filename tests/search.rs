//! The search for better dimensions at full count: some minutes.
#![cfg(feature = "thorough")]

use zonal::design::Search;
use zonal::optics::Rig;

/// Searches from 100 random points reach the same front, whatever the points.
#[test]
fn fronts_of_five_seeds_are_one() {
    let search = Search::new(&Rig::from_toml(include_str!("../optics/ghosh-2007-search.toml")).unwrap()).unwrap();
    let volumes: Vec<f64> = (1..=5).map(|seed| search.run(seed, 100).unwrap().hypervolume).collect();
    let (lo, hi) = volumes.iter().fold((f64::INFINITY, 0.0f64), |(lo, hi), v| (lo.min(*v), hi.max(*v)));
    assert!(hi / lo - 1.0 < 0.01, "{volumes:?}");
}
