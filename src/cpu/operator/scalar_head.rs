//! The scalar head: the maximum of each channel over all positions, then one number per sample.

use super::padded;
use crate::cpu::matmul::{largest_rows, weighted_rows};
use crate::cpu::real::Real;
use crate::network::Weights;

/// The linear layer `C -> 1` on the pooled channels.
pub(super) struct ScalarHead<T> {
    weight: Vec<T>,
    bias: T,
}

impl<T: Real> ScalarHead<T> {
    pub fn new(weights: &Weights) -> Self {
        let mut weight = vec![T::zero(); padded(weights.config.channels)];
        for (to, &from) in weight.iter_mut().zip(&weights.scalar.weight) {
            *to = T::of(from as f64);
        }
        Self { weight, bias: T::of(weights.scalar.bias[0] as f64) }
    }

    /// The largest value of each channel, `pooled` \[C\], over `x` [positions, C].
    pub fn pool(&self, pooled: &mut [T], x: &[T]) {
        pooled.fill(T::neg_infinity());
        largest_rows(pooled, x);
    }

    /// `scalar` \[S\] from the pooled rows `pooled` [S, H, C]; overwrites the first row of each sample.
    pub fn apply(&self, scalar: &mut [T], pooled: &mut [T]) {
        let c = self.weight.len();
        let sample = pooled.len() / scalar.len();
        for (scalar, pooled) in scalar.iter_mut().zip(pooled.chunks_exact_mut(sample)) {
            let (first, others) = pooled.split_at_mut(c);
            largest_rows(first, others);
            weighted_rows(std::slice::from_mut(scalar), self.bias, first, &self.weight);
        }
    }
}
