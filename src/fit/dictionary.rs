//! Lobes of many widths at once: non-negative combinations are found by one convex solve, without a start.

use super::family::{Family, ShapeParameter, geometric, ggx_columns};
use super::likelihood::Likelihood;
use super::search::{Minimum, Termination, polish};
use super::{Forward, Node};
use crate::reflectance::dbrdf::openness;
use crate::reflectance::ggx::gtr2;
use crate::reflectance::{
    Dbrdf, Density, DensityTerm, Ggx, GgxLobe, HalfLobe, Mixture, Model, gtr2_solid_angle_integral,
};

/// Predicted columns of lobes of fixed widths.
pub(super) struct Dictionary {
    alphas: Vec<[f64; 2]>,
    /// By width: weight of f0 and of f90.
    ggx: Vec<[Vec<f64>; 2]>,
    half: Vec<[Vec<f64>; 2]>,
}

/// Widths of isotropic dictionaries: ratios of 1.45, finer ones change no error by a percent.
const WIDTHS: usize = 15;
/// Widths along and across the grain of anisotropic ones.
const WIDTHS_EACH_WAY: usize = 7;
/// Sharpest and dullest lobe.
const RANGE: [f64; 2] = [0.006, 1.0];
/// Reflectances at normal incidence that D-BRDFs are tried with; the best is refined.
const R0: [f64; 10] = [0.003, 0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.35, 0.6, 0.95];

/// A density of half vectors of one width, with its divisor: the parts that weigh f0 and f90.
fn half_columns(alpha: [f64; 2], integral: f64, node: &Node) -> [f64; 2] {
    let lobe = gtr2(alpha, &node.h) / integral * openness(node.wi.z, node.wo.z);
    [lobe * (1.0 - node.schlick), lobe * node.schlick]
}

impl Dictionary {
    pub fn new(forward: &Forward, anisotropic: bool) -> Self {
        let alphas: Vec<[f64; 2]> = if anisotropic {
            let each = geometric(0.03, 0.9, WIDTHS_EACH_WAY);
            each.iter().flat_map(|&x| each.iter().map(move |&y| [x, y])).collect()
        } else {
            geometric(RANGE[0], RANGE[1], WIDTHS).into_iter().map(|a| [a, a]).collect()
        };
        let half = alphas
            .iter()
            .map(|&alpha| {
                let integral = gtr2_solid_angle_integral(alpha);
                forward.project(|node| half_columns(alpha, integral, node))
            })
            .collect();
        // A D-BRDF needs no others, and anisotropic integrals take their time.
        let ggx = if anisotropic {
            Vec::new()
        } else {
            alphas.iter().map(|&alpha| forward.project(|n| ggx_columns(alpha, n))).collect()
        };
        Self { alphas, ggx, half }
    }

    /// A D-BRDF: density and r0 from the mean of the channels, then r0 again and c with all of them.
    pub fn dbrdf(&self, likelihood: &Likelihood<'_>) -> (DbrdfFamily, Minimum) {
        let gray = likelihood.gray();
        let tried = R0.map(|r0| {
            let columns: Vec<Vec<f64>> =
                self.half.iter().map(|[p, s]| p.iter().zip(s).map(|(p, s)| r0 * p + s).collect()).collect();
            let solution = gray.dual(&columns, 0).non_negative();
            (r0, solution)
        });
        let (r0, best) = tried.iter().min_by(|a, b| a.1.chi2.total_cmp(&b.1.chi2)).expect("several");
        let total: f64 = best.x.iter().skip(1).sum();
        let terms = best.x.iter().skip(1).zip(&self.alphas).filter(|(x, _)| **x > 0.0);
        let mut terms: Vec<DensityTerm> = terms.map(|(x, &alpha)| DensityTerm { weight: x / total, alpha }).collect();
        if terms.is_empty() {
            terms.push(DensityTerm { weight: 1.0, alpha: *self.alphas.last().expect("several") });
        }
        let family = DbrdfFamily { p: Density::Mixture(terms) };
        let sum = |part: usize| {
            let mut sum = vec![0.0; likelihood.lambert.len()];
            for (x, half) in best.x.iter().skip(1).zip(&self.half).filter(|(x, _)| **x > 0.0) {
                sum.iter_mut().zip(&half[part]).for_each(|(s, a)| *s += x / total * a);
            }
            sum
        };
        let known = KnownDensity { family: &family, f0: sum(0), f90: sum(1) };
        let mut minimum =
            if total > 0.0 { polish(&known, likelihood, &[*r0]) } else { polish(&family, likelihood, &[*r0]) };
        minimum.evaluations += R0.len();
        (family, minimum)
    }

