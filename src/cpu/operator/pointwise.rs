//! Pointwise layers: the same small matrix at every position.

use super::padded;
use crate::cpu::matmul::{Start, Target, Term, add_rows, product};
use crate::cpu::real::Real;
use crate::network::Dense;

/// A pointwise layer `y = weight x + bias`. Its output channels are padded with zeros to whole registers.
pub(super) struct Pointwise<T> {
    /// Transposed weight, shape [in, out padded].
    pub weight: Vec<T>,
    /// Bias, shape [out padded].
    pub bias: Vec<T>,
    /// Number of input channels as stored.
    inputs: usize,
}

impl<T: Real> Pointwise<T> {
    /// Builds a layer that reads `stored` channels. Those beyond the layer's own inputs have weight 0.
    pub fn new(dense: &Dense, inputs: usize, stored: usize) -> Self {
        let outputs = dense.bias.len();
        let mut bias = vec![T::zero(); padded(outputs)];
        for (to, &from) in bias.iter_mut().zip(&dense.bias) {
            *to = T::of(from as f64);
        }
        Self { weight: transposed(&dense.weight, outputs, inputs, stored), bias, inputs: stored }
    }

    /// Returns the number of output channels as stored.
    pub fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// Computes `out` [positions, out padded] from `x` [positions, in stored].
    pub fn apply(&self, out: &mut [T], x: &[T]) {
        let columns = self.outputs();
        let rows = out.len() / columns;
        product(
            Target { out, stride: columns, rows, columns, start: Start::Row(&self.bias) },
            &[Term::new((x, self.inputs), (&self.weight, columns), self.inputs)],
        );
    }
}

/// The gradient of a pointwise layer, in the layout of [`Pointwise`].
#[derive(Clone)]
pub(super) struct PointwiseGradient<T> {
    /// Shape [in stored, out padded].
    weight: Vec<T>,
    /// Shape [out padded].
    bias: Vec<T>,
    inputs: usize,
}

impl<T: Real> PointwiseGradient<T> {
    /// Builds a zero gradient for a layer that reads `stored` channels.
    pub fn new(stored: usize, outputs: usize) -> Self {
        let zeros = |n| vec![T::zero(); n];
        Self { weight: zeros(stored * padded(outputs)), bias: zeros(padded(outputs)), inputs: stored }
    }

    /// Adds `sum over positions of x adj_y`, given `x` [positions, in stored] and `adj_y`
    /// [positions, out padded].
    pub fn add(&mut self, x: &[T], adj_y: &[T]) {
        let columns = self.bias.len();
        let target = Target {
            out: &mut self.weight,
            stride: columns,
            rows: self.inputs,
            columns,
            start: Start::Target,
        };
        let depth = adj_y.len() / columns;
        product(target, &[Term::transposed((x, self.inputs), (adj_y, columns), depth)]);
        add_rows(&mut self.bias, adj_y);
    }

    /// Adds another part of the same gradient.
    pub fn merge(&mut self, other: &Self) {
        for (to, &from) in
            self.weight.iter_mut().zip(&other.weight).chain(self.bias.iter_mut().zip(&other.bias))
        {
            *to = *to + from;
        }
    }

    /// Adds the gradient of the weight to `weight` [out, in] and that of the bias to `bias` \[out\].
    pub fn add_to(&self, weight: &mut [T], bias: &mut [T]) {
        let (inputs, columns) = (weight.len() / bias.len(), self.bias.len());
        for (o, (row, bias)) in weight.chunks_exact_mut(inputs).zip(bias).enumerate() {
            for (i, to) in row.iter_mut().enumerate() {
                *to = *to + self.weight[i * columns + o];
            }
            *bias = *bias + self.bias[o];
        }
    }

    /// Resets to zero.
    pub fn clear(&mut self) {
        self.weight.fill(T::zero());
        self.bias.fill(T::zero());
    }
}

/// Returns a weight [out, in] untransposed, shape [stored out, in padded], with zeros in the padding:
/// `adj_x = adj_y weight`.
pub(super) fn straight<T: Real>(weight: &[f32], outputs: usize, inputs: usize) -> Vec<T> {
    let columns = padded(inputs);
    let mut result = vec![T::zero(); padded(outputs) * columns];
    for (to, from) in result.chunks_exact_mut(columns).zip(weight.chunks_exact(inputs)) {
        for (to, &from) in to.iter_mut().zip(from) {
            *to = T::of(from as f64);
        }
    }
    result
}

/// Returns the transpose of a weight [out, in], shape [stored, out padded], with zeros in the padding.
pub(super) fn transposed<T: Real>(weight: &[f32], outputs: usize, inputs: usize, stored: usize) -> Vec<T> {
    let columns = padded(outputs);
    let mut result = vec![T::zero(); stored * columns];
    for o in 0..outputs {
        for i in 0..inputs {
            result[i * columns + o] = T::of(weight[o * inputs + i] as f64);
        }
    }
    result
}
