//! The learned update rule (paper section 3.3), which turns gradients into a step and remembers the previous
//! one.

use super::{Minimizer, norm};
use crate::Result;
use crate::cloth::Grid;
use crate::cpu::Real;
use crate::cpu::operator::{Network, samples_per_pass};
use crate::network::Weights;
use crate::sim::INITIAL_SCALE;
use rayon::prelude::*;

/// Amplitude to which the normalised fields are squashed, `10 tanh(. / 10)`.
const SQUASH: f64 = 10.0;
/// Lower bound of a norm. Below the smallest normal f32, hence used in double precision only.
pub(super) const NORM_FLOOR: f64 = 1e-40;
/// Share of the largest component's size that counts as that of a component at least.
const LEAST_SHARE: f64 = 1e-2;

/// The hidden state that the update rule carries from one iteration to the next, across frames.
#[derive(Clone, Debug)]
pub struct Hidden<T> {
    /// The last gradient, shape [S, H, W].
    pub last_grad: Vec<T>,
    /// The last step, shape [S, H, W].
    pub last_step: Vec<T>,
    /// The scale of the steps, shape \[S\].
    pub scale: Vec<T>,
}

/// The update rule for a number of samples on one grid. A sample is one component of one cloth.
pub struct Update<T: Real> {
    /// The network for the samples of a pass.
    network: Network<T>,
    hidden: Hidden<T>,
    /// Output of the network for all samples: the field, shape [S, H, W], and the scalar, shape \[S\].
    output: (Vec<T>, Vec<T>),
    /// Normalised gradient, last gradient and last step, shape [S, 3, H, W].
    input: Vec<T>,
}

impl<T: Real> Update<T> {
    /// Builds the update rule with a fresh hidden state. Fails if the grid is too small for the
    /// kept modes or there is not enough memory.
    pub fn new(weights: &Weights, grid: Grid, samples: usize) -> Result<Self> {
        let len = samples * grid.particles();
        let zeros = |n| vec![T::zero(); n];
        let scale = vec![T::of(INITIAL_SCALE.into()); samples];
        let hidden = Hidden { last_grad: zeros(len), last_step: zeros(len), scale };
        let network = Network::new(weights, grid, samples_per_pass(grid, samples))?;
        Ok(Self { network, hidden, output: (zeros(len), zeros(samples)), input: zeros(3 * len) })
    }

    /// Returns the hidden state.
    pub fn hidden(&self) -> &Hidden<T> {
        &self.hidden
    }

    /// Stores the step that was taken, where it differs from the one that was proposed.
    pub fn took(&mut self, cloth: usize, step: &[T]) {
        self.hidden.last_step[cloth * step.len()..][..step.len()].copy_from_slice(step);
    }

    /// Returns the hidden state for modification.
    pub fn hidden_mut(&mut self) -> &mut Hidden<T> {
        &mut self.hidden
    }
}

impl<T: Real> Hidden<T> {
    /// Writes the network's input for the gradient `grad`, whose norms are `norms`: both gradients over the
    /// root mean square of `grad`, and the last step over its own, all squashed.
    pub(super) fn normalise(&self, input: &mut [T], grad: &[T], norms: &[f64]) {
        let samples = norms.len();
        let n = grad.len() / samples;
        // If all values are zero the factor stays finite, so that 0 times it is 0 and not NaN.
        let factor = |norm: f64| {
            let scale = norm.max(NORM_FLOOR) / (n as f64).sqrt();
            T::of((SQUASH * scale).recip()).min(T::max_value())
        };
        input.par_chunks_mut(n).enumerate().for_each(|(index, input)| {
            let (sample, field) = (index / 3, index % 3);
            let source = [grad, &self.last_grad, &self.last_step][field];
            let source = &source[sample * n..][..n];
            let norm = if field == 2 { norm(source) } else { norms[sample] };
            input.copy_from_slice(source);
            T::squash(input, factor(norm), T::of(SQUASH));
        });
    }

    /// Sets the scales to the size of the last step, its root mean square for each component. Those of a cloth without a
    /// step stay.
    ///
    /// Where the network's step is a direction among others, nothing that it does shows in its length: scales that were
    /// passed on from one proposal to the next would drift apart until one component is all that is left, or overflow.
    pub fn scale_to_step(&mut self) {
        let n = self.last_step.len() / self.scale.len();
        for (step, scale) in self.last_step.chunks_exact(3 * n).zip(self.scale.chunks_exact_mut(3)) {
            let sizes = [0, 1, 2].map(|c| norm(&step[c * n..][..n]) / (n as f64).sqrt());
            let largest = sizes.iter().copied().fold(0.0, f64::max);
            if largest > 0.0 && largest.is_finite() {
                for (scale, size) in scale.iter_mut().zip(sizes) {
                    *scale = T::of(size.max(LEAST_SHARE * largest));
                }
            }
        }
    }

    /// Computes the step from the network's `field` and `scalar`, and stores it along with `grad`.
    pub(super) fn remember(&mut self, grad: &[T], (field, scalar): (&[T], &[T])) {
        for (scale, scalar) in self.scale.iter_mut().zip(scalar) {
            *scale = *scale * T::of((2.0 * (scalar.f64() / 2.0).tanh() - 1.0).exp());
        }
        self.last_step.copy_from_slice(field);
        for (step, &scale) in self.last_step.chunks_exact_mut(grad.len() / scalar.len()).zip(&self.scale) {
            T::squash(step, T::one(), scale);
        }
        self.last_grad.copy_from_slice(grad);
    }
}

impl<T: Real> Update<T> {
    /// Returns the step [S, H, W] that the network proposes at the gradient `grad`, whose norms are `norms`. The
    /// hidden state takes it for the step that is taken.
    pub fn propose(&mut self, grad: &[T], norms: &[f64]) -> &[T] {
        self.hidden.normalise(&mut self.input, grad, norms);
        let (field, scalar) = &mut self.output;
        let pass = self.network.scalar().len();
        let outputs = field.chunks_exact_mut(self.network.field().len()).zip(scalar.chunks_exact_mut(pass));
        for (input, (field, scalar)) in self.input.chunks_exact(3 * self.network.field().len()).zip(outputs) {
            self.network.forward(input);
            field.copy_from_slice(self.network.field());
            scalar.copy_from_slice(self.network.scalar());
        }
        self.hidden.remember(grad, (field, scalar));
        &self.hidden.last_step
    }
}

impl<T: Real> Minimizer<T> for Update<T> {
    fn step(&mut self, grad: &[T], norms: &[f64], a: &mut [T]) {
        let step = self.propose(grad, norms);
        a.iter_mut().zip(step).for_each(|(a, &step)| *a = *a + step);
    }

    fn reset_memory_of(&mut self, cloth: usize) {
        let Hidden { last_grad, last_step, scale } = &mut self.hidden;
        let len = 3 * last_grad.len() / scale.len();
        let fields = cloth * len..(cloth + 1) * len;
        last_grad[fields.clone()].fill(T::zero());
        last_step[fields].fill(T::zero());
        scale[3 * cloth..][..3].fill(T::of(INITIAL_SCALE.into()));
    }

    fn hidden_mut(&mut self) -> Option<&mut Hidden<T>> {
        Some(&mut self.hidden)
    }

    fn scales(&self) -> &[T] {
        &self.hidden.scale
    }
}
