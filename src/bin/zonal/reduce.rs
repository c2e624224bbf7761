//! `zonal reduce`.

use std::path::PathBuf;

use zonal::measure::reduce_run;

use crate::common::Report;
use crate::measure::report;

#[derive(clap::Args)]
pub struct Args {
    /// Run folder.
    run: PathBuf,
    /// Scale the channels by this calibration instead of the run's own.
    #[arg(long)]
    calibration: Option<PathBuf>,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let (_, record) = reduce_run(&args.run, args.calibration.as_deref())?;
    Ok(report(&record, &args.run))
}
