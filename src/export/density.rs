//! The density of half vectors of a D-BRDF as OpenEXR.

use std::path::Path;

use crate::geometry::{Direction, Sample};
use crate::reflectance::Dbrdf;
use crate::store::{Layers, Plane, StoreError};

/// Rows: theta_h every quarter of a degree, both ends included.
const ROWS: usize = 361;
/// Columns where p depends on phi_h: every two degrees. One column stands for every azimuth where it does not.
const COLUMNS: usize = 180;

/// Writes p(h) of a D-BRDF as the plane `p` of an OpenEXR image, its other parameters as attributes.
///
/// Row i is theta_h = 90 i / (rows - 1) deg; column j is phi_h = 360 j / columns deg, one column for an isotropic density. p is
/// in 1/sr and integrates to 1 over the upper hemisphere. `history` says where the model comes from.
///
/// # Errors
/// [`StoreError`].
pub fn write_density(model: &Dbrdf, history: &str, path: &Path) -> Result<(), StoreError> {
    let columns = if model.p.is_isotropic() { 1 } else { COLUMNS };
    let mut image = Layers::new(columns, ROWS);
    let at = |k: usize| {
        let [theta_deg, phi_deg] = [90.0 / (ROWS - 1) as f64, 360.0 / columns as f64];
        let h = Direction::<Sample>::from_angles(
            ((k / columns) as f64 * theta_deg).to_radians(),
            ((k % columns) as f64 * phi_deg).to_radians(),
        );
        model.p.eval(&h.vector()) as f32
    };
    image.plane("p", Plane::Float((0..columns * ROWS).map(at).collect()));
    image.attribute(
        "zonal_content",
        "p(h) of f = kd / pi + c p(h) F / (cos theta_i + cos theta_o - cos theta_i cos theta_o), F = r0 + (1 - r0) (1 - h.wo)^5",
    );
    image.attribute("zonal_units", "p 1/sr, integral over the upper hemisphere 1; c, kd, r0 no unit, linear RGB");
    image.attribute(
        "zonal_convention",
        "h = (wi + wo) / |wi + wo|, theta_h from the normal +z, phi_h from the grain +x; row i: theta_h = 90 i / (rows - 1) deg, \
         column j: phi_h = 360 j / columns deg, one column for every azimuth",
    );
    image.attribute("zonal_interpolation", "bilinear in theta_h and phi_h; phi_h wraps");
    image.attribute("zonal_colour_space", crate::radiometry::ColourSpace::of_history(history).label());
    image.attribute("zonal_history", history);
    for (name, rgb) in [("c", model.c), ("kd", model.kd)] {
        for (channel, value) in ["r", "g", "b"].into_iter().zip(rgb) {
            image.attribute(&format!("zonal_{name}_{channel}"), value);
        }
    }
    image.attribute("zonal_r0", model.r0);
    image.write(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::{Density, DensityTerm};
    use std::f64::consts::{FRAC_PI_2, TAU};

    #[test]
    fn the_file_holds_the_density_and_the_parameters() {
        // Trapezoids at a quarter of a degree against a roughness of 0.2.
        const TRAPEZOIDS: f64 = 1e-3;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.exr");
        for (alpha, columns) in [([0.2, 0.2], 1), ([0.2, 0.5], COLUMNS)] {
            let p = Density::Mixture(vec![DensityTerm { weight: 1.0, alpha }]);
            let model = Dbrdf { kd: [0.1, 0.2, 0.3], c: [0.4, 0.5, 0.6], r0: 0.04, p };
            write_density(&model, "test", &path).unwrap();
            let image = Layers::read(&path).unwrap();
            assert_eq!((image.width, image.height), (columns, ROWS));
            let p = image.get("p").unwrap();
            let step = FRAC_PI_2 / (ROWS - 1) as f64;
            let integral: f64 = p
                .iter()
                .enumerate()
                .map(|(k, &p)| f64::from(p) * (step * (k / columns) as f64).sin() * step * TAU / columns as f64)
                .sum();
            assert!((integral - 1.0).abs() < TRAPEZOIDS, "{integral}");
            let h = Direction::<Sample>::from_angles(10f64.to_radians(), FRAC_PI_2).vector();
            assert_eq!(p[40 * columns + columns / 4], model.p.eval(&h) as f32);
            assert_eq!((image.number("zonal_c_g"), image.number("zonal_kd_b")), (Some(0.5), Some(0.3)));
            assert_eq!((image.number("zonal_r0"), image.text("zonal_history")), (Some(0.04), Some("test")));
        }
    }
}
