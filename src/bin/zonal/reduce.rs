//! `zonal reduce`.

use std::path::PathBuf;

use zonal::measure::reduce_run;

use crate::common::{Colours, Report};
use crate::measure::report;

#[derive(clap::Args)]
pub struct Args {
    /// Run folder.
    run: PathBuf,
    /// Scale the channels by this calibration instead of the run's own.
    #[arg(long)]
    calibration: Option<PathBuf>,
    /// Colours of the coefficients instead of the plan's.
    #[arg(long, value_enum)]
    colour: Option<Colours>,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let (_, record) = reduce_run(&args.run, args.calibration.as_deref(), args.colour.map(Colours::space))?;
    Ok(report(&record, &args.run))
}
