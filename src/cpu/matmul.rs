//! The matrix product of the CPU path: small panels of row-major matrices, held in vector registers.
//!
//! Every linear stage of the operator takes the form `out = start + sum over terms of A B`, with channels
//! running along the registers. A few thousand elements of activations then stay in the first-level cache
//! from one stage to the next. A general library packs both operands first, which costs as much as such a
//! small product.

use super::real::Real;
use pulp::{Simd, WithSimd};
use std::time::Instant;

/// Channel counts are padded to a multiple of this, the number of lanes of the widest register in use.
pub(crate) const LANES: usize = 16;
/// Rows of `out` that one block holds in registers.
const BLOCK_ROWS: usize = 6;

/// One product `A B` of a sum: A of shape [M, K] with `a_stride` between rows, B of shape [K, N] with
/// `b_stride`.
pub struct Term<'a, T> {
    a: &'a [T],
    /// Numbers between the rows of A, or of its transpose.
    a_stride: usize,
    /// Whether `a` holds the transpose [K, M] of A.
    a_transposed: bool,
    b: &'a [T],
    b_stride: usize,
    /// K, the length of the sum.
    depth: usize,
}

impl<'a, T> Term<'a, T> {
    /// Returns the product of A [M, K] and B [K, N], each given with the numbers between its rows, summed over
    /// `depth` K.
    pub fn new((a, a_stride): (&'a [T], usize), (b, b_stride): (&'a [T], usize), depth: usize) -> Self {
        Self { a, a_stride, a_transposed: false, b, b_stride, depth }
    }

    /// Returns the product of A and B from the transpose [K, M] of A, as in sums over positions.
    pub fn transposed((a, a_stride): (&'a [T], usize), b: (&'a [T], usize), depth: usize) -> Self {
        Self { a_transposed: true, ..Self::new((a, a_stride), b, depth) }
    }
}

/// The destination of a product: M rows of N numbers with `stride` between rows. N is a multiple of
/// [`LANES`].
pub struct Target<'a, T> {
    pub out: &'a mut [T],
    pub stride: usize,
    pub rows: usize,
    pub columns: usize,
    pub start: Start<'a, T>,
}

/// The initial value to which a product is added.
#[derive(Clone, Copy)]
pub enum Start<'a, T> {
    Zero,
    /// The same numbers for each row, shape \[N\], such as a bias.
    Row(&'a [T]),
    /// The current contents of the target.
    Target,
}

/// Computes `out[m, n] = start[n] + sum over terms and k of a[m, k] b[k, n]`, summed in this order whatever
/// the number of threads.
pub(crate) fn product<T: Real>(target: Target<'_, T>, terms: &[Term<'_, T>]) {
    T::product(target, terms);
}

pub(super) fn generic_product<T: Real>(target: Target<'_, T>, terms: &[Term<'_, T>]) {
    assert!(target.columns.is_multiple_of(LANES), "columns come in multiples of the register width");
    pulp::Arch::new().dispatch(Product { target, terms });
}

/// Computes `out[m] = start + sum over k of a[m, k] weight[k]` for rows of `weight.len()` numbers, a multiple
/// of [`LANES`].
pub(crate) fn weighted_rows<T: Real>(out: &mut [T], start: T, a: &[T], weight: &[T]) {
    T::weighted_rows(out, start, a, weight);
}

pub(super) fn generic_weighted_rows<T: Real>(out: &mut [T], start: T, a: &[T], weight: &[T]) {
    pulp::Arch::new().dispatch(WeightedRows { out, start, a, weight });
}

/// Computes `sums[n] += sum over m of rows[m, n]` for rows of `sums.len()` numbers, a multiple of [`LANES`].
pub(crate) fn add_rows<T: Real>(sums: &mut [T], rows: &[T]) {
    T::add_rows(sums, rows);
}

pub(super) fn generic_add_rows<T: Real>(sums: &mut [T], rows: &[T]) {
    pulp::Arch::new().dispatch(AddRows { sums, rows });
}

/// Computes `largest[n] = max(largest[n], rows[m, n])` over all rows, each of `largest.len()` numbers.
pub(crate) fn largest_rows<T: Real>(largest: &mut [T], rows: &[T]) {
    T::largest_rows(largest, rows);
}

pub(super) fn generic_largest_rows<T: Real>(largest: &mut [T], rows: &[T]) {
    pulp::Arch::new().dispatch(LargestRows { largest, rows });
}

