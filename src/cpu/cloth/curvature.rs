//! The energy of a cloth along a few directions: its slopes and second derivatives at a trial acceleration.
//!
//! This is the vectorised form of the second derivatives in [`terms`](crate::cloth::terms), checked against the plain one.
//! No Hessian is formed: each edge and each angle adds its exact second derivative along every pair of directions
//! to the sums. The rows are processed [one register at a time](super::rows), and every edge is loaded once.
#![expect(
    clippy::needless_range_loop,
    reason = "iterator adapters would not be compiled for the registers, see `rows`"
)]

use super::elements::Element;
use super::rows::{
    Damping, Stored, any_normal, at, cross, dot, load, normalise, scaled, store, total_and_rest, vector_at,
    width,
};
use super::{Angle, Terms, Trial, particles};
use crate::cloth::{EnergyTerms, Grid};
use crate::cpu::Real;
use crate::sim::MAX_DIRECTIONS;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Minimum number of particles per task, as in [`gradient`](super::gradient).
const TASK: usize = 8192;
/// Pairs of directions: the upper triangle of a symmetric matrix, row by row.
const PAIRS: usize = MAX_DIRECTIONS * (MAX_DIRECTIONS + 1) / 2;

/// The energy near a trial acceleration, as far as a step along a few directions p is concerned.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LocalModel {
    /// The energy terms at the trial, except the repulsion.
    pub energy: EnergyTerms,
    /// `p_i . dL/da`.
    pub slopes: [f64; MAX_DIRECTIONS],
    /// `p_i . (d2L/da2) p_j`, symmetric.
    pub curvature: [[f64; MAX_DIRECTIONS]; MAX_DIRECTIONS],
    /// `|p_i|^2`.
    pub squares: [f64; MAX_DIRECTIONS],
}

/// Working memory for [`local_model`].
pub struct CurvatureRows<T> {
    grid: Grid,
    stored: Stored,
    /// One per task, which processes a range of rows.
    tasks: Vec<Work<T>>,
    /// 1 for the first W - k numbers of a row and 0 past them, k = 0, 1, 2; shape [3, W'].
    masks: Vec<T>,
}

/// Edges of a row and of the next one. Each is [1 + K, 4, W']: the unit vector and one over the length, then for
/// each direction its difference along the edge over the length, and the part of that along the edge.
struct Work<T> {
    vertical: [Vec<T>; 2],
    horizontal: [Vec<T>; 2],
    /// Lengths at the start of the frame, shape \[W'\].
    before: Vec<T>,
}

impl<T: Real> CurvatureRows<T> {
    /// Allocates working memory for cloths on this grid.
    pub fn new(grid: Grid) -> Self {
        let stored = Stored::new(grid.w);
        let edges = || [(); 2].map(|()| vec![T::zero(); 4 * (1 + MAX_DIRECTIONS) * stored.stride]);
        let tasks = (grid.particles() / TASK).clamp(1, grid.h);
        let mask = |k: usize| -> Vec<T> {
            (0..stored.stride).map(|j| T::of(f64::from(u8::from(j + k < grid.w)))).collect()
        };
        Self {
            grid,
            stored,
            tasks: (0..tasks)
                .map(|_| Work {
                    vertical: edges(),
                    horizontal: edges(),
                    before: vec![T::zero(); stored.stride],
                })
                .collect(),
            masks: [mask(0), mask(1), mask(2)].concat(),
        }
    }
}

/// Returns the local model of one cloth along `directions` [K, 3, H, W], which are 0 at handles, given the
/// gradient `grad` [3, H, W]. Sums have a fixed order, whatever the number of threads.
///
/// Panics if K is not 0 to [`MAX_DIRECTIONS`].
pub fn local_model<T: Real>(
    trial: &Trial<'_, T>,
    rows: &mut CurvatureRows<T>,
    directions: &[T],
    grad: &[T],
) -> LocalModel {
    T::local_model(trial, rows, directions, grad)
}

pub(in crate::cpu) fn generic_local_model<T: Real>(
    trial: &Trial<'_, T>,
    rows: &mut CurvatureRows<T>,
    directions: &[T],
    grad: &[T],
) -> LocalModel {
    assert_eq!(rows.grid, trial.grid, "working memory and cloth share a grid");
    match directions.len() / trial.x.len() {
        0 => along::<T, 0>(trial, rows, directions, grad),
        1 => along::<T, 1>(trial, rows, directions, grad),
        2 => along::<T, 2>(trial, rows, directions, grad),
        3 => along::<T, 3>(trial, rows, directions, grad),
        4 => along::<T, 4>(trial, rows, directions, grad),
        count => panic!("{count} directions, not 0 to {MAX_DIRECTIONS}"),
    }
}

