//! Rollouts of fixed scenes, by which weights are judged.

use super::config::ValidationConfig;
use crate::Result;
use crate::eval::suite::{Case, CaseScore, Prepared};
use crate::network::Weights;
use crate::scene::{Motion, Scene, Start};
use crate::sim::{Device, Grid, Optimizer};
use std::ops::ControlFlow;

/// What an unstable scene counts for in the score, in energy gaps: more than any gap of a stable one.
const UNSTABLE_GAP: f64 = 10.0;

/// Scenes made ready: a sheet that hangs from two corners and swings along `xy_v2`, on each grid of the configuration, and
/// a flat sheet that falls, held by two corners, on the finest of them. Default material, air, 60 frames per second.
pub struct Validation {
    iterations: usize,
    /// The scenes, and whether the gap counts there or only stability does.
    scenes: Vec<(Prepared, bool)>,
}

/// How weights did in one scene.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SceneScore {
    /// Name of the scene, such as `hanging 64x64`.
    pub scene: String,
    /// Median over the frames of the energy gap `(L_N - L_ref) / (L_0 - L_ref)` after N iterations, the frames being those of
    /// a converged simulation; nothing in the falling scene.
    pub gap: Option<f64>,
    /// Largest `|edge| - 1` over all frames, of the edges that are away from the handles ([`crate::eval::FreeEdges`]).
    pub largest_stretch: f64,
    /// Whether all frames were finite and no such edge was stretched beyond [`crate::eval::STRETCH_LIMIT`].
    pub stable: bool,
}

impl Validation {
    /// Makes the scenes ready.
    pub fn new(config: &ValidationConfig) -> Result<Self> {
        let prepared = |kind: &str, mut scene: Scene, grid: Grid| {
            scene.regrid(grid)?;
            let case = Case { name: format!("{kind} {grid}"), scene, iterations: None };
            // The start is a frame, too.
            Prepared::new(case, config.frames + 1)
        };
        let mut scenes = Vec::new();
        for &grid in &config.grids {
            scenes.push((prepared("hanging", Scene::default(), grid)?, true));
        }
        if let Some(&finest) = config.grids.iter().max_by_key(|grid| grid.particles()) {
            let scene = Scene { start: Start::Flat, motion: Motion::Still, ..Scene::default() };
            scenes.push((prepared("falling", scene, finest)?, false));
        }
        Ok(Self { iterations: config.iterations, scenes })
    }

    /// Rolls every scene out on the CPU with these weights, in single precision, and measures the gaps. Nothing when `tick`, called
    /// in each frame, ended it.
    pub fn run(
        &self,
        weights: &Weights,
        mut tick: impl FnMut() -> ControlFlow<()>,
    ) -> Result<Option<Vec<SceneScore>>> {
        let optimizer = Optimizer::learned(weights.clone());
        let score = |(scene, with_gap): &(Prepared, bool)| {
            let run = scene.run((&optimizer, self.iterations), &Device::Cpu, *with_gap, &mut tick)?;
            Ok(run.map(|(score, _)| SceneScore::of(&score)))
        };
        self.scenes.iter().map(score).collect::<Result<_>>()
    }

    /// One number for weights, smaller is better: the mean gap, in which an unstable scene outweighs all gaps.
    pub fn score(scores: &[SceneScore]) -> f64 {
        let of = |s: &SceneScore| match s.gap.unwrap_or(0.0) {
            gap if s.stable && gap < UNSTABLE_GAP => gap,
            _ => UNSTABLE_GAP,
        };
        scores.iter().map(of).sum::<f64>() / scores.len() as f64
    }
}

impl SceneScore {
    fn of(score: &CaseScore) -> Self {
        Self {
            scene: score.case.clone(),
            // None that is not finite: JSON has no number for it, and it would be taken for a scene without one.
            gap: score.measured_gap().map(|gap| gap.min(UNSTABLE_GAP)),
            largest_stretch: score.stretch_largest.min(f64::MAX),
            stable: score.sound(),
        }
    }
}
