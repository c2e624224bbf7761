//! What a page shows of a run: computed here, drawn elsewhere.

use rayon::prelude::*;

use super::{AccuracyPoint, MethodRow, Picture, ReportError, Slice, SpectrumPoint};
use crate::basis::{Conversion, ConversionError, Method};
use crate::export::ShMaterial;
use crate::fit::{Fineness, Forward, Observations};
use crate::geometry::Direction;
use crate::optics::Rig;
use crate::patterns::{Plan, Timing};
use crate::reduce::Coefficients;
use crate::reflectance::{Brdf, ZoneErrors};
use crate::render::{Image, Probe, Shape};

/// Polar angles of the camera of [`slices`], degrees.
const SLICES_DEG: [f64; 3] = [15.0, 35.0, 55.0];
/// Side of a rendered shape in pixels.
const SIZE: usize = 220;

/// The run, cut to `order`, in spherical harmonics.
///
/// # Errors
/// [`ConversionError`].
pub fn converted(measured: &Coefficients, method: Method, order: usize) -> Result<ShMaterial, ConversionError> {
    let coefficients = measured.truncated(order);
    Ok(ShMaterial::new(&coefficients, &Conversion::new(method, coefficients.grid.zone(), order)?))
}

/// Size and noise of every coefficient that a fit uses, beside what `model` predicts for it: RMS over exitant directions
/// and channels, in the frame of each exitant direction ([`Observations::of`]). Of an isotropic sample, rings are averaged
/// over azimuth and coefficients of m < 0, which are zero there, are left out.
///
/// # Errors
/// [`ReportError::Order`].
pub fn spectrum(coefficients: &Coefficients, model: &dyn Brdf) -> Result<Vec<SpectrumPoint>, ReportError> {
    let observations = Observations::of(coefficients);
    let predictions = Forward::new(&observations, Fineness::default())?.predict(model);
    let (terms, stations) = (&observations.terms, &observations.stations);
    let rms = |squares: &mut dyn Iterator<Item = f64>| (squares.sum::<f64>() / (3 * stations.len()) as f64).sqrt();
    let square = |v: &f64| v * v;
    let point = |(term, &k): (usize, &usize)| SpectrumPoint {
        k,
        rms: rms(&mut stations.iter().flat_map(|s| s.z[term].iter().map(square))),
        noise: rms(&mut stations.iter().flat_map(|s| s.sigma[term].iter().map(square))),
        predicted: rms(&mut predictions.iter().flat_map(|p| p.iter().skip(term).step_by(terms.len()).map(square))),
    };
    Ok(terms.iter().enumerate().map(point).collect())
}

/// Slices of f_cos, mean of the channels, in the plane of incidence: the truth, the parity reconstruction of the run, and
/// `models` by name.
///
/// # Errors
/// [`ConversionError`].
pub fn slices(
    coefficients: &Coefficients,
    truth: Option<&dyn Brdf>,
    models: &[(String, &dyn Brdf)],
) -> Result<Vec<Slice>, ConversionError> {
    let zone = coefficients.grid.zone();
    let parity = converted(coefficients, Method::Parity, coefficients.order)?;
    let reconstruction = (Method::Parity.name().to_owned(), &parity as &dyn Brdf);
    let slice = |theta_o_deg: f64| Slice {
        theta_o_deg,
        truth: truth.map(|truth| curve(truth, theta_o_deg)),
        methods: std::iter::once(&reconstruction)
            .chain(models)
            .map(|(name, brdf)| (name.clone(), curve(*brdf, theta_o_deg)))
            .collect(),
        zone_deg: [zone.theta_min(), zone.theta_max()].map(f64::to_degrees),
    };
    Ok(SLICES_DEG.map(slice).into())
}

/// Positive theta_i lies on the mirror side of wo.
fn curve(brdf: &dyn Brdf, theta_o_deg: f64) -> Vec<(f64, f64)> {
    let f_cos_of = brdf.towards(&Direction::from_angles(theta_o_deg.to_radians(), 0.0));
    let at = |theta_i: f64| {
        let phi = if theta_i > 0.0 { std::f64::consts::PI } else { 0.0 };
        f_cos_of(&Direction::from_angles(theta_i.abs().to_radians(), phi)).iter().sum::<f64>() / 3.0
    };
    (-179..=179).map(|i| f64::from(i) / 2.0).map(|theta_i| (theta_i, at(theta_i))).collect()
}

/// Pictures of `model` on some shapes, under one light and in the studio probe; the truth, where known, to its right.
pub fn pictures(shapes: &[Shape], what: &str, model: &dyn Brdf, truth: Option<&dyn Brdf>) -> Vec<Picture> {
    const LIGHTS: [&str; 2] = ["under a directional light", "in a studio light probe"];
    let probe = Probe::studio();
    let images = |shape: Shape, brdf: &dyn Brdf| [shape.in_key_light(brdf, SIZE), shape.in_probe(brdf, &probe, SIZE)];
    let percent = |x: Option<f64>| super::text::percent(x.unwrap_or(f64::NAN));
    let mut pictures = Vec::new();
    for &shape in shapes {
        let name = match shape {
            Shape::Sphere => "Sphere",
            Shape::Cylinder => "Cylinder",
        };
        let beside = truth.map(|truth| images(shape, truth));
        for (i, image) in images(shape, model).into_iter().enumerate() {
            let light = LIGHTS[i];
            pictures.push(match beside.as_ref().map(|beside| &beside[i]) {
                Some(truth) => Picture {
                    caption: format!(
                        "{name} {light}: {what} (left), truth (right); mean difference {}, RMS {}",
                        percent(image.relative_mean(truth)),
                        percent(image.relative_rms(truth))
                    ),
                    png: Image::side_by_side(&[image, truth.clone()]).to_png(1.0),
                },
                None => Picture { caption: format!("{name} {light}: {what}"), png: image.to_png(1.0) },
            });
        }
    }
    pictures
}

/// What each order up to the run's costs on `rig`, and how far its parity reconstruction is from the truth.
///
/// # Errors
/// [`ConversionError`].
pub fn accuracy(rig: &Rig, measured: &Coefficients, truth: &dyn Brdf) -> Result<Vec<AccuracyPoint>, ConversionError> {
    let point = |order: usize| {
        let errors = ZoneErrors::new(&converted(measured, Method::Parity, order)?, truth, rig.zone());
        let rig_s = Plan::of_order(order).rig_time(&Timing::of(rig)).total_s();
        Ok(AccuracyPoint { order, rig_s, error_in: errors.inside, error_out: errors.outside })
    };
    (0..=measured.order).into_par_iter().map(point).collect()
}

/// All methods of conversion, and how far each is from the truth.
///
/// # Errors
/// [`ConversionError`]; that noise forbids a method is none, its row says so.
pub fn conversions(measured: &Coefficients, truth: &dyn Brdf) -> Result<Vec<MethodRow>, ConversionError> {
    let zone = measured.grid.zone();
    let row = |method: Method| {
        let conversion = Conversion::new(method, zone, measured.order)?;
        let errors = ZoneErrors::new(&ShMaterial::new(measured, &conversion), truth, zone);
        Ok(MethodRow {
            method: method.name().into(),
            order: measured.order,
            condition: conversion.condition,
            noise_gain_in: conversion.noise_gain_in,
            noise_gain_out: conversion.noise_gain_out,
            error_in: Some(errors.inside),
            error_out: Some(errors.outside),
            refused: conversion.check(measured.noise_rel()).err().map(|e| e.to_string()),
        })
    };
    Method::ALL.into_iter().map(row).collect()
}