fn along<T: Real, const K: usize>(
    trial: &Trial<'_, T>,
    rows: &mut CurvatureRows<T>,
    directions: &[T],
    grad: &[T],
) -> LocalModel {
    let CurvatureRows { stored, tasks, masks, .. } = rows;
    let (h, band) = (trial.grid.h, trial.grid.h.div_ceil(tasks.len()));
    let (stored, masks) = (*stored, &masks[..]);
    let of_task = |(task, work): (usize, &mut Work<T>)| {
        let range = (task * band).min(h)..((task + 1) * band).min(h);
        Arch::new().dispatch(Band::<T, K> { trial, range, stored, work, masks, directions, grad })
    };
    match &mut tasks[..] {
        [work] => of_task((0, work)),
        tasks => {
            let parts: Vec<LocalModel> = tasks.par_iter_mut().enumerate().map(of_task).collect();
            parts.iter().fold(LocalModel::default(), |sum, part| sum.plus(part))
        }
    }
}

impl LocalModel {
    fn plus(&self, other: &Self) -> Self {
        let mut sum = *self;
        let (own, others) = (self.energy.to_array(), other.energy.to_array());
        sum.energy = EnergyTerms::from_array(std::array::from_fn(|k| own[k] + others[k]));
        for i in 0..MAX_DIRECTIONS {
            sum.slopes[i] += other.slopes[i];
            sum.squares[i] += other.squares[i];
            for j in 0..MAX_DIRECTIONS {
                sum.curvature[i][j] += other.curvature[i][j];
            }
        }
        sum
    }
}

/// Returns the place of the pair (i, j), i <= j, among [`PAIRS`].
pub(super) const fn pair(i: usize, j: usize) -> usize {
    i * MAX_DIRECTIONS - i * (i + 1) / 2 + j
}

/// The contribution of a range of rows of particles, and of the edges, angles and bends that begin there.
struct Band<'a, 'b, T, const K: usize> {
    trial: &'a Trial<'b, T>,
    range: std::ops::Range<usize>,
    stored: Stored,
    work: &'a mut Work<T>,
    masks: &'a [T],
    directions: &'a [T],
    grad: &'a [T],
}

/// Sums over a row, one lane per register lane.
pub(super) struct Sums<L> {
    /// At the places given by [`pair`].
    pub pairs: [L; PAIRS],
    pub slopes: [L; MAX_DIRECTIONS],
    pub squares: [L; MAX_DIRECTIONS],
    /// Stretch, shear, bend, inertia, external.
    pub energies: [L; 5],
}

const STRETCH: usize = 0;
const SHEAR: usize = 1;
const BEND: usize = 2;
pub(super) const INERTIA: usize = 3;
pub(super) const EXTERNAL: usize = 4;

/// What a row of particles adds. Its parts are one list, so that the code for each is compiled once: it is long, and there are
/// thirty kinds of it, one per precision, width of registers and number of directions.
#[derive(Clone, Copy)]
enum Part<'a, T> {
    /// Edges, their factor, and their row, step and count, see [`Edges::load`].
    Edges(&'a [T], T, (usize, usize, usize)),
    /// The angles between two rows of edges, and the place of their energy.
    Angles((&'a [T], &'a [T]), (Angle<T>, usize)),
}

