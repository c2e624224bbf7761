//! Finds crosses in photographs: centres to a small part of a pixel, whatever the light and the blur.

use std::f64::consts::{FRAC_PI_2, PI};

use super::least_squares::minimise;

/// Half-width of the search for a cross, as a share of the region's radius.
const SEARCH: f64 = 0.5;
/// Steps of the search along each side.
const SEARCH_STEPS: usize = 41;
/// Samples the search looks at.
const SEARCH_SAMPLES: usize = 3000;
/// A cross must stand out from the residuals by this many standard errors of its contrast.
const LEAST_SIGNIFICANCE: f64 = 10.0;
/// Samples farther from the model than this many standard deviations count for as much as at it (Huber's estimator).
const OUTLIER: f64 = 3.0;

/// A place of the image, pixels, with the light there and its standard error.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub u: f64,
    pub v: f64,
    pub value: f64,
    pub sigma: f64,
}

/// Two dark lines of one width at right angles, blurred by a disc: what a lens out of focus makes of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shape {
    /// Angle of the first line to the rows, radians.
    pub angle: f64,
    /// Width of the lines, px.
    pub width_px: f64,
    /// Radius of the disc, px.
    pub blur_px: f64,
}

/// A cross that was found.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cross {
    pub u: f64,
    pub v: f64,
    /// Standard errors of u and v, from the scatter of the residuals.
    pub sigma: [f64; 2],
}

impl Shape {
    /// Share of a blurred point at the distance `t` from a line's middle that the line covers.
    fn line(&self, t: f64, scale: f64) -> f64 {
        let (half, radius) = (0.5 * self.width_px * scale, self.blur_px * scale);
        // Area of the unit disc left of x.
        let area = |x: f64| {
            let x = x.clamp(-1.0, 1.0);
            (x * (1.0 - x * x).sqrt() + x.asin()) / PI
        };
        area((t + half) / radius) - area((t - half) / radius)
    }

    /// Share that both lines cover, about a centre, turned by `turn`.
    fn cover(&self, du: f64, dv: f64, turn: f64, scale: f64) -> f64 {
        let across = |angle: f64| {
            let (s, c) = angle.sin_cos();
            self.line(c * dv - s * du, scale)
        };
        let angle = self.angle + turn;
        1.0 - (1.0 - across(angle)) * (1.0 - across(angle + FRAC_PI_2))
    }
}

/// Contrast of black lines: what `cover` leaves dark is dark.
const EXPECTED_CONTRAST: f64 = 0.9;
/// Widths and blur come from the rig's dimensions: their common scale is near 1, by this much in its logarithm.
const SCALE: f64 = 0.2;
/// Crosses are mounted upright to this angle, in units of 0.1 rad.
const UPRIGHT: f64 = 0.5;

/// Parameters of each cross: centre (in units of its line), turn (in units of 0.1), contrast, log of its scale.
const PER_CROSS: usize = 5;

/// Finds crosses that darken one even light together, light = L(u, v) product (1 - contrast cover), within `radius` of
/// (`u`, `v`). L is a polynomial of `degree`. The first cross is searched for, the others lie near (`u`, `v`).
///
/// `None` if a cross does not stand out.
pub(super) fn find(
    samples: &[Sample],
    shapes: &[Shape],
    at: (f64, f64),
    radius: f64,
    degree: usize,
) -> Option<Vec<Cross>> {
    let inside = |s: &&Sample| (s.u - at.0).hypot(s.v - at.1) < radius && s.value.is_finite() && s.sigma > 0.0;
    let used: Vec<Sample> = samples.iter().filter(inside).copied().collect();
    let first = search(&used, &shapes[0], at, radius)?;
    let unit = |shape: &Shape| 0.5 * shape.width_px + shape.blur_px;
    let mut mean = used.iter().map(|s| s.value).sum::<f64>() / used.len() as f64;
    if mean == 0.0 {
        mean = 1.0;
    }
    let powers: Vec<(i32, i32)> = (0..=degree as i32).flat_map(|n| (0..=n).map(move |i| (n - i, i))).collect();
    let mut start = Vec::new();
    for (i, shape) in shapes.iter().enumerate() {
        let (u, v) = if i == 0 { first } else { at };
        start.extend([(u - at.0) / unit(shape), (v - at.1) / unit(shape), 0.0, EXPECTED_CONTRAST, 0.0]);
    }
    start.extend(powers.iter().map(|&(i, j)| if i + j == 0 { 1.0 } else { 0.0 }));
    let model = |s: &Sample, p: &[f64]| {
        let (x, y) = ((s.u - at.0) / radius, (s.v - at.1) / radius);
        let light: f64 =
            powers.iter().zip(&p[PER_CROSS * shapes.len()..]).map(|(&(i, j), c)| c * x.powi(i) * y.powi(j)).sum();
        let left = shapes.iter().zip(p.chunks_exact(PER_CROSS)).map(|(shape, p)| {
            let (du, dv) = (s.u - at.0 - p[0] * unit(shape), s.v - at.1 - p[1] * unit(shape));
            1.0 - p[3] * shape.cover(du, dv, 0.1 * p[2], p[4].exp())
        });
        mean * light * left.product::<f64>()
    };
    let mut found = None;
    let mut used = used;
    for _ in 0..2 {
        let residuals = |p: &[f64]| {
            let expected =
                p[..PER_CROSS * shapes.len()].chunks_exact(PER_CROSS).flat_map(|p| [p[2] / UPRIGHT, p[4] / SCALE]);
            used.iter().map(|s| (model(s, p) - s.value) / s.sigma).chain(expected).collect()
        };
        let minimum = minimise(start.clone(), &residuals)?;
        let scale = (minimum.residuals.norm_squared() / used.len() as f64).sqrt();
        let mut sizes: Vec<f64> = minimum.residuals.iter().map(|r| r.abs()).collect();
        sizes.sort_unstable_by(f64::total_cmp);
        // 0.6745 standard deviations hold half of a normal distribution.
        let limit = OUTLIER * sizes[sizes.len() / 2] / 0.6745;
        for (s, r) in used.iter_mut().zip(&minimum.residuals) {
            s.sigma *= (r.abs() / limit).max(1.0).sqrt();
        }
        start = minimum.x.as_slice().to_vec();
        found = Some((minimum, scale));
    }
    let (minimum, scale) = found?;
    let sigma = |i: usize| scale * minimum.covariance[(i, i)].sqrt();
    (0..shapes.len())
        .map(|c| {
            let (i, unit) = (c * PER_CROSS, unit(&shapes[c]));
            let stands_out = minimum.x[i + 3] > LEAST_SIGNIFICANCE * sigma(i + 3);
            stands_out.then(|| Cross {
                u: at.0 + minimum.x[i] * unit,
                v: at.1 + minimum.x[i + 1] * unit,
                sigma: [sigma(i) * unit, sigma(i + 1) * unit],
            })
        })
        .collect()
}

