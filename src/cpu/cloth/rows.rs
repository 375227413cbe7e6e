//! Rows of particles and edges, one register at a time, for computations over a whole cloth.
//!
//! A stored row ends in edges of length zero, so that no loop needs a remainder. As in
//! [`crate::cpu::elementary`], these functions contain neither closures nor iterator adapters.

use super::Trial;
use crate::cloth::Grid;
use crate::cpu::Real;
use crate::cpu::matmul::LANES;
use pulp::Simd;

/// The layout of a stored row, which is zero past its own length.
#[derive(Clone, Copy)]
pub(super) struct Stored {
    /// Distance from one row to the next, W'.
    pub stride: usize,
    /// Numbers that are computed. A register that starts one later still lies inside the row.
    pub count: usize,
}

impl Stored {
    /// Returns the layout of rows of `len` numbers.
    pub fn new(len: usize) -> Self {
        let count = len.next_multiple_of(LANES);
        Self { stride: count + LANES, count }
    }
}

/// Returns the number of lanes of a register.
#[inline(always)]
pub(super) fn width<T: Real, S: Simd>() -> usize {
    size_of::<T::Lanes<S>>() / size_of::<T>()
}

/// Returns the register that starts at `place`.
#[inline(always)]
pub(super) fn at<T: Real, S: Simd>(values: &[T], place: usize) -> T::Lanes<S> {
    T::lanes::<S>(&values[place..])[0]
}

/// Returns the registers at the same place of three components.
#[inline(always)]
pub(super) fn vector_at<T: Real, S: Simd>(values: &[T], place: usize, stride: usize) -> [T::Lanes<S>; 3] {
    [at::<T, S>(values, place), at::<T, S>(values, place + stride), at::<T, S>(values, place + 2 * stride)]
}

#[inline(always)]
pub(super) fn dot<T: Real, S: Simd>(simd: S, u: [T::Lanes<S>; 3], w: [T::Lanes<S>; 3]) -> T::Lanes<S> {
    T::fma(simd, u[0], w[0], T::fma(simd, u[1], w[1], T::mul_lanes(simd, u[2], w[2])))
}

#[inline(always)]
pub(super) fn cross<T: Real, S: Simd>(simd: S, u: [T::Lanes<S>; 3], w: [T::Lanes<S>; 3]) -> [T::Lanes<S>; 3] {
    [
        T::sub_lanes(simd, T::mul_lanes(simd, u[1], w[2]), T::mul_lanes(simd, u[2], w[1])),
        T::sub_lanes(simd, T::mul_lanes(simd, u[2], w[0]), T::mul_lanes(simd, u[0], w[2])),
        T::sub_lanes(simd, T::mul_lanes(simd, u[0], w[1]), T::mul_lanes(simd, u[1], w[0])),
    ]
}

#[inline(always)]
pub(super) fn scaled<T: Real, S: Simd>(
    simd: S,
    u: [T::Lanes<S>; 3],
    factor: T::Lanes<S>,
) -> [T::Lanes<S>; 3] {
    [T::mul_lanes(simd, u[0], factor), T::mul_lanes(simd, u[1], factor), T::mul_lanes(simd, u[2], factor)]
}

/// Sets the registers at the same place of three components.
#[inline(always)]
pub(super) fn store<T: Real, S: Simd>(values: &mut [T], place: usize, stride: usize, v: [T::Lanes<S>; 3]) {
    for component in 0..3 {
        T::lanes_mut::<S>(&mut values[place + component * stride..])[0] = v[component];
    }
}

/// Divides the edges [4, W'] at `place` by their length, and sets their fourth component to one over it; an edge of
/// length zero becomes zeros. Returns both.
#[inline(always)]
pub(super) fn normalise<T: Real, S: Simd>(
    simd: S,
    edges: &mut [T],
    place: usize,
    stride: usize,
) -> ([T::Lanes<S>; 3], T::Lanes<S>) {
    let (zero, one) = (T::splat(simd, T::zero()), T::splat(simd, T::one()));
    let e = vector_at::<T, S>(edges, place, stride);
    let length = T::sqrt_lanes(simd, dot::<T, S>(simd, e, e));
    let inverse = T::select_greater(simd, (length, zero), T::div_lanes(simd, one, length), zero);
    let u = scaled::<T, S>(simd, e, inverse);
    store::<T, S>(edges, place, stride, u);
    T::lanes_mut::<S>(&mut edges[place + 3 * stride..])[0] = inverse;
    (u, inverse)
}

