//! Many directions at once are no slower than sphericart in the same run: `bash tests/run.sh`, which sets ZONAL_PYTHON.
#![cfg(feature = "peers")]

mod speed;

/// Series of alternating calls at most.
const SERIES: usize = 4;

/// One core, the same layout, arrays that exist and are touched before.
#[test]
fn batches_are_no_slower_than_sphericart() {
    let mut peer = speed::Peer::start();
    for order in speed::ORDERS {
        // The least of some series: a busy machine disturbs one side or the other.
        let (mut ours, mut theirs) = (f64::INFINITY, f64::INFINITY);
        for _ in 0..SERIES {
            let ([a, b], _) = speed::against(&mut peer, order);
            (ours, theirs) = (ours.min(a), theirs.min(b));
            if ours <= theirs {
                break;
            }
        }
        let ratio = ours / theirs;
        println!("order {order}: {ratio:.2} of sphericart's time");
        assert!(ratio <= 1.0, "order {order}: {ratio:.2} of sphericart's time");
    }
}
