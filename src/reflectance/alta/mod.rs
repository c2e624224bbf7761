//! ALTA text files: measured reflectance at scattered directions (Belcour, Barla, Pacanowski 2014).

mod scattered;

#[cfg(test)]
mod tests;

use std::f64::consts::FRAC_PI_2;
use std::path::Path;

use nalgebra::Vector3;

use super::error::read_file;
use super::{Brdf, ReadError};
use crate::geometry::{Direction, Sample};
use scattered::{NEIGHBOURS, Point, Scattered};

/// Below this cosine of the camera's angle (89.994 deg) values are divided by it instead of by the cosine.
const MIN_COS: f64 = 1e-4;
/// Incidences closer than this, radians, are one.
const SAME_INCIDENCE: f64 = 1e-6;

/// An isotropic material measured at a few incidences, each over scattered view directions; one channel, taken as gray.
///
/// Reads the parametrisation `ISOTROPIC_TL_TV_PROJ_DPHI` of ALTA (Belcour, Barla, Pacanowski, "ALTA: A BRDF analysis
/// library", 2014): theta_l of the light, then theta_v cos(dphi) and theta_v sin(dphi) of the camera, dphi = phi_v -
/// phi_l, radians; wi = wo lies at (theta_l, theta_l, 0). Values are f (`INV_STERADIAN`) or f cos(theta_v), the cosine of
/// the *camera* (`INV_STERADIAN_COSINE_FACTOR`); [`Brdf::eval`] takes it out.
///
/// f cos(theta_o) is interpolated. Within an incidence it is a mean of the eight nearest view directions,
/// the nearer the heavier. Between incidences it is linear in theta_i after the view direction was moved along the plane of
/// incidence by what theta_i differs: with the light on its side, with the mirror direction on the other, and by less
/// between the two. So backscatter stays at wi = wo and the gloss at the mirror direction, and neither is seen twice.
/// Before the first and beyond the last incidence the nearest is moved alike. Not reciprocal.
#[derive(Debug, Clone)]
pub struct Alta {
    /// In ascending order of theta_i, at least one.
    incidences: Vec<Incidence>,
}

#[derive(Debug, Clone)]
struct Incidence {
    theta_i: f64,
    /// f cos(theta_o), 1/sr, over theta_o (cos(dphi), sin(dphi)).
    f_cos_o: Scattered,
}

/// One line of data.
#[derive(Debug, Clone, Copy)]
struct Row {
    line: usize,
    theta_i: f64,
    point: Point,
}

impl Alta {
    /// Reads a file.
    ///
    /// # Errors
    /// As [`Alta::parse`], and [`ReadError::Io`].
    pub fn read(path: impl AsRef<Path>) -> Result<Self, ReadError> {
        let (bytes, file) = read_file(path.as_ref())?;
        Self::parse(&bytes, &file)
    }

    /// Reads the bytes of a file; `file` is the name errors use. Negative values, which noise makes, become 0.
    ///
    /// # Errors
    /// [`ReadError::Invalid`] with the number of the line that contradicts the format, [`ReadError::NotSupported`] for
    /// binary files, other parametrisations and more than one channel.
    pub fn parse(bytes: &[u8], file: &str) -> Result<Self, ReadError> {
        let text = String::from_utf8_lossy(bytes);
        let mut header = Header::default();
        let mut rows = Vec::new();
        for (line, content) in text.lines().enumerate().map(|(i, content)| (i + 1, content.trim())) {
            if let Some(entry) = content.strip_prefix('#') {
                header.read(entry, file, line)?;
            } else if !content.is_empty() {
                rows.push(header.complete(file, line)?.row(content, file, line)?);
            }
        }
        if rows.is_empty() {
            let at = format!("line {}", text.lines().count());
            return Err(ReadError::invalid(file, at, "lines of numbers", "the end"));
        }
        rows.sort_by(|a, b| a.theta_i.total_cmp(&b.theta_i));
        let mut incidences = Vec::new();
        for rows in rows.chunk_by(|a, b| b.theta_i - a.theta_i < SAME_INCIDENCE) {
            let (first, theta_i) = (rows.iter().map(|r| r.line).min().unwrap_or(0), rows[0].theta_i);
            if rows.len() <= NEIGHBOURS {
                let expected = format!("at least {} view directions for each theta_l", NEIGHBOURS + 1);
                let found = format!("{} for {:.3} deg", rows.len(), theta_i.to_degrees());
                return Err(ReadError::invalid(file, format!("line {first}"), expected, found));
            }
            incidences.push(Incidence { theta_i, f_cos_o: Scattered::new(rows.iter().map(|r| r.point).collect()) });
        }
        Ok(Self { incidences })
    }

    /// Incidences measured, radians, ascending.
    pub fn theta_i(&self) -> impl Iterator<Item = f64> {
        self.incidences.iter().map(|i| i.theta_i)
    }

    /// f cos(theta_o) for the light at (theta_i, 0) and the camera at `view`, a unit vector.
    fn f_cos_o(&self, theta_i: f64, view: &Vector3<f64>) -> f64 {
        let next = self.incidences.partition_point(|i| i.theta_i <= theta_i);
        let (Some(low), Some(high)) = (next.checked_sub(1), self.incidences.get(next)) else {
            return self.incidences[next.saturating_sub(1)].moved_to(theta_i, view);
        };
        let low = &self.incidences[low];
        let t = (theta_i - low.theta_i) / (high.theta_i - low.theta_i);
        (1.0 - t) * low.moved_to(theta_i, view) + if t > 0.0 { t * high.moved_to(theta_i, view) } else { 0.0 }
    }
}

