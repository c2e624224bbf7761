//! What error a plan leaves for a class of materials, before anything is measured.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::NoiseModel;
use crate::patterns::{Plan, RigTime, Timing};
use crate::reduce::ReduceError;

/// Version of the table.
pub const FORMAT: u32 = 1;

/// Classes of materials, by how much brighter the lobe is than the rest: see [`Class::of_contrast`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Class {
    /// All of them.
    #[default]
    Any,
    /// No lobe to speak of.
    Matte,
    /// A wide lobe.
    Satin,
    /// A narrow lobe on a diffuse ground.
    Glossy,
    /// A lobe that outshines the rest.
    Specular,
}

impl Class {
    /// All, the one that holds the others first.
    pub const ALL: [Self; 5] = [Self::Any, Self::Matte, Self::Satin, Self::Glossy, Self::Specular];

    /// The class of an RMS over a mean of f_cos over incident directions, for the camera at 50 deg: 1.2 for a Lambert surface,
    /// 40 and more for a mirror.
    pub fn of_contrast(contrast: f64) -> Self {
        match contrast {
            c if c < 1.5 => Self::Matte,
            c if c < 3.0 => Self::Satin,
            c if c < 8.0 => Self::Glossy,
            _ => Self::Specular,
        }
    }

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Any => "any",
            Self::Matte => "matte",
            Self::Satin => "satin",
            Self::Glossy => "glossy",
            Self::Specular => "specular",
        }
    }
}

/// Errors of a class at one order, geometric means: [`crate::reflectance::ChannelErrors::overall`] of the fit `auto`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AtOrder {
    /// Zonal order.
    pub order: usize,
    /// Without noise: what the families miss.
    pub misfit: f64,
    /// By how much noise moves the model, per unit of `noise_rel`; it adds to the misfit in squares.
    pub per_noise: f64,
}

/// One class.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassTable {
    /// Which.
    pub class: Class,
    /// Number of materials it was learned from.
    pub materials: usize,
    /// Ascending orders.
    pub orders: Vec<AtOrder>,
}

/// The table that forecasts are made from; made by `zonal outlook`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outlook {
    /// Version.
    pub version: u32,
    /// Azimuths that noise was averaged over.
    pub sectors: usize,
    /// By class.
    pub class: Vec<ClassTable>,
}

static BUILT_IN: LazyLock<Outlook> = LazyLock::new(|| {
    let outlook: Outlook = toml::from_str(include_str!("../../data/outlook.toml")).expect("a file of ours");
    assert_eq!(outlook.version, FORMAT);
    outlook
});

/// What a plan is expected to cost and to bring.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Forecast {
    /// Camera frames.
    pub frames: usize,
    /// Time on the rig, s.
    pub rig_s: f64,
    /// What it is spent on.
    pub rig_s_items: RigTime,
    /// Noise of the coefficients of a sample with an albedo of 0.3, over z_00.
    pub noise_rel: f64,
    /// Error to expect of the class: 1 is as large as the signal.
    pub error: f64,
}

/// Albedo of the sample that noise is forecast for.
const ALBEDO: f64 = 0.3;

impl Outlook {
    /// The table this program comes with.
    pub fn built_in() -> &'static Self {
        &BUILT_IN
    }

    /// The table as TOML.
    pub fn to_toml(&self) -> String {
        let body = toml::to_string_pretty(self).expect("plain numbers");
        format!("# What fits of the built-in SGD materials err by at each order; made by `zonal outlook`.\n{body}")
    }

    /// Error that a class is left with at an order and a noise.
    ///
    /// Between orders of the table it is interpolated in logarithms; above the highest nothing further is gained.
    pub fn error(&self, class: Class, order: usize, noise_rel: f64) -> f64 {
        let table = self.class.iter().find(|c| c.class == class).or_else(|| self.class.first()).expect("one at least");
        let at = |a: &AtOrder| a.misfit.hypot(a.per_noise * noise_rel);
        let above = table.orders.iter().position(|a| a.order >= order);
        match above {
            Some(0) => at(&table.orders[0]),
            Some(i) => {
                let (below, above) = (&table.orders[i - 1], &table.orders[i]);
                let t = (order - below.order) as f64 / (above.order - below.order) as f64;
                at(below).powf(1.0 - t) * at(above).powf(t)
            }
            None => at(table.orders.last().expect("orders")),
        }
    }

    /// What a plan costs and brings on a rig. An adaptive plan is forecast as the least it takes.
    ///
    /// # Errors
    /// [`ReduceError`] if the plan's scheme cannot be read back.
    pub fn forecast(
        &self,
        noise: &NoiseModel,
        timing: &Timing,
        plan: &Plan,
        class: Class,
    ) -> Result<Forecast, ReduceError> {
        let noise_rel = noise.noise_rel(plan, ALBEDO)?;
        let items = plan.rig_time(timing);
        let order = if plan.adaptive.is_some() { plan.order.min(2) } else { plan.order };
        Ok(Forecast {
            frames: plan.frames(),
            rig_s: items.total_s(),
            rig_s_items: items,
            noise_rel,
            error: self.error(class, order, noise_rel),
        })
    }
}

/// No plan fits a budget.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error("no plan takes less than {least_s:.1} s on this rig, {budget_s} s are too few: choose a larger --budget")]
pub struct NoPlan {
    /// Time there is, s.
    pub budget_s: f64,
    /// Time of the shortest plan, s.
    pub least_s: f64,
}

#[cfg(test)]
mod tests {
    use super::super::contrast;
    use super::*;
    use crate::reflectance::{Lambert, open};

    #[test]
    fn classes_go_by_the_lobe() {
        let of = |name: &str| contrast(open(name).unwrap().as_ref());
        assert_eq!(Class::of_contrast(contrast(&Lambert::gray(0.5))), Class::Matte);
        assert_eq!(Class::of_contrast(of("ggx-0.05")), Class::Glossy);
        let contrasts = ["gray-card", "ggx-0.4", "ggx-0.1", "ggx-0.05", "ggx-0.02"].map(of);
        assert!(contrasts.is_sorted(), "{contrasts:?}");
    }

    #[test]
    fn errors_grow_with_noise_and_gloss_and_lie_between_their_orders() {
        let outlook = Outlook::built_in();
        for class in Class::ALL {
            assert!(outlook.error(class, 4, 0.05) >= outlook.error(class, 4, 0.01));
            let [below, at, above] = [4, 5, 6].map(|order| outlook.error(class, order, 0.01));
            assert!(at >= below.min(above) && at <= below.max(above));
            assert_eq!(outlook.error(class, 10, 0.01), outlook.error(class, 20, 0.01));
        }
        let [matte, specular] = [Class::Matte, Class::Specular].map(|class| outlook.error(class, 6, 0.005));
        assert!(matte < specular, "{matte} {specular}");
    }

    #[test]
    fn the_table_survives_a_round_trip() {
        let outlook = Outlook::built_in();
        assert_eq!(&toml::from_str::<Outlook>(&outlook.to_toml()).unwrap(), outlook);
    }
}