impl<T: Real, const K: usize> WithSimd for Band<'_, '_, T, K> {
    type Output = LocalModel;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> LocalModel {
        let Self { trial, range, stored, work, masks, directions, grad } = self;
        let Grid { h, w } = trial.grid;
        let Terms { vertical, horizontal, shear, vertical_bend, horizontal_bend } = trial.terms();
        let Work { vertical: [v, next_v], horizontal: [e, next_e], before } = work;
        // Of a full row, its first W - k elements.
        let mask = |i: usize, element: Element, k: usize| match trial.stiffness(i, element) {
            Some(factors) => factors,
            None => &masks[k * stored.stride..][..stored.stride],
        };
        let particles = particles::Directions { fields: directions, grad };
        let edges = Edges::<T, S, K> { simd, stored, trial, directions, kind: std::marker::PhantomData };
        let mut model = LocalModel::default();
        let (first, end) = (range.start, range.end);
        // The edges of a row are loaded ahead of the row before.
        for next in first..end + usize::from(first < end) {
            std::mem::swap(v, next_v);
            std::mem::swap(e, next_e);
            for (edges_of, (step, count), exists) in
                [(&mut *next_e, (1, w - 1), next < h), (&mut *next_v, (w, w), next + 1 < h)]
            {
                if exists {
                    edges.load((next, step, count), edges_of);
                }
            }
            if next == first {
                continue;
            }
            let i = next - 1;
            let zero = T::splat(simd, T::zero());
            let mut sums = Sums {
                pairs: [zero; PAIRS],
                slopes: [zero; MAX_DIRECTIONS],
                squares: [zero; MAX_DIRECTIONS],
                energies: [zero; 5],
            };
            particles.add_row::<S, K>(simd, trial, i, &mut sums);
            let corner = |lower: bool, right: bool| {
                let edges = (&v[usize::from(right)..], if lower { &next_e[..] } else { &e[..] });
                (Element::corner(lower, right), 1, Part::Angles(edges, (shear, SHEAR)))
            };
            let parts = [
                (Element::Right, 1, Part::Edges(e, horizontal, (i, 1, w - 1))),
                (Element::StraightRight, 2, Part::Angles((&e[1..], e), (horizontal_bend, BEND))),
                (Element::Down, 0, Part::Edges(v, vertical, (i, w, w))),
                corner(false, false),
                corner(true, false),
                corner(false, true),
                corner(true, true),
                (Element::StraightDown, 0, Part::Angles((next_v, v), (vertical_bend, BEND))),
            ];
            // Of the last rows, some have nothing below them.
            let count = if i + 2 < h {
                8
            } else if i + 1 < h {
                7
            } else {
                2
            };
            for &(element, short, part) in &parts[..count] {
                let mask = mask(i, element, short);
                match part {
                    Part::Edges(e, factor, row) => {
                        let damping = Damping::of(simd, trial, row, stored, before);
                        edges.stretch(e, (factor, damping), mask, &mut sums);
                    }
                    Part::Angles(of, angle) => edges.angles(angle, of, mask, &mut sums),
                }
            }
            add_sums::<T, S, K>(simd, &sums, &mut model);
        }
        model
    }
}

/// Adds the sums of the lanes to the model.
#[inline(always)]
fn add_sums<T: Real, S: Simd, const K: usize>(simd: S, sums: &Sums<T::Lanes<S>>, model: &mut LocalModel) {
    let EnergyTerms { stretch, shear, bend, inertia, external, .. } = &mut model.energy;
    *stretch += T::reduce_sum(simd, sums.energies[STRETCH]).f64();
    *shear += T::reduce_sum(simd, sums.energies[SHEAR]).f64();
    *bend += T::reduce_sum(simd, sums.energies[BEND]).f64();
    *inertia += T::reduce_sum(simd, sums.energies[INERTIA]).f64();
    *external += T::reduce_sum(simd, sums.energies[EXTERNAL]).f64();
    for i in 0..K {
        model.slopes[i] += T::reduce_sum(simd, sums.slopes[i]).f64();
        model.squares[i] += T::reduce_sum(simd, sums.squares[i]).f64();
        for j in i..K {
            model.curvature[i][j] += T::reduce_sum(simd, sums.pairs[pair(i, j)]).f64();
            model.curvature[j][i] = model.curvature[i][j];
        }
    }
}

#[derive(Clone, Copy)]
struct Edges<'a, 'b, T, S, const K: usize> {
    simd: S,
    stored: Stored,
    trial: &'a Trial<'b, T>,
    directions: &'a [T],
    kind: std::marker::PhantomData<T>,
}