impl Incidence {
    /// The value for another incidence: see [`Alta`].
    fn moved_to(&self, theta_i: f64, view: &Vector3<f64>) -> f64 {
        // Half of the way from the normal to a lobe moves as the lobe does, which keeps its shape.
        let inner = theta_i - 0.5 * theta_i.min(self.theta_i);
        let along = plane(view).0;
        let share = if along.abs() < inner { along / inner } else { 1f64.copysign(along) };
        let (sin, cos) = (share * (self.theta_i - theta_i)).sin_cos();
        let (x, y) = plane(&Vector3::new(cos * view.x + sin * view.z, view.y, cos * view.z - sin * view.x));
        self.f_cos_o.at(x, y)
    }
}

/// theta (cos(phi), sin(phi)) of a unit vector; those below the horizon are moved up to it.
fn plane(v: &Vector3<f64>) -> (f64, f64) {
    let sin = v.x.hypot(v.y);
    let scale = if sin > 0.0 { sin.atan2(v.z).min(FRAC_PI_2) / sin } else { 1.0 };
    (scale * v.x, scale * v.y)
}

impl Brdf for Alta {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        if wi.cos_theta() <= 0.0 || wo.cos_theta() <= 0.0 {
            return [0.0; 3];
        }
        let view = wo.rotated_about_normal(-wi.phi()).vector();
        [self.f_cos_o(wi.theta(), &view) / wo.cos_theta().max(MIN_COS); 3]
    }

    fn is_isotropic(&self) -> bool {
        true
    }
}

/// What the lines that start with `#` say.
#[derive(Debug, Default)]
struct Header {
    dimensions: bool,
    input: bool,
    /// Whether values contain cos(theta_v).
    cosine: Option<bool>,
    /// Columns after the value: bounds of its confidence interval.
    bounds: usize,
}

impl Header {
    /// Takes in one line, without its `#`.
    fn read(&mut self, entry: &str, file: &str, line: usize) -> Result<(), ReadError> {
        let mut words = entry.split_whitespace();
        let key = words.next().unwrap_or_default();
        let value = words.collect::<Vec<_>>().join(" ");
        let refuse = |remedy| {
            let found = format!("line {line}: `#{key} {value}`");
            Err(ReadError::NotSupported { file: file.into(), found, remedy })
        };
        match (key, value.as_str()) {
            ("DIM", "3 1") => self.dimensions = true,
            ("DIM", _) => return refuse("export it with `#DIM 3 1`: one channel over three angles"),
            ("PARAM_IN", "ISOTROPIC_TL_TV_PROJ_DPHI") => self.input = true,
            ("PARAM_IN", _) => return refuse("convert it to ISOTROPIC_TL_TV_PROJ_DPHI with ALTA's data2data"),
            ("PARAM_OUT", "INV_STERADIAN") => self.cosine = Some(false),
            ("PARAM_OUT", "INV_STERADIAN_COSINE_FACTOR") => self.cosine = Some(true),
            ("PARAM_OUT", _) => return refuse("export it as INV_STERADIAN or INV_STERADIAN_COSINE_FACTOR"),
            ("VS", "0" | "1" | "2") => self.bounds = value.parse().unwrap_or(0),
            ("VS", _) => return refuse("0, 1 or 2 columns may follow the value"),
            ("FORMAT", "text") => {}
            ("FORMAT", _) => return refuse("save it as text with ALTA's data2data"),
            // Names, origins and other remarks.
            _ => {}
        }
        Ok(())
    }

    /// All that lines of numbers need.
    fn complete(&self, file: &str, line: usize) -> Result<Columns, ReadError> {
        let missing = |what: &str| {
            let expected = format!("`#{what}` before the first line of numbers");
            Err(ReadError::invalid(file, format!("line {line}"), expected, "numbers"))
        };
        match self {
            Self { dimensions: false, .. } => missing("DIM 3 1"),
            Self { input: false, .. } => missing("PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI"),
            Self { cosine: None, .. } => missing("PARAM_OUT INV_STERADIAN_COSINE_FACTOR"),
            Self { cosine: Some(cosine), bounds, .. } => Ok(Columns { cosine: *cosine, count: 4 + bounds }),
        }
    }
}

/// How lines of numbers are to be read.
struct Columns {
    cosine: bool,
    count: usize,
}

impl Columns {
    fn row(&self, content: &str, file: &str, line: usize) -> Result<Row, ReadError> {
        // Damaged lines may be long.
        const SHOWN: usize = 60;
        let invalid = |expected: &str| {
            let found = format!("`{}`", content.chars().take(SHOWN).collect::<String>());
            ReadError::invalid(file, format!("line {line}"), expected, found)
        };
        let numbers: Option<Vec<f64>> = content
            .split_whitespace()
            .take(self.count + 1)
            .map(|word| word.parse().ok().filter(|v: &f64| v.is_finite()))
            .collect();
        let numbers = numbers
            .filter(|n| n.len() == self.count)
            .ok_or_else(|| invalid(&format!("{} finite numbers", self.count)))?;
        let [theta_i, x, y, value] = [numbers[0], numbers[1], numbers[2], numbers[3]];
        let theta_o = x.hypot(y);
        // Angles are rounded to the digits of the file.
        const ROUNDING: f64 = 1e-5;
        if !(0.0..=FRAC_PI_2 + ROUNDING).contains(&theta_i) || theta_o > FRAC_PI_2 + ROUNDING {
            return Err(invalid("theta_l in 0..=pi/2 and theta_v up to pi/2, radians"));
        }
        let value = value.max(0.0) * if self.cosine { 1.0 } else { theta_o.cos().max(0.0) };
        Ok(Row { line, theta_i, point: Point { x, y, value } })
    }
}
