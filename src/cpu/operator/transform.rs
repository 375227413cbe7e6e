//! The truncated two-dimensional real Fourier transform and its inverse, as products with trigonometric
//! tables.
//!
//! Only `modes_h` rows `k_h = -modes_h/2 ..` and `modes_w` columns `k_w = 0 ..` of the spectrum are kept, so
//! each direction is one product along the rows of the grid and one along its columns. A row spectrum `R`
//! holds the columns k_w of one grid row as (re, im) pairs, shape [modes_w, 2, C]. The forward transform
//! carries the factor 1/(HW), the inverse none.

use crate::Result;
use crate::cloth::Grid;
use crate::cpu::matmul::{Start, Target, Term, product};
use crate::cpu::real::Real;
use crate::network::Config;
use std::f64::consts::TAU;

/// The trigonometric tables of one grid, for `channels` channels as stored.
#[derive(Clone)]
pub struct Transform<T> {
    grid: Grid,
    channels: usize,
    modes_h: usize,
    modes_w: usize,
    /// `cos`, `-sin` of `2 pi k_w j / W`, divided by HW, shape [modes_w * 2, W].
    row_forward: Vec<T>,
    /// `cos`, `-sin` of `2 pi k_w j / W`, doubled where a column also stands for its conjugate, shape
    /// [W, modes_w * 2].
    row_inverse: Vec<T>,
    /// `cos`, then `sin`, of `2 pi k_h i / H`, shape [2 * modes_h, H].
    column_forward: Vec<T>,
    /// The transpose of `column_forward`, shape [H, 2 * modes_h].
    column_inverse: Vec<T>,
}

impl<T: Real> Transform<T> {
    /// Builds the tables of a grid. Fails if the grid is too small for the kept modes.
    pub fn new(config: &Config, grid: Grid, channels: usize) -> Result<Self> {
        let Grid { h, w } = grid;
        let (modes_h, modes_w) = (config.modes_h, config.modes_w);
        config.check_grid(grid, "network", "grid")?;
        // Reducing the argument exactly keeps the tables accurate to the last bit for long rows.
        let angle = |k: usize, j: usize, n: usize| TAU * ((k * j) % n) as f64 / n as f64;
        let mut row_forward = vec![T::zero(); modes_w * 2 * w];
        let mut row_inverse = vec![T::zero(); modes_w * 2 * w];
        for k in 0..modes_w {
            // Columns 0 and W/2 are their own conjugates; of their sum the inverse needs only the real part.
            let copies = if k == 0 || 2 * k == w { 1.0 } else { 2.0 };
            for j in 0..w {
                let (sin, cos) = angle(k, j, w).sin_cos();
                for (part, value) in [cos, -sin].into_iter().enumerate() {
                    row_forward[(2 * k + part) * w + j] = T::of(value / (h * w) as f64);
                    row_inverse[j * 2 * modes_w + 2 * k + part] = T::of(value * copies);
                }
            }
        }
        let mut column_forward = vec![T::zero(); 2 * modes_h * h];
        let mut column_inverse = vec![T::zero(); 2 * modes_h * h];
        for m in 0..modes_h {
            let k = (m + h - modes_h / 2) % h;
            for i in 0..h {
                let (sin, cos) = angle(k, i, h).sin_cos();
                for (row, value) in [(m, cos), (modes_h + m, sin)] {
                    column_forward[row * h + i] = T::of(value);
                    column_inverse[i * 2 * modes_h + row] = T::of(value);
                }
            }
        }
        Ok(Self {
            grid,
            channels,
            modes_h,
            modes_w,
            row_forward,
            row_inverse,
            column_forward,
            column_inverse,
        })
    }

    /// Returns the adjoint: its forward transform is the adjoint of the inverse, its inverse that of the
    /// forward transform. Along the columns the two are each other's adjoint already; along the rows the
    /// tables trade places. The weight that a mode carries in the inverse, 2 if it also stands for its
    /// conjugate, is therefore in the adjoint's forward transform.
    pub fn adjoint(&self) -> Self {
        let (w, modes) = (self.grid.w, 2 * self.modes_w);
        let transposed = |table: &[T], rows: usize, columns: usize| {
            (0..rows * columns).map(|n| table[n % rows * columns + n / rows]).collect()
        };
        Self {
            row_forward: transposed(&self.row_inverse, w, modes),
            row_inverse: transposed(&self.row_forward, modes, w),
            ..self.clone()
        }
    }

    /// Returns the length of the row spectrum of one grid row, shape [modes_w, 2, C].
    pub fn row_len(&self) -> usize {
        self.modes_w * 2 * self.channels
    }