/// The centre at which the shape explains most of what a sample of the image has besides a plane.
fn search(samples: &[Sample], shape: &Shape, at: (f64, f64), radius: f64) -> Option<(f64, f64)> {
    let few: Vec<&Sample> = samples.iter().step_by((samples.len() / SEARCH_SAMPLES).max(1)).collect();
    let n = few.len() as f64;
    if few.is_empty() {
        return None;
    }
    let mean = few.iter().map(|s| s.value).sum::<f64>() / n;
    let step = 2.0 * SEARCH * radius / (SEARCH_STEPS - 1) as f64;
    let candidates = (0..SEARCH_STEPS * SEARCH_STEPS).map(|i| {
        let offset = |j: usize| j as f64 * step - SEARCH * radius;
        (at.0 + offset(i % SEARCH_STEPS), at.1 + offset(i / SEARCH_STEPS))
    });
    let explained = |&(u, v): &(f64, f64)| {
        let cover: Vec<f64> = few.iter().map(|s| shape.cover(s.u - u, s.v - v, 0.0, 1.0)).collect();
        let middle = cover.iter().sum::<f64>() / n;
        let (mut product, mut square) = (0.0, 0.0);
        for (s, c) in few.iter().zip(&cover) {
            product += (s.value - mean) * (c - middle);
            square += (c - middle).powi(2);
        }
        // Darker where it covers: negative products.
        if product < 0.0 { product * product / square.max(1e-12) } else { 0.0 }
    };
    candidates.max_by(|a, b| explained(a).total_cmp(&explained(b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn photograph(light: impl Fn(f64, f64) -> f64, left: impl Fn(f64, f64) -> f64) -> Vec<Sample> {
        let mut rng = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(5);
        let mut samples = Vec::new();
        for i in 0..150 * 150 {
            let (u, v) = (f64::from(i % 150 * 4), f64::from(i / 150 * 4));
            let noise: f64 = StandardNormal.sample(&mut rng);
            samples.push(Sample { u, v, value: light(u, v) * left(u, v) + 12.0 * noise, sigma: 12.0 });
        }
        samples
    }

    fn assert_found(found: &Cross, u: f64, v: f64, tolerance: f64) {
        println!("{found:?}");
        assert!((found.u - u).abs() < tolerance && (found.v - v).abs() < tolerance, "{found:?}");
        assert!((found.u - u).abs() < 4.0 * found.sigma[0] && (found.v - v).abs() < 4.0 * found.sigma[1], "{found:?}");
    }

    const MIDDLE: (f64, f64) = (300.0, 300.0);

    #[test]
    fn lines_are_found_in_uneven_light_and_noise() {
        let shape = Shape { angle: 0.0, width_px: 14.6, blur_px: 10.0 };
        let light = |u: f64, v: f64| 400.0 * (1.0 + 0.3 * (u / 600.0 - 0.5) - 0.4 * (v / 600.0 - 0.5).powi(2));
        let samples = photograph(light, |u, v| 1.0 - 0.9 * shape.cover(u - 331.3, v - 287.9, 0.004, 1.0));
        assert_found(&find(&samples, &[shape], MIDDLE, 268.0, 4).unwrap()[0], 331.3, 287.9, 0.1);
        assert!(find(&photograph(light, |_, _| 1.0), &[shape], MIDDLE, 268.0, 4).is_none(), "no cross is none");
    }

    #[test]
    fn wires_and_their_broad_shadow_are_told_apart() {
        let wire = Shape { angle: 0.25 * PI, width_px: 32.0, blur_px: 17.0 };
        let shadow = Shape { angle: 0.25 * PI, width_px: 32.0, blur_px: 217.0 };
        let left = |u: f64, v: f64| {
            (1.0 - wire.cover(u - 331.3, v - 287.9, 0.004, 1.0))
                * (1.0 - shadow.cover(u - 291.7, v - 308.2, 0.004, 1.0))
        };
        let found = find(&photograph(|_, _| 400.0, left), &[wire, shadow], MIDDLE, 268.0, 0).unwrap();
        assert_found(&found[0], 331.3, 287.9, 0.1);
        assert_found(&found[1], 291.7, 308.2, 2.5);
    }
}
