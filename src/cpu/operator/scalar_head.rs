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

    /// Computes the largest value of each channel, `pooled` \[C\], over `x` [positions, C].
    pub fn pool(&self, pooled: &mut [T], x: &[T]) {
        pooled.fill(T::neg_infinity());
        largest_rows(pooled, x);
    }

    /// Finds the first row that holds the largest value of each channel, `rows` [S, C], from the pooled rows
    /// `pooled` [S, H, C]. The maximum's cotangent goes to the first position that attains it.
    pub fn first_rows(&self, rows: &mut [u32], pooled: &[T]) {
        let c = self.weight.len();
        let sample = pooled.len() / (rows.len() / c);
        for (rows, pooled) in rows.chunks_exact_mut(c).zip(pooled.chunks_exact(sample)) {
            rows.fill(0);
            for (i, row) in pooled.chunks_exact(c).enumerate() {
                for (k, &x) in row.iter().enumerate() {
                    if x > pooled[rows[k] as usize * c + k] {
                        rows[k] = i as u32;
                    }
                }
            }
        }
    }

    /// Adds to `adj_x` [W, C] the cotangents of row `i` of a sample, given the cotangent `adj_scalar` of the
    /// head's output. They go to where `x` [W, C] first attains its maximum, for the channels whose maximum
    /// lies in this row according to `first_rows` \[C\].
    pub fn backward_row(&self, adj_x: &mut [T], x: &[T], (i, first_rows): (usize, &[u32]), adj_scalar: T) {
        let c = self.weight.len();
        for (k, &weight) in self.weight.iter().enumerate().filter(|(k, _)| first_rows[*k] as usize == i) {
            let mut largest = 0;
            for j in 1..x.len() / c {
                if x[j * c + k] > x[largest * c + k] {
                    largest = j;
                }
            }
            adj_x[largest * c + k] = adj_x[largest * c + k] + adj_scalar * weight;
        }
    }

    /// Adds the gradients of the weight, `weight` \[C\], and of the bias, given the largest values `pooled`
    /// \[C\] of a sample.
    pub fn add_gradient(weight: &mut [T], bias: &mut T, pooled: &[T], adj_scalar: T) {
        for (to, &largest) in weight.iter_mut().zip(pooled) {
            *to = *to + adj_scalar * largest;
        }
        *bias = *bias + adj_scalar;
    }

    /// Computes `scalar` \[S\] from the pooled rows `pooled` [S, H, C]. Overwrites the first row of each
    /// sample.
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
