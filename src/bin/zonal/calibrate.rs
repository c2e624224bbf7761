//! `zonal calibrate`.

use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context;
use clap::ValueEnum;
use serde_json::json;
use zonal::calibrate::{
    Acceptance, CameraFigures, DeviceAlignment, Devices, EmvaDescription, Folder, Header, Kind as Part, Known,
    NoiseFigures, Origin, Reference, ResponseMethod, RigMap, align, black_trap, camera_codes, colour, flat_field,
    gray_card, gray_card_plan, in_order, linearity, map, noise, response,
};
use zonal::capture::{Bench, Control, Placement, SensorMaps, check_devices};
use zonal::optics::Rig;
use zonal::patterns::{Exitant, Plan};
use zonal::radiometry::{LinearRange, Response};
use zonal::reduce::Coefficients;
use zonal::reflectance::Brdf;
use zonal::store::{self, StoreError};

use crate::common::{self, BadUsage, Report};

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Kind {
    /// The projector's response, black level and contrast.
    Response,
    /// Where camera and projector stand, from crosses on the optical axis.
    Align,
    /// Where devices and mirrors stand, from fringes in a mirror; needs `response`, uses `align` from the same folder.
    Map,
    /// The projector's light over its panel; uses `map`.
    FlatField,
    /// The scale of every channel; needs `response` and `flat-field` in the same folder, uses `map`.
    GrayCard,
    /// Stray light, which is then taken from the gray card and from measurements; needs response and flat-field. Comes
    /// before gray-card.
    BlackTrap,
    /// The camera's gain, dark noise, black level, saturation, linear range and hot pixels. Comes first.
    Noise,
    /// The camera's linear range alone.
    Linearity,
    /// The projector's primaries as the camera's channels see them.
    Colour,
    /// What the 8-bit codes of a camera that is not linear mean; then every frame is made linear. Comes before all others.
    CameraResponse,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Method {
    /// Debevec and Malik: smooth.
    Debevec,
    /// Robertson, Borman and Stevenson: maximum likelihood.
    Robertson,
}

#[derive(clap::Args)]
pub struct Args {
    /// What to calibrate.
    kind: Kind,
    /// Rig file.
    rig: PathBuf,
    /// Folder the calibration is written to; calibrations in it are used.
    #[arg(long)]
    out: PathBuf,
    /// Calibrate the simulated rig.
    #[arg(long)]
    simulate: bool,
    /// Calibrate with the real devices of this file.
    #[arg(long, value_name = "FILE", conflicts_with = "simulate")]
    devices: Option<PathBuf>,
    /// What is needed is in place: do not ask. For kinds that need one thing alone.
    #[arg(long, requires = "devices")]
    yes: bool,
    /// Simulated rig: pinhole or finite, as for `zonal measure`.
    #[arg(long, value_name = "NAME", default_value = "pinhole")]
    twin: String,
    /// Seed of the simulated noise.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
    /// What is out of place in the simulated rig: a JSON file with any of the keys of `perturbation` in run.json.
    #[arg(long, value_name = "FILE.json")]
    misalign: Option<PathBuf>,
    /// Plan whose order and directions black-trap is to serve; without it, the gray card's own.
    #[arg(long)]
    plan: Option<PathBuf>,
    /// What is in the gray card's place: a .csv or .json table of reflectance factors (theta_i_deg, theta_o_deg, factor), or
    /// a material as for `zonal measure --simulate`.
    #[arg(long, value_name = "FILE")]
    reference: Option<String>,
    /// Albedo of an ideal diffuser in the gray card's place (0.18); with --reference, a factor of its values.
    #[arg(long)]
    albedo: Option<f64>,
    /// Take noise from a data set for EMVA 1288 (its description file) instead of from the camera.
    #[arg(long, value_name = "FILE")]
    emva: Option<PathBuf>,
    /// How camera-response is found (debevec).
    #[arg(long, value_enum)]
    method: Option<Method>,
}

impl Kind {
    /// What has to be put in place, in this order.
    fn placements(self) -> &'static [Placement] {
        match self {
            Kind::Response | Kind::GrayCard | Kind::Linearity | Kind::Colour => &[Placement::GrayCard],
            Kind::Align => &[Placement::PrintedCross, Placement::Crosses],
            Kind::Map => &[Placement::Mirror],
            Kind::FlatField | Kind::CameraResponse => &[Placement::Screen],
            Kind::BlackTrap => &[Placement::BlackTrap],
            Kind::Noise => &[Placement::BlackTrap, Placement::GrayCard],
        }
    }
}

