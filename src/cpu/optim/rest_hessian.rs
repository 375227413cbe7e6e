//! The Hessian of a flat sheet's energy, inverted by a cosine transform or factored: the starting point of
//! quasi-Newton methods.

use super::passes::Pass;
use crate::cloth::modes::{Component, SheetConstants, cosine};
use crate::cloth::{Cloth, Grid};
use crate::cpu::Real;
use crate::cpu::matmul::{LANES, Start, Target, Term, product};
use crate::{Error, Result, memory};
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::Llt;
use faer::sparse::{SparseColMat, Triplet};
use faer::{MatMut, Side};
use pulp::{Arch, Simd, WithSimd};
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
    /// 1 / lambda ([`Cosines::inverses`]).
    inverse: Vec<T>,
    held: Vec<usize>,
    scratch: Scratch<T>,
}

/// Two buffers per component, each of shape [H, stride].
pub(super) type Scratch<T> = [[Vec<T>; 2]; 3];

/// The cosine transform of a grid, as matrix products.
///
/// Mode k has the same values at both ends of a row if k is even, and opposite ones if it is odd. So along a long axis even modes are products
/// with the sums of what is as far from either end, odd ones with the differences: two matrices of half the size. In memory the
/// even modes come first, and the odd ones of a row begin at a multiple of the width of registers.
pub struct Cosines<T> {
    grid: Grid,
    /// Numbers in memory of the even and of the odd modes of a row.
    widths: [usize; 2],
    /// Even and odd modes along the height, [modes, positions] in the first half of the rows.
    rows: [Vec<T>; 2],
    /// The same along the width, padded, and their transposes.
    columns: [Vec<T>; 2],
    columns_transposed: [Vec<T>; 2],
}

/// Positions along an axis from which on halves pay: of 64x64 particles they save 5 % of a frame, of 100x100 9 %, of 256x256 17 %; of
/// 32x32 the small products take as long as the large one.
const LONG: usize = 80;

/// Returns how many even and odd modes there are along an axis, which are also the positions whose sums and differences are taken. The
/// modes of a short axis stay together, as if all were even.
fn halves(count: usize) -> [usize; 2] {
    if count < LONG { [count, 0] } else { [count.div_ceil(2), count / 2] }
}

/// Returns the mode with this number among the even or the odd ones of an axis.
fn mode(count: usize, number: usize, odd: usize) -> usize {
    if count < LONG { number } else { 2 * number + odd }
}

/// Returns the coefficients of the stretch along the height and along the width, with what the damping adds to them.
fn damped(cloth: &Cloth) -> [f64; 2] {
    cloth.material.stretches().map(|coefficient| (1.0 + cloth.damping) * coefficient)
}

impl<T: Real> Cosines<T> {
    /// Builds the tables of a grid.
    pub fn new(grid: Grid) -> Self {
        let Grid { h, w } = grid;
        let widths = halves(w).map(|count| count.next_multiple_of(LANES));
        let of_width = |transposed: bool| {
            [0, 1].map(|odd| {
                let count = halves(w)[odd];
                table((count, count), widths[odd], &|a, b| {
                    let (number, at) = if transposed { (b, a) } else { (a, b) };
                    cosine(w, mode(w, number, odd), at)
                })
            })
        };
        let of_height = |odd: usize| {
            let count = halves(h)[odd];
            table((count, count), count, &|number, at| cosine(h, mode(h, number, odd), at))
        };
        let rows = [of_height(0), of_height(1)];
        Self { grid, widths, rows, columns: of_width(false), columns_transposed: of_width(true) }
    }

    /// Numbers from a row in memory to the next.
    fn stride(&self) -> usize {
        self.widths.iter().sum()
    }

