//! Measured materials are not reciprocal, and the tensor says so. Feature `corpus`.
#![cfg(feature = "corpus")]

mod common;

use common::{exact_coefficients, measured_materials, noisy};
use zonal::basis::reciprocity;
use zonal::export::both_sides;
use zonal::fit::CalibrationUncertainty;
use zonal::geometry::ExitantGrid;

/// All nine RGL files fail the test at orders 2 to 6 and 1% noise.
#[test]
fn rgl_materials_are_not_reciprocal() {
    let zone = common::rig("ghosh-2007-built").zone();
    let grid = ExitantGrid::new(zone, 32, 64);
    let mut files = 0;
    for (name, brdf) in measured_materials().iter().filter(|(name, _)| !name.starts_with("merl")) {
        for order in [2, 4, 6] {
            let z = noisy(&exact_coefficients(brdf.as_ref(), grid, order, zone), 0.01, 1);
            let tensors = both_sides(&z, order, true, &CalibrationUncertainty::default()).unwrap();
            let test = reciprocity(&tensors).unwrap();
            println!(
                "{name}, order {order}: violation {:.2}%, expected {:.2}%, chi2 {:.0} of {}, p {:.1e}",
                100.0 * test.violation,
                100.0 * test.expected,
                test.chi2,
                test.freedom,
                test.p
            );
            assert!(!test.holds(), "{name}, order {order}");
        }
        files += 1;
    }
    assert_eq!(files, 9);
}
