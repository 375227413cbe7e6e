//! The Hessian of a flat sheet's energy, inverted by a cosine transform or factored: the starting point of
//! quasi-Newton methods.

use crate::cloth::{Cloth, Grid, Material};
use crate::cpu::Real;
use crate::cpu::matmul::{LANES, Start, Target, Term, product};
use crate::{Error, Result};
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::Llt;
use faer::sparse::{SparseColMat, Triplet};
use faer::{MatMut, Side};
use rayon::prelude::*;
use std::f64::consts::PI;

/// The initial inverse Hessian of a quasi-Newton method.
pub trait InverseHessian<T>: Send + Sync {
    /// Multiplies `direction` [3, H, W] by the inverse Hessian. The result is 0 at handles.
    fn apply(&mut self, direction: &mut [T]);
}

/// `H0^-1 = P C^T diag(1 / lambda) C P`. The two-dimensional cosine transform C (DCT-II, orthonormal) makes
/// the energy's Hessian at rest nearly diagonal; P zeroes the handles, which do not move (after Liu, Bouaziz
/// and Kavan 2017).
pub struct RestHessian<T> {
    grid: Grid,
    /// Length of a row in memory.
    stride: usize,
    /// Cosine matrices along the height [H, H] and along the width, padded to [W, stride], and the transpose
    /// of the latter.
    rows: Vec<T>,
    columns: Vec<T>,
    columns_transposed: Vec<T>,
    /// 1 / lambda, shape [H, stride], 0 in the padding.
    inverse: Vec<T>,
    handles: Vec<usize>,
    /// Two buffers per component.
    scratch: [[Vec<T>; 2]; 3],
}

/// Returns the element in row k, column i of the orthonormal DCT-II of n points.
fn cosine(n: usize, k: usize, i: usize) -> f64 {
    let scale = if k == 0 { 1.0 } else { 2.0 };
    // Reducing the argument exactly keeps long transforms accurate to the last bit.
    let angle = PI * (k * (2 * i + 1) % (4 * n)) as f64 / (2 * n) as f64;
    (scale / n as f64).sqrt() * angle.cos()
}

/// Returns the eigenvalue of mode (k, l): inertia, stretch, bend and shear of a small wave on the sheet at
/// rest.
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
    /// Builds the inverse Hessian of one cloth.
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
            scratch: [(); 3].map(|()| [(); 2].map(|()| vec![T::zero(); h * stride])),
        }
    }
}

impl<T: Real> InverseHessian<T> for RestHessian<T> {
    fn apply(&mut self, direction: &mut [T]) {
        let Self { grid, stride, rows, columns, columns_transposed, inverse, handles, scratch } = self;
        let (Grid { h, w }, stride) = (*grid, *stride);
        let hold = |component: &mut [T]| handles.iter().for_each(|&p| component[p] = T::zero());
        let along = |out: &mut [T], from: &[T], transposed: bool| {
            let of = if transposed { Term::transposed } else { Term::new };
            let a = of((rows, h), (from, stride), h);
            multiply(out, (h, stride), a);
        };
        let across = |out: &mut [T], from: &[T], table: &[T]| {
            let a = Term::new((from, stride), (table, stride), w);
            multiply(out, (h, stride), a);
        };
        let components = direction.par_chunks_exact_mut(h * w).zip(scratch);
        components.for_each(|(component, [a, b])| {
            hold(component);
            for (row, values) in a.chunks_exact_mut(stride).zip(component.chunks_exact(w)) {
                row[..w].copy_from_slice(values);
            }
            along(b, a, false);
            across(a, b, columns_transposed);
            a.iter_mut().zip(&*inverse).for_each(|(z, &inverse)| *z = *z * inverse);
            across(b, a, columns);
            along(a, b, true);
            for (values, row) in component.chunks_exact_mut(w).zip(a.chunks_exact(stride)) {
                values.copy_from_slice(&row[..w]);
            }
            hold(component);
        });
    }
}

