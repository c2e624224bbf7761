//! `zonal convert`.

use std::path::PathBuf;

use clap::ValueEnum;
use zonal::basis::{Conversion, Method};
use zonal::export::ShMaterial;

use crate::both_sides;
use crate::common::{self, Report};

#[derive(Clone, Copy, ValueEnum)]
enum MethodArg {
    /// The literal dual basis of the thesis; refused where its noise explodes.
    Thesis,
    /// The dual with the small eigenvalues cut.
    Truncated,
    /// Harmonics that vanish at the horizon, up to the next order.
    Parity,
}

impl From<MethodArg> for Method {
    fn from(arg: MethodArg) -> Self {
        match arg {
            MethodArg::Thesis => Method::Thesis,
            MethodArg::Truncated => Method::Truncated,
            MethodArg::Parity => Method::Parity,
        }
    }
}

#[derive(clap::Args)]
pub struct Args {
    /// Run folder.
    run: PathBuf,
    /// How values outside the zone are found.
    #[arg(long, default_value = "parity")]
    method: MethodArg,
    /// Zonal order to use, at most the run's.
    #[arg(long, allow_negative_numbers = true)]
    order: Option<usize>,
    /// OpenEXR file to write.
    #[arg(long)]
    out: PathBuf,
    /// Convert even where noise exceeds the signal.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    both: both_sides::Args,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let out = common::writable(&args.out)?;
    let coefficients = common::coefficients(&args.run, args.order)?;
    let order = coefficients.order;
    if args.both.both_sides {
        return both_sides::run(&args.both, &coefficients, args.method.into(), args.force, &out);
    }
    let conversion = Conversion::new(args.method.into(), coefficients.grid.zone(), order)?;
    if !args.force {
        conversion.check(coefficients.noise_rel())?;
    }
    ShMaterial::new(&coefficients, &conversion).write(&out)?;
    let text = format!(
        "{} at order {order}: condition {:.2e}, noise gain {:.3} in and {:.3} out of the zone; {}",
        conversion.method.name(),
        conversion.condition,
        conversion.noise_gain_in,
        conversion.noise_gain_out,
        out.display()
    );
    let json = serde_json::json!({
        "method": conversion.method.name(),
        "order": order,
        "sh_order": conversion.sh_order,
        "condition": conversion.condition,
        "noise_gain_in": conversion.noise_gain_in,
        "noise_gain_out": conversion.noise_gain_out,
        "noise_rel": coefficients.noise_rel(),
        "out": common::said(&out),
    });
    Ok(Report { text, json })
}
