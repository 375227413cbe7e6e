//! Rollouts of fixed scenes that measure the quality of weights.

use super::config::ValidationConfig;
use crate::Device;
use crate::Result;
use crate::cloth::Grid;
use crate::eval::STRETCH_LIMIT;
use crate::eval::suite::{Case, CaseScore, Prepared};
use crate::network::Weights;
use crate::scene::{Motion, Scene, Start};
use crate::sim::Optimizer;
use std::ops::ControlFlow;

/// The prepared scenes: on each grid of the configuration a sheet that hangs from two corners and swings
/// along `xy_v2`, and on the finest of them a flat sheet that falls, held by two corners. Default material,
/// air, 60 frames per second.
pub struct Validation {
    iterations: usize,
    /// The scenes, each with whether its gap counts or only its soundness.
    scenes: Vec<(Prepared, bool)>,
}

/// The score of weights in one scene.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SceneScore {
    /// Name of the scene, such as `hanging 64x64`.
    pub scene: String,
    /// Median over the frames of a converged simulation of the energy gap `(L_N - L_ref) / (L_0 - L_ref)`
    /// after N iterations; `None` in the falling scene.
    pub gap: Option<f64>,
    /// Largest `|edge| - 1` over all frames and all edges away from the handles ([`crate::eval::FreeEdges`]).
    /// `None` if a frame was not finite.
    #[serde(alias = "largest_stretch")]
    pub stretch_largest: Option<f64>,
    /// Whether the rollout was sound: all frames finite, and no such edge stretched beyond
    /// [`crate::eval::STRETCH_LIMIT`].
    #[serde(alias = "stable")]
    pub sound: bool,
}

impl Validation {
    /// Prepares the scenes.
    pub fn new(config: &ValidationConfig) -> Result<Self> {
        let prepared = |kind: &str, mut scene: Scene, grid: Grid| {
            scene.regrid(grid)?;
            let case = Case { name: format!("{kind} {grid}"), scene, iterations: None };
            // The start counts as a frame.
            Prepared::new(case, config.frames + 1)
        };
        let mut scenes = Vec::new();
        for &grid in &config.grids {
            scenes.push((prepared("swinging", Scene::released(), grid)?, true));
        }
        if let Some(&finest) = config.grids.iter().max_by_key(|grid| grid.particles()) {
            let scene = Scene { start: Start::Flat, motion: Motion::Still, ..Scene::default() };
            scenes.push((prepared("falling", scene, finest)?, false));
        }
        Ok(Self { iterations: config.iterations, scenes })
    }

    /// Rolls out every scene with these weights, on the CPU in single precision, and measures the gaps.
    /// Returns `None` if `tick`, which is called in each frame, breaks.
    pub fn run(
        &self,
        weights: &Weights,
        mut tick: impl FnMut() -> ControlFlow<()>,
    ) -> Result<Option<Vec<SceneScore>>> {
        let optimizer = Optimizer::paper(weights.clone());
        let score = |(scene, with_gap): &(Prepared, bool)| {
            let run = scene.run((&optimizer, self.iterations), &Device::Cpu, *with_gap, &mut tick)?;
            Ok(run.map(|(score, _)| SceneScore::of(&score)))
        };
        self.scenes.iter().map(score).collect::<Result<_>>()
    }

    /// Returns the score of weights, smaller is better: the mean gap, in which an unsound rollout outweighs
    /// any gap.
    pub fn score(scores: &[SceneScore]) -> f64 {
        let of = |s: &SceneScore| match s.gap.unwrap_or(0.0) {
            gap if s.sound && gap < SceneScore::MOST_GAP => gap,
            _ => SceneScore::MOST_GAP,
        };
        scores.iter().map(of).sum::<f64>() / scores.len() as f64
    }
}

impl SceneScore {
    /// The largest gap that is told from larger ones, and the contribution of an unsound rollout to the score
    /// of weights.
    pub const MOST_GAP: f64 = 10.0;

    fn of(score: &CaseScore) -> Self {
        Self {
            scene: score.case.clone(),
            // Cap the gap, also if it is infinite or NaN: JSON would store that as null, which means no gap.
            gap: score.measured_gap().map(|gap| gap.min(Self::MOST_GAP)),
            stretch_largest: score.verdict.stretch_largest_free,
            // The gap counts by itself.
            sound: score.stable
                && score.verdict.stretch_largest_free.is_some_and(|stretch| stretch <= STRETCH_LIMIT),
        }
    }
}
