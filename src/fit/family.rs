//! Families of models: a few shape parameters, and columns that enter linearly.

use super::{Forward, Node};
use crate::reflectance::abc::{abc_lobe, abc_lobe_slopes};
use crate::reflectance::{Abc, Ggx, GgxLobe, Lambert, Model};

/// A shape parameter and the range it is searched in; the search runs in its logarithm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ShapeParameter {
    pub name: &'static str,
    /// Smallest and largest value.
    pub range: [f64; 2],
    /// Subtracted before the logarithm is taken: indices of refraction begin at 1.
    pub origin: f64,
}

/// A family whose shape parameters `theta` are natural values and whose other parameters are non-negative and linear.
pub(super) trait Family: Sync {
    fn shape(&self) -> Vec<ShapeParameter>;
    /// Names of the linear parameters, RGB each; the first is `kd`.
    fn linear(&self) -> Vec<String>;
    /// One predicted column for each linear parameter but the first.
    fn columns(&self, forward: &Forward, theta: &[f64]) -> Vec<Vec<f64>>;
    /// Derivatives of the columns by the logarithm of each shape parameter above its origin, `[parameter][column]`: central
    /// differences, unless a family knows better.
    fn slopes(&self, forward: &Forward, theta: &[f64]) -> Vec<Vec<Vec<f64>>> {
        let of = |(j, p): (usize, &ShapeParameter)| {
            let at = |step: f64| {
                let mut moved = theta.to_vec();
                moved[j] = p.origin + (theta[j] - p.origin) * step.exp();
                self.columns(forward, &moved)
            };
            let both = at(STEP).into_iter().zip(at(-STEP));
            both.map(|(p, m)| p.iter().zip(&m).map(|(p, m)| (p - m) / (2.0 * STEP)).collect()).collect()
        };
        self.shape().iter().enumerate().map(of).collect()
    }
    /// The model, `x[column][channel]`.
    fn model(&self, theta: &[f64], x: &[[f64; 3]]) -> Model;
    /// Shape parameters to start a search from, from coarse to complete cover.
    fn starts(&self) -> Vec<Vec<f64>>;
    /// Where to search once more when a search has ended at `theta`: valleys apart from it that look alike from the zone.
    fn rivals(&self, _theta: &[f64]) -> Vec<Vec<f64>> {
        Vec::new()
    }
    /// Brings `theta` to a standard order where several values mean the same.
    fn ordered(&self, theta: &[f64]) -> Vec<f64> {
        theta.to_vec()
    }
}

/// Step of numerical derivatives.
const STEP: f64 = 1e-5;

/// Roughness a fit looks for: sharper lobes are mirrors to every order a rig shows, duller ones are all but diffuse.
pub(super) const ALPHA: [f64; 2] = [0.005, 1.0];

/// `n` values from `lo` to `hi` in equal ratios.
pub(super) fn geometric(lo: f64, hi: f64, n: usize) -> Vec<f64> {
    (0..n).map(|i| lo * (hi / lo).powf(i as f64 / (n - 1) as f64)).collect()
}

/// A diffuser.
pub(super) struct LambertFamily;

impl Family for LambertFamily {
    fn shape(&self) -> Vec<ShapeParameter> {
        Vec::new()
    }

    fn linear(&self) -> Vec<String> {
        vec!["kd".into()]
    }

    fn columns(&self, _forward: &Forward, _theta: &[f64]) -> Vec<Vec<f64>> {
        Vec::new()
    }

    fn model(&self, _theta: &[f64], x: &[[f64; 3]]) -> Model {
        Model::Lambert(Lambert { albedo: x[0] })
    }

    fn starts(&self) -> Vec<Vec<f64>> {
        vec![Vec::new()]
    }
}

/// One or two GGX lobes on a diffuser, isotropic or with a roughness across the grain of their own.
pub(super) struct GgxFamily {
    pub lobes: usize,
    pub anisotropic: bool,
}

impl GgxFamily {
    fn alphas(&self, theta: &[f64]) -> Vec<[f64; 2]> {
        let per_lobe = if self.anisotropic { 2 } else { 1 };
        theta.chunks(per_lobe).map(|t| [t[0], t[per_lobe - 1]]).collect()
    }
}

