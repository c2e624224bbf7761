//! From a run's zonal coefficients to functions of all incident directions, for every exitant one.

mod population;
mod stability;
mod table;
mod trial;

pub use population::{members, population, ring};
pub use stability::{Scan, StabilityRow, stability_csv};
pub use table::{PRIOR_VERSION, PriorTable, PriorTableError};
pub use trial::{Spectra, Trial, ring_mean};
