//! Spherical harmonics over incident and exitant directions, as a material and as OpenEXR.

use std::path::Path;

use nalgebra::DMatrix;

use crate::basis::{Conversion, HarmonicTensor, Harmonics, MAX_ORDER, Tensor, TensorError, index, size};
use crate::geometry::{Direction, Sample, Zone};
use crate::radiometry::ColourSpace;
use crate::reduce::CHANNEL_NAMES;
use crate::reflectance::{Brdf, Towards};
use crate::store::{Layers, Plane, StoreError};

/// f cos(theta_i) cos(theta_o) = sum over a, b of Y_ab Y_a(wi) Y_b(wo), real SH on both sides.
///
/// Exitant directions beyond the measured zone are extrapolated as incident ones are: by the method's functions.
#[derive(Debug, Clone)]
pub struct TensorMaterial {
    /// Measured zone, of both sides.
    pub zone: Zone,
    /// Name of the method the coefficients come from.
    pub method: String,
    /// Zonal orders measured: incident, exitant.
    pub zonal_orders: [usize; 2],
    /// Whether only equal m couple.
    pub isotropic: bool,
    /// Whether the tensor was made symmetric.
    pub reciprocal: bool,
    /// Coefficients and standard errors, linear RGB, no unit.
    pub channels: [HarmonicTensor; 3],
    /// What was measured, with what: see [`crate::reduce::Coefficients::history`].
    pub history: String,
    incident: Harmonics,
    exitant: Harmonics,
}

/// The attribute that tells these files from others, and its value.
const KIND: (&str, &str) = ("zonal_kind", "tensor");

const FUNCTIONS: &str = "real spherical harmonics, orthonormal over the sphere: Y_lm = N_l|m| P_l|m|(cos theta) times 1 for \
m = 0, sqrt(2) cos(m phi) for m > 0, sqrt(2) sin(|m| phi) for m < 0; N_lm^2 = (2l+1)/(4 pi) (l-m)!/(l+m)!; no Condon-Shortley \
phase; directions point away from the sample, theta from its normal +z, phi from its grain +x";

const ISOTROPIC: &str = "column = exitant degree l'; rows = incident (|m|, l), l = |m|..=zonal_sh_order for |m| = 0, 1, ...; the \
value couples (l, m) with (l', m) and (l, -m) with (l', -m), all others are 0; unused columns hold 0";

const FULL: &str = "row = incident function, column = exitant function, both k = l(l+1) + m";

impl TensorMaterial {
    /// Converts measured tensors, one for each channel, with one conversion for each side.
    ///
    /// # Errors
    /// [`TensorError::Orders`] if a conversion is of another zonal order.
    pub fn new(
        channels: &[Tensor; 3],
        incident: &Conversion,
        exitant: &Conversion,
        zone: Zone,
        history: String,
    ) -> Result<Self, TensorError> {
        let convert = |c: usize| channels[c].to_harmonics(incident, exitant);
        let sh = |order| Harmonics::spherical(order).map_err(TensorError::from);
        Ok(Self {
            zone,
            method: incident.method.name().into(),
            zonal_orders: [incident.order, exitant.order],
            isotropic: channels[0].isotropic,
            reciprocal: channels[0].is_symmetric(),
            channels: [convert(0)?, convert(1)?, convert(2)?],
            history,
            incident: sh(incident.sh_order)?,
            exitant: sh(exitant.sh_order)?,
        })
    }

    /// SH orders: incident, exitant.
    pub fn orders(&self) -> [usize; 2] {
        [self.incident.order(), self.exitant.order()]
    }

