//! The report of a rollout, with the fields of the command's `report.json`.

use super::Settings;
use super::device::absolute;
use crate::Frame;
use crate::cloth::{BodyStats, LayerStats};
use crate::eval::{Verdict, median_time};
use crate::scene::{Scene, Setup};
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

/// What a frame of one cloth was like.
#[derive(Clone, Debug, serde::Serialize)]
pub(crate) struct PerFrame {
    frame: usize,
    ms: f64,
    energy_total: f64,
    #[serde(flatten)]
    stats: FrameStats,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    bodies: Vec<OfBody>,
    #[serde(skip_serializing_if = "Option::is_none")]
    layers: Option<OfLayers>,
}

/// What a body did in a frame, in SI units and the scene's axes.
#[derive(Clone, Debug, serde::Serialize)]
struct OfBody {
    touching: usize,
    deepest_m: f64,
    load_n: [f64; 3],
    friction_work_j: f64,
}

/// What the layers of the cloth did to each other in a frame.
#[derive(Clone, Debug, serde::Serialize)]
struct OfLayers {
    touching: usize,
    nearest_m: Option<f64>,
}

impl OfBody {
    fn new(stats: &BodyStats, setup: &Setup) -> Self {
        let joules = |energy: f64| setup.units.energy_j(energy, setup.model.grid.particles());
        let newtons = stats.load.map(|load| joules(load) / setup.units.length_m);
        Self {
            touching: stats.touching,
            deepest_m: stats.deepest * setup.units.length_m,
            load_n: setup.up.from_z_up(newtons),
            friction_work_j: joules(stats.friction_work),
        }
    }
}

impl OfLayers {
    fn new(stats: LayerStats, setup: &Setup) -> Self {
        let nearest_m = (stats.pairs > 0).then_some(stats.nearest * setup.units.length_m);
        Self { touching: stats.touching, nearest_m }
    }
}

impl PerFrame {
    /// Returns what cloth `b` of a frame was like; `setup` is its own.
    pub fn new(frame: &Frame, b: usize, setup: &Setup) -> Self {
        let stats = frame.stats[b].clone();
        Self {
            frame: frame.index,
            ms: frame.wall.as_secs_f64() * 1e3,
            energy_total: stats.energy.total(),
            bodies: stats.bodies.iter().map(|body| OfBody::new(body, setup)).collect(),
            layers: stats.layers.map(|layers| OfLayers::new(layers, setup)),
            stats,
        }
    }

    /// Returns it as JSON.
    pub fn to_json(&self) -> Value {
        serde_json::to_value(self).unwrap_or_default()
    }
}

/// What a report is made of.
pub(crate) struct Report<'a> {
    pub scene: &'a Scene,
    pub settings: &'a Settings,
    pub optimizer: &'a Optimizer,
    pub device: String,
    pub verdict: Verdict,
    pub frames: usize,
    pub per_frame: &'a [PerFrame],
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