    /// Returns the length of the column sums of one sample, shape [modes_w, 2 modes_h, 2, C].
    pub fn column_len(&self) -> usize {
        2 * self.modes_h * self.row_len()
    }

    /// Transforms along a row: `out` [modes_w, 2, C] from `x` [W, C].
    pub fn row_forward(&self, out: &mut [T], x: &[T]) {
        let (w, c) = (self.grid.w, self.channels);
        product(
            Target { out, stride: c, rows: 2 * self.modes_w, columns: c, start: Start::Zero },
            &[Term::new((&self.row_forward, w), (x, c), w)],
        );
    }

    /// Returns the term that adds the inverse along a row, [W, C], of a row spectrum `z` [modes_w, 2, C].
    pub(super) fn row_inverse<'a>(&'a self, z: &'a [T]) -> Term<'a, T> {
        let depth = 2 * self.modes_w;
        Term::new((&self.row_inverse, depth), (z, self.channels), depth)
    }

    /// Transforms along column `k_w` of a sample: `out` [2 modes_h, 2, C], the sums with the cosines followed
    /// by those with the sines, from the row spectra `rows` [H, modes_w, 2, C]. [`Transform::mode`] combines
    /// them.
    pub fn column_forward(&self, out: &mut [T], rows: &[T], k_w: usize) {
        let (h, columns) = (self.grid.h, 2 * self.channels);
        let b = &rows[k_w * columns..];
        product(
            Target { out, stride: columns, rows: 2 * self.modes_h, columns, start: Start::Zero },
            &[Term::new((&self.column_forward, h), (b, self.row_len()), h)],
        );
    }

    /// Returns the real and the imaginary part of mode (m_h, k_w), channel c, from the column sums
    /// [2 modes_h, 2, C] of that k_w.
    pub fn mode(&self, sums: &[T], m_h: usize, c: usize) -> (T, T) {
        let at = |row: usize, part: usize| sums[(row * 2 + part) * self.channels + c];
        let (cos, sin) = (m_h, self.modes_h + m_h);
        (at(cos, 0) + at(sin, 1), at(cos, 1) - at(sin, 0))
    }

    /// Applies the whole inverse: returns the field, shape [H, W, C], of `modes` [modes_h, modes_w, C, 2].
    pub fn inverse(&self, modes: &[T]) -> Vec<T> {
        let (c, row_len) = (self.channels, self.row_len());
        let mut parts = vec![T::zero(); 2 * modes.len()];
        for (parts, modes) in parts.chunks_exact_mut(4 * c).zip(modes.chunks_exact(2 * c)) {
            for i in 0..c {
                let (re, im) = (modes[2 * i], modes[2 * i + 1]);
                (parts[i], parts[c + i], parts[2 * c + i], parts[3 * c + i]) = (re, im, -im, re);
            }
        }
        let mut spectra = vec![T::zero(); self.grid.h * row_len];
        self.column_inverse(&mut spectra, 0, ModeParts { values: &parts, samples: 1, sample: 0 });
        let mut field = vec![T::zero(); self.grid.particles() * c];
        for (out, z) in field.chunks_exact_mut(self.grid.w * c).zip(spectra.chunks_exact(row_len)) {
            product(
                Target { out, stride: c, rows: self.grid.w, columns: c, start: Start::Zero },
                &[self.row_inverse(z)],
            );
        }
        field
    }

    /// Applies the inverse along the columns, for grid rows from `i` on: `out` [rows, modes_w, 2, C] from the
    /// `modes` of a sample, stored twice: as (re, im), then times the imaginary unit, (-im, re).
    pub(super) fn column_inverse(&self, out: &mut [T], i: usize, modes: ModeParts<'_, T>) {
        let columns = 2 * self.channels;
        let rows = out.len() / self.row_len();
        for k_w in 0..self.modes_w {
            let part = |times_i: usize| {
                let a = &self.column_inverse[i * 2 * self.modes_h + times_i * self.modes_h..];
                let b = &modes.values[((k_w * 2 + times_i) * modes.samples + modes.sample) * columns..];
                let b_stride = self.modes_w * 2 * modes.samples * columns;
                Term::new((a, 2 * self.modes_h), (b, b_stride), self.modes_h)
            };
            let out = &mut out[k_w * columns..];
            product(
                Target { out, stride: self.row_len(), rows, columns, start: Start::Zero },
                &[part(0), part(1)],
            );
        }
    }
}

/// The modes of one sample among those of all, as [`Transform::column_inverse`] reads them.
#[derive(Clone, Copy)]
pub(super) struct ModeParts<'a, T> {
    /// Modes of all samples, shape [modes_h, modes_w, 2, S, 2, C].
    pub values: &'a [T],
    /// S.
    pub samples: usize,
    /// Number of the sample.
    pub sample: usize,
}
