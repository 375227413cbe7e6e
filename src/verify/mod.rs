//! Checks of every stage against golden files, which hold arrays computed with the method's original
//! implementation.
//!
//! A file's name determines what it contains: `network_weights`, `network_forward_*`, `update_rule_*`,
//! `energy_*`, `repulsion_*`, `checkpoint_NAME`, `rollout_NAME_*`, `training_step*`, `adamw*`. Sizes are read
//! from the arrays, so files with other grids and seeds work as well. Every array is compared separately, so
//! that an error points to one stage.

mod checker;
mod cpu;
mod files;
mod golden;
mod gpu;

pub use cpu::CpuStages;
pub use files::verify_folder;
pub use gpu::GpuStages;

use crate::Result;
use crate::cloth::{Cloth, EnergyTerms, Grid, Repulsion};
use crate::network::Weights;
use std::sync::Arc;

/// The precision in which a device computes, which determines the tolerances.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// 64-bit floating point.
    Double,
    /// 32-bit floating point.
    Single,
    /// 32-bit floating point, with activations and weights of the network stored in 16 bits.
    Half,
}

/// The stages of a frame on some device. Every array is in double precision here, whatever the device
/// computes in.
pub trait Stages {
    /// Returns the name of the device and its precision.
    fn name(&self) -> String;

    /// Returns the precision of the device.
    fn precision(&self) -> Precision;

    /// Runs the network on `input` [S, fields, H, W].
    fn network(&mut self, weights: &Weights, grid: Grid, input: &[f64]) -> Result<NetworkOutput>;

    /// Returns the energy terms of each cloth and the gradient dL/da [B, 3, H, W].
    fn energy(&mut self, case: &EnergyCase) -> Result<(Vec<EnergyTerms>, Vec<f64>)>;

    /// Returns the repulsion of a cloth with positions [3, H, W] \[edges\]: its energy, and the gradient over
    /// the positions.
    fn repulsion(&mut self, grid: Grid, positions: &[f64], repulsion: Repulsion) -> Result<(f64, Vec<f64>)>;

    /// Applies the update rule once; returns the step [S, H, W] and the new scales `[S]`.
    fn update(&mut self, weights: &Weights, case: &UpdateCase) -> Result<(Vec<f64>, Vec<f64>)>;

    /// Returns the loss and the gradient of one training step. Not supported in [`Precision::Half`].
    fn training_step(&mut self, weights: &Weights, case: &TrainingCase) -> Result<TrainingOutput>;

    /// Returns the weights after each of several steps of AdamW.
    fn adamw(&mut self, case: &AdamWCase) -> Result<Vec<Vec<f64>>>;

    /// Returns the frames of a rollout from rest with a fresh hidden state.
    fn rollout(&mut self, weights: &Arc<Weights>, case: &RolloutCase) -> Result<Vec<RolloutFrame>>;
}

/// Returns the gradient of the repulsion's energy over positions [3, H, W], given the accelerations that the
/// repulsion causes: the force on a particle is its mass over `H W` times its acceleration.
fn gradient_of_push(grid: Grid, accelerations: &[f64]) -> Vec<f64> {
    let n = grid.particles();
    let mass = |p: usize| grid.mass(p / grid.w, p % grid.w) / n as f64;
    accelerations.iter().enumerate().map(|(k, a)| -mass(k % n) * a).collect()
}

/// The intermediate and final results of the network.
#[derive(Clone, Debug, Default)]
pub struct NetworkOutput {
    /// Fields with the positional channels, shape [S, fields + 2, H, W].
    pub embedded: Vec<f64>,
    /// Output of the lifting, shape [S, C, H, W].
    pub lifted: Vec<f64>,
    /// Output of each block, shape [S, C, H, W].
    pub blocks: Vec<Vec<f64>>,
    /// Field head, shape [S, H, W].
    pub field: Vec<f64>,
    /// Scalar head, shape `[S]`.
    pub scalar: Vec<f64>,
}

/// Cloths at a trial acceleration.
#[derive(Clone, Debug)]
pub struct EnergyCase {
    /// The grid.
    pub grid: Grid,
    /// The cloths, B of them. Their gravity and air are ignored.
    pub cloths: Vec<Cloth>,
    /// Positions at the start of the frame, shape [B, 3, H, W].
    pub x: Vec<f64>,
    /// Displacements without acceleration, shape [B, 3, H, W]: the trial moves free particles by `base + a`,
    /// handles by `base`.
    pub base: Vec<f64>,
    /// Accelerations, shape [B, 3, H, W].
    pub a: Vec<f64>,
    /// External accelerations, shape [B, 3, H, W].
    pub external: Vec<f64>,
}

