//! The same seed gives the same bits, on any number of threads, and from the stored run again.

mod common;

use zonal::capture::RunFolder;
use zonal::measure::reduce_run;
use zonal::patterns::Plan;
use zonal::reflectance::open;
use zonal::twin::{TwinBench, TwinConfig};

#[test]
fn coefficients_do_not_depend_on_threads_and_can_be_reduced_again() {
    let rig = common::rig("ghosh-2007-built");
    let config = TwinConfig::pinhole(7);
    let calibration = common::calibrated(&rig, &config);
    let plan = Plan::of_order(1);
    let dir = tempfile::tempdir().unwrap();
    let measure_on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let path = dir.path().join(format!("run-{threads}"));
        let measured = pool.install(|| {
            let mut bench = TwinBench::new(&rig, config.clone(), open("ggx-0.2").unwrap());
            let folder = RunFolder::create(&path, false).unwrap();
            common::measured(&rig, &plan, &mut bench, &calibration, Some(&folder)).unwrap()
        });
        (path, measured)
    };
    let (path, one) = measure_on(1);
    let (_, three) = measure_on(3);
    let bits = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&one.coefficients.values), bits(&three.coefficients.values));
    assert_eq!(bits(&one.coefficients.sigma), bits(&three.coefficients.sigma));

    let (again, record) = reduce_run(&path, None, None).unwrap();
    assert_eq!(bits(&again.values), bits(&one.coefficients.values));
    assert_eq!(record.noise_rel, one.record.noise_rel);
    let journal = std::fs::read_to_string(path.join("journal.jsonl")).unwrap();
    assert_eq!(journal.lines().filter(|line| line.contains(r#""event":"frame""#)).count(), plan.frames());
    assert!(!path.join("pending").exists());
}