    /// Incident coefficients of f_cos towards `wo`, `[k][channel]`.
    fn at(&self, wo: &Direction<Sample>) -> Vec<[f64; 3]> {
        let y = self.exitant.eval(wo);
        let mut out = vec![[0.0; 3]; self.incident.len()];
        for (c, channel) in self.channels.iter().enumerate() {
            if !self.isotropic {
                let y = &channel.values[0] * nalgebra::DVector::from_column_slice(&y);
                out.iter_mut().zip(y.iter()).for_each(|(out, y)| out[c] = y / wo.cos_theta());
                continue;
            }
            for (m, block) in channel.values.iter().enumerate() {
                for (row, l) in (m..=self.incident.order()).enumerate() {
                    for m in [m as i32, -(m as i32)] {
                        let terms =
                            (0..block.ncols()).map(|j| block[(row, j)] * y[index(m.unsigned_abs() as usize + j, m)]);
                        out[index(l, m)][c] = terms.sum::<f64>() / wo.cos_theta();
                    }
                }
            }
        }
        out
    }

    fn expand(&self, wi: &Direction<Sample>, coefficients: &[[f64; 3]]) -> [f64; 3] {
        let mut y = [0.0; size(MAX_ORDER)];
        let y = &mut y[..self.incident.len()];
        self.incident.eval_direction_into(wi, y);
        let mut sum = [0.0; 3];
        for (y, coefficients) in y.iter().zip(coefficients) {
            sum.iter_mut().zip(coefficients).for_each(|(sum, c)| *sum += y * c);
        }
        sum
    }

