//! The Hessian of a flat sheet's energy, inverted by a cosine transform or factored: the starting point of
//! quasi-Newton methods.

use crate::cloth::modes::{Component, SheetConstants, cosine};
use crate::cloth::{Cloth, Grid};
use crate::cpu::Real;
use crate::cpu::matmul::{LANES, Start, Target, Term, product};
use crate::{Error, Result, memory};
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::Llt;
use faer::sparse::{SparseColMat, Triplet};
use faer::{MatMut, Side};
use rayon::prelude::*;
use std::sync::Arc;

/// The initial inverse Hessian of a quasi-Newton method.
pub trait InverseHessian<T>: Send + Sync {
    /// Multiplies `direction` [3, H, W] by the inverse Hessian. The result is 0 at handles.
    fn apply(&mut self, direction: &mut [T]);
}

/// `H0^-1 = P C^T diag(1 / lambda) C P`. The two-dimensional cosine transform C (DCT-II, orthonormal) makes
/// the energy's Hessian at rest nearly diagonal; P zeroes the handles, which do not move (after Liu, Bouaziz
/// and Kavan 2017).
pub struct RestHessian<T> {
    cosines: Arc<Cosines<T>>,
    /// 1 / lambda, shape [H, stride], 0 in the padding.
    inverse: Vec<T>,
    held: Vec<usize>,
    scratch: Scratch<T>,
}

/// Two buffers per component, each of shape [H, stride].
pub(super) type Scratch<T> = [[Vec<T>; 2]; 3];

/// The cosine transform of a grid, as matrix products.
pub struct Cosines<T> {
    grid: Grid,
    /// Length of a row in memory.
    stride: usize,
    /// Cosine matrices along the height [H, H] and along the width, padded to [W, stride], and the transpose
    /// of the latter.
    rows: Vec<T>,
    columns: Vec<T>,
    columns_transposed: Vec<T>,
}

/// Returns the coefficients of the stretch along the height and along the width, with what the damping adds to them.
fn damped(cloth: &Cloth) -> [f64; 2] {
    cloth.material.stretches().map(|coefficient| (1.0 + cloth.damping) * coefficient)
}

impl<T: Real> Cosines<T> {
    /// Builds the tables of a grid.
    pub fn new(grid: Grid) -> Self {
        let Grid { h, w } = grid;
        let stride = w.next_multiple_of(LANES);
        Self {
            grid,
            stride,
            rows: table((h, h), h, &|k, i| cosine(h, k, i)),
            columns: table((w, w), stride, &|l, j| cosine(w, l, j)),
            columns_transposed: table((w, w), stride, &|j, l| cosine(w, l, j)),
        }
    }

    /// Returns the inverses of the eigenvalues of all modes of a component, shape [H, stride].
    pub(super) fn inverses(&self, component: Component, of: (&Cloth, &SheetConstants)) -> Vec<T> {
        let Grid { h, w } = self.grid;
        table((h, w), self.stride, &|k, l| component.eigenvalue(self.grid, of, (k, l)).recip())
    }

    /// Returns the grid.
    pub(super) fn grid(&self) -> Grid {
        self.grid
    }

    pub(super) fn scratch(&self) -> Scratch<T> {
        [(); 3].map(|()| [(); 2].map(|()| vec![T::zero(); self.grid.h * self.stride]))
    }

    /// Transforms a field [H, W], multiplies it by `inverse` [H, stride] and transforms it back.
    pub(super) fn apply(&self, field: &mut [T], inverse: &[T], [a, b]: &mut [Vec<T>; 2]) {
        let Self { grid: Grid { h, w }, stride, rows, columns, columns_transposed } = self;
        let (h, w, stride) = (*h, *w, *stride);
        let along = |out: &mut [T], from: &[T], transposed: bool| {
            let of = if transposed { Term::transposed } else { Term::new };
            let a = of((rows, h), (from, stride), h);
            multiply(out, (h, stride), a);
        };
        let across = |out: &mut [T], from: &[T], table: &[T]| {
            let a = Term::new((from, stride), (table, stride), w);
            multiply(out, (h, stride), a);
        };
        for (row, values) in a.chunks_exact_mut(stride).zip(field.chunks_exact(w)) {
            row[..w].copy_from_slice(values);
        }
        along(b, a, false);
        across(a, b, columns_transposed);
        a.iter_mut().zip(inverse).for_each(|(z, &inverse)| *z = *z * inverse);
        across(b, a, columns);
        along(a, b, true);
        for (values, row) in field.chunks_exact_mut(w).zip(a.chunks_exact(stride)) {
            values.copy_from_slice(&row[..w]);
        }
    }
}