    /// Returns the inverses of the eigenvalues of all modes of a component, as they are in memory, 0 in the padding.
    pub(super) fn inverses(&self, component: Component, of: (&Cloth, &SheetConstants)) -> Vec<T> {
        let (grid, stride) = (self.grid, self.stride());
        let ([even, _], evens) = (self.widths, halves(grid.h)[0]);
        let mut inverses = vec![T::zero(); grid.h * stride];
        let places = |count: usize, odd_from: usize| {
            let of_half = move |odd: usize| {
                (0..halves(count)[odd]).map(move |k| (odd * odd_from + k, mode(count, k, odd)))
            };
            (0..2).flat_map(of_half)
        };
        for (row, k) in places(grid.h, evens) {
            for (column, l) in places(grid.w, even) {
                inverses[row * stride + column] = T::of(component.eigenvalue(grid, of, (k, l)).recip());
            }
        }
        inverses
    }

    /// Returns the grid.
    pub(super) fn grid(&self) -> Grid {
        self.grid
    }

    pub(super) fn scratch(&self) -> Scratch<T> {
        [(); 3].map(|()| [(); 2].map(|()| vec![T::zero(); self.grid.h * self.stride()]))
    }

    /// Transforms a field [H, W], multiplies it by `inverse` ([`Cosines::inverses`]) and transforms it back.
    pub(super) fn apply(&self, field: &mut [T], inverse: &[T], [a, b]: &mut [Vec<T>; 2]) {
        Arch::new().dispatch(Fold { cosines: self, field, to: a });
        self.along(b, a, false);
        self.across(a, b, &self.columns_transposed);
        Pass::Multiply(a, inverse).run();
        self.across(b, a, &self.columns);
        self.along(a, b, true);
        Arch::new().dispatch(Unfold { cosines: self, from: a, field });
    }

    /// Transforms along the height, or back.
    fn along(&self, out: &mut [T], from: &[T], back: bool) {
        let stride = self.stride();
        let [evens, odds] = halves(self.grid.h);
        let (even_out, odd_out) = out.split_at_mut(evens * stride);
        let (even_from, odd_from) = from.split_at(evens * stride);
        let of = if back { Term::transposed } else { Term::new };
        for (out, from, table, count) in
            [(even_out, even_from, &self.rows[0], evens), (odd_out, odd_from, &self.rows[1], odds)]
        {
            let target = Target { out, stride, rows: count, columns: stride, start: Start::Zero };
            product(target, &[of((table, count), (from, stride), count)]);
        }
    }

    /// Transforms along the width with these tables.
    fn across(&self, out: &mut [T], from: &[T], tables: &[Vec<T>; 2]) {
        let (stride, Grid { h, w }) = (self.stride(), self.grid);
        for (odd, first) in [(0, 0), (1, self.widths[0])] {
            let columns = self.widths[odd];
            let target = Target { out: &mut out[first..], stride, rows: h, columns, start: Start::Zero };
            product(target, &[Term::new((&from[first..], stride), (&tables[odd], columns), halves(w)[odd])]);
        }
    }
}

/// Takes the sums and the differences of what is as far from either end, along both axes, from `field` [H, W].
struct Fold<'a, T> {
    cosines: &'a Cosines<T>,
    field: &'a [T],
    to: &'a mut [T],
}

impl<T: Real> WithSimd for Fold<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { cosines, field, to } = self;
        let (stride, Grid { h, w }) = (cosines.stride(), cosines.grid);
        let [evens, pairs] = halves(h);
        for k in 0..h {
            let i = if k < evens { k } else { k - evens };
            let rows = [&field[i * w..][..w], &field[(h - 1 - i) * w..][..w]];
            let (even, odd) = to[k * stride..][..stride].split_at_mut(cosines.widths[0]);
            if k >= evens {
                fold_row([even, odd], rows, |a, b| a - b);
            } else if k < pairs {
                fold_row([even, odd], rows, |a, b| a + b);
            } else {
                // The row in the middle of a long axis, and each of a short one, stands alone.
                fold_row([even, odd], rows, |a, _| a);
            }
        }
    }
}