/// A calibration under way: the rig, its folder, and what is there already.
struct Job<'a> {
    args: &'a Args,
    /// As in its file.
    rig: Rig,
    /// With the camera's measured figures.
    measured: Rig,
    camera: Option<(Header, CameraFigures)>,
    sensor: Option<SensorMaps>,
    map: Option<(Header, RigMap)>,
    origin: Origin,
}

pub fn run(args: &Args) -> anyhow::Result<Report> {
    let rig = common::rig(&args.rig)?;
    common::makeable(&args.out)?;
    let misplaced = [
        ("--plan", args.plan.is_some() && args.kind != Kind::BlackTrap),
        ("--reference", args.reference.is_some() && args.kind != Kind::GrayCard),
        ("--albedo", args.albedo.is_some() && args.kind != Kind::GrayCard),
        ("--emva", args.emva.is_some() && args.kind != Kind::Noise),
        ("--method", args.method.is_some() && args.kind != Kind::CameraResponse),
    ];
    if let Some((option, _)) = misplaced.into_iter().find(|m| m.1) {
        let message = format!("{option} says nothing to this kind of calibration: leave it out");
        return Err(BadUsage(message).into());
    }
    if let Some(description) = &args.emva {
        let job = Job::new(args, rig, Devices::Real)?;
        return job.noise_on_disk(description);
    }
    if !args.simulate && args.devices.is_none() {
        return Err(common::no_devices());
    }
    if args.yes && args.kind.placements().len() > 1 {
        let message =
            "--yes: this kind needs one thing after the other in place; leave it out and answer at the terminal";
        return Err(BadUsage(message.into()).into());
    }
    if std::io::stderr().is_terminal() {
        let names: Vec<String> = args.kind.placements().iter().map(Placement::to_string).collect();
        eprintln!("this needs in place: {}", names.join(", then "));
    }
    let devices = if args.simulate { Devices::Simulated { seed: args.seed } } else { Devices::Real };
    let job = Job::new(args, rig, devices)?;
    let mut bench = job.bench()?;
    let bench = bench.as_mut();
    match args.kind {
        Kind::Response => job.response(bench),
        Kind::Align => job.align(bench),
        Kind::Map => job.map(bench),
        Kind::FlatField => job.flat_field(bench),
        Kind::GrayCard => job.gray_card(bench),
        Kind::BlackTrap => job.black_trap(bench),
        Kind::Noise => job.noise(bench),
        Kind::Linearity => job.linearity(bench),
        Kind::Colour => job.colour(bench),
        Kind::CameraResponse => job.camera_response(bench),
    }
}

impl<'a> Job<'a> {
    fn new(args: &'a Args, rig: Rig, devices: Devices) -> anyhow::Result<Self> {
        let origin = Origin { date: jiff::Timestamp::now(), devices };
        let accept = accepted(devices);
        let files = Folder { path: &args.out, rig: &rig, accept };
        let camera = files.if_there(Part::Camera, Folder::read_camera).transpose()?;
        let sensor = files.if_there(Part::CameraMaps, Folder::read_maps).transpose()?.map(|(_, sensor)| sensor);
        let map = files.if_there(Part::Map, Folder::read_map).transpose()?;
        let measured = camera.as_ref().map_or_else(|| rig.clone(), |(_, camera)| camera.of_rig(&rig));
        Ok(Self { args, rig, measured, camera, sensor, map, origin })
    }

    fn bench(&self) -> anyhow::Result<Box<dyn Bench>> {
        if let Some(path) = &self.args.devices {
            let bench = common::devices(&common::devices_file(path)?, &self.rig, self.args.yes, &Control::default())?;
            check_devices(&self.rig, &bench, &[])?;
            return Ok(Box::new(bench));
        }
        let twin = common::twin(&self.args.twin, self.args.seed, self.args.misalign.as_deref())?;
        let config = common::for_calibration(&twin);
        let bench = common::bench(&self.rig, &config, zonal::reflectance::open("gray-card")?);
        let card = reference(self.args)?.brdf() as Arc<dyn Brdf>;
        Ok(Box::new(if self.args.kind == Kind::GrayCard { bench.with_card(card) } else { bench }))
    }

