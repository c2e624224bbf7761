//! RGL `.bsdf` files: adaptive tables of measured materials (Dupuy & Jakob 2018).

mod warp;

#[cfg(test)]
mod tests;

use std::f64::consts::{FRAC_1_PI, PI, TAU};
use std::path::Path;

use nalgebra::Vector3;

use super::error::read_file;
use super::{Brdf, ReadError, TensorFile};
use crate::geometry::{Direction, Sample};
pub(crate) use warp::{Flattening, Table, Taps};

/// Below this cosine of the light's angle (89.994 deg) f is divided by it instead of by the cosine, so that f stays
/// finite at the horizon.
const MIN_COS: f64 = 1e-4;

/// A material in the parameterisation of Dupuy & Jakob, "An adaptive parameterization for efficient material
/// acquisition and rendering", ACM TOG 37(6), 2018: the RGB variant of the files at <https://rgl.epfl.ch/materials>.
///
/// Evaluates what the `measured` plugin of Mitsuba 3 does, with the arguments and the cosine translated: the table is
/// indexed by the *camera* (Mitsuba's `si.wi`), holds f cos(theta) of the *light* (Mitsuba's `wo`), and [`Brdf::eval`]
/// takes that cosine out. Negative values, which real files hold, become 0. Not exactly reciprocal.
#[derive(Debug, Clone)]
pub struct Rgl {
    description: String,
    symmetry: Symmetry,
    has_jacobian: bool,
    phi: Vec<f64>,
    theta: Vec<f64>,
    ndf: Table<1>,
    sigma: Table<1>,
    vndf: Flattening,
    rgb: Table<3>,
}

/// What the azimuths of the camera in the file cover.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Symmetry {
    /// Any rotation about the normal.
    Isotropic,
    /// None: all azimuths are in the file.
    Full,
    /// Half a turn: azimuths -pi..=0 are in the file.
    HalfTurn,
    /// Both axes: azimuths -pi..=-pi/2 are in the file.
    BothAxes,
}

impl Rgl {
    /// Reads a file.
    ///
    /// # Errors
    /// As [`Rgl::parse`], and [`ReadError::Io`].
    pub fn read(path: impl AsRef<Path>) -> Result<Self, ReadError> {
        let (bytes, file) = read_file(path.as_ref())?;
        Self::parse(&bytes, &file)
    }

    /// Reads the bytes of a file; `file` is the name errors use.
    ///
    /// # Errors
    /// [`ReadError::Invalid`] where the file contradicts the format, [`ReadError::NotSupported`] for spectral files and
    /// unknown symmetries.
    pub fn parse(bytes: &[u8], file: &str) -> Result<Self, ReadError> {
        let tensors = TensorFile::parse(bytes, file)?;
        if !tensors.has("rgb") && tensors.has("spectra") {
            return Err(ReadError::NotSupported {
                file: file.into(),
                found: "the spectral variant of a material".into(),
                remedy: "use the file of the same material whose name ends in _rgb.bsdf",
            });
        }
        let read = Fields { tensors: &tensors, file };
        let (phi, theta) = (read.angles("phi_i")?, read.angles("theta_i")?);
        let slices = phi.len() * theta.len();
        let symmetry = symmetry(&phi, file)?;

        let (ndf_shape, ndf) = read.not_negative("ndf", 2)?;
        let (sigma_shape, sigma) = read.not_negative("sigma", 2)?;
        let (vndf_shape, vndf) = read.not_negative("vndf", 4)?;
        let (rgb_shape, rgb) = tensors.f32("rgb", 5)?;
        read.shape("vndf", vndf_shape, &[phi.len(), theta.len()])?;
        read.shape("rgb", rgb_shape, &[phi.len(), theta.len(), 3])?;

        let (rgb_height, rgb_width) = read.extent("rgb", rgb_shape)?;
        let pixels = rgb_height * rgb_width;
        let channel = |slice: usize, c: usize, k: usize| rgb[(slice * 3 + c) * pixels + k];
        let rgb = (0..slices)
            .flat_map(|s| (0..pixels).map(move |k| (s, k)))
            .map(|(s, k)| [channel(s, 0, k), channel(s, 1, k), channel(s, 2, k)])
            .collect();

        let (vndf_height, vndf_width) = read.extent("vndf", vndf_shape)?;
        let vndf = Flattening::new(vndf_width, vndf_height, &vndf).map_err(|slice| {
            ReadError::invalid(file, format!("field `vndf`, slice {slice}"), "a positive value", "zeros only")
        })?;
        let map = |name, shape: &[usize], values: Vec<f32>| {
            let (height, width) = read.extent(name, shape)?;
            Ok(Table::new(width, height, values.into_iter().map(|v| [v]).collect()))
        };
        Ok(Self {
            description: String::from_utf8_lossy(tensors.u8("description")?).into_owned(),
            symmetry,
            has_jacobian: tensors.u8("jacobian")?.first().is_some_and(|&flag| flag != 0),
            ndf: map("ndf", ndf_shape, ndf)?,
            sigma: map("sigma", sigma_shape, sigma)?,
            vndf,
            rgb: Table::new(rgb_width, rgb_height, rgb),
            phi,
            theta,
        })
    }