/// Measures the peak rate of multiply-adds in single precision, in floating-point operations per second, two
/// for each multiply-add: that of the product, on all threads of the current rayon pool and on operands that
/// stay in the first-level cache. Takes a third of a second.
pub fn peak_rate() -> f64 {
    const SIZE: usize = 64;
    const ROWS: usize = 6 * BLOCK_ROWS;
    const PRODUCTS: usize = 200;
    let work = || {
        let (a, b) = (vec![1e-3f32; ROWS * SIZE], vec![1e-3f32; SIZE * SIZE]);
        let mut out = vec![0.0f32; ROWS * SIZE];
        for _ in 0..PRODUCTS {
            let target =
                Target { out: &mut out, stride: SIZE, rows: ROWS, columns: SIZE, start: Start::Zero };
            let term = Term::new((&a, SIZE), (&b, SIZE), SIZE);
            product(target, &[std::hint::black_box(term)]);
        }
        std::hint::black_box(out);
    };
    let threads = rayon::current_num_threads();
    let begun = Instant::now();
    let mut best: f64 = 0.0;
    while begun.elapsed().as_secs_f64() < 0.3 {
        let start = Instant::now();
        rayon::broadcast(|_| work());
        let flop = (2 * ROWS * SIZE * SIZE * PRODUCTS * threads) as f64;
        best = best.max(flop / start.elapsed().as_secs_f64());
    }
    best
}

struct Product<'a, 'b, T> {
    target: Target<'a, T>,
    terms: &'b [Term<'b, T>],
}

impl<T: Real> WithSimd for Product<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let width = LANES / T::lanes::<S>(&[T::zero(); LANES]).len();
        let mut column = 0;
        // Blocks of 6 x 4 accumulators fit 32 registers, blocks of 6 x 2 fit 16.
        let wide = if S::REGISTER_COUNT >= 32 { 4 } else { 2 };
        while column < self.target.columns {
            let left = (self.target.columns - column) / width;
            if wide == 4 && left >= 4 {
                panel::<T, S, 4>(simd, &mut self, column);
                column += 4 * width;
            } else if left >= 2 {
                panel::<T, S, 2>(simd, &mut self, column);
                column += 2 * width;
            } else {
                panel::<T, S, 1>(simd, &mut self, column);
                column += width;
            }
        }
    }
}

/// Computes `V` registers of columns from `column` on, for all rows, in blocks of nearly equal height.
#[inline(always)]
fn panel<T: Real, S: Simd, const V: usize>(simd: S, p: &mut Product<'_, '_, T>, column: usize) {
    let rows = p.target.rows;
    let blocks = rows.div_ceil(BLOCK_ROWS);
    for index in 0..blocks {
        let (row, end) = (index * rows / blocks, (index + 1) * rows / blocks);
        match end - row {
            1 => block::<T, S, 1, V>(simd, p, row, column),
            2 => block::<T, S, 2, V>(simd, p, row, column),
            3 => block::<T, S, 3, V>(simd, p, row, column),
            4 => block::<T, S, 4, V>(simd, p, row, column),
            5 => block::<T, S, 5, V>(simd, p, row, column),
            _ => block::<T, S, BLOCK_ROWS, V>(simd, p, row, column),
        }
    }
}

#[inline(always)]
fn block<T: Real, S: Simd, const M: usize, const V: usize>(
    simd: S,
    p: &mut Product<'_, '_, T>,
    row: usize,
    column: usize,
) {
    let target = &mut p.target;
    let mut sum = [[T::splat(simd, T::zero()); V]; M];
    match target.start {
        Start::Zero => {}
        Start::Row(start) => {
            let start = T::lanes::<S>(&start[column..]);
            for sum in &mut sum {
                sum.copy_from_slice(&start[..V]);
            }
        }
        Start::Target => {
            for (m, sum) in sum.iter_mut().enumerate() {
                let start = T::lanes::<S>(&target.out[(row + m) * target.stride + column..]);
                sum.copy_from_slice(&start[..V]);
            }
        }
    }
    for term in p.terms {
        let depth = term.depth;
        let b_rows = term.b[column..].chunks(term.b_stride).take(depth);
        if term.a_transposed {
            for (a, b) in term.a[row..].chunks(term.a_stride).zip(b_rows) {
                let (a, b) = (&a[..M], &T::lanes::<S>(b)[..V]);
                for m in 0..M {
                    let a = T::splat(simd, a[m]);
                    for v in 0..V {
                        sum[m][v] = T::fma(simd, a, b[v], sum[m][v]);
                    }
                }
            }
            continue;
        }
        let a: [&[T]; M] = std::array::from_fn(|m| &term.a[(row + m) * term.a_stride..][..depth]);
        for (k, b) in b_rows.enumerate() {
            let b = &T::lanes::<S>(b)[..V];
            for m in 0..M {
                let a = T::splat(simd, a[m][k]);
                for v in 0..V {
                    sum[m][v] = T::fma(simd, a, b[v], sum[m][v]);
                }
            }
        }
    }
    for (m, sum) in sum.iter().enumerate() {
        let out = &mut target.out[(row + m) * target.stride + column..];
        T::lanes_mut::<S>(out)[..V].copy_from_slice(sum);
    }
}

