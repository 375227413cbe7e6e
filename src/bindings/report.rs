//! The report of a rollout, with the fields of the command's `report.json`.

use super::Settings;
use super::settings::absolute;
use crate::eval::{FrameReport, Verdict, median_time};
use crate::scene::Scene;
use crate::sim::{FrameStats, Optimizer};
use serde_json::{Value, json};

/// How a rollout ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Status {
    Done,
    Interrupted,
    NonFinite,
    Failed,
}

/// What a report is made of.
pub(crate) struct Report<'a> {
    pub scene: &'a Scene,
    pub settings: &'a Settings,
    pub optimizer: &'a Optimizer,
    pub device: String,
    pub verdict: Verdict,
    pub frames: usize,
    pub per_frame: &'a [FrameReport],
}

impl Report<'_> {
    /// Returns the report of a rollout that ended so.
    pub fn to_json(&self, status: Status) -> Value {
        let Settings { checkpoint, precision, .. } = self.settings;
        // Newton's method takes as many as it needs.
        let iterations = (!self.optimizer.converges()).then(|| self.settings.iterations(self.optimizer).ok());
        let sum = |count: &dyn Fn(&FrameStats) -> usize| {
            self.per_frame.iter().map(|frame| count(&frame.stats)).sum::<usize>()
        };
        let times: Vec<f64> = self.per_frame.iter().map(|frame| frame.ms).collect();
        json!({
            "version": env!("CARGO_PKG_VERSION"),
            "settings": {
                "scene": self.scene.to_json(),
                "solver": self.optimizer.name(),
                "iterations": iterations.flatten(),
                "checkpoint": checkpoint.as_deref().map(absolute),
                "precision": precision,
            },
            "weights_crc32": self.optimizer.weights_crc32(),
            "device": self.device,
            "status": status,
            "sound": status != Status::NonFinite && self.verdict.is_sound(),
            "unsound": self.verdict.faults().iter().map(ToString::to_string).collect::<Vec<_>>(),
            "stretch_largest_free": self.verdict.stretch_largest_free,
            "gap_estimate": self.verdict.gap_estimate,
            "steps_shortened": sum(&|stats| stats.steps.shortened),
            "directions_dropped": sum(&|stats| stats.steps.dropped),
            "frames": self.frames,
            "ms_per_frame": median_time(&times),
            "per_frame": self.per_frame,
        })
    }
}