/// The inverse Hessian at rest of the free particles alone, by sparse Cholesky factors in double precision.
/// Unlike [`RestHessian`], it is exact at the handles too.
///
/// With the second differences D of a row and of a column of particles, the Hessian is
/// `1/(HW) + 2 k_stretch (D_H / ((H-1) W) + D_W / (H (W-1))) + 2 k_bend/(HW) (D_H^2 + D_W^2) +
/// 4 k_shear/(HW) (D_H + D_W)`.
pub struct FactoredRestHessian {
    factors: Llt<usize, f64>,
    handles: Vec<usize>,
    /// Shape [3, H, W].
    direction: Vec<f64>,
}

impl FactoredRestHessian {
    /// Factors the Hessian of one cloth. Fails if there is not enough memory for the factors.
    pub fn new(grid: Grid, cloth: &Cloth) -> Result<Self> {
        let Grid { h, w } = grid;
        let (n, Material { stretch, shear, bend }) = ((h * w) as f64, cloth.material);
        let along = |length: usize, lines: usize, d: f64, d2: f64| {
            d * (2.0 * stretch / ((length - 1) * lines) as f64 + 4.0 * shear / n) + d2 * 2.0 * bend / n
        };
        let mut is_handle = vec![false; grid.particles()];
        cloth.handles.iter().for_each(|&p| is_handle[p] = true);
        let mut triplets = Vec::new();
        for (q, &is_handle) in is_handle.iter().enumerate() {
            let (i, j) = (q / w, q % w);
            if is_handle {
                triplets.push(Triplet::new(q, q, 1.0));
                continue;
            }
            // The lower triangle: particles further down or to the right.
            for k in i..(i + 3).min(h) {
                let mut value = along(h, w, second_difference(h, k, i), square_of_it(h, k, i));
                if k == i {
                    value += 1.0 / n + along(w, h, second_difference(w, j, j), square_of_it(w, j, j));
                }
                triplets.push(Triplet::new(k * w + j, q, value));
            }
            for l in j + 1..(j + 3).min(w) {
                let value = along(w, h, second_difference(w, l, j), square_of_it(w, l, j));
                triplets.push(Triplet::new(i * w + l, q, value));
            }
        }
        triplets.retain(|t| t.row == t.col || !is_handle[t.row]);
        let failed = |e: &dyn std::fmt::Debug| {
            Error::Device(format!("cpu: factoring the Hessian at rest failed: {e:?}"))
        };
        let particles = grid.particles();
        let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(particles, particles, &triplets)
            .map_err(|e| failed(&e))?;
        let factors = matrix.sp_cholesky(Side::Lower).map_err(|e| failed(&e))?;
        Ok(Self { factors, handles: cloth.handles.clone(), direction: vec![0.0; 3 * particles] })
    }
}

/// Returns `D[a, b]` for a line of `n` particles: 2 (1 at its ends) on the diagonal, -1 next to it.
fn second_difference(n: usize, a: usize, b: usize) -> f64 {
    match a.abs_diff(b) {
        0 => 2.0 - f64::from(u8::from(a == 0)) - f64::from(u8::from(a + 1 == n)),
        1 => -1.0,
        _ => 0.0,
    }
}

/// Returns `(D D)[a, b]`.
fn square_of_it(n: usize, a: usize, b: usize) -> f64 {
    (a.saturating_sub(1)..(a + 2).min(n))
        .map(|k| second_difference(n, a, k) * second_difference(n, k, b))
        .sum()
}

impl<T: Real> InverseHessian<T> for FactoredRestHessian {
    fn apply(&mut self, direction: &mut [T]) {
        let n = direction.len() / 3;
        self.direction.iter_mut().zip(&*direction).for_each(|(to, &from)| *to = from.f64());
        for component in self.direction.chunks_exact_mut(n) {
            self.handles.iter().for_each(|&p| component[p] = 0.0);
        }
        self.factors.solve_in_place(MatMut::from_column_major_slice_mut(&mut self.direction, n, 3));
        direction.iter_mut().zip(&self.direction).for_each(|(to, &from)| *to = T::of(from));
    }
}

fn multiply<T: Real>(out: &mut [T], (rows, stride): (usize, usize), term: Term<'_, T>) {
    product(Target { out, stride, rows, columns: stride, start: Start::Zero }, &[term]);
}
