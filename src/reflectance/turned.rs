//! A sample mounted at an angle.

use std::sync::Arc;

use super::{Brdf, Towards};
use crate::geometry::{Direction, Sample};

/// A material turned about its normal.
pub struct Turned {
    inner: Arc<dyn Brdf>,
    angle: f64,
}

impl Turned {
    /// `inner` with its grain at `angle` radians from +x, counter-clockwise seen from above.
    pub fn new(inner: Arc<dyn Brdf>, angle: f64) -> Self {
        Self { inner, angle }
    }

    fn back(&self, d: &Direction<Sample>) -> Direction<Sample> {
        d.rotated_about_normal(-self.angle)
    }
}

impl Brdf for Turned {
    fn eval(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> [f64; 3] {
        self.inner.eval(&self.back(wi), &self.back(wo))
    }

    fn towards<'a>(&'a self, wo: &Direction<Sample>) -> Towards<'a> {
        let towards = self.inner.towards(&self.back(wo));
        Box::new(move |wi| towards(&self.back(wi)))
    }

    fn albedo(&self, wo: &Direction<Sample>) -> [f64; 3] {
        self.inner.albedo(&self.back(wo))
    }

    fn sample(&self, wo: &Direction<Sample>, u: [f64; 2]) -> Option<Direction<Sample>> {
        Some(self.inner.sample(&self.back(wo), u)?.rotated_about_normal(self.angle))
    }

    fn pdf(&self, wi: &Direction<Sample>, wo: &Direction<Sample>) -> f64 {
        self.inner.pdf(&self.back(wi), &self.back(wo))
    }

    fn is_isotropic(&self) -> bool {
        self.inner.is_isotropic()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::Ggx;

    #[test]
    fn the_grain_turns_with_the_sample() {
        let ggx = Ggx::anisotropic(0.1, 0.4, [0.5; 3]);
        let turned = Turned::new(Arc::new(ggx.clone()), 0.5);
        let at = |phi: f64| (Direction::from_angles(0.6, phi), Direction::from_angles(0.3, phi + 2.0));
        let ((wi, wo), (turned_wi, turned_wo)) = (at(0.2), at(0.7));
        let (straight, along) = (ggx.eval(&wi, &wo)[0], turned.eval(&turned_wi, &turned_wo)[0]);
        assert!((along / straight - 1.0).abs() < 1e-12, "{along} {straight}");
        assert!((turned.towards(&turned_wo)(&turned_wi)[0] - along * turned_wi.cos_theta()).abs() < 1e-12);
        assert!((turned.eval(&wi, &wo)[0] / straight - 1.0).abs() > 0.1, "the grain matters here");
        let drawn = turned.sample(&turned_wo, [0.3, 0.6]).unwrap();
        assert!(
            (drawn.vector() - ggx.sample(&wo, [0.3, 0.6]).unwrap().rotated_about_normal(0.5).vector()).norm() < 1e-12
        );
    }
}
