//! Pointwise layers: the same small matrix at every position.

use super::padded;
use crate::cpu::matmul::{Target, Term, product};
use crate::cpu::real::Real;
use crate::network::Dense;

/// A pointwise layer `y = weight x + bias`, its output channels padded to whole registers with zeros.
pub(super) struct Pointwise<T> {
    /// Transposed weight, shape [in, out padded].
    pub weight: Vec<T>,
    /// Bias, shape [out padded].
    pub bias: Vec<T>,
    /// Input channels as they lie in memory.
    inputs: usize,
}

impl<T: Real> Pointwise<T> {
    /// A layer that reads `stored` channels, of which those beyond the layer's own inputs carry weight 0.
    pub fn new(dense: &Dense, inputs: usize, stored: usize) -> Self {
        let outputs = dense.bias.len();
        let mut bias = vec![T::zero(); padded(outputs)];
        for (to, &from) in bias.iter_mut().zip(&dense.bias) {
            *to = T::of(from as f64);
        }
        Self { weight: transposed(&dense.weight, outputs, inputs, stored), bias, inputs: stored }
    }

    /// Output channels as they lie in memory.
    pub fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// `out` [positions, out padded] from `x` [positions, in stored].
    pub fn apply(&self, out: &mut [T], x: &[T]) {
        let columns = self.outputs();
        let rows = out.len() / columns;
        product(
            Target { out, stride: columns, rows, columns, start: Some(&self.bias) },
            &[Term { a: x, a_stride: self.inputs, b: &self.weight, b_stride: columns, depth: self.inputs }],
        );
    }
}

/// The transpose of a weight [out, in], of shape [stored, out padded], zero in what is padded.
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
