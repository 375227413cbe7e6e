//! The Hessian of a flat sheet's energy, inverted by a cosine transform: where quasi-Newton methods start from.

use crate::cpu::Real;
use crate::cpu::matmul::{LANES, Start, Target, Term, product};
use crate::sim::{Cloth, Grid, Material};
use std::f64::consts::PI;

/// `H0^-1 = P C^T diag(1 / lambda) C P`: the two-dimensional cosine transform C (DCT-II, orthonormal) makes the energy's
/// Hessian at rest nearly diagonal; P zeroes the handles, which do not move (after Liu, Bouaziz and Kavan 2017).
pub struct RestHessian<T> {
    grid: Grid,
    /// Numbers of a row in memory.
    stride: usize,
    /// Cosine matrices along the height [H, H] and the width, the latter padded [W, stride], and its transpose.
    rows: Vec<T>,
    columns: Vec<T>,
    columns_transposed: Vec<T>,
    /// 1 / lambda, shape [H, stride], 0 in the padding.
    inverse: Vec<T>,
    handles: Vec<usize>,
    scratch: [Vec<T>; 2],
}

/// The orthonormal DCT-II of n points: row k, column i.
fn cosine(n: usize, k: usize, i: usize) -> f64 {
    let scale = if k == 0 { 1.0 } else { 2.0 };
    // An argument reduced exactly keeps long transforms good to the last bit.
    let angle = PI * (k * (2 * i + 1) % (4 * n)) as f64 / (2 * n) as f64;
    (scale / n as f64).sqrt() * angle.cos()
}

/// The eigenvalue of mode (k, l): inertia, stretch, bend and shear of a small wave on the sheet at rest.
fn eigenvalue(grid: Grid, material: Material, (k, l): (usize, usize)) -> f64 {
    let mu = |n: usize, k: usize| 2.0 - 2.0 * (PI * k as f64 / n as f64).cos();
    let Grid { h, w } = grid;
    let (mu_h, mu_w) = (mu(h, k), mu(w, l));
    let n = (h * w) as f64;
    let stretch = mu_h / ((h - 1) * w) as f64 + mu_w / (h * (w - 1)) as f64;
    1.0 / n
        + 2.0 * material.stretch * stretch
        + 2.0 * material.bend / n * (mu_h * mu_h + mu_w * mu_w)
        + 4.0 * material.shear / n * (mu_h + mu_w)
}

impl<T: Real> RestHessian<T> {
    /// For one cloth.
    pub fn new(grid: Grid, cloth: &Cloth) -> Self {
        let Grid { h, w } = grid;
        let stride = w.next_multiple_of(LANES);
        let table = |rows: usize, columns: usize, stride: usize, value: &dyn Fn(usize, usize) -> f64| {
            let mut table = vec![T::zero(); rows * stride];
            for (r, row) in table.chunks_exact_mut(stride).enumerate() {
                row[..columns].iter_mut().enumerate().for_each(|(c, to)| *to = T::of(value(r, c)));
            }
            table
        };
        Self {
            grid,
            stride,
            rows: table(h, h, h, &|k, i| cosine(h, k, i)),
            columns: table(w, w, stride, &|l, j| cosine(w, l, j)),
            columns_transposed: table(w, w, stride, &|j, l| cosine(w, l, j)),
            inverse: table(h, w, stride, &|k, l| eigenvalue(grid, cloth.material, (k, l)).recip()),
            handles: cloth.handles.clone(),
            scratch: [(); 2].map(|_| vec![T::zero(); h * stride]),
        }
    }

    /// Replaces each component of `direction` [3, H, W] by `H0^-1` times it.
    pub fn apply(&mut self, direction: &mut [T]) {
        let Grid { h, w } = self.grid;
        for component in direction.chunks_exact_mut(h * w) {
            self.hold(component);
            let [a, b] = &mut self.scratch;
            for (row, values) in a.chunks_exact_mut(self.stride).zip(component.chunks_exact(w)) {
                row[..w].copy_from_slice(values);
            }
            let along = |out: &mut [T], from: &[T], transposed: bool| {
                let term = Term {
                    a: &self.rows,
                    a_stride: h,
                    a_transposed: transposed,
                    b: from,
                    b_stride: self.stride,
                    depth: h,
                };
                multiply(out, (h, self.stride), term);
            };
            let across = |out: &mut [T], from: &[T], table: &[T]| {
                let term = Term {
                    a: from,
                    a_stride: self.stride,
                    a_transposed: false,
                    b: table,
                    b_stride: self.stride,
                    depth: w,
                };
                multiply(out, (h, self.stride), term);
            };
            along(b, a, false);
            across(a, b, &self.columns_transposed);
            a.iter_mut().zip(&self.inverse).for_each(|(z, &inverse)| *z = *z * inverse);
            across(b, a, &self.columns);
            along(a, b, true);
            for (values, row) in component.chunks_exact_mut(w).zip(a.chunks_exact(self.stride)) {
                values.copy_from_slice(&row[..w]);
            }
            self.hold(component);
        }
    }

    fn hold(&self, component: &mut [T]) {
        self.handles.iter().for_each(|&p| component[p] = T::zero());
    }
}

fn multiply<T: Real>(out: &mut [T], (rows, stride): (usize, usize), term: Term<'_, T>) {
    product(Target { out, stride, rows, columns: stride, start: Start::Zero }, &[term]);
}
