//! Rows of particles and edges a register at a time, for what goes through a whole cloth.
//!
//! A stored row ends in edges of length zero, so that no loop needs a remainder. As in [`crate::cpu::real`], closures and
//! iterator adapters stay out of these functions.

use super::Trial;
use crate::cpu::Real;
use crate::cpu::matmul::LANES;
use crate::sim::Grid;
use pulp::Simd;

/// A row as it is stored: zero from its own length on.
#[derive(Clone, Copy)]
pub(super) struct Stored {
    /// Numbers from one row to the next, W'.
    pub stride: usize,
    /// Numbers that are computed: what begins one further on is inside too.
    pub count: usize,
}

impl Stored {
    /// Rows of `len` numbers.
    pub fn new(len: usize) -> Self {
        let count = len.next_multiple_of(LANES);
        Self { stride: count + LANES, count }
    }
}

/// Numbers in a register.
#[inline(always)]
pub(super) fn width<T: Real, S: Simd>() -> usize {
    size_of::<T::Lanes<S>>() / size_of::<T>()
}

/// The register that begins at a place.
#[inline(always)]
pub(super) fn at<T: Real, S: Simd>(values: &[T], place: usize) -> T::Lanes<S> {
    T::lanes::<S>(&values[place..])[0]
}

/// The registers at the same place of three components.
#[inline(always)]
pub(super) fn vector_at<T: Real, S: Simd>(values: &[T], place: usize, stride: usize) -> [T::Lanes<S>; 3] {
    [at::<T, S>(values, place), at::<T, S>(values, place + stride), at::<T, S>(values, place + 2 * stride)]
}

#[inline(always)]
pub(super) fn dot<T: Real, S: Simd>(simd: S, u: [T::Lanes<S>; 3], w: [T::Lanes<S>; 3]) -> T::Lanes<S> {
    T::fma(simd, u[0], w[0], T::fma(simd, u[1], w[1], T::product(simd, u[2], w[2])))
}

#[inline(always)]
pub(super) fn cross<T: Real, S: Simd>(simd: S, u: [T::Lanes<S>; 3], w: [T::Lanes<S>; 3]) -> [T::Lanes<S>; 3] {
    [
        T::difference(simd, T::product(simd, u[1], w[2]), T::product(simd, u[2], w[1])),
        T::difference(simd, T::product(simd, u[2], w[0]), T::product(simd, u[0], w[2])),
        T::difference(simd, T::product(simd, u[0], w[1]), T::product(simd, u[1], w[0])),
    ]
}

#[inline(always)]
pub(super) fn scaled<T: Real, S: Simd>(
    simd: S,
    u: [T::Lanes<S>; 3],
    factor: T::Lanes<S>,
) -> [T::Lanes<S>; 3] {
    [T::product(simd, u[0], factor), T::product(simd, u[1], factor), T::product(simd, u[2], factor)]
}

/// Sets `edges` [3, W'] to the edges from the first `count` particles of row `i` to those `step` further on; there are as many
/// particles behind `step`.
#[inline(always)]
pub(super) fn load<T: Real, S: Simd>(
    simd: S,
    trial: &Trial<'_, T>,
    (i, step, count): (usize, usize, usize),
    stored: Stored,
    edges: &mut [T],
) {
    let Grid { h, w } = trial.grid;
    for component in 0..3 {
        let from = (component * h + i) * w;
        let (x, x_to) = (&trial.x[from..][..count], &trial.x[from + step..][..count]);
        let (shift, shift_to) = (&trial.shift[from..][..count], &trial.shift[from + step..][..count]);
        let edges = T::lanes_mut::<S>(&mut edges[component * stored.stride..][..stored.count]);
        let mut place = 0;
        for edge in edges {
            let way = T::difference(simd, T::first(simd, &x_to[place..]), T::first(simd, &x[place..]));
            let further =
                T::difference(simd, T::first(simd, &shift_to[place..]), T::first(simd, &shift[place..]));
            *edge = T::total(simd, way, further);
            place = (place + width::<T, S>()).min(count);
        }
    }
}
