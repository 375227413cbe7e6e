//! What a report says of a frame.

use crate::Frame;
use crate::cloth::{BodyStats, LayerStats};
use crate::scene::Setup;
use crate::sim::FrameStats;

/// What a frame of one cloth was like, as an entry of `per_frame` in a report.
#[derive(Clone, Debug, serde::Serialize)]
pub struct FrameReport {
    /// Number of the frame.
    pub frame: usize,
    /// Wall time \[ms\].
    pub ms: f64,
    /// The energy, in grid units.
    pub energy_total: f64,
    /// Its terms and more, in grid units.
    #[serde(flatten)]
    pub stats: FrameStats,
    /// What each body did, left out where there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    bodies: Vec<OfBody>,
    /// What its layers did, left out if the cloth does not touch itself.
    #[serde(skip_serializing_if = "Option::is_none")]
    layers: Option<OfLayers>,
}

/// What a body did in a frame, in SI units and the scene's axes.
#[derive(Clone, Debug, serde::Serialize)]
struct OfBody {
    touching: usize,
    /// Largest depth of a particle below its surface.
    deepest_m: f64,
    /// Force of the cloth on it.
    load_n: [f64; 3],
    /// Work that friction took from the cloth.
    friction_work_j: f64,
}

/// What the layers of the cloth did to each other in a frame.
#[derive(Clone, Debug, serde::Serialize)]
struct OfLayers {
    /// Pairs of parts, a particle and a triangle or two edges, that are nearer than the thickness.
    touching: usize,
    /// Least distance between two parts; `null` if none are near each other.
    nearest_m: Option<f64>,
}

impl FrameReport {
    /// Returns what cloth `b` of a frame was like; `setup` is its own. Panics if there is no such cloth.
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
