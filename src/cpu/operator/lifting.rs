//! Lifting: from normalised fields and positions to channels, through a hidden layer that never leaves the
//! cache.

use super::pointwise::{Pointwise, PointwiseGradient};
use super::{ADJOINT_SEGMENT, SEGMENT, padded};
use crate::cloth::Grid;
use crate::cpu::matmul::{Start, Target, Term, product};
use crate::cpu::real::Real;
use crate::network::{Config, Weights};

/// The lifting layers and the positional fields.
pub(super) struct Lifting<T> {
    hidden: Pointwise<T>,
    out: Pointwise<T>,
    fields: usize,
}

/// The input fields of one sample, [fields, H, W].
#[derive(Clone, Copy)]
pub(super) struct Fields<'a, T> {
    pub values: &'a [T],
    pub grid: Grid,
}

/// Working memory of one task.
pub(super) struct LiftingScratch<T> {
    embedded: Vec<T>,
    hidden: Vec<T>,
}

/// A partial gradient of [`Lifting`], with working memory.
pub(super) struct LiftingGradient<T> {
    pub hidden: PointwiseGradient<T>,
    pub out: PointwiseGradient<T>,
    embedded: Vec<T>,
    scratch: [Vec<T>; 3],
}

impl<T: Real> LiftingGradient<T> {
    pub fn new(config: &Config) -> Self {
        let (inputs, hidden) = (config.inputs(), padded(config.lifting));
        Self {
            hidden: PointwiseGradient::new(inputs, config.lifting),
            out: PointwiseGradient::new(hidden, config.channels),
            embedded: vec![T::zero(); ADJOINT_SEGMENT * inputs],
            scratch: [(); 3].map(|_| vec![T::zero(); ADJOINT_SEGMENT * hidden]),
        }
    }
}

impl<T: Real> Lifting<T> {
    pub fn new(weights: &Weights) -> Self {
        let config = &weights.config;
        let [first, second] = &weights.lifting;
        let hidden = Pointwise::new(first, config.inputs(), config.inputs());
        let out = Pointwise::new(second, config.lifting, padded(config.lifting));
        Self { hidden, out, fields: config.fields }
    }

    pub fn scratch(&self) -> LiftingScratch<T> {
        let zeros = |channels| vec![T::zero(); SEGMENT * channels];
        LiftingScratch { embedded: zeros(self.fields + 2), hidden: zeros(self.hidden.outputs()) }
    }

    /// Lifts row `i` of a sample to `out` [W, C].
    pub fn row(&self, out: &mut [T], fields: Fields<'_, T>, i: usize, scratch: &mut LiftingScratch<T>) {
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

    /// Adds to the gradient, given the cotangents `adj_out` [positions, C] of a sample's positions from
    /// number `first` on. The hidden layer is recomputed. Its inputs are constants of training, so nothing
    /// propagates further back. `weight` is the weight of the second layer [C, hidden].
    pub fn backward(
        &self,
        adj_out: &[T],
        (fields, first): (Fields<'_, T>, usize),
        weight: &[T],
        gradient: &mut LiftingGradient<T>,
    ) {
        let (c, inputs, hidden) = (self.out.outputs(), self.fields + 2, self.hidden.outputs());
        for (segment, adj_out) in adj_out.chunks(ADJOINT_SEGMENT * c).enumerate() {
            let n = adj_out.len() / c;
            let embedded = &mut gradient.embedded[..n * inputs];
            for (k, at) in embedded.chunks_exact_mut(inputs).enumerate() {
                let p = first + segment * ADJOINT_SEGMENT + k;
                self.embed(at, fields, p / fields.grid.w, p % fields.grid.w);
            }
            let [values, slopes, adj] = gradient.scratch.each_mut().map(|s| &mut s[..n * hidden]);
            self.hidden.apply(values, embedded);
            T::gelu_and_slope(values, slopes);
            gradient.out.add(values, adj_out);
            product(
                Target { out: adj, stride: hidden, rows: n, columns: hidden, start: Start::Zero },
                &[Term::new((adj_out, c), (weight, hidden), c)],
            );
            for (adj, &slope) in adj.iter_mut().zip(&*slopes) {
                *adj = *adj * slope;
            }
            gradient.hidden.add(embedded, adj);
        }
    }

    /// Writes the network's inputs at (i, j): the fields, then `i / (H-1)` and `j / (W-1)`.
    pub fn embed(&self, at: &mut [T], fields: Fields<'_, T>, i: usize, j: usize) {
        let Fields { values, grid: Grid { h, w } } = fields;
        for (c, at) in at[..self.fields].iter_mut().enumerate() {
            *at = values[(c * h + i) * w + j];
        }
        at[self.fields] = T::of(i as f64 / (h - 1) as f64);
        at[self.fields + 1] = T::of(j as f64 / (w - 1) as f64);
    }
}
