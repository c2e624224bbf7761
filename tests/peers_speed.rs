//! Many directions at once are no slower than sphericart in the same run: `bash tests/run.sh`, which sets ZONAL_PYTHON.
#![cfg(feature = "peers")]

mod speed;

/// One core, the same layout, arrays that exist and are touched before.
#[test]
fn batches_are_no_slower_than_sphericart() {
    let mut peer = speed::Peer::start();
    for order in speed::ORDERS {
        let ([ours, theirs], _) = speed::against(&mut peer, order);
        let ratio = ours / theirs;
        println!("order {order}: {ratio:.2} of sphericart's time");
        assert!(ratio <= 1.0, "order {order}: {ratio:.2} of sphericart's time");
    }
}