struct WeightedRows<'a, T> {
    out: &'a mut [T],
    start: T,
    a: &'a [T],
    weight: &'a [T],
}

impl<T: Real> WithSimd for WeightedRows<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let weight = T::lanes::<S>(self.weight);
        for (out, a) in self.out.iter_mut().zip(self.a.chunks_exact(self.weight.len())) {
            let mut sum = T::splat(simd, T::zero());
            for (&a, &w) in T::lanes::<S>(a).iter().zip(weight) {
                sum = T::fma(simd, a, w, sum);
            }
            *out = self.start + T::reduce_sum(simd, sum);
        }
    }
}

struct AddRows<'a, T> {
    sums: &'a mut [T],
    rows: &'a [T],
}

impl<T: Real> WithSimd for AddRows<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let columns = self.sums.len();
        let one = T::splat(simd, T::one());
        let sums = T::lanes_mut::<S>(self.sums);
        for row in self.rows.chunks_exact(columns) {
            for (sum, &x) in sums.iter_mut().zip(T::lanes::<S>(row)) {
                *sum = T::fma(simd, one, x, *sum);
            }
        }
    }
}

struct LargestRows<'a, T> {
    largest: &'a mut [T],
    rows: &'a [T],
}

impl<T: Real> WithSimd for LargestRows<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let columns = self.largest.len();
        let largest = T::lanes_mut::<S>(self.largest);
        for row in self.rows.chunks_exact(columns) {
            for (largest, &x) in largest.iter_mut().zip(T::lanes::<S>(row)) {
                *largest = T::max_lanes(simd, *largest, x);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_of_products_match_plain_loops() {
        for (rows, columns, depth) in [(1, 16, 1), (7, 48, 5), (13, 64, 33), (24, 272, 10)] {
            let value = |n: usize, seed: usize| ((n * 7919 + seed) % 101) as f64 / 50.0 - 1.0;
            let a: Vec<f64> = (0..rows * (depth + 2)).map(|n| value(n, 1)).collect();
            let b: Vec<f64> = (0..depth * (columns + 3)).map(|n| value(n, 2)).collect();
            let start: Vec<f64> = (0..columns).map(|n| value(n, 3)).collect();
            let transposed: Vec<f64> = (0..depth * (rows + 1))
                .map(|n| {
                    if n % (rows + 1) < rows {
                        a[n % (rows + 1) * (depth + 2) + n / (rows + 1)]
                    } else {
                        f64::NAN
                    }
                })
                .collect();
            let b_stride = columns + 3;
            let straight = Term::new((&a, depth + 2), (&b, b_stride), depth);
            let transposed = Term::transposed((&transposed, rows + 1), (&b, b_stride), depth);
            let stride = columns + 1;
            let mut out = vec![f64::NAN; rows * stride];
            let target = Target { out: &mut out, stride, rows, columns, start: Start::Row(&start) };
            product(target, &[straight]);
            let target = Target { out: &mut out, stride, rows, columns, start: Start::Target };
            product(target, &[transposed]);
            for m in 0..rows {
                for n in 0..columns {
                    let ab: f64 = (0..depth).map(|k| a[m * (depth + 2) + k] * b[k * (columns + 3) + n]).sum();
                    assert!((out[m * stride + n] - start[n] - 2.0 * ab).abs() < 1e-12);
                }
                assert!(out[m * stride + columns].is_nan(), "wrote beyond the columns");
            }
        }
    }
}