impl<T: Real, S: Simd, const K: usize> Edges<'_, '_, T, S, K> {
    /// Loads the edges from the first `count` particles of row `i` to those `step` later in the array, and the
    /// differences of the directions along them.
    #[inline(always)]
    fn load(self, (i, step, count): (usize, usize, usize), edges: &mut [T]) {
        let Self { simd, stored, trial, directions, .. } = self;
        let (Stored { stride, count: computed }, Grid { h, w }) = (stored, trial.grid);
        load(simd, trial, (i, step, count), stored, edges);
        for k in 0..K {
            for component in 0..3 {
                let from = ((3 * k + component) * h + i) * w;
                let (p, p_to) = (&directions[from..][..count], &directions[from + step..][..count]);
                let to = &mut edges[(4 * (1 + k) + component) * stride..][..computed];
                let mut place = 0;
                for to in T::lanes_mut::<S>(to) {
                    *to = T::sub_lanes(
                        simd,
                        T::load_partial(simd, &p_to[place..]),
                        T::load_partial(simd, &p[place..]),
                    );
                    place = (place + width::<T, S>()).min(count);
                }
            }
        }
        for register in 0..computed / width::<T, S>() {
            let place = register * width::<T, S>();
            let (u, inverse) = normalise::<T, S>(simd, edges, place, stride);
            for k in 0..K {
                let at = place + 4 * (1 + k) * stride;
                let alpha = scaled::<T, S>(simd, vector_at::<T, S>(edges, at, stride), inverse);
                store::<T, S>(edges, at, stride, alpha);
                T::lanes_mut::<S>(&mut edges[at + 3 * stride..])[0] = dot::<T, S>(simd, u, alpha);
            }
        }
    }

