//! Many directions at once are no slower than sphericart in the same run, but for order 6 ([`AT_MOST`]): `bash tests/run.sh`, which
//! sets ZONAL_PYTHON.
#![cfg(feature = "peers")]

mod speed;

/// Series of alternating calls at most.
const SERIES: usize = 4;
/// Time over sphericart's, at most. Up to order 6 sphericart has its functions written out one by one, and more than half of our
/// time goes into writing the array; which of the two is ahead depends on the processor (1.05 to 1.2 on a Zen 3).
const AT_MOST: [(usize, f64); 4] = [(6, 1.25), (10, 1.0), (20, 1.0), (50, 1.0)];

/// One core, the same layout, arrays that exist and are touched before.
#[test]
fn batches_are_no_slower_than_sphericart() {
    let mut peer = speed::Peer::start();
    assert_eq!(AT_MOST.map(|(order, _)| order), speed::ORDERS);
    for (order, at_most) in AT_MOST {
        // The least of some series: a busy machine disturbs one side or the other.
        let (mut ours, mut theirs) = (f64::INFINITY, f64::INFINITY);
        for _ in 0..SERIES {
            let ([a, b], _) = speed::against(&mut peer, order);
            (ours, theirs) = (ours.min(a), theirs.min(b));
            if ours <= at_most * theirs {
                break;
            }
        }
        let ratio = ours / theirs;
        println!("order {order}: {ratio:.2} of sphericart's time");
        assert!(ratio <= at_most, "order {order}: {ratio:.2} of sphericart's time, {at_most} allowed");
    }
}
