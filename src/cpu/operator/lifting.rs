//! Lifting: normalised fields and positions to channels, through a hidden layer that never leaves the cache.

use super::pointwise::Pointwise;
use super::{SEGMENT, padded};
use crate::cpu::real::Real;
use crate::network::Weights;
use crate::sim::Grid;

/// The lifting layers and the positional fields (paper section 4).
pub(super) struct Lifting<T> {
    hidden: Pointwise<T>,
    out: Pointwise<T>,
    grid: Grid,
    fields: usize,
}

/// Working memory of one task.
pub(super) struct LiftingScratch<T> {
    embedded: Vec<T>,
    hidden: Vec<T>,
}

impl<T: Real> Lifting<T> {
    pub fn new(weights: &Weights, grid: Grid) -> Self {
        let config = &weights.config;
        let [first, second] = &weights.lifting;
        let hidden = Pointwise::new(first, config.inputs(), config.inputs());
        let out = Pointwise::new(second, config.lifting, padded(config.lifting));
        Self { hidden, out, grid, fields: config.fields }
    }

    pub fn scratch(&self) -> LiftingScratch<T> {
        let zeros = |channels| vec![T::zero(); SEGMENT * channels];
        LiftingScratch { embedded: zeros(self.fields + 2), hidden: zeros(self.hidden.outputs()) }
    }

    /// Lifts row `i` of a sample: `fields` [fields, H, W] to `out` [W, C].
    pub fn row(&self, out: &mut [T], fields: &[T], i: usize, scratch: &mut LiftingScratch<T>) {
        let inputs = self.fields + 2;
        for (segment, out) in out.chunks_mut(SEGMENT * self.out.outputs()).enumerate() {
            let positions = out.len() / self.out.outputs();
            let embedded = &mut scratch.embedded[..positions * inputs];
            for (k, at) in embedded.chunks_exact_mut(inputs).enumerate() {
                self.embed(at, fields, i, segment * SEGMENT + k);
            }
            let hidden = &mut scratch.hidden[..positions * self.hidden.outputs()];
            self.hidden.apply(hidden, embedded);
            T::gelu(hidden);
            self.out.apply(out, hidden);
        }
    }

    /// The inputs of the network at (i, j): the fields, then `i / (H-1)` and `j / (W-1)`.
    pub fn embed(&self, at: &mut [T], fields: &[T], i: usize, j: usize) {
        let Grid { h, w } = self.grid;
        for (c, at) in at[..self.fields].iter_mut().enumerate() {
            *at = fields[(c * h + i) * w + j];
        }
        at[self.fields] = T::of(i as f64 / (h - 1) as f64);
        at[self.fields + 1] = T::of(j as f64 / (w - 1) as f64);
    }
}
