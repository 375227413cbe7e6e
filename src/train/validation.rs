//! Rollouts of fixed scenes, by which weights are judged.

use super::config::ValidationConfig;
use crate::network::Weights;
use crate::scene::{Motion, Scene, Setup, Start};
use crate::sim::{Optimizer, State};
use crate::{Result, cpu};

/// An edge that is this much longer than at rest tells that the rollout blew up: sheets of the fixed scenes on up to
/// 100x100 particles stay below 1.
const UNSTABLE_STRETCH: f64 = 3.0;

/// Scenes made ready: a sheet that hangs from two corners and swings along `xy_v2`, on each grid of the configuration, and
/// a flat sheet that falls, held by two corners, on the finest of them. Default material, air, 60 frames per second.
pub struct Validation {
    iterations: usize,
    frames: usize,
    scenes: Vec<(String, Setup)>,
}

/// How weights did in one scene.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct SceneScore {
    /// Name of the scene, such as `hanging 64x64`.
    pub scene: String,
    /// Median over the frames of what the iterations have left to do: `|dL/da|` at the last iteration over that at the
    /// first; 0 would be the minimum. Infinite when the rollout was unstable.
    pub remainder: f64,
    /// Largest `|edge| - 1` over all frames.
    pub largest_stretch: f64,
    /// Whether all frames were finite and no edge was longer than four times its length at rest.
    pub stable: bool,
}

impl Validation {
    /// Makes the scenes ready.
    pub fn new(config: &ValidationConfig) -> Result<Self> {
        let mut scenes = Vec::new();
        for &grid in &config.grids {
            let mut scene = Scene::default();
            scene.regrid(grid)?;
            scenes.push((format!("hanging {grid}"), scene));
        }
        if let Some(&finest) = config.grids.iter().max_by_key(|grid| grid.particles()) {
            let mut scene = Scene { start: Start::Flat, motion: Motion::Still, ..Scene::default() };
            scene.regrid(finest)?;
            scenes.push((format!("falling {finest}"), scene));
        }
        let ready = |(name, scene): (String, Scene)| Ok((name, scene.setup()?));
        let scenes = scenes.into_iter().map(ready).collect::<Result<_>>()?;
        Ok(Self { iterations: config.iterations, frames: config.frames, scenes })
    }

    /// Rolls every scene out on the CPU with these weights.
    pub fn run(&self, weights: &Weights) -> Result<Vec<SceneScore>> {
        let optimizer = Optimizer::learned(weights.clone());
        self.scenes.iter().map(|(name, setup)| self.rollout(name, setup, &optimizer)).collect()
    }

    fn rollout(&self, name: &str, setup: &Setup, optimizer: &Optimizer) -> Result<SceneScore> {
        let mut solver = cpu::Solver::<f32>::new(&setup.model, optimizer, self.iterations)?;
        let mut state: State<f32> = setup.start.cast();
        let mut remainders = Vec::new();
        let (mut largest_stretch, mut stable) = (f64::NEG_INFINITY, true);
        for frame in 1..=self.frames {
            let stats = solver.step(&mut state, &setup.control(frame))[0];
            largest_stretch = largest_stretch.max(stats.stretch_largest);
            remainders.push(stats.gradient_last / stats.gradient_first);
            stable = stats.is_finite() && stats.stretch_largest < UNSTABLE_STRETCH;
            if !stable {
                break;
            }
        }
        let remainder = if stable { median(&mut remainders) } else { f64::INFINITY };
        Ok(SceneScore { scene: name.to_owned(), remainder, largest_stretch, stable })
    }

    /// One number for weights, smaller is better: the mean remainder, infinite when a scene was unstable.
    pub fn score(scores: &[SceneScore]) -> f64 {
        scores.iter().map(|s| s.remainder).sum::<f64>() / scores.len() as f64
    }
}

/// The median of some numbers; the upper one of two.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
