//! Rollouts of fixed scenes, by which weights are judged.

use super::config::ValidationConfig;

use crate::cpu::Track;
use crate::eval::{FreeEdges, STRETCH_LIMIT};
use crate::network::Weights;
use crate::scene::{Motion, Scene, Setup, Start};
use crate::sim::{Grid, Optimizer, State};
use crate::{Result, cpu};
use std::cell::OnceCell;

/// What an unstable scene counts for in the score, in energy gaps: more than any gap of a stable one.
const UNSTABLE_GAP: f64 = 10.0;

/// Scenes made ready: a sheet that hangs from two corners and swings along `xy_v2`, on each grid of the configuration, and
/// a flat sheet that falls, held by two corners, on the finest of them. Default material, air, 60 frames per second.
pub struct Validation {
    iterations: usize,
    frames: usize,
    scenes: Vec<Judged>,
}

/// A scene, and what the energy gaps in it are measured on.
struct Judged {
    name: String,
    setup: Setup,
    /// Whether the gap counts, or only stability does.
    with_gap: bool,
    /// Converged frames, computed when first needed.
    track: OnceCell<Track>,
}

/// How weights did in one scene.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SceneScore {
    /// Name of the scene, such as `hanging 64x64`.
    pub scene: String,
    /// Median over the frames of the energy gap `(L_N - L_ref) / (L_0 - L_ref)` after N iterations, the frames being those of
    /// a converged simulation; nothing in the falling scene.
    pub gap: Option<f64>,
    /// Largest `|edge| - 1` over all frames, of the edges that are away from the handles ([`FreeEdges`]).
    pub largest_stretch: f64,
    /// Whether all frames were finite and no such edge was stretched beyond [`STRETCH_LIMIT`].
    pub stable: bool,
}

impl Validation {
    /// Makes the scenes ready.
    pub fn new(config: &ValidationConfig) -> Result<Self> {
        let mut scenes = Vec::new();
        for &grid in &config.grids {
            scenes.push(Judged::new("hanging", Scene::default(), grid, true)?);
        }
        if let Some(&finest) = config.grids.iter().max_by_key(|grid| grid.particles()) {
            let scene = Scene { start: Start::Flat, motion: Motion::Still, ..Scene::default() };
            scenes.push(Judged::new("falling", scene, finest, false)?);
        }
        Ok(Self { iterations: config.iterations, frames: config.frames, scenes })
    }

    /// Rolls every scene out on the CPU with these weights, in single precision, and measures the gaps.
    pub fn run(&self, weights: &Weights) -> Result<Vec<SceneScore>> {
        let optimizer = Optimizer::learned(weights.clone());
        self.scenes.iter().map(|scene| scene.judge(&optimizer, self.frames, self.iterations)).collect()
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

impl Judged {
    fn new(kind: &str, mut scene: Scene, grid: Grid, with_gap: bool) -> Result<Self> {
        scene.regrid(grid)?;
        Ok(Self { name: format!("{kind} {grid}"), setup: scene.setup()?, with_gap, track: OnceCell::new() })
    }

    fn judge(&self, optimizer: &Optimizer, frames: usize, iterations: usize) -> Result<SceneScore> {
        let Setup { model, start, .. } = &self.setup;
        let edges = FreeEdges::new(model, 0);
        let mut solver = cpu::Solver::<f32>::new(model, optimizer, iterations)?;
        let mut state: State<f32> = start.cast();
        let (mut largest_stretch, mut stable) = (0.0, true);
        for frame in 1..=frames {
            let finite = solver.step(&mut state, &self.setup.control(frame))[0].is_finite();
            largest_stretch = edges.largest(&state.x).max(largest_stretch);
            stable = finite && largest_stretch <= STRETCH_LIMIT;
            if !stable {
                break;
            }
        }
        let gap = || {
            if self.track.get().is_none() {
                let controls = (1..=frames).map(|frame| self.setup.control(frame));
                let track = Track::new(model, start.clone(), controls)?;
                self.track.set(track).ok().expect("it was not set");
            }
            self.track.get().expect("it was set").median_gap(optimizer, iterations)
        };
        // None that is not finite: JSON has no number for it, and it would be taken for a scene without one.
        let gap = self.with_gap.then(gap).transpose()?.map(|gap| gap.min(UNSTABLE_GAP));
        let largest_stretch = largest_stretch.min(f64::MAX);
        Ok(SceneScore { scene: self.name.clone(), gap, largest_stretch, stable })
    }
}