/// Returns a table of these values, [rows, stride], 0 past the columns.
fn table<T: Real>(
    (rows, columns): (usize, usize),
    stride: usize,
    value: &dyn Fn(usize, usize) -> f64,
) -> Vec<T> {
    let mut table = vec![T::zero(); rows * stride];
    for (r, row) in table.chunks_exact_mut(stride).enumerate() {
        row[..columns].iter_mut().enumerate().for_each(|(c, to)| *to = T::of(value(r, c)));
    }
    table
}

/// Zeroes a field [3, H, W] at the particles that are held.
pub(super) fn hold<T: Real>(held: &[usize], field: &mut [T]) {
    let n = field.len() / 3;
    for component in field.chunks_exact_mut(n) {
        held.iter().for_each(|&p| component[p] = T::zero());
    }
}

impl<T: Real> RestHessian<T> {
    /// Builds the inverse Hessian of one cloth.
    pub fn new(grid: Grid, cloth: &Cloth) -> Self {
        Self::with(&Arc::new(Cosines::new(grid)), cloth)
    }

    /// Builds the inverse Hessian of one cloth with the tables of its grid.
    pub fn with(cosines: &Arc<Cosines<T>>, cloth: &Cloth) -> Self {
        Self {
            inverse: cosines.inverses(Component::Space, (cloth, &SheetConstants::FLAT)),
            held: cloth.held(),
            scratch: cosines.scratch(),
            cosines: cosines.clone(),
        }
    }
}

impl<T: Real> InverseHessian<T> for RestHessian<T> {
    fn apply(&mut self, direction: &mut [T]) {
        let Self { cosines, inverse, held, scratch } = self;
        hold(held, direction);
        let components = direction.par_chunks_exact_mut(cosines.grid.particles()).zip(scratch);
        components.for_each(|(component, scratch)| cosines.apply(component, inverse, scratch));
        hold(held, direction);
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
    held: Vec<usize>,
    /// Shape [3, H, W].
    direction: Vec<f64>,
}

impl FactoredRestHessian {
    /// Factors the Hessian of one cloth. Fails if there is not enough memory for the factors.
    pub fn new(grid: Grid, cloth: &Cloth) -> Result<Self> {
        let Grid { h, w } = grid;
        // Measured on 300x300 to 1000x1000 particles: the fill grows with their logarithm.
        let each = (160 * grid.particles().ilog2() as usize).saturating_sub(1000);
        memory::check(grid.particles().saturating_mul(each), "the factors of a Hessian at rest")?;
        let (n, material) = ((h * w) as f64, cloth.material);
        let ([down, across], [bend_down, bend_across]) = (damped(cloth), material.bends());
        let along = |length: usize, lines: usize, [stretch, bend]: [f64; 2], d: f64, d2: f64| {
            d * (2.0 * stretch / ((length - 1) * lines) as f64 + 4.0 * material.shear / n)
                + d2 * 2.0 * bend / n
        };
        let (vertical, horizontal) = ([down, bend_down], [across, bend_across]);
        let held = cloth.held();
        let mut is_held = vec![false; grid.particles()];
        held.iter().for_each(|&p| is_held[p] = true);
        let mut triplets = Vec::new();
        for (q, &held) in is_held.iter().enumerate() {
            let (i, j) = (q / w, q % w);
            if held {
                triplets.push(Triplet::new(q, q, 1.0));
                continue;
            }
            // The lower triangle: particles further down or to the right.
            for k in i..(i + 3).min(h) {
                let mut value = along(h, w, vertical, second_difference(h, k, i), square_of_it(h, k, i));
                if k == i {
                    value +=
                        1.0 / n + along(w, h, horizontal, second_difference(w, j, j), square_of_it(w, j, j));
                }
                triplets.push(Triplet::new(k * w + j, q, value));
            }
            for l in j + 1..(j + 3).min(w) {
                let value = along(w, h, horizontal, second_difference(w, l, j), square_of_it(w, l, j));
                triplets.push(Triplet::new(i * w + l, q, value));
            }
        }
        triplets.retain(|t| t.row == t.col || !is_held[t.row]);
        let failed = |e: &dyn std::fmt::Debug| {
            Error::Device(format!("cpu: factoring the Hessian at rest failed: {e:?}"))
        };
        let particles = grid.particles();
        let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(particles, particles, &triplets)
            .map_err(|e| failed(&e))?;
        let factors = matrix.sp_cholesky(Side::Lower).map_err(|e| failed(&e))?;
        Ok(Self { factors, held, direction: vec![0.0; 3 * particles] })
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
            self.held.iter().for_each(|&p| component[p] = 0.0);
        }
        self.factors.solve_in_place(MatMut::from_column_major_slice_mut(&mut self.direction, n, 3));
        direction.iter_mut().zip(&self.direction).for_each(|(to, &from)| *to = T::of(from));
    }
}

fn multiply<T: Real>(out: &mut [T], (rows, stride): (usize, usize), term: Term<'_, T>) {
    product(Target { out, stride, rows, columns: stride, start: Start::Zero }, &[term]);
}