/// Input of the update rule.
#[derive(Clone, Debug)]
pub struct UpdateCase {
    /// The grid.
    pub grid: Grid,
    /// Gradients, shape [S, H, W].
    pub grad: Vec<f64>,
    /// Last gradients, shape [S, H, W].
    pub last_grad: Vec<f64>,
    /// Last steps, shape [S, H, W].
    pub last_step: Vec<f64>,
    /// Scales, shape `[S]`.
    pub scale: Vec<f64>,
}

/// A batch of cloths in the middle of a frame, for one training step.
#[derive(Clone, Debug)]
pub struct TrainingCase {
    /// The grid.
    pub grid: Grid,
    /// The cloths, B of them, in still air.
    pub cloths: Vec<Cloth>,
    /// Handle positions of all cloths at the end of the frame.
    pub targets: Vec<[f64; 3]>,
    /// Positions at the start of the frame, shape [B, 3, H, W].
    pub x: Vec<f64>,
    /// Velocities, shape [B, 3, H, W].
    pub v: Vec<f64>,
    /// Accelerations so far, shape [B, 3, H, W].
    pub a: Vec<f64>,
    /// External accelerations, shape [B, 3, H, W].
    pub external: Vec<f64>,
    /// Last gradients, shape [S, H, W].
    pub last_grad: Vec<f64>,
    /// Last steps, shape [S, H, W].
    pub last_step: Vec<f64>,
    /// Scales, shape `[S]`.
    pub scale: Vec<f64>,
}

/// The results of a training step before the weights are updated.
#[derive(Clone, Debug)]
pub struct TrainingOutput {
    /// Mean over the batch of the energy after the step.
    pub loss: f64,
    /// The step, shape [S, H, W].
    pub step: Vec<f64>,
    /// Gradient over all weights, in the order of [`Weights::parameters`].
    pub gradient: Vec<f64>,
}

/// Several steps of AdamW with the authors' settings.
#[derive(Clone, Debug)]
pub struct AdamWCase {
    /// Weights at the start.
    pub before: Vec<f64>,
    /// Gradient of each step.
    pub gradients: Vec<Vec<f64>>,
    /// Norm to which gradients are clipped.
    pub clip: f64,
    /// Learning rate.
    pub rate: f64,
}

/// A rollout of one cloth.
#[derive(Clone, Debug)]
pub struct RolloutCase {
    /// The grid.
    pub grid: Grid,
    /// The cloth, in still air.
    pub cloth: Cloth,
    /// Iterations per frame.
    pub iterations: usize,
    /// Positions at the start, shape [3, H, W].
    pub start: Vec<f64>,
    /// Handle positions of each frame.
    pub targets: Vec<Vec<[f64; 3]>>,
}

/// One frame of a rollout.
#[derive(Clone, Debug)]
pub struct RolloutFrame {
    /// Positions, shape [3, H, W].
    pub x: Vec<f64>,
    /// Velocities, shape [3, H, W].
    pub v: Vec<f64>,
    /// Accelerations, shape [3, H, W].
    pub a: Vec<f64>,
    /// Scale after each iteration, shape [N, 3].
    pub scales: Vec<f64>,
    /// Gradient norm in each iteration, shape [N, 3].
    pub gradient_norms: Vec<f64>,
}

/// The result for one array, or for a file that could not be checked.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Check {
    /// Name of the file.
    pub file: String,
    /// Device and precision.
    pub device: String,
    /// The verdict.
    pub outcome: Verdict,
    /// What it rests on.
    #[serde(flatten)]
    pub finding: Finding,
}

/// What the verdict of a [`Check`] rests on.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[serde(untagged)]
pub enum Finding {
    /// An array compared with that of the file.
    Comparison {
        /// Name of the array.
        array: String,
        /// Largest absolute error.
        absolute: f64,
        /// Relative error, in the measure to which the tolerance applies.
        relative: f64,
        /// Largest relative error that passes.
        tolerance: f64,
    },
    /// No comparison.
    Message {
        /// What the file holds, or what prevented a comparison.
        message: String,
    },
}

/// The verdict of a [`Check`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Within the tolerance.
    Passed,
    /// Not within the tolerance, or damaged.
    Failed,
    /// Not checkable on this device.
    Skipped,
}

impl std::fmt::Display for Check {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let verdict = match self.outcome {
            Verdict::Passed => "pass",
            Verdict::Failed => "FAIL",
            Verdict::Skipped => "skip",
        };
        let Self { file, device, .. } = self;
        match &self.finding {
            Finding::Comparison { array, absolute, relative, tolerance } => {
                write!(f, "{verdict}  {file:30} {array:34} {device:9}")?;
                write!(f, " abs {absolute:.2e}  rel {relative:.2e}  tol {tolerance:.0e}")
            }
            Finding::Message { message } => write!(f, "{verdict}  {file:30} {device:9} {message}"),
        }
    }
}