/// Returns vectors orthogonal to the unit vectors `u`, not normalised.
#[inline(always)]
pub(super) fn any_normal<T: Real, S: Simd>(simd: S, u: [T::Lanes<S>; 3]) -> [T::Lanes<S>; 3] {
    let zero = T::splat(simd, T::zero());
    let steep = (T::mul_lanes(simd, u[0], u[0]), T::splat(simd, T::of(0.5)));
    [
        T::select_greater(simd, steep, T::sub_lanes(simd, zero, u[2]), zero),
        T::select_greater(simd, steep, zero, u[2]),
        T::select_greater(simd, steep, u[0], T::sub_lanes(simd, zero, u[1])),
    ]
}

/// Sets `edges` [3, W'] to the edges from the first `count` particles of row `i` to the particles `step`
/// later in the array, which must hold `count` particles from there on. Those that the cloth doesn't have are zero.
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
            let initial =
                T::sub_lanes(simd, T::load_partial(simd, &x_to[place..]), T::load_partial(simd, &x[place..]));
            let change = T::sub_lanes(
                simd,
                T::load_partial(simd, &shift_to[place..]),
                T::load_partial(simd, &shift[place..]),
            );
            *edge = T::add_lanes(simd, initial, change);
            place = (place + width::<T, S>()).min(count);
        }
    }
    if let Some(elements) = trial.elements {
        let has = elements.edges(i, step != 1);
        for component in 0..3 {
            let mut place = 0;
            for edge in T::lanes_mut::<S>(&mut edges[component * stored.stride..][..stored.count]) {
                *edge = T::mul_lanes(simd, *edge, at::<T, S>(has, place));
                place += width::<T, S>();
            }
        }
    }
}

/// The damping of a row of edges: its coefficient \[frames\], and their lengths at the start of the frame, shape \[W'\].
#[derive(Clone, Copy)]
pub(super) struct Damping<'a, T> {
    coefficient: T,
    before: &'a [T],
}

impl<'a, T: Real> Damping<'a, T> {
    /// Returns the damping of the edges that [`load`] loads, with `before` as memory; `None` if there is none.
    #[inline(always)]
    pub fn of<S: Simd>(
        simd: S,
        trial: &Trial<'_, T>,
        (i, step, count): (usize, usize, usize),
        stored: Stored,
        before: &'a mut [T],
    ) -> Option<Self> {
        if trial.damping == 0.0 {
            return None;
        }
        let Grid { h, w } = trial.grid;
        let mut place = 0;
        for to in T::lanes_mut::<S>(&mut before[..stored.count]) {
            let mut square = T::splat(simd, T::zero());
            for component in 0..3 {
                let from = (component * h + i) * w;
                let (x, x_to) = (&trial.x[from..][..count], &trial.x[from + step..][..count]);
                let e = T::sub_lanes(
                    simd,
                    T::load_partial(simd, &x_to[place..]),
                    T::load_partial(simd, &x[place..]),
                );
                square = T::fma(simd, e, e, square);
            }
            *to = T::sqrt_lanes(simd, square);
            place = (place + width::<T, S>()).min(count);
        }
        Some(Self { coefficient: T::of(trial.damping), before })
    }

    /// Returns 1 + t and the rest lengths r = 1 + t |e0| of the edges from `place` on ([`terms::Edge`](crate::cloth::terms::Edge)).
    #[inline(always)]
    pub fn total_and_rest<S: Simd>(self, simd: S, place: usize) -> (T::Lanes<S>, T::Lanes<S>) {
        let (one, coefficient) = (T::splat(simd, T::one()), T::splat(simd, self.coefficient));
        let rest = T::fma(simd, coefficient, at::<T, S>(self.before, place), one);
        (T::add_lanes(simd, one, coefficient), rest)
    }

    /// Returns `t (l - |e0|)^2` for edges of lengths l from `place` on.
    #[inline(always)]
    pub fn energy<S: Simd>(self, simd: S, place: usize, length: T::Lanes<S>) -> T::Lanes<S> {
        let change = T::sub_lanes(simd, length, at::<T, S>(self.before, place));
        T::mul_lanes(simd, T::splat(simd, self.coefficient), T::mul_lanes(simd, change, change))
    }
}

/// Returns 1 + t and r for edges of this damping t, see [`Damping::total_and_rest`].
#[inline(always)]
pub(super) fn total_and_rest<T: Real, S: Simd>(
    simd: S,
    damping: Option<Damping<'_, T>>,
    place: usize,
) -> (T::Lanes<S>, T::Lanes<S>) {
    match damping {
        Some(damping) => damping.total_and_rest(simd, place),
        None => (T::splat(simd, T::one()), T::splat(simd, T::one())),
    }
}

/// Multiplies a register by the factors from `place` on, if there are any.
#[inline(always)]
pub(super) fn times<T: Real, S: Simd>(
    simd: S,
    value: T::Lanes<S>,
    factors: Option<&[T]>,
    place: usize,
) -> T::Lanes<S> {
    match factors {
        Some(factors) => T::mul_lanes(simd, value, at::<T, S>(factors, place)),
        None => value,
    }
}