impl Family for GgxFamily {
    fn shape(&self) -> Vec<ShapeParameter> {
        let names: &[&'static str] = match (self.lobes, self.anisotropic) {
            (1, false) => &["alpha"],
            (1, true) => &["alpha_x", "alpha_y"],
            (_, false) => &["alpha", "alpha_2"],
            (_, true) => &["alpha_x", "alpha_y", "alpha_2_x", "alpha_2_y"],
        };
        names.iter().map(|&name| ShapeParameter { name, range: ALPHA, origin: 0.0 }).collect()
    }

    fn linear(&self) -> Vec<String> {
        ["kd", "f0", "f90", "f0_2", "f90_2"][..1 + 2 * self.lobes].iter().map(|&n| n.into()).collect()
    }

    fn columns(&self, forward: &Forward, theta: &[f64]) -> Vec<Vec<f64>> {
        let lobes = self.alphas(theta).into_iter();
        lobes.flat_map(|alpha| forward.project(|node| ggx_columns(alpha, node))).collect()
    }

    fn model(&self, theta: &[f64], x: &[[f64; 3]]) -> Model {
        let lobes = self.alphas(theta).into_iter().zip(x[1..].chunks(2));
        let lobes = lobes.map(|(alpha, x)| GgxLobe { alpha, f0: x[0], f90: x[1] }).collect();
        Model::Ggx(Ggx { kd: x[0], lobes })
    }

    fn starts(&self) -> Vec<Vec<f64>> {
        let coarse = |n: usize| geometric(0.01, 0.8, n);
        match (self.lobes, self.anisotropic) {
            (1, false) => coarse(14).into_iter().map(|a| vec![a]).collect(),
            (1, true) => coarse(6).into_iter().flat_map(|a| coarse(6).into_iter().map(move |b| vec![a, b])).collect(),
            (_, false) => pairs(&coarse(10)).into_iter().map(|(a, b)| vec![a, b]).collect(),
            (_, true) => pairs(&coarse(5)).into_iter().map(|(a, b)| vec![a, a, b, b]).collect(),
        }
    }

    fn ordered(&self, theta: &[f64]) -> Vec<f64> {
        let mut lobes: Vec<&[f64]> = theta.chunks(theta.len() / self.lobes).collect();
        lobes.sort_by(|a, b| a[0].total_cmp(&b[0]));
        lobes.concat()
    }
}

/// A GGX lobe's parts that weigh f0 and f90.
pub(super) fn ggx_columns(alpha: [f64; 2], node: &Node) -> [f64; 2] {
    let lobe = GgxLobe { alpha, f0: [1.0; 3], f90: [1.0; 3] }.shape(&node.h, &node.wi, &node.wo);
    [lobe * (1.0 - node.schlick), lobe * node.schlick]
}

fn pairs(values: &[f64]) -> Vec<(f64, f64)> {
    (0..values.len()).flat_map(|j| (0..j).map(move |i| (i, j))).map(|(i, j)| (values[i], values[j])).collect()
}

/// One ABC lobe on a diffuser.
///
/// In place of `b` and `c`, which trade against each other for sharp lobes, the search uses the angle theta_h at which 1 + b t has
/// grown to 2^(1 / (c + 1/4)), and `c`. Without the quarter that is where the distribution has fallen to a half, which the long tails
/// of fabrics, c of some hundredths, never do.
pub(super) struct AbcFamily;

/// The quarter, added to c.
const TAIL: f64 = 0.25;

/// `b` from the width in radians, for t = 1 - cos(theta_h).
fn abc_b(width: f64, c: f64) -> f64 {
    (2f64.powf(1.0 / (c + TAIL)) - 1.0) / (1.0 - width.cos())
}

/// Index of refraction from which on there are two valleys: up to the dome's angles, the Fresnel reflectance of 4 changes as little
/// as that of a perfect mirror, and between them it falls towards its Brewster angle.
const METAL: f64 = 2.5;
/// A start in each of the two.
const METALS: [f64; 2] = [4.0, 40.0];

impl Family for AbcFamily {
    fn shape(&self) -> Vec<ShapeParameter> {
        vec![
            ShapeParameter { name: "width_rad", range: [0.0005, 1.5], origin: 0.0 },
            ShapeParameter { name: "c", range: [0.01, 50.0], origin: 0.0 },
            ShapeParameter { name: "ior", range: [1.01, 100.0], origin: 1.0 },
        ]
    }

    fn linear(&self) -> Vec<String> {
        vec!["kd".into(), "a".into()]
    }

