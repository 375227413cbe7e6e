//! The plan of a two-dimensional real transform: which passes run in which order over which tensors.

use super::{Fields, JoinSpectra, PackPairs, Pass, Radix4, RadixPrime, SplitSpectra, UnpackPairs};
use crate::gpu::{Context, Schedule, Tensor};
use crate::settings::Norm;
use crate::{Error, Result};
use std::f64::consts::TAU;

/// Longest side. Direct sums over a prime of this size still stay below the 65,535 loop iterations after
/// which some software drivers stop silently.
pub const MAX_LENGTH: usize = 65_535;

/// Batched two-dimensional real Fourier transforms of one size, forward and inverse.
///
/// `spectrum[b, k_h, k_w] = factor sum_(i, j) x[b, i, j] exp(-2 pi i (k_h i / H + k_w j / W))` for all rows
/// k_h, 0 first, and the columns `k_w = 0 ..= W / 2`; the other columns follow by conjugation. Any size
/// works: this is a Stockham transform with passes of radix 4 and of the remaining prime factors, where a
/// factor p costs p steps per element. Two real rows travel as one complex row, so the rows cost half a
/// complex transform. Neither direction changes its input. `new` allocates everything. The transforms of one
/// plan share its working memory, so record them sequentially on one queue.
#[derive(Clone, Debug)]
pub struct RealFft2 {
    fields: Fields,
    norm: Norm,
    rows: Axis,
    columns: Axis,
    scratch: [Tensor; 2],
    kernels: Kernels,
}

/// One axis: its length as a product of radices, and the roots of unity.
#[derive(Clone, Debug)]
struct Axis {
    radices: Vec<usize>,
    table: Tensor,
}

#[derive(Clone, Debug)]
struct Kernels {
    pack_pairs: PackPairs,
    unpack_pairs: UnpackPairs,
    split_spectra: SplitSpectra,
    join_spectra: JoinSpectra,
    radix4: Radix4,
    radix_prime: RadixPrime,
}

impl RealFft2 {
    /// Builds the tables, working memory and kernels for `fields`. Fails if a side is 0 or above
    /// [`MAX_LENGTH`], if the batch is empty or exceeds the device's workgroups along an axis, or if the
    /// device cannot hold the tensors.
    pub fn new(context: &Context, fields: Fields, norm: Norm) -> Result<Self> {
        for (name, length) in [("height", fields.h), ("width", fields.w)] {
            if !(1..=MAX_LENGTH).contains(&length) {
                return Err(Error::invalid("transform", name, format!("1 to {MAX_LENGTH}"), length));
            }
        }
        let most = context.device.limits().max_compute_workgroups_per_dimension as usize;
        if !(1..=most).contains(&fields.batch) {
            return Err(Error::invalid("transform", "batch", format!("1 to {most}"), fields.batch));
        }
        let elements = (fields.pairs() * fields.w).max(fields.h * fields.half());
        let scratch = |label| Tensor::zeros(context, label, &[fields.batch, elements, 2]);
        context.checked(|| {
            Ok(Self {
                fields,
                norm,
                rows: Axis::new(context, "fft.rows", fields.w)?,
                columns: Axis::new(context, "fft.columns", fields.h)?,
                scratch: [scratch("fft.scratch")?, scratch("fft.scratch")?],
                kernels: Kernels {
                    pack_pairs: PackPairs::new(context)?,
                    unpack_pairs: UnpackPairs::new(context)?,
                    split_spectra: SplitSpectra::new(context)?,
                    join_spectra: JoinSpectra::new(context)?,
                    radix4: Radix4::new(context)?,
                    radix_prime: RadixPrime::new(context)?,
                },
            })
        })
    }

    /// Returns the size and number of the fields.
    pub fn fields(&self) -> Fields {
        self.fields
    }

    /// Returns the shape of a spectrum, [B, H, W / 2 + 1, 2].
    pub fn spectrum_shape(&self) -> [usize; 4] {
        [self.fields.batch, self.fields.h, self.fields.half(), 2]
    }

    /// Computes `spectrum` [B, H, W / 2 + 1, 2] from `x` [B, H, W].
    pub fn push_forward(&self, schedule: &mut Schedule, x: &Tensor, spectrum: &Tensor) {
        assert_eq!(spectrum.shape(), self.spectrum_shape());
        let (k, packed) = (&self.kernels, &self.scratch[0]);
        k.pack_pairs.push(schedule, self.fields, self.factor(Norm::Forward), x, packed);
        let rows = self.push_axis(schedule, (&self.rows, self.row_pass(false)), packed, None);
        // The last column pass writes the spectrum; if there are no column passes, the step before them does.
        let halves = if self.columns.radices.is_empty() { spectrum } else { self.scratch_beside(rows) };
        k.split_spectra.push(schedule, self.fields, rows, halves);
        self.push_axis(schedule, (&self.columns, self.column_pass(false)), halves, Some(spectrum));
    }

