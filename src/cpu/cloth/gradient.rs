//! The gradient `dL/da` of the energy, in two passes over the rows. First each row of cells writes the
//! gradient with respect to its edges, evaluating every angle once; then each row of particles gathers from
//! the edges that meet there. This is the vectorised form of the gradients in [`terms`](crate::cloth::terms), checked
//! against the plain one. Rows write to separate places, so the result does not depend on the number of
//! threads.
//!
//! Both passes process [rows](super::rows) one register at a time. The edges of length zero at their ends
//! contribute nothing.

use super::elements::Element;
use super::particles::GradientRow;
use super::rows::{Damping, Stored, at, cross, dot, load, scaled, times, total_and_rest, vector_at, width};
use super::{Angle, Terms, Trial};
use crate::cloth::Grid;
use crate::cpu::Real;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Minimum number of particles per task. Waking a thread takes as long as processing about two thousand
/// particles, and happens twice per gradient.
const TASK: usize = 8192;

/// Gradients with respect to edges, as the rows of cells write them, with working memory.
pub struct GradientRows<T> {
    /// Shape [H, 4, 3, W'].
    edges: Vec<T>,
    /// One per task, which processes a range of rows.
    tasks: Vec<Work<T>>,
    grid: Grid,
    stored: Stored,
}

/// Edges of a row and of the next one, shape [4, W']: three components, then one over the squared length.
struct Work<T> {
    vertical: [Vec<T>; 2],
    horizontal: [Vec<T>; 2],
    /// Lengths at the start of the frame, shape \[W'\].
    before: Vec<T>,
}

/// The vertical edges of this row, from its own stretch, shear and bend.
const VERTICAL: usize = 0;
/// The vertical edges of the next row, from the bend between both.
const NEXT_VERTICAL: usize = 1;
/// The horizontal edges of this row, from their stretch and bend and the shear of the cells below.
const HORIZONTAL: usize = 2;
/// The horizontal edges of the next row, from the shear of the cells above them.
const NEXT_HORIZONTAL: usize = 3;

impl<T: Real> GradientRows<T> {
    /// Allocates working memory for cloths on this grid.
    pub fn new(grid: Grid) -> Self {
        let stored = Stored::new(grid.w);
        let tasks = (grid.particles() / TASK).clamp(1, grid.h);
        Self {
            edges: vec![T::zero(); grid.h * 12 * stored.stride],
            tasks: (0..tasks).map(|_| Work::new(stored.stride)).collect(),
            grid,
            stored,
        }
    }

    /// Returns where row `i` of cells writes one component of the gradients for one kind of edges, shape
    /// \[W'\].
    fn row(&self, i: usize, kind: usize, component: usize) -> usize {
        ((i * 4 + kind) * 3 + component) * self.stored.stride
    }
}

impl<T: Real> Work<T> {
    fn new(stride: usize) -> Self {
        let edges = || [(); 2].map(|()| vec![T::zero(); 4 * stride]);
        Self { vertical: edges(), horizontal: edges(), before: vec![T::zero(); stride] }
    }
}

/// Computes `dL/da` of one cloth, `grad` [3, H, W]. At handles only inertia and external work depend on a.
pub fn gradient<T: Real>(trial: &Trial<'_, T>, rows: &mut GradientRows<T>, grad: &mut [T]) {
    T::gradient(trial, rows, grad);
}