    fn columns(&self, forward: &Forward, theta: &[f64]) -> Vec<Vec<f64>> {
        let (b, c, ior) = (abc_b(theta[0], theta[1]), theta[1], theta[2]);
        let [column] = forward.project(|n| [abc_lobe(b, c, ior, [n.wi.z, n.wo.z], n.h.z, n.wo.dot(&n.h))]);
        vec![column]
    }

    /// One pass over the nodes for all three.
    fn slopes(&self, forward: &Forward, theta: &[f64]) -> Vec<Vec<Vec<f64>>> {
        let [width, c, ior] = [theta[0], theta[1], theta[2]];
        let b = abc_b(width, c);
        // d ln b by ln width and by ln c.
        let b_by_width = -width * width.sin() / (1.0 - width.cos());
        let grown = 2f64.powf(1.0 / (c + TAIL));
        let b_by_c = -std::f64::consts::LN_2 * c / (c + TAIL).powi(2) * grown / (grown - 1.0);
        let slopes = forward.project(|n| {
            let [by_b, by_c, by_ior] = abc_lobe_slopes(b, c, ior, [n.wi.z, n.wo.z], n.h.z, n.wo.dot(&n.h));
            [b * b_by_width * by_b, b * b_by_c * by_b + c * by_c, (ior - 1.0) * by_ior]
        });
        slopes.into_iter().map(|slope| vec![slope]).collect()
    }

    fn model(&self, theta: &[f64], x: &[[f64; 3]]) -> Model {
        Model::Abc(Abc { kd: x[0], a: x[1], b: abc_b(theta[0], theta[1]), c: theta[1], ior: theta[2] })
    }

    fn starts(&self) -> Vec<Vec<f64>> {
        let widths = geometric(0.003, 0.4, 6);
        let tails = [0.15, 0.5, 1.2, 3.0];
        widths.into_iter().flat_map(|w| tails.map(|c| vec![w, c, 1.5])).collect()
    }

    fn rivals(&self, theta: &[f64]) -> Vec<Vec<f64>> {
        if theta[2] < METAL { Vec::new() } else { METALS.map(|ior| vec![theta[0], theta[1], ior]).into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::basis::size;
    use crate::fit::{Fineness, Observations};
    use crate::geometry::{ExitantGrid, Zone};
    use crate::reduce::Coefficients;

    /// ABC lobes without slopes of their own.
    struct Differences;

    impl Family for Differences {
        fn shape(&self) -> Vec<ShapeParameter> {
            AbcFamily.shape()
        }

        fn linear(&self) -> Vec<String> {
            AbcFamily.linear()
        }

        fn columns(&self, forward: &Forward, theta: &[f64]) -> Vec<Vec<f64>> {
            AbcFamily.columns(forward, theta)
        }

        fn model(&self, theta: &[f64], x: &[[f64; 3]]) -> Model {
            AbcFamily.model(theta, x)
        }

        fn starts(&self) -> Vec<Vec<f64>> {
            AbcFamily.starts()
        }
    }

    /// Central differences over 1e-5 of a logarithm, of columns that cancel to a tenth of their terms.
    const DIFFERENCE: f64 = 1e-6;

    #[test]
    fn closed_slopes_of_abc_lobes_are_those_of_their_columns() {
        let (order, grid) = (2, ExitantGrid::new(Zone::from_degrees(9.0, 57.0).unwrap(), 6, 8));
        let n = size(order) * 3 * grid.len();
        let (values, sigma) = (vec![0.1; n], vec![1e-4; n]);
        let coefficients = Coefficients { grid, order, values, sigma, history: String::new() };
        let forward = Forward::new(&Observations::folded(&coefficients), Fineness::default()).unwrap();
        for theta in [[0.02, 1.2, 1.5], [0.3, 0.4, 1.1], [0.1, 5.0, 3.0]] {
            let size = |column: &[f64]| column.iter().fold(0.0f64, |most, x| most.max(x.abs()));
            let scale = size(&AbcFamily.columns(&forward, &theta)[0]);
            let both = AbcFamily.slopes(&forward, &theta).into_iter().zip(Differences.slopes(&forward, &theta));
            for (j, (closed, differences)) in both.enumerate() {
                let off: Vec<f64> = closed[0].iter().zip(&differences[0]).map(|(a, b)| a - b).collect();
                assert!(size(&off) < DIFFERENCE * scale, "{theta:?}, parameter {j}: {} of {scale}", size(&off));
                assert!(size(&closed[0]) > 1e3 * size(&off), "{theta:?}, parameter {j}");
            }
        }
    }
}
