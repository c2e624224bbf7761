//! The command line: parses, calls, prints. Exit status 0 done, 1 failed, 2 wrong usage or bad input.

mod batch;
mod both_sides;
mod budget;
mod calibrate;
mod chart;
mod common;
mod compare;
mod convert;
mod demo;
mod design;
mod design_search;
mod devices;
mod export;
mod first_light;
mod fit;
mod materials;
mod measure;
mod merge;
mod patterns;
mod plan;
mod outlook;
mod prior;
mod reduce;
mod render;
mod report;

use std::io::{ErrorKind, Write};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(
    name = "zonal",
    version,
    about = "Measures how a flat sample reflects light, with zonal basis lobes in a mirrored dome",
    after_help = "Exit status: 0 done, 1 failed, 2 wrong usage or bad input."
)]
struct Cli {
    /// Print one JSON object on stdout; messages stay on stderr.
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// The whole pipeline on the simulated rig and a built-in material, ending in one HTML page.
    Demo(demo::Args),
    /// Built-in materials and where their numbers come from.
    Materials,
    /// What a rig will measure, what ends its zone and what its tolerances cost; drawings and profile files.
    Design(design::Args),
    /// Cameras and projectors there are, each with the lines for a devices file.
    Devices,
    /// What the devices of a file can and cannot do on a rig, tried out.
    FirstLight(first_light::Args),
    /// Frames and time of a plan on a rig; moves nothing.
    Plan(plan::Args),
    /// The projector frames of a plan.
    Patterns(patterns::Args),
    /// Measures what a measurement must know of the rig.
    Calibrate(calibrate::Args),
    /// Runs a plan and reduces it to zonal coefficients.
    Measure(measure::Args),
    /// Reduces a stored run again.
    Reduce(reduce::Args),
    /// How far a run's albedo may be off and why; of several runs of one sample, how remounts scatter.
    Budget(budget::Args),
    /// Remounts of one sample at several angles, merged into one run.
    Merge(merge::Args),
    /// Turns a run's zonal coefficients into spherical harmonics.
    Convert(convert::Args),
    /// Learns the table that `plan` forecasts errors by from published materials.
    Outlook(outlook::Args),
    /// Learns the table of `convert --method prior` from the published materials.
    Prior(prior::Args),
    /// Fits a reflection model to a run.
    Fit(fit::Args),
    /// How far a model is from the truth.
    Compare(compare::Args),
    /// Models fitted to a run, compared on one HTML page.
    Report(report::Args),
    /// What the methods can and cannot do, from built-in materials alone: a table, a picture and a page.
    Chart(chart::Args),
    /// A sphere or a cylinder of a material, a fit or a converted run.
    Render(render::Args),
    /// A material, a fit or a converted run as a file for other programs.
    Export(export::Args),
}

fn main() -> ExitCode {
    // A file-size limit is an error of the write, not the end of the program.
    let ignored = Arc::new(AtomicBool::new(false));
    if let Err(error) = signal_hook::flag::register(libc::SIGXFSZ, ignored) {
        eprintln!("warning: a file-size limit will end the program: {error}");
    }
    let cli = Cli::parse();
    let result = match cli.command {
        Command::Demo(args) => demo::run(&args),
        Command::Materials => materials::run(),
        Command::Design(args) => design::run(&args),
        Command::Devices => devices::run(),
        Command::FirstLight(args) => first_light::run(&args),
        Command::Plan(args) => plan::run(&args),
        Command::Patterns(args) => patterns::run(&args),
        Command::Calibrate(args) => calibrate::run(&args),
        Command::Measure(args) => measure::run(&args),
        Command::Reduce(args) => reduce::run(&args),
        Command::Budget(args) => budget::run(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Convert(args) => convert::run(&args),
        Command::Outlook(args) => outlook::run(&args),
        Command::Prior(args) => prior::run(&args),
        Command::Fit(args) => fit::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Report(args) => report::run(&args),
        Command::Chart(args) => chart::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Export(args) => export::run(&args),
    };
    match result {
        Ok(report) => {
            let said = if cli.json { report.json.to_string() } else { report.text };
            match writeln!(std::io::stdout(), "{said}") {
                // Who closed the pipe has read enough.
                Err(error) if error.kind() != ErrorKind::BrokenPipe => {
                    eprintln!("error: done, but cannot write to stdout: {error}; redirect it elsewhere");
                    ExitCode::from(2)
                }
                _ => ExitCode::SUCCESS,
            }
        }
        Err(error) => {
            if let (true, Some(found)) = (cli.json, common::found(&error)) {
                // Who closed the pipe reads the status.
                let _ = writeln!(std::io::stdout(), "{found}");
            }
            eprintln!("error: {}", common::message(&error));
            common::exit_code(&error)
        }
    }
}