    fn files(&self) -> Folder<'_> {
        Folder { path: &self.args.out, rig: &self.rig, accept: accepted(self.origin.devices) }
    }

    /// Adds files to the folder, or makes the folder with them.
    fn write(&self, files: impl FnOnce(&Folder<'_>) -> Result<(), StoreError>) -> Result<(), StoreError> {
        let fill = |path: &Path| files(&Folder { path, ..self.files() });
        if self.args.out.is_dir() { fill(&self.args.out) } else { store::write_dir(&self.args.out, fill) }
    }

    fn header(&self, part: Part) -> Header {
        Header::new(part, &self.rig, Some(&self.origin))
    }

    /// What it says, with the file it left.
    fn report(&self, text: &str, part: Part, mut json: serde_json::Value) -> Report {
        json["file"] = common::said(&self.args.out.join(part.file())).into();
        Report { text: format!("{text}; {} in {}", part.file(), self.args.out.display()), json }
    }

    fn response(&self, bench: &mut dyn Bench) -> anyhow::Result<Report> {
        let (response, channels) = response(&self.measured, bench)?;
        self.write(|f| f.write_response(&self.header(Part::Response), &response, Some(&channels)))?;
        let [red, green, blue] = channels.each_ref().map(Response::contrast);
        let contrast = response.contrast();
        let text = format!("contrast {contrast:.1}:1 (red {red:.1}, green {green:.1}, blue {blue:.1})");
        let json = json!({ "kind": "response", "contrast": contrast, "channel_contrast": [red, green, blue] });
        Ok(self.report(&text, Part::Response, json))
    }

    fn align(&self, bench: &mut dyn Bench) -> anyhow::Result<Report> {
        let found = align(&self.measured, bench)?;
        self.write(|f| f.write_align(&self.header(Part::Align), &found))?;
        let told = |name: &str, d: &DeviceAlignment| {
            let ([x, y], [ex, ey], [a, b], [ea, eb]) =
                (d.displacement_mm, d.displacement_error_mm, d.turn_deg, d.turn_error_deg);
            format!(
                "{name}: x {x:+.3} +- {ex:.3} mm, y {y:+.3} +- {ey:.3} mm; turned {a:+.3} +- {ea:.3} deg about x, \
                 {b:+.3} +- {eb:.3} deg about y\n  {}\n",
                d.instruction(name)
            )
        };
        let text = format!(
            "{}{}x and y as the device sees them, through the beam splitter",
            told("camera", &found.camera),
            told("projector", &found.projector)
        );
        let instructions = [found.camera.instruction("camera"), found.projector.instruction("projector")];
        let json = json!({ "kind": "align", "alignment": found, "instructions": instructions });
        Ok(self.report(&text, Part::Align, json))
    }

    fn map(&self, bench: &mut dyn Bench) -> anyhow::Result<Report> {
        let needs = "the map needs `zonal calibrate response` in the same --out first";
        let (_, (response, _)) = self.files().read_response().context(needs)?;
        let known = self.files().if_there(Part::Align, Folder::read_align).transpose()?.map(|(_, known)| known);
        let found = map(&self.measured, bench, &response, known.as_ref())?;
        found.check_zone(&self.rig)?;
        self.write(|f| f.write_map(&self.header(Part::Map), &found))?;
        let text = format!(
            "{} + {} pairs, residuals {:.3} and {:.3} px; directions to {:.3} deg (camera) and {:.3} deg (projector){}\n\
             usable zone {:.2} +- {:.2} to {:.2} +- {:.2} deg, fringes seen in {:.1}% of it",
            found.pairs[0],
            found.pairs[1],
            found.residual_px[0],
            found.residual_px[1],
            found.direction_error_deg[0],
            found.direction_error_deg[1],
            if known.is_some() { "" } else { "; `zonal calibrate align` first would tell more" },
            found.zone_deg[0],
            found.zone_error_deg[0],
            found.zone_deg[1],
            found.zone_error_deg[1],
            100.0 * found.seen_share
        );
        Ok(self.report(&text, Part::Map, json!({ "kind": "map", "map": found })))
    }

    fn flat_field(&self, bench: &mut dyn Bench) -> anyhow::Result<Report> {
        let flat = flat_field(&self.measured, bench, self.map.as_ref().map(|(_, map)| map))?;
        self.write(|f| f.write_flat_field(&self.header(Part::FlatField), &flat))?;
        let darkest = flat.values.iter().copied().fold(1.0f32, f32::min);
        let text = format!("darkest pixel {darkest:.3} of the brightest");
        Ok(self.report(&text, Part::FlatField, json!({ "kind": "flat-field", "darkest": darkest })))
    }

    fn gray_card(&self, bench: &mut dyn Bench) -> anyhow::Result<Report> {
        let trap = self.files().if_there(Part::BlackTrap, Folder::read_black_trap).transpose()?;
        let reference = reference(self.args)?;
        let mut plan = gray_card_plan(&self.rig);
        if let Some((_, trap)) = &trap {
            plan.exitant = Exitant { rings: trap.grid.rings(), sectors: trap.grid.sectors() };
        }
        let (scale, check) = self.zonal(trap.as_ref(), |known| {
            let mut bar = common::frames_bar("gray card");
            Ok(gray_card(&self.measured, bench, &plan, known, &reference, &mut bar)?)
        })?;
        self.write(|f| f.write_gray_card(&self.header(Part::GrayCard), &scale, &check))?;
        let stray = if trap.is_some() { ", stray light taken off" } else { "" };
        let text = format!(
            "{}: z_10 off by {:.3}% of z_00, z_20 by {:.3}% (largest {:.3}%){stray}",
            reference.name,
            100.0 * check.z_10_error,
            100.0 * check.z_20_error,
            100.0 * check.worst_error,
        );
        let json = json!({ "kind": "gray-card", "check": check, "reference": reference.name, "trap": trap.is_some() });
        Ok(self.report(&text, Part::GrayCard, json))
    }

    fn black_trap(&self, bench: &mut dyn Bench) -> anyhow::Result<Report> {
        let plan = match &self.args.plan {
            // Exposures are the gray card's: there is little light whatever the sample will need.
            Some(path) => {
                let plan = common::plan(path)?;
                Plan { exitant: plan.exitant, repeats: plan.repeats, ..Plan::of_order(plan.order) }
            }
            None => gray_card_plan(&self.rig),
        };
        let trap = self.zonal(None, |known| {
            let mut bar = common::frames_bar("black trap");
            Ok(black_trap(&self.measured, bench, &plan, known, &mut bar)?)
        })?;
        self.write(|f| f.write_black_trap(&self.header(Part::BlackTrap), &trap))?;
        let mean = mean_constant(&trap);
        let text = format!("order {}: stray light {mean:.3e} e-/s in z_00", trap.order);
        let json = json!({ "kind": "black-trap", "order": trap.order, "z_00_e_s": mean });
        Ok(self.report(&text, Part::BlackTrap, json))
    }

    /// Runs what needs the projector's calibrations.
    fn zonal<T>(
        &self,
        trap: Option<&(Header, Coefficients)>,
        measure: impl FnOnce(Known<'_>) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        let needs = "this needs `zonal calibrate response` and `flat-field` in the same --out first";
        let (of_response, (response, _)) = self.files().read_response().context(needs)?;
        let (of_flat, flat) = self.files().read_flat_field().context(needs)?;
        let mut headers = BTreeMap::from([(Part::Response, of_response), (Part::FlatField, of_flat)]);
        headers.extend(self.camera.iter().map(|(header, _)| (Part::Camera, header.clone())));
        headers.extend(self.map.iter().map(|(header, _)| (Part::Map, header.clone())));
        headers.extend(trap.map(|(header, _)| (Part::BlackTrap, header.clone())));
        in_order(&self.args.out, &headers)?;
        let (trap, map) = (trap.map(|(_, trap)| trap), self.map.as_ref().map(|(_, map)| map));
        let sensor = self.sensor.as_ref();
        measure(Known { response: &response, flat: &flat, sensor, trap, map })
    }

    fn camera_response(&self, bench: &mut dyn Bench) -> anyhow::Result<Report> {
        let method = match self.args.method {
            Some(Method::Robertson) => ResponseMethod::Robertson,
            Some(Method::Debevec) | None => ResponseMethod::Debevec,
        };
        let codes = camera_codes(&self.rig, bench, method)?;
        // Figures of the camera as it was before are of other samples.
        let figures = CameraFigures { codes: Some(codes), ..CameraFigures::default() };
        self.write(|f| f.write_camera(&self.header(Part::Camera), &figures))?;
        let middle = figures.codes.as_ref().map_or(0.0, |codes| codes[128] / codes[255]);
        let text =
            format!("code 128 is {:.1}% of the light of code 255; next come noise and the others", 100.0 * middle);
        Ok(self.report(&text, Part::Camera, json!({ "kind": "camera-response", "figures": figures })))
    }

    /// The rig whose frames are made linear, if they must be, and nothing else.
    fn linear(&self) -> Rig {
        let codes = self.camera.as_ref().and_then(|(_, camera)| camera.codes.clone());
        CameraFigures { codes, ..CameraFigures::default() }.of_rig(&self.rig)
    }

    fn noise(&self, bench: &mut dyn Bench) -> anyhow::Result<Report> {
        let (mut figures, maps) = noise(&self.linear(), bench)?;
        figures.codes = self.camera.as_ref().and_then(|(_, camera)| camera.codes.clone());
        self.write(|f| {
            f.write_maps(&self.header(Part::CameraMaps), &maps)?;
            f.write_camera(&self.header(Part::Camera), &figures)
        })?;
        let bad = maps.bad.iter().filter(|&&bad| bad).count();
        Ok(self.of_figures("noise", &figures, Some(bad)))
    }

    /// Noise from a data set on disk.
    fn noise_on_disk(&self, description: &Path) -> anyhow::Result<Report> {
        let folder = description.parent().unwrap_or_else(|| Path::new("."));
        let name = || description.display().to_string();
        let read = EmvaDescription::read(description).with_context(name)?;
        let levels = read.levels(folder).with_context(name)?;
        let noise = NoiseFigures::of(&levels, None).with_context(name)?;
        let figures = CameraFigures { noise: Some(noise), ..CameraFigures::default() };
        self.write(|f| f.write_camera(&self.header(Part::Camera), &figures))?;
        Ok(self.of_figures("noise", &figures, None))
    }

    fn linearity(&self, bench: &mut dyn Bench) -> anyhow::Result<Report> {
        let range: LinearRange = linearity(&self.measured, bench)?;
        let mut header = self.header(Part::Camera);
        let mut figures = CameraFigures { linear_range: Some(range), ..CameraFigures::default() };
        if let Some((former, camera)) = &self.camera {
            // A file is as old as the oldest of what it holds.
            header.date = header.date.min(former.date.or(header.date));
            (figures.noise, figures.codes) = (camera.noise.clone(), camera.codes.clone());
        }
        self.write(|f| f.write_camera(&header, &figures))?;
        Ok(self.of_figures("linearity", &figures, None))
    }

    fn of_figures(&self, kind: &str, figures: &CameraFigures, bad: Option<usize>) -> Report {
        let mut said = Vec::new();
        if let Some(noise) = &figures.noise {
            let t = &noise.transfer;
            said.push(format!(
                "gain {:.4} DN/e-, dark noise {:.2} e-, black level {:.2} DN, saturation {:.0} DN, linear to {:.2}%",
                t.gain_dn_per_e,
                t.dark_noise_e,
                noise.black_level_dn,
                noise.saturation_dn,
                100.0 * t.linearity_error_rel
            ));
        }
        if let Some(range) = &figures.linear_range {
            let seen = if range.ends { "" } else { " or beyond, which no exposure reached" };
            said.push(format!("linear range ends at {:.0} DN{seen}", range.end_dn));
        }
        if let Some(bad) = bad {
            said.push(format!("{bad} pixels not used"));
        }
        let json = json!({ "kind": kind, "figures": figures, "bad_pixels": bad });
        self.report(&said.join("; "), Part::Camera, json)
    }

    fn colour(&self, bench: &mut dyn Bench) -> anyhow::Result<Report> {
        let colours = colour(&self.measured, bench)?;
        self.write(|f| f.write_colour(&self.header(Part::Colour), &colours))?;
        let own = (0..3).map(|c| colours.matrix[c][c]).fold(1.0, f64::min);
        let text = format!(
            "a channel gets {:.1}% or more from its own primary, condition {:.2}",
            100.0 * own,
            colours.condition
        );
        Ok(self.report(&text, Part::Colour, json!({ "kind": "colour", "colour": colours })))
    }
}

fn accepted(devices: Devices) -> Acceptance {
    Acceptance { simulated: Some(matches!(devices, Devices::Simulated { .. })), freshness: None }
}

fn reference(args: &Args) -> anyhow::Result<Reference> {
    if let Some(bad) = args.albedo.filter(|a| !(*a > 0.0 && *a <= 1.0)) {
        return Err(BadUsage(format!("--albedo {bad} is out of range: choose more than 0, at most 1")).into());
    }
    Ok(match (&args.reference, args.albedo) {
        (None, None) => Reference::default(),
        (None, Some(albedo)) => Reference::ideal(albedo),
        (Some(name), factor) => Reference::open(name, factor.unwrap_or(1.0))?,
    })
}

/// Mean z_00 over directions and channels.
fn mean_constant(trap: &Coefficients) -> f64 {
    let values = &trap.values[..3 * trap.grid.len()];
    values.iter().map(|&z| f64::from(z)).sum::<f64>() / values.len() as f64
}
