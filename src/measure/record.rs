//! The record of a run.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{Assumptions, Budget, Decision, MeasureError};
use crate::capture::RUN_FORMAT;
use crate::optics::Rig;
use crate::patterns::{Plan, RigTime};
use crate::radiometry::ColourSpace;
use crate::store::{self, StoreError};

/// What is measured and by what: goes into the record as it is.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Provenance {
    /// Name or file of the material: what is opened in simulation.
    pub sample: String,
    /// The simulated rig, if it is one.
    pub simulation: Option<serde_json::Value>,
    /// What the sample is called, where that says more than `sample`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Angle from the rig's +x to the sample's grain as it is mounted, about the normal, counter-clockwise, degrees.
    #[serde(default)]
    pub grain_deg: f64,
    /// When the run began, UTC, ISO 8601.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub started: Option<String>,
    /// Runs this one was merged from.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub merged: Vec<String>,
    /// What is taken for granted about rig, card and mount.
    #[serde(default)]
    pub assumed: Assumptions,
}

impl Provenance {
    /// One line for the headers of files: sample, rig, plan and the simulated rig with its seed.
    /// The sample's name, or its material.
    pub fn sample_name(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.sample)
    }

    pub(super) fn history(&self, rig: &Rig, plan: &Plan) -> String {
        let simulation = self.simulation.as_ref().map_or_else(String::new, |s| format!("; simulated rig {s}"));
        let mut sample = self.sample.clone();
        if let Some(name) = &self.name {
            sample = format!("{name} ({sample})");
        }
        if self.grain_deg != 0.0 {
            sample += &format!(", grain at {} deg", self.grain_deg);
        }
        format!("sample {sample}; rig {}; plan {}{simulation}", rig.name, plan.name)
    }
}

/// `run.json`: the record of a run. Times in seconds, angles in degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// Version of the run folder.
    pub format: u32,
    /// Program and version.
    pub software: String,
    /// `running` (or killed while it ran), `stopped`, `failed` or `complete`.
    pub status: String,
    /// Name of the rig.
    pub rig: String,
    /// Name of the plan.
    pub plan: String,
    /// What was measured and by what.
    pub provenance: Provenance,
    /// Zonal order.
    pub order: usize,
    /// Patterns shown.
    pub images: usize,
    /// Camera frames.
    pub frames: usize,
    /// Predicted wall time on the physical rig.
    pub rig_s: f64,
    /// What it is spent on.
    pub rig_s_items: RigTime,
    /// Time this program took from the first pattern to the coefficients.
    pub compute_s: f64,
    /// Time from the last frame to the coefficients.
    pub post_s: f64,
    /// Limits of the measured zone.
    pub zone_deg: [f64; 2],
    /// RMS sigma over RMS DC.
    pub noise_rel: f64,
    /// Share of zone pixels saturated in every exposure.
    pub saturated_fraction: f64,
    /// Divisor of each step's rates; of each frame's where there are twice as many.
    pub gains: Vec<f64>,
    /// Steps of the plan that the coefficients are made from; all where none is named.
    #[serde(default)]
    pub steps: Vec<usize>,
    /// Whether the sample was taken to be isotropic.
    #[serde(default)]
    pub isotropic: bool,
    /// RMS deviation from isotropy beyond noise, over RMS z_00; 0 where isotropy was not assumed.
    #[serde(default)]
    pub anisotropy: f64,
    /// What an adaptive run decided.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub decisions: Vec<Decision>,
    /// Colours of the coefficients.
    #[serde(default)]
    pub colour_space: ColourSpace,
    /// How the frames came; not known of runs of older versions.
    #[serde(default)]
    pub capture: CaptureRecord,
    /// How far the result may be off and why; not known of runs of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Budget>,
}

/// How the frames of a run came.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CaptureRecord {
    /// Sessions it took: more than one if the run was resumed.
    pub sessions: usize,
    /// Frames that were no good and were taken again.
    pub rejected: usize,
    /// Frames a free-running camera took while patterns and settings changed, in the last session.
    pub skipped: usize,
    /// Time of the engine's own for each frame, in the last session.
    pub engine_s_per_frame: f64,
    /// From the projector's word that a frame is lit to its light.
    pub latency_s: f64,
    /// Whether a coded patch proved every frame.
    pub tagged: bool,
    /// Least and greatest light of the lamp relative to the start of the run; it is divided out.
    pub lamp: [f64; 2],
    /// Standard error of that, relative.
    pub lamp_sigma: f64,
    /// Time on the rig's clock from the first pattern to the last frame, in the last session.
    #[serde(default)]
    pub elapsed_s: f64,
    /// Time on the rig's clock for making devices ready (latency, coded patch), in the last session.
    #[serde(default)]
    pub preparation_s: f64,
}

impl RunRecord {
    /// Reads the record of a run folder.
    ///
    /// # Errors
    /// [`StoreError`]; a record of a newer program is [`StoreError::Invalid`].
    pub fn read(run: &Path) -> Result<Self, StoreError> {
        store::read_versioned(&run.join("run.json"), RUN_FORMAT)
    }

    /// Reads the record of a run that has ended well.
    ///
    /// # Errors
    /// As [`RunRecord::read`], and [`MeasureError::NotComplete`].
    pub fn read_complete(run: &Path) -> Result<Self, MeasureError> {
        let record = Self::read(run)?;
        if record.status == "complete" {
            return Ok(record);
        }
        Err(MeasureError::NotComplete { path: run.join("run.json"), status: record.status })
    }
}
