//! The optimizers on the CPU, which turn the gradient of a frame's energy into a step of the accelerations.

mod adam;
mod extrapolate;
mod gd;
mod lbfgs;
mod passes;
mod rest_hessian;
mod sheet_hessian;
mod subspace;
mod sums;
mod update;
mod update_adj;

pub use adam::Adam;
pub use extrapolate::{Extrapolation, best_start};
pub use gd::GradientDescent;
pub(super) use lbfgs::History;
pub use lbfgs::Lbfgs;
pub use rest_hessian::{Cosines, FactoredRestHessian, InverseHessian, RestHessian};
pub use sheet_hessian::{SheetHessian, SheetSteps};
pub use subspace::{BestStep, Subspace, best_step};
pub(super) use sums::{dot, norm};
pub use update::{Hidden, Update};
pub use update_adj::UpdateAdjoint;

use super::Real;
use crate::cloth::Model;
use crate::network::Weights;
use crate::sim::{Direction, Initial, Length, Optimizer};
use crate::{Error, Result};

/// An optimizer running on a batch of cloths.
pub trait Minimizer<T>: Send + Sync {
    /// Starts a frame, at a = 0.
    fn begin_frame(&mut self) {}
    /// Adds a step to the accelerations `a`, given `grad` = dL/da at `a` and `norms`, its norm for each
    /// component of each cloth; shapes [B, 3, H, W] and \[S\] with S = 3 B.
    fn step(&mut self, grad: &[T], norms: &[f64], a: &mut [T]);
    /// Clears the state kept across frames for this cloth, as when it restarts. Most optimizers keep none.
    fn reset_memory_of(&mut self, _cloth: usize) {}
    /// Returns the hidden state of a network; `None` for other optimizers, which keep nothing from frame to frame.
    fn hidden_mut(&mut self) -> Option<&mut Hidden<T>> {
        None
    }
    /// Returns the scale of each sample, shape \[S\]; empty if the optimizer has none.
    fn scales(&self) -> &[T] {
        &[]
    }
}

/// Builds an optimizer with a fixed length or along secants for the cloths of `model`. Fails if the grid does not suit the network,
/// if there is not enough memory, or if its length is another: [`Subspace`] and [`crate::cpu::Reference`] see more
/// than the gradient.
pub fn minimizer<T: Real>(optimizer: &Optimizer, model: &Model) -> Result<Box<dyn Minimizer<T>>> {
    T::minimizer(optimizer, model)
}

pub(super) fn generic_minimizer<T: Real>(
    optimizer: &Optimizer,
    model: &Model,
) -> Result<Box<dyn Minimizer<T>>> {
    let (batch, cloth) = (model.batch(), 3 * model.grid.particles());
    let refused = || {
        let expected = "one direction that depends on the gradient alone, and a length that does, too";
        Error::invalid("optimizer", "directions", expected, optimizer.name())
    };
    let [direction] = &optimizer.directions[..] else { return Err(refused()) };
    Ok(match (direction, optimizer.length) {
        (Direction::Network(weights), Length::Fixed(_)) => Box::new(update(weights, model)?),
        (Direction::Gradient, Length::Fixed(rate)) => Box::new(GradientDescent::new(rate)),
        (Direction::Adam(settings), Length::Fixed(_)) => Box::new(Adam::new(*settings, batch * cloth)),
        (&Direction::Lbfgs { settings, initial }, length @ (Length::Fixed(_) | Length::Secant)) => {
            let lbfgs = match initial {
                Initial::Identity => Lbfgs::new(settings, cloth, batch),
                _ => Lbfgs::from_rest(settings, initial == Initial::Factored, model)?,
            };
            Box::new(if length == Length::Secant { lbfgs.along_secants() } else { lbfgs })
        }
        _ => return Err(refused()),
    })
}

/// Builds the learned update rule for the cloths of `model`.
fn update<T: Real>(weights: &Weights, model: &Model) -> Result<Update<T>> {
    // Folding saves a layer but rounds the weights; double precision keeps them as they are.
    let samples = 3 * model.batch();
    match size_of::<T>() < size_of::<f64>() {
        true => Update::new(&weights.folded(), model.grid, samples),
        false => Update::new(weights, model.grid, samples),
    }
}
