//! The interface between the host's side of training and the device's.

use super::checkpoint::Tensors;
use super::config::Config;
use super::cpu::CpuLearner;
use super::gpu::GpuLearner;
use super::ranks::Ranks;
use crate::Device;
use crate::Result;
use crate::cloth::{Cloth, Control, EnergyTerms, Grid, Model, cast};
use crate::network::Weights;
use num_traits::Float;

/// The device's side of training: the weights, AdamW's moments and the arrays of all pools.
pub trait Learner {
    /// Performs one training step (paper section 3.3). For each cloth drawn:
    ///
    /// 1. If `start` is given, x becomes the sheet at rest, rotated; v and a become 0 and the hidden state is
    ///    reset.
    /// 2. g = dL/da at a; the update rule computes a step; a <- a + step; the hidden state is updated.
    /// 3. The loss is the sum over batches of the batch mean of L at the new a. Backpropagation goes through
    ///    step, tanh, scale and network only, with the gradient normalisation rule.
    /// 4. If `advance` is set, the frame ends: v <- v + a, x <- x + v, a <- 0, handles are at their targets
    ///    with velocity 0, and v loses the fraction `damping`.
    ///
    /// Then [`Ranks::sum_gradients`] sums the gradients of all ranks, the gradient is clipped by its norm,
    /// and AdamW updates the weights and their running mean. If the loss or the norm is not finite
    /// ([`StepReport::is_finite`]), the weights, AdamW's moments and the running mean do not change. With one
    /// rank the gradient need not leave the device.
    fn step(&mut self, batches: &[Batch], update: WeightUpdate, ranks: &dyn Ranks) -> Result<StepReport>;

    /// Returns the weights.
    fn weights(&self) -> Result<Weights>;

    /// Returns the running mean of the weights.
    fn averaged(&self) -> Result<Weights>;

    /// Returns everything that a run needs to continue bit for bit.
    fn save(&self) -> Result<Tensors>;

    /// Returns the human-readable name of the device.
    fn device(&self) -> String;

    /// Returns an identifier of the parameter order in gradient vectors. Only gradients of the same order can
    /// be summed.
    fn gradient_order(&self) -> u64 {
        0
    }

    /// Restores the state that [`Learner::save`] returned.
    fn load(&mut self, saved: &Tensors) -> Result<()>;
}

/// The cloths that a step draws from one pool.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Index of the pool.
    pub pool: usize,
    /// The cloths, all distinct.
    pub cloths: Vec<Drawn>,
}

/// A cloth of a batch.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawn {
    /// Slot in the pool's arrays.
    pub slot: usize,
    /// Material, gravity and handles, at most [`super::MAX_HANDLES`]. No air.
    pub cloth: Cloth,
    /// Handle positions at the end of the current frame \[edges\], in the order of `cloth.handles`.
    pub targets: Vec<[f64; 3]>,
    /// Rotation of the sheet at rest (rows of a matrix) if a new life starts.
    pub start: Option<[[f64; 3]; 3]>,
    /// Whether this iteration is the last of the frame.
    pub advance: bool,
    /// Fraction of its velocity that the cloth loses when the frame ends.
    pub damping: f64,
}

impl Batch {
    /// Returns the cloths as a model.
    pub fn model(&self, grid: Grid) -> Model {
        Model { grid, cloths: self.cloths.iter().map(|drawn| drawn.cloth.clone()).collect() }
    }

    /// Returns the control of the current frame of all cloths.
    pub fn control<T: Float + Default>(&self) -> Control<T> {
        let targets = self.cloths.iter().flat_map(|drawn| &drawn.targets);
        Control { handles: targets.map(|p| p.map(cast)).collect(), ..Control::default() }
    }
}

/// Parameters of the weight update of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightUpdate {
    /// Index of the update, counted from 1 without skipped steps; used by AdamW's bias correction.
    pub number: u64,
    /// Learning rate.
    pub rate: f64,
    /// Decay of the running mean of the weights; with 0 the mean equals the weights.
    pub average: f64,
}

/// The result of a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Norm over all weights of the gradient of the loss of all ranks, before clipping.
    pub gradient_norm: f64,
    /// Outcomes of the cloths drawn from each pool on this rank; empty for a pool that took no part.
    pub outcomes: Vec<Vec<Outcome>>,
}

/// The outcome of a step for one cloth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Energy terms at the new a.
    pub energy: EnergyTerms,
    /// Natural logarithm of the mean over particles and components of |dL/da| at the new a.
    pub log_gradient: f64,
    /// Persistent scale of each component, used by the next step.
    pub scale: [f64; 3],
}

impl StepReport {
    /// Returns the loss of this rank: the sum over the batches of the mean energy of their cloths.
    pub fn loss(&self) -> f64 {
        let mean = |o: &Vec<Outcome>| o.iter().map(|o| o.energy.total()).sum::<f64>() / o.len() as f64;
        self.outcomes.iter().filter(|outcomes| !outcomes.is_empty()).map(mean).sum()
    }

    /// Returns whether the step is usable. All ranks agree, because [`Ranks::sum_gradients`] propagates
    /// non-finite losses.
    pub fn is_finite(&self) -> bool {
        self.gradient_norm.is_finite() && self.loss().is_finite()
    }
}

/// Creates the learner for a device, starting from `weights`.
pub fn learner(device: &Device, config: &Config, weights: &Weights) -> Result<Box<dyn Learner>> {
    match device {
        Device::Cpu => Ok(Box::new(CpuLearner::new(config, weights)?)),
        Device::Gpu(context) => Ok(Box::new(GpuLearner::new(context, config, weights)?)),
    }
}

#[cfg(test)]
mod tests {
    use super::{EnergyTerms, Outcome, StepReport};

    #[test]
    fn a_step_with_a_loss_or_gradient_that_is_not_finite_is_unusable() {
        let report = |gradient_norm, external| {
            let energy = EnergyTerms { external, ..EnergyTerms::default() };
            let outcomes = vec![vec![Outcome { energy, ..Outcome::default() }], vec![]];
            StepReport { gradient_norm, outcomes }
        };
        assert!(report(1.0, 2.0).is_finite());
        assert!(!report(f64::NAN, 2.0).is_finite() && !report(f64::INFINITY, 2.0).is_finite());
        assert!(!report(1.0, f64::NAN).is_finite() && !report(1.0, f64::NEG_INFINITY).is_finite());
    }
}
