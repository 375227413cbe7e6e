//! The loss of a batch of cloths on one grid and its gradient over the weights (paper section 3.3): the
//! energies that one iteration of the learned optimizer leads to.

use crate::Result;
use crate::cloth::{Control, EnergyTerms, Model, State};
use crate::cpu::operator::LaidOut;
use crate::cpu::optim::{Hidden, UpdateAdjoint};
use crate::cpu::{Objective, Real};
use crate::network::Weights;
use crate::settings::Normalisation;

/// The loss for batches of B cloths on one grid.
pub struct Loss<T: Real> {
    objective: Objective<T>,
    update: UpdateAdjoint<T>,
    adj_step: Vec<T>,
}

/// The result of a step for one cloth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClothLoss {
    /// Energy terms after the step.
    pub energy: EnergyTerms,
    /// Mean over particles and components of |dL/da| after the step.
    pub mean_gradient: f64,
}

impl<T: Real> Loss<T> {
    /// Builds the loss for batches of the sizes of `model`. Returns an error if the grid is too small for the
    /// kept modes or there is not enough memory.
    pub fn new(weights: &Weights, model: &Model, normalisation: Normalisation) -> Result<Self> {
        let objective = Objective::new(model);
        let update = UpdateAdjoint::new(weights, (model.grid, 3 * model.batch()), normalisation)?;
        let adj_step = vec![T::zero(); objective.grad().len()];
        Ok(Self { objective, update, adj_step })
    }

    /// Replaces the weights with others of the same sizes.
    pub fn set_weights(&mut self, weights: &LaidOut<T>) {
        self.update.set_weights(weights);
    }

    /// Replaces the cloths with as many others on the same grid.
    pub fn set_model(&mut self, model: &Model) {
        self.objective.set_model(model);
    }

    /// Runs one iteration of the frame that `control` drives from `state`: adds the step to `a` [B, 3, H, W]
    /// and stores it in `hidden`. Adds to `gradient` the gradient over all weights of `share` times the sum
    /// of the energies.
    pub fn step(
        &mut self,
        (state, control): (&State<T>, &Control<T>),
        (a, hidden): (&mut [T], &mut Hidden<T>),
        share: f64,
        gradient: &mut [T],
    ) -> Vec<ClothLoss> {
        let Self { objective, update, adj_step } = self;
        objective.begin_frame(state, control);
        objective.set_accelerations(a);
        objective.evaluate(state, control);
        update.forward((&objective.grad, &objective.norms), hidden, &mut objective.trial.a);
        a.copy_from_slice(&objective.trial.a);
        objective.evaluate(state, control);
        let share = T::of(share);
        for (adj, &grad) in adj_step.iter_mut().zip(objective.grad()) {
            *adj = grad * share;
        }
        update.backward(adj_step, hidden, gradient);
        let cloth = objective.cloth_len();
        let outcome = |(b, grad): (usize, &[T])| ClothLoss {
            energy: objective.energy(state, b),
            mean_gradient: grad.iter().map(|g| g.f64().abs()).sum::<f64>() / cloth as f64,
        };
        objective.grad().chunks_exact(cloth).enumerate().map(outcome).collect()
    }
}
