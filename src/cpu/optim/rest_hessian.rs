//! The Hessian of a flat sheet's energy, inverted by a cosine transform or factored: the starting point of
//! quasi-Newton methods.

use crate::cloth::{Cloth, Grid};
use crate::cpu::Real;
use crate::cpu::cloth::AXES;
use crate::cpu::matmul::{LANES, Start, Target, Term, product};
use crate::settings::{SheetConstants, TENSION};
use crate::{Error, Result, memory};
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::Llt;
use faer::sparse::{SparseColMat, Triplet};
use faer::{MatMut, Side};
use rayon::prelude::*;
use std::f64::consts::PI;
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

/// The inverse Hessian of a sheet that is not flat, approximately, in the axes of the world and in the sheet's own
/// ([`sheet_axes`]). Neither serves alone: along its surface a sheet is a thousand times as stiff as across it, and its inertia is
/// the same in all directions, however it is bent.
///
/// In space it is `P S C^T diag(1 / lambda) C S P`, as in [`RestHessian`] but for S, which multiplies each particle by its factor,
/// and for a larger inertia in lambda. In the sheet it is `P A C^T diag(1 / lambda) C A^T P`, where the columns of A are the axes of
/// each particle, and lambda differs from one to the next.
///
/// [`sheet_axes`]: crate::cpu::cloth::sheet_axes
pub struct SheetHessian<T> {
    cosines: Arc<Cosines<T>>,
    /// 1 / lambda, shape [H, stride].
    in_space: Vec<T>,
    /// 1 / lambda along t_1, t_2 and the normal, each of shape [H, stride].
    in_sheet: [Vec<T>; 3],
    held: Vec<usize>,
    scratch: Scratch<T>,
}

/// Two buffers per component, each of shape [H, stride].
type Scratch<T> = [[Vec<T>; 2]; 3];

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

/// Returns the element in row k, column i of the orthonormal DCT-II of n points.
fn cosine(n: usize, k: usize, i: usize) -> f64 {
    let scale = if k == 0 { 1.0 } else { 2.0 };
    // Reducing the argument exactly keeps long transforms accurate to the last bit.
    let angle = PI * (k * (2 * i + 1) % (4 * n)) as f64 / (2 * n) as f64;
    (scale / n as f64).sqrt() * angle.cos()
}

/// Returns the eigenvalue of mode k of second differences along n points.
fn mu(n: usize, k: usize) -> f64 {
    2.0 - 2.0 * (PI * k as f64 / n as f64).cos()
}

/// Returns the eigenvalue of mode (k, l): inertia, stretch, bend and shear of a small wave on the sheet at
/// rest, and its contacts with bodies, as if all particles had them.
fn eigenvalue(grid: Grid, cloth: &Cloth, (k, l): (usize, usize)) -> f64 {
    let (Grid { h, w }, material) = (grid, cloth.material);
    let (mu_h, mu_w) = (mu(h, k), mu(w, l));
    let n = (h * w) as f64;
    let ([down, across], [bend_down, bend_across]) = (material.weave.stretch, material.weave.bend);
    let stretch = down * mu_h / ((h - 1) * w) as f64 + across * mu_w / (h * (w - 1)) as f64;
    (1.0 + cloth.contact_curvature()) / n
        + 2.0 * (1.0 + cloth.damping) * material.stretch * stretch
        + 2.0 * material.bend / n * (bend_down * mu_h * mu_h + bend_across * mu_w * mu_w)
        + 4.0 * material.shear / n * (mu_h + mu_w)
}

/// Returns the coefficients of the stretch along the height and along the width, with what the damping adds to them.
fn damped(cloth: &Cloth) -> [f64; 2] {
    cloth.material.stretches().map(|coefficient| (1.0 + cloth.damping) * coefficient)
}

