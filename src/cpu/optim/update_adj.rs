//! The update rule with its backward passes: the one that training takes (paper section 3.3) through step, tanh, scale and
//! network to the weights, where gradients, states and memory are constants; and the one to these, where the weights are.

use super::update::{NORM_FLOOR, SQUASH};
use super::{Hidden, dot, norm};
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
    adj_input: Vec<T>,
    adj_field: Vec<T>,
    adj_scalar: Vec<T>,
    /// Cotangent of the scale of each sample after the iteration, all paths together.
    adj_scale: Vec<f64>,
}

/// Cotangents of one sample.
struct SampleAdj<'a, T> {
    /// Of `tanh(field)`.
    tanh: &'a mut [T],
    /// Of `2 tanh(scalar / 2) - 1`.
    exponent: f64,
}

impl<T: Real> UpdateAdjoint<T> {
    /// The update rule of a network; an error if the grid is too small for the kept modes.
    pub fn new(weights: &Weights, grid: Grid, samples: usize) -> Result<Self> {
        let zeros = |n| vec![T::zero(); n];
        let len = samples * grid.particles();
        let network = Adjoint::new(weights, grid, samples)?;
        Ok(Self {
            network,
            input: zeros(3 * len),
            adj_input: zeros(3 * len),
            adj_field: zeros(len),
            adj_scalar: zeros(samples),
            adj_scale: vec![0.0; samples],
        })
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

    /// Adds the gradient over all weights to `gradient`, for the cotangents `adj_a` [S, H, W] of what the step was added to
    /// and `adj` of the memory after it, `hidden`.
    ///
    /// On the way back the cotangent of `tanh(field)` and that of `2 tanh(scalar / 2) - 1` are divided by their own norm,
    /// sample by sample, and clamped: every cloth weighs the same, whatever its energies are (the authors' rule; no true
    /// adjoint).
    pub fn backward(&mut self, adj_a: &[T], adj: &Hidden<T>, hidden: &Hidden<T>, gradient: &mut [T]) {
        self.outputs_adj(adj_a, adj, hidden, |adj| {
            // A cloth in equilibrium has cotangents near 0: the factor stays finite, so that 0 times it is 0.
            let factor = norm(adj.tanh).max(NORM_FLOOR).recip();
            adj.exponent = (adj.exponent / adj.exponent.abs().max(NORM_FLOOR)).clamp(-CLAMP, CLAMP);
            for adj in &mut *adj.tanh {
                *adj = T::of((adj.f64() * factor).clamp(-CLAMP, CLAMP));
            }
        });
        self.network.backward(&self.input, (&self.adj_field, &self.adj_scalar), gradient);
    }

    /// The true adjoint of an iteration, weights aside: for the cotangents `adj_a` [S, H, W] of what its step was added to and
    /// `adj` of the memory after it, sets `adj_grad` [S, H, W] to the cotangent of its gradient and `adj` to that of the
    /// memory before it. `before` and `after` are what was remembered.
    pub fn pull_back(
        &mut self,
        adj_a: &[T],
        adj: &mut Hidden<T>,
        (before, after): (&Hidden<T>, &Hidden<T>),
        adj_grad: &mut [T],
    ) {
        self.outputs_adj(adj_a, adj, after, |_| ());
        self.network.backward_input(&self.input, (&self.adj_field, &self.adj_scalar), &mut self.adj_input);
        // The gradient is remembered as it is, and seen by the network in proportion to its size.
        adj_grad.copy_from_slice(&adj.last_grad);
        let n = adj_a.len() / before.scale.len();
        for (sample, adj_grad) in adj_grad.chunks_exact_mut(n).enumerate() {
            let at = sample * n..(sample + 1) * n;
            let (grad, last_grad) = (&after.last_grad[at.clone()], &before.last_grad[at.clone()]);
            let last_step = &before.last_step[at.clone()];
            let adj_last_grad = &mut adj.last_grad[at.clone()];
            let adj_last_step = &mut adj.last_step[at];
            let fields = 3 * sample * n..3 * (sample + 1) * n;
            let (adj_input, input) = (&mut self.adj_input[fields.clone()], &self.input[fields]);
            let sizes = [grad, grad, last_step].map(|x| norm(x) / (n as f64).sqrt());
            for ((adj, input), size) in adj_input.chunks_exact_mut(n).zip(input.chunks_exact(n)).zip(sizes) {
                squash_adj(adj, input, size);
            }
            let [now, before_it, stepped] = [0, 1, 2].map(|field| &adj_input[field * n..][..n]);
            adj_last_grad.copy_from_slice(before_it);
            adj_last_step.copy_from_slice(stepped);
            let of_size = dot(now, grad) + dot(before_it, last_grad);
            adj_grad.iter_mut().zip(now).for_each(|(to, &adj)| *to = *to + adj);
            size_adj(adj_grad, grad, sizes[0], of_size);
            size_adj(adj_last_step, last_step, sizes[2], dot(stepped, last_step));
            let ratio = after.scale[sample].f64() / before.scale[sample].f64();
            adj.scale[sample] = T::of(self.adj_scale[sample] * ratio);
        }
    }

    /// Sets the cotangents of the network's field and scalar; `rule` may change those of `tanh(field)` and of the exponent.
    fn outputs_adj(
        &mut self,
        adj_a: &[T],
        adj: &Hidden<T>,
        hidden: &Hidden<T>,
        rule: impl Fn(&mut SampleAdj<'_, T>) + Sync,
    ) {
        let n = adj_a.len() / hidden.scale.len();
        let to = self.adj_field.par_chunks_exact_mut(n).zip(&mut self.adj_scalar).zip(&mut self.adj_scale);
        let outputs = self.network.field().par_chunks_exact(n).zip(self.network.scalar());
        let steps = adj_a.par_chunks_exact(n).zip(adj.last_step.par_chunks_exact(n));
        let scales = hidden.scale.par_iter().zip(&adj.scale);
        to.zip(outputs).zip(steps).zip(scales).for_each(
            |(
                ((((adj_field, adj_scalar), to_scale), (field, scalar)), (adj_a, adj_step)),
                (&scale, &adj_scale),
            )| {
                let mut tanh_field = field.to_vec();
                T::squash(&mut tanh_field, T::one(), T::one());
                for ((to, &adj), &more) in adj_field.iter_mut().zip(adj_a).zip(adj_step) {
                    *to = adj + more;
                }
                let product = |(&u, &adj): (&T, &T)| u.f64() * adj.f64();
                *to_scale = adj_scale.f64() + tanh_field.iter().zip(&*adj_field).map(product).sum::<f64>();
                adj_field.iter_mut().for_each(|adj| *adj = *adj * scale);
                let mut both = SampleAdj { tanh: adj_field, exponent: *to_scale * scale.f64() };
                rule(&mut both);
                let tanh = (scalar.f64() / 2.0).tanh();
                *adj_scalar = T::of(both.exponent * (1.0 - tanh * tanh));
                for (adj, u) in adj_field.iter_mut().zip(tanh_field) {
                    *adj = *adj * (T::one() - u * u);
                }
            },
        );
    }
}

/// From the cotangent of what a field of this size became, `10 tanh(field / size / 10)`, to that of the field, its size apart.
fn squash_adj<T: Real>(adj: &mut [T], squashed: &[T], size: f64) {
    // What is zero stays zero whatever it is divided by.
    let factor = if size > NORM_FLOOR { size.recip() } else { 0.0 };
    for (adj, &squashed) in adj.iter_mut().zip(squashed) {
        let tanh = squashed.f64() / SQUASH;
        *adj = T::of(adj.f64() * factor * (1.0 - tanh * tanh));
    }
}

/// Adds what comes back through the size, a root mean square, that fields were divided by: `of_size` is the sum of those
/// fields times the cotangents after [`squash_adj`].
fn size_adj<T: Real>(adj: &mut [T], field: &[T], size: f64, of_size: f64) {
    if size > NORM_FLOOR {
        let factor = -of_size / (field.len() as f64 * size * size);
        adj.iter_mut().zip(field).for_each(|(adj, &x)| *adj = *adj + T::of(factor * x.f64()));
    }
}
