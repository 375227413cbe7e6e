//! The update rule with its backward pass for training (paper section 3.3). It differentiates through step,
//! tanh, scale and network; gradients, states and the hidden state are constants.

use super::update::NORM_FLOOR;
use super::{Hidden, norm};
use crate::Result;
use crate::cloth::Grid;
use crate::cpu::Real;
use crate::cpu::operator::{Adjoint, LaidOut};
use crate::network::Weights;
use crate::settings::{CLAMP, Normalisation};
use rayon::prelude::*;

/// The update rule for a number of samples on one grid, forward and backward. The caller owns the hidden
/// state.
pub struct UpdateAdjoint<T: Real> {
    network: Adjoint<T>,
    normalisation: Normalisation,
    /// Normalised gradient, last gradient and last step, shape [S, 3, H, W].
    input: Vec<T>,
    adj_field: Vec<T>,
    adj_scalar: Vec<T>,
    /// Per sample, before normalisation: the norm of the cotangent of tanh(field), and the cotangent of the
    /// scale's exponent.
    sizes: Vec<[f64; 2]>,
}

impl<T: Real> UpdateAdjoint<T> {
    /// Builds the update rule of a network. Fails if the grid is too small for the kept modes
    /// or there is not enough memory.
    ///
    /// Panics if `normalisation` is over cloths and `samples` is not a multiple of three.
    pub fn new(
        weights: &Weights,
        (grid, samples): (Grid, usize),
        normalisation: Normalisation,
    ) -> Result<Self> {
        assert_eq!(samples % normalisation.samples(), 0, "whole cloths");
        let zeros = |n| vec![T::zero(); n];
        let len = samples * grid.particles();
        Ok(Self {
            network: Adjoint::new(weights, grid, samples)?,
            normalisation,
            input: zeros(3 * len),
            adj_field: zeros(len),
            adj_scalar: zeros(samples),
            sizes: vec![[0.0; 2]; samples],
        })
    }

    /// Replaces the weights with others of the same sizes.
    pub fn set_weights(&mut self, weights: &LaidOut<T>) {
        self.network.set_weights(weights);
    }

    /// Adds a step to `a` [S, H, W] for the gradient `grad` [S, H, W] with norms `norms` \[S\], and stores
    /// both in `hidden`.
    pub fn forward(&mut self, (grad, norms): (&[T], &[f64]), hidden: &mut Hidden<T>, a: &mut [T]) {
        hidden.normalise(&mut self.input, grad, norms);
        self.network.forward(&self.input);
        hidden.remember(grad, (self.network.field(), self.network.scalar()));
        a.iter_mut().zip(&hidden.last_step).for_each(|(a, &step)| *a = *a + step);
    }

    /// Adds the gradient over all weights to `gradient`, given the cotangents `adj_step` [S, H, W] of the
    /// last step, which `hidden` must still hold.
    ///
    /// The cotangents of `tanh(field)` and of `2 tanh(scalar / 2) - 1` are each divided by the norm that
    /// [`Normalisation`] selects, and clamped. Every component, or every cloth, then weighs the same,
    /// whatever its energy. This is the authors' rule, not a true adjoint.
    pub fn backward(&mut self, adj_step: &[T], hidden: &Hidden<T>, gradient: &mut [T]) {
        let n = adj_step.len() / hidden.scale.len();
        let steps = || adj_step.par_chunks_exact(n).zip(&hidden.scale);
        let fields = self.adj_field.par_chunks_exact_mut(n).zip(self.network.field().par_chunks_exact(n));
        fields.zip(&mut self.sizes).zip(steps()).for_each(|(((tanh, field), sizes), (adj_step, &scale))| {
            tanh.copy_from_slice(field);
            T::squash(tanh, T::one(), T::one());
            let product = |(&u, &adj): (&T, &T)| u.f64() * adj.f64();
            let adj_scale: f64 = tanh.iter().zip(adj_step).map(product).sum();
            *sizes = [norm(adj_step), adj_scale].map(|size| size * scale.f64());
        });
        let group = self.normalisation.samples();
        let cotangents = self.adj_field.par_chunks_exact_mut(n).zip(&mut self.adj_scalar);
        let each = cotangents.zip(self.network.scalar()).zip(steps()).enumerate();
        each.for_each(|(sample, (((field, adj_scalar), scalar), (adj_step, &scale)))| {
            let cloth = &self.sizes[sample / group * group..][..group];
            let norms = [0, 1].map(|k| {
                let squares: f64 = cloth.iter().map(|sizes| sizes[k] * sizes[k]).sum();
                (squares / group as f64).sqrt().max(NORM_FLOOR)
            });
            let adj_exponent = (self.sizes[sample][1] / norms[1]).clamp(-CLAMP, CLAMP);
            let tanh = (scalar.f64() / 2.0).tanh();
            *adj_scalar = T::of(adj_exponent * (1.0 - tanh * tanh));
            // A cloth in equilibrium has cotangents near 0. The factor stays finite, so that 0 times it is 0.
            let factor = scale.f64() / norms[0];
            // Replaces tanh(field) by the cotangent of the field.
            for (u, &adj) in field.iter_mut().zip(adj_step) {
                let adj = T::of((adj.f64() * factor).clamp(-CLAMP, CLAMP));
                *u = adj * (T::one() - *u * *u);
            }
        });
        self.network.backward(&self.input, (&self.adj_field, &self.adj_scalar), gradient);
    }
}