/// Returns the eigenvalues of mode (k, l) along t_1, t_2 and the normal.
fn eigenvalues_of_axes(
    grid: Grid,
    (cloth, constants): (&Cloth, &SheetConstants),
    (k, l): (usize, usize),
) -> [f64; 3] {
    let (Grid { h, w }, material) = (grid, cloth.material);
    let (mu_h, mu_w) = (mu(h, k), mu(w, l));
    let n = (h * w) as f64;
    let ([down, across], [bend_down, bend_across]) = (damped(cloth), material.bends());
    let (along_h, along_w) = (2.0 * down / ((h - 1) * w) as f64, 2.0 * across / (h * (w - 1)) as f64);
    let tangential = |along: f64, own: f64, other: f64, bend: f64| {
        let shear = 8.0 * material.shear * other / n;
        constants.tangential_inertia / n
            + along * (own + TENSION * other)
            + shear
            + 2.0 * bend * other * other / n
    };
    let normal = (1.0 + 2.0 * TENSION * material.stretch) / n
        + TENSION * (along_h * mu_h + along_w * mu_w)
        + 2.0 * constants.normal_bend * (bend_down * mu_h * mu_h + bend_across * mu_w * mu_w) / n;
    [tangential(along_h, mu_h, mu_w, bend_across), tangential(along_w, mu_w, mu_h, bend_down), normal]
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

    /// Returns the inverses of the eigenvalues of all modes, shape [H, stride].
    fn inverses(&self, eigenvalue: &dyn Fn((usize, usize)) -> f64) -> Vec<T> {
        let Grid { h, w } = self.grid;
        table((h, w), self.stride, &|k, l| eigenvalue((k, l)).recip())
    }

    fn scratch(&self) -> Scratch<T> {
        [(); 3].map(|()| [(); 2].map(|()| vec![T::zero(); self.grid.h * self.stride]))
    }

    /// Transforms a field [H, W], multiplies it by `inverse` [H, stride] and transforms it back.
    fn apply(&self, field: &mut [T], inverse: &[T], [a, b]: &mut [Vec<T>; 2]) {
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
        let grid = cosines.grid;
        Self {
            inverse: cosines.inverses(&|mode| eigenvalue(grid, cloth, mode)),
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

impl<T: Real> SheetHessian<T> {
    /// Builds the inverse Hessian of one cloth with the tables of its grid.
    pub fn new(cosines: &Arc<Cosines<T>>, cloth: &Cloth, constants: &SheetConstants) -> Self {
        let grid = cosines.grid;
        let more = (constants.spatial_inertia - 1.0) / grid.particles() as f64;
        let of = (cloth, constants);
        let inverse = |axis: usize| cosines.inverses(&|mode| eigenvalues_of_axes(grid, of, mode)[axis]);
        Self {
            in_space: cosines.inverses(&|mode| eigenvalue(grid, cloth, mode) + more),
            in_sheet: [0, 1, 2].map(inverse),
            held: cloth.held(),
            scratch: cosines.scratch(),
            cosines: cosines.clone(),
        }
    }

    /// Multiplies `direction` [3, H, W] by the inverse Hessian in space, given the `axes` [10, H, W] of the sheet. The result is 0
    /// at handles.
    pub fn apply_in_space(&mut self, axes: &[T], direction: &mut [T]) {
        let Self { cosines, in_space, held, scratch, .. } = self;
        let n = cosines.grid.particles();
        let factors = &axes[(AXES - 1) * n..];
        let multiply = |component: &mut [T]| {
            component.iter_mut().zip(factors).for_each(|(v, &factor)| *v = *v * factor);
        };
        hold(held, direction);
        direction.par_chunks_exact_mut(n).zip(scratch).for_each(|(component, scratch)| {
            multiply(component);
            cosines.apply(component, in_space, scratch);
            multiply(component);
        });
        hold(held, direction);
    }

    /// Multiplies `direction` [3, H, W] by the inverse Hessian in the sheet, given its `axes` [10, H, W]. The result is 0 at
    /// handles.
    pub fn apply_in_sheet(&mut self, axes: &[T], direction: &mut [T]) {
        let Self { cosines, in_sheet, held, scratch, .. } = self;
        let n = cosines.grid.particles();
        hold(held, direction);
        turn(axes, direction, false);
        let components = direction.par_chunks_exact_mut(n).zip(scratch).zip(in_sheet);
        components.for_each(|((component, scratch), inverse)| cosines.apply(component, inverse, scratch));
        turn(axes, direction, true);
        hold(held, direction);
    }
}

/// Sets the vectors of a field [3, n] to their products with the three axes of each particle, or those with the transpose.
fn turn<T: Real>(axes: &[T], field: &mut [T], back: bool) {
    let n = field.len() / 3;
    let (x, rest) = field.split_at_mut(n);
    let (y, z) = rest.split_at_mut(n);
    let axis: [&[T]; 9] = std::array::from_fn(|k| &axes[k * n..][..n]);
    for p in 0..n {
        let a: [T; 9] = std::array::from_fn(|k| axis[k][p]);
        let v = [x[p], y[p], z[p]];
        let with = |a: [T; 3]| a[0] * v[0] + a[1] * v[1] + a[2] * v[2];
        [x[p], y[p], z[p]] = match back {
            false => [0, 3, 6].map(|k| with([a[k], a[k + 1], a[k + 2]])),
            true => [0, 1, 2].map(|k| with([a[k], a[k + 3], a[k + 6]])),
        };
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
