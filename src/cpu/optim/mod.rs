//! The optimizers on the CPU, which turn the gradient of a frame's energy into a step of the accelerations.

mod adam;
mod gd;
mod lbfgs;
mod rest_hessian;
mod sums;
mod update;
mod update_adj;

pub use adam::Adam;
pub use gd::GradientDescent;
pub(super) use lbfgs::History;
pub use lbfgs::Lbfgs;
pub use rest_hessian::{FactoredRestHessian, InverseHessian, RestHessian};
pub(super) use sums::{dot, norm};
pub use update::{Hidden, Update};
pub use update_adj::UpdateAdjoint;

use super::Real;
use crate::cloth::Model;
use crate::sim::Optimizer;
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
    /// Returns the scale of each sample, shape \[S\]; empty if the optimizer has none.
    fn scales(&self) -> &[T] {
        &[]
    }
}

/// Builds the optimizer for the cloths of `model`. Fails if the grid does not suit the network, if
/// there is not enough memory, or if the optimizer is Newton's method, which [`crate::cpu::Reference`]
/// implements.
pub fn minimizer<T: Real>(optimizer: &Optimizer, model: &Model) -> Result<Box<dyn Minimizer<T>>> {
    let (grid, batch) = (model.grid, model.batch());
    let cloth = 3 * grid.particles();
    Ok(match *optimizer {
        // Folding saves a layer but rounds the weights; double precision keeps them as they are.
        Optimizer::Learned(ref weights) => match size_of::<T>() < size_of::<f64>() {
            true => Box::new(Update::new(&weights.folded(), grid, 3 * batch)?),
            false => Box::new(Update::new(weights, grid, 3 * batch)?),
        },
        Optimizer::GradientDescent { rate } => Box::new(GradientDescent::new(rate)),
        Optimizer::Adam(settings) => Box::new(Adam::new(settings, batch * cloth)),
        Optimizer::Lbfgs(settings) => Box::new(Lbfgs::new(settings, cloth, batch)),
        Optimizer::QuasiNewton { lbfgs, factored } => Box::new(Lbfgs::from_rest(lbfgs, factored, model)?),
        Optimizer::Newton => {
            let expected = "a gradient-based optimizer";
            return Err(Error::invalid("optimizer", "newton", expected, "newton, which needs the Hessian"));
        }
    })
}