    /// Lobes of both kinds (of half vectors alone where widths differ across the grain): which ones from the mean of the channels, their weights by channel.
    pub fn mixture(&self, likelihood: &Likelihood<'_>) -> (MixtureFamily, Minimum) {
        let kinds = [(Kind::Ggx, self.ggx.len()), (Kind::Half, self.half.len())];
        let all: Vec<(Kind, usize)> = kinds.into_iter().flat_map(|(k, n)| (0..2 * n).map(move |i| (k, i))).collect();
        let columns: Vec<Vec<f64>> = all.iter().map(|&(kind, i)| self.column(kind, i).to_vec()).collect();
        let found = likelihood.gray().dual(&columns, 0).non_negative();
        let used = found.x.iter().skip(1).zip(&all).filter(|(x, _)| **x > 0.0).map(|(_, &u)| u);
        let terms: Vec<MixtureTerm> =
            used.map(|(kind, i)| MixtureTerm { kind, alpha: self.alphas[i / 2], grazing: i % 2 == 1 }).collect();
        let columns: Vec<Vec<f64>> =
            found.x.iter().skip(1).zip(columns).filter_map(|(x, column)| (*x > 0.0).then_some(column)).collect();
        let solution = likelihood.solve(&columns);
        let termination = Termination::Direct;
        let minimum = Minimum { theta: Vec::new(), columns, solution, evaluations: 1, termination };
        (MixtureFamily { terms }, minimum)
    }

    fn column(&self, kind: Kind, i: usize) -> &[f64] {
        match kind {
            Kind::Ggx => &self.ggx[i / 2][i % 2],
            Kind::Half => &self.half[i / 2][i % 2],
        }
    }
}

/// A D-BRDF of a given density; r0 is the one shape parameter.
pub(super) struct DbrdfFamily {
    pub p: Density,
}

impl Family for DbrdfFamily {
    fn shape(&self) -> Vec<ShapeParameter> {
        vec![ShapeParameter { name: "r0", range: [0.001, 1.0], origin: 0.0 }]
    }

    fn linear(&self) -> Vec<String> {
        vec!["kd".into(), "c".into()]
    }

    fn columns(&self, forward: &Forward, theta: &[f64]) -> Vec<Vec<f64>> {
        let p = self.p.prepared();
        let [column] = forward.project(|node| {
            [p(&node.h) * openness(node.wi.z, node.wo.z) * (theta[0] + (1.0 - theta[0]) * node.schlick)]
        });
        vec![column]
    }

    fn model(&self, theta: &[f64], x: &[[f64; 3]]) -> Model {
        Model::Dbrdf(Dbrdf { kd: x[0], c: x[1], r0: theta[0], p: self.p.clone() })
    }

    fn starts(&self) -> Vec<Vec<f64>> {
        R0.iter().map(|&r0| vec![r0]).collect()
    }
}

/// A D-BRDF whose two columns are known: F = r0 (1 - s) + s mixes them.
struct KnownDensity<'a> {
    family: &'a DbrdfFamily,
    f0: Vec<f64>,
    f90: Vec<f64>,
}

impl Family for KnownDensity<'_> {
    fn shape(&self) -> Vec<ShapeParameter> {
        self.family.shape()
    }

    fn linear(&self) -> Vec<String> {
        self.family.linear()
    }

    fn columns(&self, _forward: &Forward, theta: &[f64]) -> Vec<Vec<f64>> {
        vec![self.f0.iter().zip(&self.f90).map(|(p, s)| theta[0] * p + s).collect()]
    }

    fn model(&self, theta: &[f64], x: &[[f64; 3]]) -> Model {
        self.family.model(theta, x)
    }

    fn starts(&self) -> Vec<Vec<f64>> {
        self.family.starts()
    }
}

