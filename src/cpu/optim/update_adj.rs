//! The update rule with its backward pass, as training takes it (paper section 3.3): through step, tanh, scale and network;
//! gradients, states and memory are constants.

use super::update::NORM_FLOOR;
use super::{Hidden, norm};
use crate::Result;
use crate::cpu::Real;
use crate::cpu::operator::{Adjoint, LaidOut};
use crate::network::Weights;
use crate::sim::Grid;
use rayon::prelude::*;

/// Bound of a normalised cotangent.
const CLAMP: f64 = 10.0;

/// The update rule for a number of samples on one grid, forward and backward. The memory is the caller's.
pub struct UpdateAdjoint<T: Real> {
    network: Adjoint<T>,
    /// Normalised gradient, last gradient and last step, shape [S, 3, H, W].
    input: Vec<T>,
    adj_field: Vec<T>,
    adj_scalar: Vec<T>,
}

impl<T: Real> UpdateAdjoint<T> {
    /// The update rule of a network; an error if the grid is too small for the kept modes.
    pub fn new(weights: &Weights, grid: Grid, samples: usize) -> Result<Self> {
        let zeros = |n| vec![T::zero(); n];
        let len = samples * grid.particles();
        let network = Adjoint::new(weights, grid, samples)?;
        Ok(Self { network, input: zeros(3 * len), adj_field: zeros(len), adj_scalar: zeros(samples) })
    }

    /// Takes other weights of the same sizes.
    pub fn set_weights(&mut self, weights: &LaidOut<T>) {
        self.network.set_weights(weights);
    }

    /// Adds a step to `a` [S, H, W] for the gradient `grad` [S, H, W] with norms `norms` \[S\]; `hidden` remembers it.
    pub fn forward(&mut self, (grad, norms): (&[T], &[f64]), hidden: &mut Hidden<T>, a: &mut [T]) {
        hidden.normalise(&mut self.input, grad, norms);
        self.network.forward(&self.input);
        hidden.remember(grad, (self.network.field(), self.network.scalar()), a);
    }

    /// Adds the gradient over all weights to `gradient`, for the cotangents `adj_step` [S, H, W] of the last step, which
    /// `hidden` still remembers.
    ///
    /// On the way back the cotangent of `tanh(field)` and that of `2 tanh(scalar / 2) - 1` are divided by their own norm,
    /// sample by sample, and clamped: every cloth weighs the same, whatever its energies are (the authors' rule; no true
    /// adjoint).
    pub fn backward(&mut self, adj_step: &[T], hidden: &Hidden<T>, gradient: &mut [T]) {
        let n = adj_step.len() / hidden.scale.len();
        let samples = self.adj_field.par_chunks_exact_mut(n).zip(&mut self.adj_scalar);
        let outputs = self.network.field().par_chunks_exact(n).zip(self.network.scalar());
        let steps = adj_step.par_chunks_exact(n).zip(&hidden.scale);
        samples.zip(outputs).zip(steps).for_each(
            |(((adj_field, adj_scalar), (field, scalar)), (adj_step, &scale))| {
                // tanh(field) here, its cotangent below.
                adj_field.copy_from_slice(field);
                T::squash(adj_field, T::one(), T::one());
                let product = |(&u, &adj): (&T, &T)| u.f64() * adj.f64();
                let adj_scale: f64 = adj_field.iter().zip(adj_step).map(product).sum();
                let adj_exponent = adj_scale * scale.f64();
                let adj_exponent = (adj_exponent / adj_exponent.abs().max(NORM_FLOOR)).clamp(-CLAMP, CLAMP);
                let tanh = (scalar.f64() / 2.0).tanh();
                *adj_scalar = T::of(adj_exponent * (1.0 - tanh * tanh));
                let norm = (scale.f64() * norm(adj_step)).max(NORM_FLOOR);
                // A cloth in equilibrium has cotangents near 0: the factor stays finite, so that 0 times it is 0.
                let factor = scale.f64() / norm;
                for (u, &adj) in adj_field.iter_mut().zip(adj_step) {
                    let adj = T::of((adj.f64() * factor).clamp(-CLAMP, CLAMP));
                    *u = adj * (T::one() - *u * *u);
                }
            },
        );
        self.network.backward(&self.input, (&self.adj_field, &self.adj_scalar), gradient);
    }
}
