//! The field head: from channels to one field, through a hidden layer that never leaves the cache.

use super::pointwise::{Pointwise, PointwiseGradient};
use super::{ADJOINT_SEGMENT, SEGMENT, padded};
use crate::cpu::matmul::{Start, Target, Term, product, weighted_rows};
use crate::cpu::real::Real;
use crate::network::{Config, Weights};

/// A partial gradient of [`Projection`], with working memory.
pub(super) struct ProjectionGradient<T> {
    pub hidden: PointwiseGradient<T>,
    /// Shape [hidden padded].
    pub weight: Vec<T>,
    pub bias: T,
    scratch: [Vec<T>; 2],
}

impl<T: Real> ProjectionGradient<T> {
    pub fn new(config: &Config) -> Self {
        let hidden = padded(config.projection);
        Self {
            hidden: PointwiseGradient::new(padded(config.channels), config.projection),
            weight: vec![T::zero(); hidden],
            bias: T::zero(),
            scratch: [(); 2].map(|_| vec![T::zero(); ADJOINT_SEGMENT * hidden]),
        }
    }
}

/// The two layers of the projection, `C -> hidden -> 1`.
pub(super) struct Projection<T> {
    hidden: Pointwise<T>,
    /// Whether the first layer is the identity, as in [`Weights::folded`].
    folded: bool,
    weight: Vec<T>,
    bias: T,
}

impl<T: Real> Projection<T> {
    pub fn new(weights: &Weights) -> Self {
        let config = &weights.config;
        let [first, second] = &weights.projection;
        let hidden = Pointwise::new(first, config.channels, padded(config.channels));
        let mut weight = vec![T::zero(); hidden.outputs()];
        for (to, &from) in weight.iter_mut().zip(&second.weight) {
            *to = T::of(from as f64);
        }
        Self { hidden, folded: weights.is_folded(), weight, bias: T::of(second.bias[0] as f64) }
    }

    /// Computes the cotangents `adj_x` [positions, C] at the input `x` [positions, C] from those of the
    /// field, `adj_field` \[positions\], and adds to the gradient. The hidden layer is recomputed.
    /// `weight` is the weight of the first layer [hidden, C].
    pub fn backward(
        &self,
        adj_x: &mut [T],
        (x, adj_field): (&[T], &[T]),
        weight: &[T],
        gradient: &mut ProjectionGradient<T>,
    ) {
        let (c, hidden) = (x.len() / adj_field.len(), self.hidden.outputs());
        let parts = adj_x.chunks_mut(ADJOINT_SEGMENT * c).zip(x.chunks(ADJOINT_SEGMENT * c));
        for ((adj_x, x), adj_field) in parts.zip(adj_field.chunks(ADJOINT_SEGMENT)) {
            let n = adj_field.len();
            let [values, slopes] = gradient.scratch.each_mut().map(|s| &mut s[..n * hidden]);
            self.hidden.apply(values, x);
            T::gelu_and_slope(values, slopes);
            product(
                Target {
                    out: &mut gradient.weight,
                    stride: hidden,
                    rows: 1,
                    columns: hidden,
                    start: Start::Target,
                },
                &[Term::transposed((adj_field, 1), (values, hidden), n)],
            );
            for (slopes, &adj) in slopes.chunks_exact_mut(hidden).zip(adj_field) {
                for (slope, &weight) in slopes.iter_mut().zip(&self.weight) {
                    *slope = *slope * weight * adj;
                }
                gradient.bias = gradient.bias + adj;
            }
            gradient.hidden.add(x, slopes);
            product(
                Target { out: adj_x, stride: c, rows: n, columns: c, start: Start::Zero },
                &[Term::new((slopes, hidden), (weight, c), hidden)],
            );
        }
    }

    pub fn scratch(&self) -> Vec<T> {
        vec![T::zero(); SEGMENT * self.hidden.outputs()]
    }

    /// Computes `field` \[positions\] from `x` [positions, C], which may be overwritten.
    pub fn apply(&self, field: &mut [T], x: &mut [T], scratch: &mut [T]) {
        if self.folded {
            T::gelu(x);
            weighted_rows(field, self.bias, x, &self.weight);
            return;
        }
        let channels = x.len() / field.len();
        for (field, x) in field.chunks_mut(SEGMENT).zip(x.chunks(SEGMENT * channels)) {
            let hidden = &mut scratch[..field.len() * self.hidden.outputs()];
            self.hidden.apply(hidden, x);
            T::gelu(hidden);
            weighted_rows(field, self.bias, hidden, &self.weight);
        }
    }
}