pub(in crate::cpu) fn generic_gradient<T: Real>(
    trial: &Trial<'_, T>,
    rows: &mut GradientRows<T>,
    grad: &mut [T],
) {
    let Grid { h, w } = trial.grid;
    assert_eq!(rows.grid, trial.grid, "working memory and cloth share a grid");
    let (stored, band) = (rows.stored, h.div_ceil(rows.tasks.len()));
    let row = 12 * stored.stride;
    let edges_of_task = |(task, (edges, work)): (usize, (&mut [T], &mut Work<T>))| {
        let rows = edges.chunks_exact_mut(row).zip(task * band..);
        rows.for_each(|(edges, i)| Arch::new().dispatch(EdgeRow { trial, i, stored, edges, work }));
    };
    let GradientRows { edges, tasks, .. } = &mut *rows;
    match &mut tasks[..] {
        [work] => edges_of_task((0, (edges, work))),
        tasks => edges.par_chunks_mut(band * row).zip(tasks).enumerate().for_each(edges_of_task),
    }
    let rows = &*rows;
    let particles_of_task = |(task, grad): (usize, &mut [T])| {
        // The rows are numbered through all components: a band may extend from one component into the next.
        let rows_of_task = grad.chunks_exact_mut(w).zip(task * band..);
        rows_of_task.for_each(|(grad, row)| Arch::new().dispatch(ParticleRow { trial, rows, row, grad }));
    };
    match rows.tasks.len() {
        1 => particles_of_task((0, grad)),
        _ => grad.par_chunks_mut(band * w).enumerate().for_each(particles_of_task),
    }
}

/// Fills `edges` [4, 3, W'] with the contributions of row `i` of cells and of the edges that begin in row
/// `i`.
struct EdgeRow<'a, 'b, T> {
    trial: &'a Trial<'b, T>,
    i: usize,
    stored: Stored,
    edges: &'a mut [T],
    work: &'a mut Work<T>,
}

impl<T: Real> WithSimd for EdgeRow<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { trial, i, stored, edges, work } = self;
        let Grid { h, w } = trial.grid;
        let Terms { vertical, horizontal, shear, vertical_bend, horizontal_bend } = trial.terms();
        let Work { vertical: [v, next_v], horizontal: [e, next_e], before } = work;
        let angles = |angle, element| Angles { simd, stored, angle, factors: trial.stiffness(i, element) };
        edges.fill(T::zero());
        let block = 3 * stored.stride;
        load(simd, trial, (i, 1, w - 1), stored, e);
        invert(simd, stored, e);
        let damping = Damping::of(simd, trial, (i, 1, w - 1), stored, before);
        let factors = trial.stiffness(i, Element::Right);
        let of_edges = Stretch { simd, stored, factor: horizontal, factors, damping };
        of_edges.add(e, &mut edges[HORIZONTAL * block..]);
        let straight = angles(horizontal_bend, Element::StraightRight);
        straight.add((&e[1..], e), edges, (HORIZONTAL * block + 1, HORIZONTAL * block));
        if i + 1 == h {
            return;
        }
        load(simd, trial, (i, w, w), stored, v);
        invert(simd, stored, v);
        let damping = Damping::of(simd, trial, (i, w, w), stored, before);
        let factors = trial.stiffness(i, Element::Down);
        let of_edges = Stretch { simd, stored, factor: vertical, factors, damping };
        of_edges.add(v, &mut edges[VERTICAL * block..]);
        load(simd, trial, (i + 1, 1, w - 1), stored, next_e);
        invert(simd, stored, next_e);
        for right in 0..2 {
            let corner = |lower| angles(shear, Element::corner(lower, right == 1));
            let to = VERTICAL * block + right;
            corner(false).add((&v[right..], e), edges, (to, HORIZONTAL * block));
            corner(true).add((&v[right..], next_e), edges, (to, NEXT_HORIZONTAL * block));
        }
        if i + 2 == h {
            return;
        }
        load(simd, trial, (i + 1, w, w), stored, next_v);
        invert(simd, stored, next_v);
        let straight = angles(vertical_bend, Element::StraightDown);
        straight.add((next_v, v), edges, (NEXT_VERTICAL * block, VERTICAL * block));
    }
}

