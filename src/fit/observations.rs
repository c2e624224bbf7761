//! What a fit sees of a run: zonal coefficients in the frame of each exitant direction.

use crate::basis::{Harmonics, about_normal, about_normal_variance, index, lm, size};
use crate::geometry::{Direction, ExitantGrid};
use crate::reduce::Coefficients;

/// Zonal coefficients at stations of exitant directions, each turned about the normal until it lies at phi_o = 0.
///
/// A turn by phi_o mixes (l, m) and (l, -m) like a plane vector. For an isotropic sample all sectors of a ring then say
/// the same, and the sine terms nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct Observations {
    /// Exitant directions of the run.
    pub grid: ExitantGrid,
    /// Zonal order L.
    pub order: usize,
    /// Which functions are kept, ascending k: those with m >= 0, or all.
    pub terms: Vec<usize>,
    /// Exitant directions.
    pub stations: Vec<Station>,
    /// Whether rings were averaged on the assumption of isotropy.
    pub folded: bool,
    /// RMS over the data of (deviation from the ring's mean) / sigma: 1 for an isotropic sample, and of
    /// [`Observations::anisotropic`].
    pub isotropy_chi: f64,
    /// RMS deviation from the ring's mean beyond noise, over RMS z_00; 0 of [`Observations::anisotropic`].
    pub anisotropy: f64,
}

/// One exitant direction and its coefficients.
#[derive(Debug, Clone, PartialEq)]
pub struct Station {
    /// Its ring.
    pub ring: usize,
    /// Its azimuth, radians; 0 in folded observations.
    pub phi_o: f64,
    /// Values, 1/sqrt(sr): `[term][channel]`.
    pub z: Vec<[f64; 3]>,
    /// Standard errors, indexed alike.
    pub sigma: Vec<[f64; 3]>,
}

impl Station {
    /// The exitant direction.
    pub fn wo(&self, grid: &ExitantGrid) -> Direction {
        Direction::from_angles(grid.theta(self.ring), self.phi_o)
    }
}

/// Rings and sectors of anisotropic observations are thinned to about these many.
const ANISOTROPIC_RINGS: usize = 11;
const ANISOTROPIC_SECTORS: usize = 16;
/// Deviation from isotropy, over z_00 and beyond noise, from which on a sample counts as anisotropic. Mirror-like lobes,
/// narrower than a cell of the exitant grid, feign up to half as much.
pub const ANISOTROPIC: f64 = 0.04;

impl Observations {
    /// What a fit uses: [`Observations::folded`], or [`Observations::anisotropic`] where the sample is not isotropic.
    pub fn of(coefficients: &Coefficients) -> Self {
        let folded = Self::folded(coefficients);
        if folded.anisotropy > ANISOTROPIC {
            let Self { isotropy_chi, anisotropy, .. } = folded;
            return Self { isotropy_chi, anisotropy, ..Self::anisotropic(coefficients) };
        }
        folded
    }

    /// Averages each ring over its azimuths, by inverse variance, as if the sample were isotropic.
    pub fn folded(coefficients: &Coefficients) -> Self {
        let grid = coefficients.grid;
        let terms: Vec<usize> = measured(coefficients).filter(|&k| lm(k).1 >= 0).collect();
        let (mut excess, mut freedom, mut power) = (0.0, 0usize, 0.0);
        let mut stations = Vec::new();
        for ring in 0..grid.rings() {
            let mut station = Station { ring, phi_o: 0.0, z: Vec::new(), sigma: Vec::new() };
            for &k in &terms {
                let means = [0, 1, 2].map(|c| {
                    let parts = parts(coefficients, ring, k, c);
                    let (sum, weight, data) = parts.iter().fold((0.0, 0.0, 0usize), |(s, w, n), p| {
                        (s + p.factor * p.z / p.variance, w + p.factor * p.factor / p.variance, n + 1)
                    });
                    let mean = sum / weight;
                    for p in &parts {
                        let square = (p.z - mean * p.factor).powi(2);
                        excess += square / p.variance;
                        power += square - p.variance;
                    }
                    freedom += data.saturating_sub(1);
                    (mean, weight.sqrt().recip())
                });
                station.z.push(means.map(|m| m.0));
                station.sigma.push(means.map(|m| m.1));
            }
            // A ring without data says nothing.
            if !terms.is_empty() && station.z.iter().flatten().all(|z| z.is_finite()) {
                stations.push(station);
            }
        }
        let isotropy_chi = if freedom > 0 { (excess / freedom as f64).sqrt() } else { 1.0 };
        let mut all =
            Self { grid, order: coefficients.order, terms, stations, folded: true, isotropy_chi, anisotropy: 0.0 };
        all.anisotropy = (power / freedom.max(1) as f64).max(0.0).sqrt() / all.dc();
        all
    }