    /// Writes planes `y.R|G|B` and `sigma.R|G|B`, the convention in the header. Isotropic tensors are stored by |m|.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn write(&self, path: &Path) -> Result<(), StoreError> {
        let (width, height) = shape(self.orders(), self.isotropic);
        let mut image = Layers::new(width, height);
        for (channel, name) in self.channels.iter().zip(CHANNEL_NAMES) {
            for (stem, blocks) in [("y", &channel.values), ("sigma", &channel.sigma)] {
                let mut plane = vec![0.0; width * height];
                self.visit(|at, block, entry| plane[at] = blocks[block][entry] as f32);
                image.plane(format!("{stem}.{name}"), Plane::Float(plane));
            }
        }
        image.attribute(KIND.0, KIND.1);
        image.attribute(
            "zonal_content",
            "SH coefficients Y_ab on both sides: f cos(theta_i) cos(theta_o) = sum over a, b of Y_ab Y_a(wi) Y_b(wo)",
        );
        image.attribute("zonal_units", "none (1/sr of f times sr of the functions), linear RGB");
        image.attribute("zonal_colour_space", ColourSpace::of_history(&self.history).label());
        image.attribute("zonal_convention", if self.isotropic { ISOTROPIC } else { FULL });
        image.attribute("zonal_functions", FUNCTIONS);
        image.attribute("zonal_history", self.history.as_str());
        image.attribute("zonal_method", self.method.as_str());
        for (name, value) in [
            ("zonal_isotropic", f64::from(u8::from(self.isotropic))),
            ("zonal_reciprocal", f64::from(u8::from(self.reciprocal))),
            ("zonal_order", self.zonal_orders[0] as f64),
            ("zonal_exitant_order", self.zonal_orders[1] as f64),
            ("zonal_sh_order", self.incident.order() as f64),
            ("zonal_exitant_sh_order", self.exitant.order() as f64),
            ("zonal_theta_min_deg", self.zone.theta_min().to_degrees()),
            ("zonal_theta_max_deg", self.zone.theta_max().to_degrees()),
        ] {
            image.attribute(name, value);
        }
        image.write(path)
    }

    /// Whether a file says of itself that it holds a tensor.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn is_in(path: &Path) -> Result<bool, StoreError> {
        Ok(Layers::read(path)?.text(KIND.0) == Some(KIND.1))
    }

    /// Reads what [`TensorMaterial::write`] wrote.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn read(path: &Path) -> Result<Self, StoreError> {
        let image = Layers::read(path)?;
        let missing = |what: &str| StoreError::invalid(path, format!("`{what}` is missing: convert the run again"));
        let number = |name: &str| image.number(name).ok_or_else(|| missing(name));
        if image.text(KIND.0) != Some(KIND.1) {
            return Err(StoreError::invalid(path, "it holds no tensor: convert the run with --both-sides"));
        }
        let zone = Zone::from_degrees(number("zonal_theta_min_deg")?, number("zonal_theta_max_deg")?)
            .map_err(|e| StoreError::invalid(path, e.to_string()))?;
        let sh = |name: &str| {
            Harmonics::spherical(number(name)? as usize).map_err(|e| StoreError::invalid(path, e.to_string()))
        };
        let (incident, exitant) = (sh("zonal_sh_order")?, sh("zonal_exitant_sh_order")?);
        let orders = [incident.order(), exitant.order()];
        let isotropic = number("zonal_isotropic")? != 0.0;
        if (image.width, image.height) != shape(orders, isotropic) {
            let reason = format!(
                "{} x {} entries are not those of its orders: convert the run again",
                image.width, image.height
            );
            return Err(StoreError::invalid(path, reason));
        }
        let [order, exitant_order] = orders;
        let empty = || -> Vec<DMatrix<f64>> {
            if isotropic {
                (0..=order.min(exitant_order)).map(|m| DMatrix::zeros(order - m + 1, exitant_order - m + 1)).collect()
            } else {
                vec![DMatrix::zeros(size(order), size(exitant_order))]
            }
        };
        let blank = || HarmonicTensor { order, exitant_order, values: empty(), sigma: empty() };
        let mut material = Self {
            zone,
            method: image.text("zonal_method").unwrap_or_default().into(),
            zonal_orders: [number("zonal_order")? as usize, number("zonal_exitant_order")? as usize],
            isotropic,
            reciprocal: number("zonal_reciprocal")? != 0.0,
            channels: [blank(), blank(), blank()],
            history: image.text("zonal_history").unwrap_or_default().into(),
            incident,
            exitant,
        };
        let mut channels = material.channels.clone();
        for (channel, name) in channels.iter_mut().zip(CHANNEL_NAMES) {
            for (stem, blocks) in [("y", &mut channel.values), ("sigma", &mut channel.sigma)] {
                let plane = format!("{stem}.{name}");
                let samples = image.get(&plane).ok_or_else(|| missing(&plane))?;
                material.visit(|at, block, entry| blocks[block][entry] = f64::from(samples[at]));
            }
        }
        material.channels = channels;
        Ok(material)
    }

    /// All stored entries: position in a plane, block, (row, column).
    fn visit(&self, mut each: impl FnMut(usize, usize, (usize, usize))) {
        let width = shape(self.orders(), self.isotropic).0;
        let mut top = 0;
        for (m, block) in self.channels[0].values.iter().enumerate() {
            let left = if self.isotropic { m } else { 0 };
            for row in 0..block.nrows() {
                (0..block.ncols()).for_each(|column| each((top + row) * width + left + column, m, (row, column)));
            }
            top += block.nrows();
        }
    }
}

/// Width and height of the planes for SH orders (incident, exitant).
fn shape([order, exitant_order]: [usize; 2], isotropic: bool) -> (usize, usize) {
    if isotropic {
        (exitant_order + 1, (0..=order.min(exitant_order)).map(|m| order - m + 1).sum())
    } else {
        (size(exitant_order), size(order))
    }
}

impl Brdf for TensorMaterial {
    /// f; may be negative.
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        if wi.cos_theta() <= 0.0 { [0.0; 3] } else { self.eval_cos(wi, wo).map(|f| f / wi.cos_theta()) }
    }

    fn eval_cos(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        self.towards(wo)(wi)
    }

    fn towards<'a>(&'a self, wo: &Direction<Sample>) -> Towards<'a> {
        if wo.cos_theta() <= 0.0 {
            return Box::new(|_| [0.0; 3]);
        }
        let coefficients = self.at(wo);
        Box::new(move |wi| if wi.cos_theta() > 0.0 { self.expand(wi, &coefficients) } else { [0.0; 3] })
    }

    fn is_isotropic(&self) -> bool {
        self.isotropic
    }
}