/// Adds `factor v` at `place`.
#[inline(always)]
fn add_at<T: Real, S: Simd>(
    simd: S,
    values: &mut [T],
    (place, stride): (usize, usize),
    (v, factor): ([T::Lanes<S>; 3], T::Lanes<S>),
) {
    for component in 0..3 {
        let to = &mut T::lanes_mut::<S>(&mut values[place + component * stride..])[0];
        *to = T::fma(simd, v[component], factor, *to);
    }
}

/// Sets the fourth component of `edges` [4, W'] to one over the squared length. An edge takes part in six
/// angles, and divisions dominate the cost of an angle.
#[inline(always)]
fn invert<T: Real, S: Simd>(simd: S, stored: Stored, edges: &mut [T]) {
    let (one, least) = (T::splat(simd, T::one()), T::splat(simd, T::min_positive_value()));
    for k in 0..stored.count / width::<T, S>() {
        let place = k * width::<T, S>();
        let e = vector_at::<T, S>(edges, place, stored.stride);
        // The smallest normal number avoids 0 / 0 for edges of length zero.
        let square = T::max_lanes(simd, dot::<T, S>(simd, e, e), least);
        T::lanes_mut::<S>(&mut edges[3 * stored.stride + place..])[0] = T::div_lanes(simd, one, square);
    }
}

/// The stretch of a row of edges.
#[derive(Clone, Copy)]
struct Stretch<'a, T, S> {
    simd: S,
    stored: Stored,
    factor: T,
    /// Shape \[W'\].
    factors: Option<&'a [T]>,
    damping: Option<Damping<'a, T>>,
}

impl<T: Real, S: Simd> Stretch<'_, T, S> {
    /// Adds the gradient to `to`. It is taken as 0 for an edge of length zero.
    #[inline(always)]
    fn add(self, edges: &[T], to: &mut [T]) {
        let Self { simd, stored, factor, factors, damping } = self;
        let zero = T::splat(simd, T::zero());
        let twice = T::splat(simd, factor + factor);
        for k in 0..stored.count / width::<T, S>() {
            let place = k * width::<T, S>();
            let e = vector_at::<T, S>(edges, place, stored.stride);
            let length = T::sqrt_lanes(simd, dot::<T, S>(simd, e, e));
            let (total, rest) = total_and_rest::<T, S>(simd, damping, place);
            let excess = T::sub_lanes(simd, T::mul_lanes(simd, total, length), rest);
            let slope = T::mul_lanes(simd, twice, T::div_lanes(simd, excess, length));
            let slope = times::<T, S>(simd, slope, factors, place);
            // A NaN length also fails the comparison, but the edge itself carries the NaN on.
            let slope = T::select_greater(simd, (length, zero), slope, zero);
            add_at(simd, to, (place, stored.stride), (e, slope));
        }
    }
}

/// The energy of an angle, for pairs of edges along a row.
#[derive(Clone, Copy)]
struct Angles<'a, T, S> {
    simd: S,
    stored: Stored,
    angle: Angle<T>,
    /// Shape \[W'\].
    factors: Option<&'a [T]>,
}

