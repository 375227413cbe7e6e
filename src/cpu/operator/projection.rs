//! The field head: channels to one field, through a hidden layer that never leaves the cache.

use super::pointwise::Pointwise;
use super::{SEGMENT, padded};
use crate::cpu::matmul::weighted_rows;
use crate::cpu::real::Real;
use crate::network::Weights;

/// The two layers of the projection, `C -> hidden -> 1`.
pub(super) struct Projection<T> {
    hidden: Pointwise<T>,
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
        Self { hidden, weight, bias: T::of(second.bias[0] as f64) }
    }

    pub fn scratch(&self) -> Vec<T> {
        vec![T::zero(); SEGMENT * self.hidden.outputs()]
    }

    /// `field` \[positions\] from `x` [positions, C].
    pub fn apply(&self, field: &mut [T], x: &[T], scratch: &mut [T]) {
        let channels = x.len() / field.len();
        for (field, x) in field.chunks_mut(SEGMENT).zip(x.chunks(SEGMENT * channels)) {
            let hidden = &mut scratch[..field.len() * self.hidden.outputs()];
            self.hidden.apply(hidden, x);
            T::gelu(hidden);
            weighted_rows(field, self.bias, hidden, &self.weight);
        }
    }
}