    /// Computes `x` [B, H, W] from `spectrum` [B, H, W / 2 + 1, 2]. In columns that are their own conjugates,
    /// imaginary parts that remain after the column passes are ignored.
    pub fn push_inverse(&self, schedule: &mut Schedule, spectrum: &Tensor, x: &Tensor) {
        assert_eq!(spectrum.shape(), self.spectrum_shape());
        let k = &self.kernels;
        let halves = self.push_axis(schedule, (&self.columns, self.column_pass(true)), spectrum, None);
        let packed = self.scratch_beside(halves);
        k.join_spectra.push(schedule, self.fields, halves, packed);
        let rows = self.push_axis(schedule, (&self.rows, self.row_pass(true)), packed, None);
        k.unpack_pairs.push(schedule, self.fields, self.factor(Norm::Backward), rows, x);
    }

    /// Pushes the passes of one axis over `source` and returns the tensor with their result: `target` if
    /// there is one, or else a scratch tensor. If the axis has length 1, it needs no passes, and the result
    /// is `source` itself.
    fn push_axis<'a>(
        &'a self,
        schedule: &mut Schedule,
        (axis, mut pass): (&Axis, Pass),
        source: &'a Tensor,
        target: Option<&'a Tensor>,
    ) -> &'a Tensor {
        let mut at = source;
        for (i, &radix) in axis.radices.iter().enumerate() {
            let last = i + 1 == axis.radices.len();
            let to = target.filter(|_| last).unwrap_or_else(|| self.scratch_beside(at));
            pass.radix = radix;
            if radix == 4 {
                self.kernels.radix4.push(schedule, pass, &axis.table, (at, to));
            } else {
                self.kernels.radix_prime.push(schedule, pass, &axis.table, (at, to));
            }
            pass.span *= radix;
            at = to;
        }
        at
    }

    /// Returns a scratch tensor other than `taken`.
    fn scratch_beside(&self, taken: &Tensor) -> &Tensor {
        &self.scratch[usize::from(std::ptr::eq(taken, &self.scratch[0]))]
    }

    /// Returns the first pass over the packed rows, shape [B, ceil(H / 2), W].
    fn row_pass(&self, inverse: bool) -> Pass {
        let Fields { batch, w, .. } = self.fields;
        Pass { batch, lines: self.fields.pairs(), length: w, inner: 1, span: 1, radix: 1, inverse }
    }

    /// Returns the first pass over the columns of the half spectra, shape [B, H, W / 2 + 1].
    fn column_pass(&self, inverse: bool) -> Pass {
        let Fields { batch, h, .. } = self.fields;
        Pass { batch, lines: 1, length: h, inner: self.fields.half(), span: 1, radix: 1, inverse }
    }

    fn factor(&self, direction: Norm) -> f32 {
        if self.norm == direction { (1.0 / (self.fields.h * self.fields.w) as f64) as f32 } else { 1.0 }
    }
}

impl Axis {
    fn new(context: &Context, label: &'static str, length: usize) -> Result<Self> {
        // Devices disagree on sines and cosines, so the roots of unity are computed here, in double
        // precision.
        let root = |j: usize| {
            let theta = TAU * j as f64 / length as f64;
            [theta.cos() as f32, theta.sin() as f32]
        };
        let roots: Vec<[f32; 2]> = (0..length).map(root).collect();
        Ok(Self {
            radices: radices(length),
            table: Tensor::from_slice(context, label, &[length, 2], &roots)?,
        })
    }
}

/// Factors a length: fours, then at most one two, then odd primes. Empty for 1.
fn radices(mut length: usize) -> Vec<usize> {
    let mut found = Vec::new();
    let mut factor = 4;
    while length > 1 {
        // Without a small factor, what remains is prime.
        let next = if factor * factor > length && factor > 4 { length } else { factor };
        if length.is_multiple_of(next) {
            found.push(next);
            length /= next;
        } else {
            factor = match factor {
                4 => 2,
                2 => 3,
                odd => odd + 2,
            };
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::radices;

    #[test]
    fn lengths_become_radices() {
        assert!(radices(1).is_empty());
        assert_eq!(radices(64), [4, 4, 4]);
        assert_eq!(radices(32), [4, 4, 2]);
        assert_eq!(radices(100), [4, 5, 5]);
        assert_eq!(radices(6), [2, 3]);
        assert_eq!(radices(47), [47]);
        assert_eq!(radices(4093), [4093]);
        for n in 1..=4096usize {
            let found = radices(n);
            assert_eq!(found.iter().product::<usize>(), n);
            assert!(found.iter().all(|&r| r == 4 || (2..r).all(|d| !r.is_multiple_of(d))), "{n}: {found:?}");
        }
    }
}