impl<T: Real, S: Simd> Angles<'_, T, S> {
    /// Adds the gradients with respect to the edges `u` and `w` [4, W'] of each pair to the two places in
    /// `edges`.
    ///
    /// With `c = u x w` and the angle t, `dt/du = u x c / (|c| |u|^2)` and `dt/dw = c x w / (|c| |w|^2)`. For
    /// parallel edges `(t - rest) / |c|` has the limit `1 / (u . w)` if rest = 0. Otherwise the direction is
    /// undefined and the gradient is taken as 0, as it is for an edge of length zero.
    #[inline(always)]
    fn add(self, (u, w): (&[T], &[T]), edges: &mut [T], (to_u, to_w): (usize, usize)) {
        let Self { simd, stored: Stored { stride, count }, angle, factors } = self;
        let Angle { factor, rest, parallel } = angle;
        let (zero, least) = (T::splat(simd, T::zero()), T::splat(simd, T::min_positive_value()));
        let twice = T::splat(simd, factor + factor);
        let (rest, limit) = (T::splat(simd, rest), T::splat(simd, parallel));
        for k in 0..count / width::<T, S>() {
            let place = k * width::<T, S>();
            let (by_u, by_w) = (at::<T, S>(u, place + 3 * stride), at::<T, S>(w, place + 3 * stride));
            let (u, w) = (vector_at::<T, S>(u, place, stride), vector_at::<T, S>(w, place, stride));
            let c = cross::<T, S>(simd, u, w);
            let (sine, cosine) = (T::sqrt_lanes(simd, dot::<T, S>(simd, c, c)), dot::<T, S>(simd, u, w));
            // One division serves both cases: of the angle by the sine, or of 1 by the cosine.
            let parallel = T::select_greater(simd, (cosine, least), limit, zero);
            let bent = T::sub_lanes(simd, T::angle(simd, sine, cosine), rest);
            let above = T::select_greater(simd, (sine, zero), bent, parallel);
            let below = T::select_greater(simd, (sine, zero), sine, T::max_lanes(simd, cosine, least));
            let ratio = T::mul_lanes(simd, twice, T::div_lanes(simd, above, below));
            let ratio = times::<T, S>(simd, ratio, factors, place);
            // Dividing by the square first avoids the product of two large factors for edges of almost no
            // length.
            let (along_u, along_w) = (cross::<T, S>(simd, u, c), cross::<T, S>(simd, c, w));
            add_at(simd, edges, (to_u + place, stride), (scaled::<T, S>(simd, along_u, by_u), ratio));
            add_at(simd, edges, (to_w + place, stride), (scaled::<T, S>(simd, along_w, by_w), ratio));
        }
    }
}

/// Gathers one component of one row of particles, `grad` \[W\], from the edges that meet there.
struct ParticleRow<'a, 'b, T> {
    trial: &'a Trial<'b, T>,
    rows: &'a GradientRows<T>,
    /// Number of the row, counted through all components.
    row: usize,
    grad: &'a mut [T],
}

impl<T: Real> WithSimd for ParticleRow<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { trial, rows, row, grad } = self;
        let Grid { h, w } = trial.grid;
        let (component, i) = (row / h, row % h);
        let (above, two_above) = (i.checked_sub(1), i.checked_sub(2));
        let edges = |i: Option<usize>, kind: usize| i.map(|i| rows.row(i, kind, component));
        // Edges that end here pull one way, those that begin here the other. The number before a row is zero.
        let ends = [
            edges(above, VERTICAL),
            edges(two_above, NEXT_VERTICAL),
            edges(Some(i), HORIZONTAL).map(|start| start - 1),
            edges(above, NEXT_HORIZONTAL).map(|start| start - 1),
        ];
        let begins = [
            edges(Some(i), VERTICAL),
            edges(above, NEXT_VERTICAL),
            edges(Some(i), HORIZONTAL),
            edges(above, NEXT_HORIZONTAL),
        ];
        let particles = GradientRow::new(trial, row);
        for k in 0..w.div_ceil(width::<T, S>()) {
            let place = k * width::<T, S>();
            let mut sum = T::splat(simd, T::zero());
            for kind in 0..4 {
                if let Some(start) = ends[kind] {
                    sum = T::add_lanes(simd, sum, at::<T, S>(&rows.edges, start + place));
                }
                if let Some(start) = begins[kind] {
                    sum = T::sub_lanes(simd, sum, at::<T, S>(&rows.edges, start + place));
                }
            }
            T::store_partial(simd, &mut grad[place..], particles.plus(simd, place, sum));
        }
        let marks = &trial.marks[i * w..][..w];
        if !marks.iter().fold(true, |all, mark| all & mark.is_free()) {
            for (j, grad) in grad.iter_mut().enumerate().filter(|&(j, _)| !marks[j].is_free()) {
                *grad = particles.alone(j);
            }
        }
    }
}
