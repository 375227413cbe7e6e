//! The spectral product: for every kept mode a complex matrix over the channels.

use super::padded;
use super::transform::Transform;
use crate::cpu::matmul::{Target, Term, product};
use crate::cpu::real::Real;
use crate::network::{Block, Config};
use rayon::prelude::*;

/// Weights of the spectral products of one block, laid out so that all samples of a batch share one reading of them.
pub struct Spectral<T> {
    /// Real parts of all input channels, then imaginary parts, per mode: shape [modes_h, modes_w, 2, in, out].
    weight: Vec<T>,
    channels: usize,
    modes_h: usize,
    modes_w: usize,
}

impl<T: Real> Spectral<T> {
    /// Lays out the weights of a block, shape [in, out, modes_h, modes_w, 2].
    pub fn new(config: &Config, block: &Block) -> Self {
        let (n, modes, c) = (config.channels, config.modes(), padded(config.channels));
        let mut weight = vec![T::zero(); modes * 2 * c * c];
        for i in 0..n {
            for o in 0..n {
                for m in 0..modes {
                    for part in 0..2 {
                        let from = block.spectral[((i * n + o) * modes + m) * 2 + part];
                        weight[((m * 2 + part) * c + i) * c + o] = T::of(from as f64);
                    }
                }
            }
        }
        Self { weight, channels: c, modes_h: config.modes_h, modes_w: config.modes_w }
    }

    /// Numbers of working memory that [`Spectral::apply`] needs for `samples` samples.
    pub fn scratch_len(&self, samples: usize) -> usize {
        self.modes_h * self.modes_w * 4 * samples * self.channels
    }

    /// `out` [modes_h, modes_w, 2, S, 2, C] from the column sums `sums` [S, modes_w, 2 modes_h, 2, C] of the forward
    /// transform: `out = sum over in of x\[in\] weight[in, out]`, and behind it the same times the imaginary unit.
    ///
    /// The complex product is a real one: rows (re, -im) and (im, re) times the real parts above the imaginary parts.
    pub fn apply(&self, out: &mut [T], sums: &[T], transform: &Transform<T>, scratch: &mut [T]) {
        let c = self.channels;
        let samples = sums.len() / transform.column_len();
        let column_len = transform.column_len() / self.modes_w;
        let inputs = scratch.par_chunks_mut(4 * samples * c);
        let modes = out.par_chunks_mut(4 * samples * c).zip(inputs).enumerate();
        modes.for_each(|(mode, (out, inputs))| {
            let (m_h, k_w) = (mode / self.modes_w, mode % self.modes_w);
            for (s, rows) in inputs.chunks_exact_mut(4 * c).enumerate() {
                let sums = &sums[(s * self.modes_w + k_w) * column_len..][..column_len];
                for i in 0..c {
                    let (re, im) = transform.mode(sums, m_h, i);
                    rows[i] = re;
                    rows[c + i] = -im;
                    rows[2 * c + i] = im;
                    rows[3 * c + i] = re;
                }
            }
            let (straight, turned) = out.split_at_mut(2 * samples * c);
            let weight = &self.weight[mode * 2 * c * c..][..2 * c * c];
            product(
                Target { out: straight, stride: c, rows: 2 * samples, columns: c, start: None },
                &[Term { a: inputs, a_stride: 2 * c, b: weight, b_stride: c, depth: 2 * c }],
            );
            for (from, to) in straight.chunks_exact(2 * c).zip(turned.chunks_exact_mut(2 * c)) {
                for o in 0..c {
                    to[o] = -from[c + o];
                    to[c + o] = from[o];
                }
            }
        });
    }
}
