//! The spectral product: one complex matrix over the channels per kept mode.

use super::padded;
use super::transform::Transform;
use crate::cpu::matmul::{Start, Target, Term, product};
use crate::cpu::real::Real;
use crate::network::{Block, Config};
use rayon::prelude::*;

/// Weights of one block's spectral products, laid out so that all samples of a batch share one read of them.
pub struct Spectral<T> {
    /// For each mode, the real parts of all input channels, then the imaginary parts: shape
    /// [modes_h, modes_w, 2, in, out].
    weight: Vec<T>,
    channels: usize,
    modes_h: usize,
    modes_w: usize,
}

impl<T: Real> Spectral<T> {
    /// Lays out the weights of a block, shape [in, out, modes_h, modes_w, 2].
    pub fn new(config: &Config, block: &Block) -> Self {
        let n = config.channels;
        Self::laid_out(config, |i, o, m, part| block.spectral[((i * n + o) * config.modes() + m) * 2 + part])
    }

    /// Builds the adjoint, for cotangents: the conjugate of the weights, with inputs and outputs exchanged.
    pub fn adjoint(config: &Config, block: &Block) -> Self {
        let n = config.channels;
        Self::laid_out(config, |i, o, m, part| {
            let value = block.spectral[((o * n + i) * config.modes() + m) * 2 + part];
            if part == 1 { -value } else { value }
        })
    }

    fn laid_out(config: &Config, value: impl Fn(usize, usize, usize, usize) -> f32 + Sync) -> Self {
        let (n, modes, c) = (config.channels, config.modes(), padded(config.channels));
        let mut weight = vec![T::zero(); modes * 2 * c * c];
        weight.par_chunks_exact_mut(c * c).enumerate().for_each(|(part, matrix)| {
            for (i, row) in matrix.chunks_exact_mut(c).take(n).enumerate() {
                for (o, to) in row.iter_mut().take(n).enumerate() {
                    *to = T::of(value(i, o, part / 2, part % 2) as f64);
                }
            }
        });
        Self { weight, channels: c, modes_h: config.modes_h, modes_w: config.modes_w }
    }

    /// Returns the length of the working memory that [`Spectral::apply`] needs for `samples` samples.
    pub fn scratch_len(&self, samples: usize) -> usize {
        self.modes_h * self.modes_w * 4 * samples * self.channels
    }

    /// Adds the gradient of the weights to `gradient` [in, out, modes_h, modes_w, 2]: the sum over samples of
    /// `conj(x) adj_y`. `x` is what [`Spectral::apply`] left in `scratch`, `adj_y` what the adjoint's `apply`
    /// left there for the cotangents of the outputs. `matrices` is working memory of the size of the weights.
    pub fn add_gradient(&self, gradient: &mut [T], (x, adj_y): (&[T], &[T]), matrices: &mut [T]) {
        let (c, modes) = (self.channels, self.modes_h * self.modes_w);
        let mode_len = x.len() / modes;
        let parts = x.par_chunks_exact(mode_len).zip(adj_y.par_chunks_exact(mode_len));
        matrices.par_chunks_exact_mut(2 * c * c).zip(parts).for_each(|(matrices, (x, adj_y))| {
            // Of the rows of `c` numbers the even ones alternate re and im, the odd ones -im and re. The sum
            // with the even rows is the gradient's real part, that with the odd rows its negative imaginary
            // part.
            let (real, imaginary) = matrices.split_at_mut(c * c);
            for (out, b) in [(real, adj_y), (imaginary, &adj_y[c..])] {
                product(
                    Target { out, stride: c, rows: c, columns: c, start: Start::Zero },
                    &[Term::transposed((x, 2 * c), (b, 2 * c), mode_len / (2 * c))],
                );
            }
        });
        let matrices = &*matrices;
        let n = (gradient.len() / (2 * modes)).isqrt();
        gradient.par_chunks_exact_mut(n * modes * 2).enumerate().for_each(|(i, gradient)| {
            for (o, gradient) in gradient.chunks_exact_mut(modes * 2).enumerate() {
                for (m, to) in gradient.chunks_exact_mut(2).enumerate() {
                    let at = (m * 2 * c + i) * c + o;
                    to[0] = to[0] + matrices[at];
                    to[1] = to[1] - matrices[at + c * c];
                }
            }
        });
    }

    /// Returns the length of the working memory that [`Spectral::add_gradient`] needs.
    pub(super) fn weight_len(&self) -> usize {
        self.weight.len()
    }

    /// Computes `out` [modes_h, modes_w, 2, S, 2, C] from the column sums `sums`
    /// [S, modes_w, 2 modes_h, 2, C] of the forward transform: `out = sum over in of x[in] weight[in, out]`,
    /// followed by the same times the imaginary unit.
    ///
    /// The complex product is computed as a real one: rows (re, -im) and (im, re) times the real parts above
    /// the imaginary parts.
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
            let (straight, times_i) = out.split_at_mut(2 * samples * c);
            let weight = &self.weight[mode * 2 * c * c..][..2 * c * c];
            product(
                Target { out: straight, stride: c, rows: 2 * samples, columns: c, start: Start::Zero },
                &[Term::new((inputs, 2 * c), (weight, c), 2 * c)],
            );
            for (from, to) in straight.chunks_exact(2 * c).zip(times_i.chunks_exact_mut(2 * c)) {
                for o in 0..c {
                    to[o] = -from[c + o];
                    to[c + o] = from[o];
                }
            }
        });
    }
}