    /// Adds the energies of edges and their second derivatives, `2 factor (1 + t)` along the edge and
    /// `2 factor (1 + t - r / |e|)` across it ([`terms::Edge`](crate::cloth::terms::Edge)), each times its number in `mask`.
    #[inline(always)]
    fn stretch(
        self,
        edges: &[T],
        (factor, damping): (T, Option<Damping<'_, T>>),
        mask: &[T],
        sums: &mut Sums<T::Lanes<S>>,
    ) {
        let Self { simd, stored: Stored { stride, count }, .. } = self;
        let (zero, one) = (T::splat(simd, T::zero()), T::splat(simd, T::one()));
        let twice = T::splat(simd, factor + factor);
        let factor = T::splat(simd, factor);
        for register in 0..count / width::<T, S>() {
            let place = register * width::<T, S>();
            let inverse = at::<T, S>(edges, place + 3 * stride);
            let length = T::select_greater(simd, (inverse, zero), T::div_lanes(simd, one, inverse), zero);
            let excess = T::sub_lanes(simd, length, one);
            let mask = at::<T, S>(mask, place);
            let square = T::mul_lanes(simd, excess, excess);
            let energy = match damping {
                Some(damping) => T::add_lanes(simd, square, damping.energy(simd, place, length)),
                None => square,
            };
            let factor = T::mul_lanes(simd, factor, mask);
            sums.energies[STRETCH] = T::fma(simd, factor, energy, sums.energies[STRETCH]);
            // The differences are over the length: |e|^2 times both factors.
            let (total, rest) = total_and_rest::<T, S>(simd, damping, place);
            let each = T::mul_lanes(simd, T::mul_lanes(simd, twice, mask), length);
            let along = T::mul_lanes(simd, each, rest);
            let across =
                T::mul_lanes(simd, each, T::sub_lanes(simd, T::mul_lanes(simd, total, length), rest));
            for i in 0..K {
                let from = place + 4 * (1 + i) * stride;
                let radial = T::mul_lanes(simd, along, at::<T, S>(edges, from + 3 * stride));
                let p = scaled::<T, S>(simd, vector_at::<T, S>(edges, from, stride), across);
                for j in i..K {
                    let from = place + 4 * (1 + j) * stride;
                    let other = vector_at::<T, S>(edges, from, stride);
                    let sum = &mut sums.pairs[pair(i, j)];
                    *sum = T::fma(simd, radial, at::<T, S>(edges, from + 3 * stride), *sum);
                    *sum = T::add_lanes(simd, *sum, dot::<T, S>(simd, p, other));
                }
            }
        }
    }

    /// Adds the energies of the angles t between edges u and w to those at the place `energy`. The formulas, with the
    /// unit vectors n, m_u and m_w, are those of [`terms::Angle::hessian`](crate::cloth::terms::Angle::hessian).
    #[inline(always)]
    fn angles(
        self,
        (angle, energy): (Angle<T>, usize),
        (u, w): (&[T], &[T]),
        mask: &[T],
        sums: &mut Sums<T::Lanes<S>>,
    ) {
        let Self { simd, stored: Stored { stride, count }, .. } = self;
        let Angle { factor, rest, parallel } = angle;
        let (zero, one) = (T::splat(simd, T::zero()), T::splat(simd, T::one()));
        let limit = T::splat(simd, parallel_below::<T>());
        let twice = T::splat(simd, factor + factor);
        let factor = T::splat(simd, factor);
        let (rest, parallel) = (T::splat(simd, rest), T::splat(simd, parallel));
        for register in 0..count / width::<T, S>() {
            let place = register * width::<T, S>();
            let by_w = at::<T, S>(w, place + 3 * stride);
            let (unit_u, unit_w) = (vector_at::<T, S>(u, place, stride), vector_at::<T, S>(w, place, stride));
            let c = cross::<T, S>(simd, unit_u, unit_w);
            let sine = T::sqrt_lanes(simd, dot::<T, S>(simd, c, c));
            let cosine = dot::<T, S>(simd, unit_u, unit_w);
            let delta = T::sub_lanes(simd, T::angle(simd, sine, cosine), rest);
            let mask = at::<T, S>(mask, place);
            let square = T::mul_lanes(simd, delta, delta);
            let factor = T::mul_lanes(simd, factor, mask);
            sums.energies[energy] = T::fma(simd, factor, square, sums.energies[energy]);
            if K == 0 {
                continue;
            }
            let twice = T::mul_lanes(simd, twice, mask);
            // For parallel edges any normal will do.
            let any = any_normal::<T, S>(simd, unit_u);
            let across = T::sqrt_lanes(simd, dot::<T, S>(simd, any, any));
            let length = T::select_greater(simd, (sine, limit), sine, across);
            let inverse = T::select_greater(simd, (length, zero), T::div_lanes(simd, one, length), zero);
            let parallel = T::select_greater(simd, (cosine, zero), parallel, zero);
            let s = T::select_greater(simd, (sine, limit), T::mul_lanes(simd, delta, inverse), parallel);
            // An edge of length zero forms no angle. If it is w, the normal must be zeroed; if it is u, the
            // normal is zero already.
            let inverse = T::select_greater(simd, (by_w, zero), inverse, zero);
            let n = [
                T::select_greater(simd, (sine, limit), c[0], any[0]),
                T::select_greater(simd, (sine, limit), c[1], any[1]),
                T::select_greater(simd, (sine, limit), c[2], any[2]),
            ];
            let n = scaled::<T, S>(simd, n, inverse);
            let (m_u, m_w) = (cross::<T, S>(simd, n, unit_u), cross::<T, S>(simd, unit_w, n));
            let delta = T::mul_lanes(simd, twice, delta);
            let s = T::mul_lanes(simd, twice, s);
            // For each direction: across u, along u, across w, along w, along the normal at u and at w, and the
            // change of the angle.
            let mut parts = [[zero; 7]; K];
            for (k, parts) in parts.iter_mut().enumerate() {
                let from = place + 4 * (1 + k) * stride;
                let (of_u, of_w) = (vector_at::<T, S>(u, from, stride), vector_at::<T, S>(w, from, stride));
                let (across_u, across_w) = (dot::<T, S>(simd, m_u, of_u), dot::<T, S>(simd, m_w, of_w));
                *parts = [
                    across_u,
                    at::<T, S>(u, from + 3 * stride),
                    across_w,
                    at::<T, S>(w, from + 3 * stride),
                    dot::<T, S>(simd, n, of_u),
                    dot::<T, S>(simd, n, of_w),
                    T::add_lanes(simd, across_u, across_w),
                ];
            }
            for i in 0..K {
                let [across_u, along_u, across_w, along_w, normal_u, normal_w, change] = parts[i];
                let bent_u =
                    T::mul_lanes(simd, s, T::sub_lanes(simd, T::mul_lanes(simd, cosine, normal_u), normal_w));
                let bent_w =
                    T::mul_lanes(simd, s, T::sub_lanes(simd, T::mul_lanes(simd, cosine, normal_w), normal_u));
                let factors = [
                    T::mul_lanes(simd, delta, along_u),
                    T::mul_lanes(simd, delta, across_u),
                    T::mul_lanes(simd, delta, along_w),
                    T::mul_lanes(simd, delta, across_w),
                    bent_u,
                    bent_w,
                    T::mul_lanes(simd, twice, change),
                ];
                for j in i..K {
                    let mut sum = sums.pairs[pair(i, j)];
                    for part in 0..7 {
                        sum = T::fma(simd, factors[part], parts[j][part], sum);
                    }
                    sums.pairs[pair(i, j)] = sum;
                }
            }
        }
    }
}

/// Returns the sine below which edges count as parallel: the cross product of two unit vectors no longer tells
/// their normal.
fn parallel_below<T: Real>() -> T {
    T::epsilon().sqrt() * T::of(0.1)
}