    /// The material's description in the file.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// f cos(theta) of the light, before clamping: what the table holds. `camera` and `light` are above the surface.
    fn f_cos(&self, camera: Vector3<f64>, light: Vector3<f64>) -> [f64; 3] {
        let (camera, light) = self.symmetry.reduced(camera, light);
        let m = (camera + light).normalize();
        let phi_camera = azimuth(&camera);
        let phi_m = if self.is_isotropic() { azimuth(&m) - phi_camera } else { azimuth(&m) };
        let theta_camera = elevation(&camera);

        let v = phi_m / TAU + 0.5;
        let (u, v) = (u_of_theta(elevation(&m)), v - v.floor());
        let taps = Taps::between(&self.phi, &self.theta, phi_camera, theta_camera);
        let (s, t) = self.vndf.flatten(&taps, u, v);
        let rgb = self.rgb.at(&taps, s, t);
        if !self.has_jacobian {
            return rgb;
        }
        let [ndf] = self.ndf.at(&Taps::SINGLE, u, v);
        let [sigma] = self.sigma.at(&Taps::SINGLE, u_of_theta(theta_camera), phi_camera / TAU + 0.5);
        let jacobian = if sigma > 0.0 { ndf / (4.0 * sigma) } else { 0.0 };
        rgb.map(|value| value * jacobian)
    }
}

impl Brdf for Rgl {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        if wi.cos_theta() <= 0.0 || wo.cos_theta() <= 0.0 {
            return [0.0; 3];
        }
        let cos_i = wi.cos_theta().max(MIN_COS);
        self.f_cos(wo.vector(), wi.vector()).map(|f_cos| f_cos.max(0.0) / cos_i)
    }

    fn is_isotropic(&self) -> bool {
        self.symmetry == Symmetry::Isotropic
    }
}

impl Symmetry {
    /// Both directions moved to where the file has data for the camera.
    fn reduced(self, camera: Vector3<f64>, light: Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let (x, y) = match self {
            Self::Isotropic | Self::Full => return (camera, light),
            Self::HalfTurn => (camera.y, camera.y),
            Self::BothAxes => (camera.x, camera.y),
        };
        let flip = Vector3::new(-1f64.copysign(x), -1f64.copysign(y), 1.0);
        (camera.component_mul(&flip), light.component_mul(&flip))
    }
}

/// The symmetry that the camera's azimuths stand for, as Mitsuba 3 infers it.
fn symmetry(phi: &[f64], file: &str) -> Result<Symmetry, ReadError> {
    if phi.len() <= 2 {
        return Ok(Symmetry::Isotropic);
    }
    let covered = phi[phi.len() - 1] - phi[0];
    match (TAU / covered).round() {
        1.0 => Ok(Symmetry::Full),
        2.0 => Ok(Symmetry::HalfTurn),
        4.0 => Ok(Symmetry::BothAxes),
        _ => Err(ReadError::NotSupported {
            file: file.into(),
            found: format!("a table over {:.1} deg of the camera's azimuth", covered.to_degrees()),
            remedy: "measure or export it over 90, 180 or 360 deg",
        }),
    }
}

/// Polar angle of a unit vector.
fn elevation(d: &Vector3<f64>) -> f64 {
    (d.x * d.x + d.y * d.y).sqrt().atan2(d.z)
}

/// Azimuth in -pi..=pi; 0 at the pole.
fn azimuth(d: &Vector3<f64>) -> f64 {
    if d.x == 0.0 && d.y == 0.0 { 0.0 } else { d.y.atan2(d.x) }
}

/// The square root spacing of polar angles: theta = u^2 pi / 2.
pub(crate) fn u_of_theta(theta: f64) -> f64 {
    (theta * 2.0 * FRAC_1_PI).sqrt()
}

/// The inverse of [`u_of_theta`].
pub(crate) fn theta_of_u(u: f64) -> f64 {
    0.5 * PI * u * u
}

/// Checks on the fields that go beyond the container's.
struct Fields<'a> {
    tensors: &'a TensorFile<'a>,
    file: &'a str,
}

impl Fields<'_> {
    /// A list of ascending angles, at least one, all within a turn.
    fn angles(&self, name: &str) -> Result<Vec<f64>, ReadError> {
        let (_, values) = self.tensors.f32(name, 1)?;
        let angles: Vec<f64> = values.into_iter().map(f64::from).collect();
        if angles.is_empty() || angles.windows(2).any(|p| p[0] >= p[1]) || angles.iter().any(|a| a.abs() > 2.0 * PI) {
            let expected = "angles in radians, at least one, in ascending order";
            return Err(ReadError::invalid(self.file, format!("field `{name}`"), expected, format!("{angles:?}")));
        }
        Ok(angles)
    }

    fn not_negative(&self, name: &str, dimensions: usize) -> Result<(&[usize], Vec<f32>), ReadError> {
        let (shape, values) = self.tensors.f32(name, dimensions)?;
        match values.iter().position(|&v| v < 0.0) {
            None => Ok((shape, values)),
            Some(i) => {
                Err(ReadError::invalid(self.file, format!("field `{name}`, value {i}"), "no negative value", values[i]))
            }
        }
    }

    /// The first dimensions must be these.
    fn shape(&self, name: &str, shape: &[usize], expected: &[usize]) -> Result<(), ReadError> {
        if shape.starts_with(expected) {
            return Ok(());
        }
        let expected = format!("a shape that starts with {expected:?} (phi_i, theta_i, channels)");
        Err(ReadError::invalid(self.file, format!("field `{name}`"), expected, format!("{shape:?}")))
    }

    /// Height and width of the slices: the last two dimensions.
    fn extent(&self, name: &str, shape: &[usize]) -> Result<(usize, usize), ReadError> {
        match shape {
            [.., height, width] if *height >= 2 && *width >= 2 => Ok((*height, *width)),
            _ => {
                let expected = "at least 2 x 2 values per slice";
                Err(ReadError::invalid(self.file, format!("field `{name}`"), expected, format!("{shape:?}")))
            }
        }
    }
}
