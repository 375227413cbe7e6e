//! The seam between the host's side of training and the device's.

use super::checkpoint::Tensors;
use super::config::Config;
use super::cpu::CpuLearner;
use super::gpu::GpuLearner;
use super::ranks::Ranks;
use crate::Result;
use crate::network::Weights;
use crate::sim::{Cloth, Control, Device, EnergyTerms, Grid, Model, cast};
use num_traits::Float;

/// The device's side of training: the weights, AdamW's memory and the arrays of all pools.
pub trait Learner {
    /// One training step (paper section 3.3). For each cloth drawn:
    ///
    /// 1. where `start` is given, x is the sheet at rest, rotated; v and a are 0 and the optimizer's memory is fresh;
    /// 2. g = dL/da at a; the update rule makes a step; a <- a + step; the memory is kept;
    /// 3. the loss is the sum over batches of the mean over the batch of L at the new a. It goes back through step, tanh,
    ///    scale and network only, with the gradient-normalising rule;
    /// 4. where `advance` is set, the frame ends: v <- v + a, x <- x + v, handles at their targets with velocity 0, a <- 0,
    ///    and v loses the share `damping`.
    ///
    /// Then [`Ranks::join`] adds up the gradients of all ranks, and AdamW follows with the gradient's norm clipped,
    /// and the running mean of the weights. If the loss or the norm is not finite ([`StepReport::is_finite`]), weights,
    /// AdamW's memory and running mean stay as they are. With one rank the gradient need not leave the device.
    fn step(&mut self, batches: &[Batch], update: Update, ranks: &dyn Ranks) -> Result<StepReport>;

    /// The weights.
    fn weights(&self) -> Result<Weights>;

    /// The running mean of the weights.
    fn averaged(&self) -> Result<Weights>;

    /// All that a run needs to continue to the same bits.
    fn save(&self) -> Result<Tensors>;

    /// Name of the device, for people.
    fn device(&self) -> String;

    /// What tells the orders apart that learners have gradients in: alike where they can be added up.
    fn order(&self) -> u64 {
        0
    }

    /// Continues from what [`Learner::save`] gave.
    fn load(&mut self, saved: &Tensors) -> Result<()>;
}

/// The cloths that a step takes from one pool.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Index of the pool.
    pub pool: usize,
    /// The cloths, all different.
    pub cloths: Vec<Drawn>,
}

/// A cloth of a batch.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawn {
    /// Its place in the pool's arrays.
    pub slot: usize,
    /// Material, gravity and handles, at most [`super::MAX_HANDLES`]. No air.
    pub cloth: Cloth,
    /// Where its handles are at the end of the present frame \[edges\], in the order of `cloth.handles`.
    pub targets: Vec<[f64; 3]>,
    /// Rotation of the sheet at rest (rows of a matrix) where a new life starts.
    pub start: Option<[[f64; 3]; 3]>,
    /// Whether this iteration is the last of the frame.
    pub advance: bool,
    /// Share of its velocity that the cloth loses when the frame ends.
    pub damping: f64,
}

impl Batch {
    /// The cloths as a model.
    pub fn model(&self, grid: Grid) -> Model {
        Model { grid, cloths: self.cloths.iter().map(|drawn| drawn.cloth.clone()).collect() }
    }

    /// What drives the present frame of each of them.
    pub fn control<T: Float + Default>(&self) -> Control<T> {
        let targets = self.cloths.iter().flat_map(|drawn| &drawn.targets);
        Control { handles: targets.map(|p| p.map(cast)).collect(), ..Control::default() }
    }
}

/// How the weights are updated in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Update {
    /// Number of the update, counted from 1 without the steps that were skipped; AdamW corrects its bias with it.
    pub number: u64,
    /// Learning rate.
    pub rate: f64,
    /// Decay of the running mean of the weights; 0 makes it the weights.
    pub average: f64,
}

/// What a step tells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Norm of the gradient over all weights of the loss of all ranks, before clipping.
    pub gradient_norm: f64,
    /// The cloths drawn from each pool on this rank; none where it was not the pool's turn.
    pub outcomes: Vec<Vec<Outcome>>,
}

/// What became of a cloth in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Energy terms at the new a.
    pub energy: EnergyTerms,
    /// Natural logarithm of the mean over particles and components of |dL/da| at the new a.
    pub log_gradient: f64,
    /// Scale of the next step of each component.
    pub scale: [f64; 3],
}

impl StepReport {
    /// The loss of this rank: the sum over the batches of the mean energy of their cloths.
    pub fn loss(&self) -> f64 {
        let mean = |o: &Vec<Outcome>| o.iter().map(|o| o.energy.total()).sum::<f64>() / o.len() as f64;
        self.outcomes.iter().filter(|outcomes| !outcomes.is_empty()).map(mean).sum()
    }

    /// Whether the step can be used; all ranks find the same, as [`Ranks::join`] tells each of all losses.
    pub fn is_finite(&self) -> bool {
        self.gradient_norm.is_finite() && self.loss().is_finite()
    }
}

/// The learner of a device, beginning with `weights`.
pub fn learner(device: &Device, config: &Config, weights: &Weights) -> Result<Box<dyn Learner>> {
    match device {
        Device::Cpu => Ok(Box::new(CpuLearner::new(config, weights)?)),
        Device::Gpu(context) => Ok(Box::new(GpuLearner::new(context, config, weights)?)),
    }
}