    /// A thinned selection of exitant directions, nothing assumed.
    pub fn anisotropic(coefficients: &Coefficients) -> Self {
        let grid = coefficients.grid;
        let terms: Vec<usize> = measured(coefficients).collect();
        let ring_step = grid.rings().div_ceil(ANISOTROPIC_RINGS);
        let sector_step = grid.sectors().div_ceil(ANISOTROPIC_SECTORS);
        let mut stations = Vec::new();
        for ring in (ring_step / 2..grid.rings()).step_by(ring_step) {
            for sector in (ring % sector_step..grid.sectors()).step_by(sector_step) {
                let cell = ring * grid.sectors() + sector;
                let phi_o = grid.phi(sector);
                // Turned back to phi_o = 0.
                let z = [0, 1, 2].map(|c| about_normal(&coefficients.spectrum(c, cell), -phi_o));
                let variance = [0, 1, 2].map(|c| {
                    let of: Vec<f64> = coefficients.spectrum_sigma(c, cell).iter().map(|s| s * s).collect();
                    about_normal_variance(&of, -phi_o)
                });
                let z: Vec<[f64; 3]> = terms.iter().map(|&k| [0, 1, 2].map(|c| z[c][k])).collect();
                let sigma = terms.iter().map(|&k| [0, 1, 2].map(|c| variance[c][k].sqrt())).collect();
                if !terms.is_empty() && z.iter().flatten().all(|z| z.is_finite()) {
                    stations.push(Station { ring, phi_o, z, sigma });
                }
            }
        }
        Self { grid, order: coefficients.order, terms, stations, folded: false, isotropy_chi: 1.0, anisotropy: 0.0 }
    }

    /// Number of data in one channel.
    pub fn len(&self) -> usize {
        self.stations.len() * self.terms.len()
    }

    /// Whether no exitant direction has data.
    pub fn is_empty(&self) -> bool {
        self.stations.is_empty()
    }

    /// RMS of z_00 over stations and channels.
    pub fn dc(&self) -> f64 {
        let sum: f64 = self.stations.iter().flat_map(|s| s.z[0]).map(|z| z * z).sum();
        (sum / (3 * self.stations.len()).max(1) as f64).sqrt()
    }
}

impl Observations {
    /// RMS standard error over RMS z_00.
    pub fn noise_rel(&self) -> f64 {
        let sum: f64 = self.stations.iter().flat_map(|s| s.sigma.iter().flatten()).map(|sigma| sigma * sigma).sum();
        (sum / (3 * self.len()).max(1) as f64).sqrt() / self.dc()
    }

    /// RMS difference between the data and predictions (by channel, `station * terms + term`), over RMS z_00.
    pub fn misfit(&self, predictions: &[Vec<f64>; 3]) -> f64 {
        let all = self.stations.iter().flat_map(|s| &s.z).enumerate();
        let sum: f64 = all.map(|(i, z)| (0..3).map(|c| (z[c] - predictions[c][i]).powi(2)).sum::<f64>()).sum();
        (sum / (3 * self.len()).max(1) as f64).sqrt() / self.dc()
    }

    /// Light sent back to its source over light mirrored, both in the zonal reconstruction and away from the normal; None
    /// if nothing is mirrored or no such direction was measured.
    pub fn backscatter_share(&self) -> Option<f64> {
        let basis = Harmonics::zonal(self.grid.zone(), self.order).ok()?;
        let (mut back, mut mirrored) = (0.0, 0.0);
        for station in &self.stations {
            let theta_o = self.grid.theta(station.ring);
            if theta_o < APART {
                continue;
            }
            let toward = |phi: f64| {
                let functions = basis.eval(&Direction::from_angles(theta_o, phi));
                self.terms.iter().zip(&station.z).map(|(&k, z)| functions[k] * z.iter().sum::<f64>()).sum::<f64>()
            };
            back += toward(0.0);
            mirrored += toward(std::f64::consts::PI);
        }
        (mirrored > 0.0).then(|| back / mirrored)
    }
}

/// Functions that were shown at all: an adaptive run leaves some out.
fn measured(coefficients: &Coefficients) -> impl Iterator<Item = usize> {
    (0..size(coefficients.order)).filter(|&k| (0..3).any(|c| coefficients.plane(k, c).iter().any(|z| z.is_finite())))
}

/// Exitant angle, radians, from which on the way back and the mirror direction are told apart by low orders.
const APART: f64 = 0.5;

struct Part {
    /// cos or sin of m phi_o: the datum is this times the folded coefficient.
    factor: f64,
    z: f64,
    variance: f64,
}

/// All data of one ring that speak of (l, |m|).
fn parts(coefficients: &Coefficients, ring: usize, k: usize, channel: usize) -> Vec<Part> {
    let grid = coefficients.grid;
    let (l, m) = lm(k);
    let mut parts = Vec::with_capacity(2 * grid.sectors());
    for sector in 0..grid.sectors() {
        let cell = ring * grid.sectors() + sector;
        let (sin, cos) = (f64::from(m) * grid.phi(sector)).sin_cos();
        let mut push = |k: usize, factor: f64| {
            let at = (k * 3 + channel) * grid.len() + cell;
            let (z, sigma) = (f64::from(coefficients.values[at]), f64::from(coefficients.sigma[at]));
            if z.is_finite() && sigma > 0.0 && factor != 0.0 {
                parts.push(Part { factor, z, variance: sigma * sigma });
            }
        };
        push(k, cos);
        push(index(l, -m), sin);
    }
    parts
}