/// Sets `field` [H, W] to the sums, and from the other ends the differences, of its even and odd parts in memory: twice the inverse of
/// [`Fold`] along each axis.
struct Unfold<'a, T> {
    cosines: &'a Cosines<T>,
    from: &'a [T],
    field: &'a mut [T],
}

impl<T: Real> WithSimd for Unfold<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { cosines, from, field } = self;
        let (stride, Grid { h, w }) = (cosines.stride(), cosines.grid);
        let [evens, pairs] = halves(h);
        for i in 0..h {
            let k = i.min(h - 1 - i);
            // Without pairs, every row stands alone.
            let (even, odd) = if pairs == 0 { (i, i) } else { (k, (evens + k).min(h - 1)) };
            let parts = [even, odd].map(|k| from[k * stride..][..stride].split_at(cosines.widths[0]));
            let parts = [parts.map(|p| p.0), parts.map(|p| p.1)];
            let row = &mut field[i * w..][..w];
            if i < pairs {
                unfold_row(row, parts, |a, b| a + b);
            } else if i + pairs >= h {
                unfold_row(row, parts, |a, b| a - b);
            } else {
                unfold_row(row, parts, |a, _| a);
            }
        }
    }
}

/// Sets the part `to` of a row in memory to the sums of the values at both ends of it, and `differences` to their differences. The values
/// are `of` those of two rows. Adapters and closures as small as these are inlined, and so compiled for the registers.
#[inline(always)]
fn fold_row<T: Real>([to, differences]: [&mut [T]; 2], [one, other]: [&[T]; 2], of: impl Fn(T, T) -> T) {
    let (w, pairs) = (one.len(), halves(one.len())[1]);
    let (to, middle) = to.split_at_mut(pairs);
    let begins = one.iter().zip(other);
    let ends = one.iter().rev().zip(other.iter().rev());
    let each = to.iter_mut().zip(differences).zip(begins.zip(ends));
    for ((sum, difference), ((&a, &b), (&c, &d))) in each {
        let ends = [of(a, b), of(c, d)];
        (*sum, *difference) = (ends[0] + ends[1], ends[0] - ends[1]);
    }
    let alone = pairs..w - pairs;
    let values = one[alone.clone()].iter().zip(&other[alone]);
    middle.iter_mut().zip(values).for_each(|(to, (&a, &b))| *to = of(a, b));
}

/// Sets a row to the sums of an even and an odd part, and from its other end to their differences. The parts are `of` those of two rows.
#[inline(always)]
fn unfold_row<T: Real>(to: &mut [T], [even, odd]: [[&[T]; 2]; 2], of: impl Fn(T, T) -> T) {
    let (w, pairs) = (to.len(), halves(to.len())[1]);
    let (begin, end) = to.split_at_mut(pairs);
    let parts = even[0].iter().zip(even[1]).zip(odd[0].iter().zip(odd[1]));
    for ((one, other), ((&a, &b), (&c, &d))) in begin.iter_mut().zip(end.iter_mut().rev()).zip(parts) {
        let parts = [of(a, b), of(c, d)];
        (*one, *other) = (parts[0] + parts[1], parts[0] - parts[1]);
    }
    let alone = pairs..w - pairs;
    let values = even[0][alone.clone()].iter().zip(&even[1][alone]);
    end.iter_mut().zip(values).for_each(|(to, (&a, &b))| *to = of(a, b));
}

/// Returns a table of these values, [rows, stride], 0 past the columns.
fn table<T: Real>(
    (rows, columns): (usize, usize),
    stride: usize,
    value: &dyn Fn(usize, usize) -> f64,
) -> Vec<T> {
    let mut table = vec![T::zero(); rows * stride];
    // The odd half of a short axis is empty.
    for (r, row) in table.chunks_exact_mut(stride.max(1)).enumerate() {
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