/// Which shape a term of a mixture has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Ggx,
    Half,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct MixtureTerm {
    kind: Kind,
    alpha: [f64; 2],
    grazing: bool,
}

/// A mixture of chosen lobes: all parameters are linear.
pub(super) struct MixtureFamily {
    terms: Vec<MixtureTerm>,
}

impl Family for MixtureFamily {
    fn shape(&self) -> Vec<ShapeParameter> {
        Vec::new()
    }

    fn linear(&self) -> Vec<String> {
        let name = |t: &MixtureTerm| {
            let kind = if t.kind == Kind::Ggx { "ggx" } else { "half" };
            let [along, across] = t.alpha.map(|alpha| format!("{alpha:.4}"));
            let width = if along == across { along } else { format!("{along}_{across}") };
            format!("{kind}_{width}_{}", if t.grazing { "f90" } else { "f0" })
        };
        std::iter::once("kd".into()).chain(self.terms.iter().map(name)).collect()
    }

    fn columns(&self, forward: &Forward, _theta: &[f64]) -> Vec<Vec<f64>> {
        let column = |t: &MixtureTerm| {
            let part = usize::from(t.grazing);
            let integral = gtr2_solid_angle_integral(t.alpha);
            let [column] = forward.project(|node| match t.kind {
                Kind::Ggx => [ggx_columns(t.alpha, node)[part]],
                Kind::Half => [half_columns(t.alpha, integral, node)[part]],
            });
            column
        };
        self.terms.iter().map(column).collect()
    }

    fn model(&self, _theta: &[f64], x: &[[f64; 3]]) -> Model {
        let mut mixture = Mixture { ggx: Ggx { kd: x[0], lobes: Vec::new() }, half: Vec::new() };
        for (t, &x) in self.terms.iter().zip(&x[1..]) {
            let black = [0.0; 3];
            let (f0, f90) = if t.grazing { (black, x) } else { (x, black) };
            // A width's two parts, next to each other, are one lobe.
            match t.kind {
                Kind::Ggx => match mixture.ggx.lobes.last_mut() {
                    Some(lobe) if lobe.alpha == t.alpha => lobe.f90 = f90,
                    _ => mixture.ggx.lobes.push(GgxLobe { alpha: t.alpha, f0, f90 }),
                },
                Kind::Half => match mixture.half.last_mut() {
                    Some(lobe) if lobe.alpha == t.alpha => lobe.f90 = f90,
                    _ => mixture.half.push(HalfLobe { alpha: t.alpha, f0, f90 }),
                },
            }
        }
        Model::Mixture(mixture)
    }

    fn starts(&self) -> Vec<Vec<f64>> {
        vec![Vec::new()]
    }
}

#[cfg(test)]
mod tests {
    use crate::basis::size;
    use crate::fit::{FitMethod, FitOptions, fit};
    use crate::geometry::{ExitantGrid, Zone};
    use crate::reduce::Coefficients;

    #[test]
    fn an_anisotropic_mixture_names_every_lobe() {
        let (order, grid) = (2, ExitantGrid::new(Zone::from_degrees(9.0, 57.0).unwrap(), 4, 8));
        let n = 3 * grid.len();
        let mut values = vec![0.0; size(order) * n];
        values[..n].fill(0.1);
        // The same cos(2 phi_i) for every camera: light from along the grain is reflected more.
        values[8 * n..].fill(0.02);
        let sigma = vec![1e-4; values.len()];
        let coefficients = Coefficients { grid, order, values, sigma, history: String::new() };
        let report = fit(&coefficients, FitMethod::Mixture, &FitOptions::default()).unwrap();
        let lobes = report.parameters.keys().filter(|n| n.starts_with("half_") && n.ends_with("_r")).count();
        assert!(lobes > 0 && report.parameters.len() == 3 * (lobes + 1), "{:?}", report.parameters);
        assert!(report.parameters.keys().any(|n| n.split('_').count() == 5), "{:?}", report.parameters);
        assert!(report.isotropy_chi > 10.0, "{}", report.isotropy_chi);
    }
}
