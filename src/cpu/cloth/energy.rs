//! The energy of a cloth at a trial acceleration (paper section 3.2): the vectorised form of the energies in
//! [`terms`](crate::cloth::terms), checked against the plain one.

use super::elements::Element;
use super::rows::{Damping, Stored, cross, dot, load, vector_at, width};
use super::{Angle, Terms, Trial, particles};
use crate::cloth::{EnergyTerms, Grid};
use crate::cpu::Real;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Returns the energy terms of one cloth, except its repulsion, summed in double precision row by row.
pub fn energy<T: Real>(trial: &Trial<'_, T>) -> EnergyTerms {
    T::energy(trial)
}

pub(in crate::cpu) fn generic_energy<T: Real>(trial: &Trial<'_, T>) -> EnergyTerms {
    let stored = Stored::new(trial.grid.w);
    let row = |work: &mut Work<T>, i| Arch::new().dispatch(Row { trial, i, stored, work });
    let rows: Vec<EnergyTerms> =
        (0..trial.grid.h).into_par_iter().map_init(|| Work::new(stored.stride), row).collect();
    EnergyTerms::from_array(std::array::from_fn(|k| rows.iter().map(|row| row.to_array()[k]).sum()))
}

/// Edges of a row and of the next one, shape [3, W'], their lengths at the start of the frame, and the squares to be summed,
/// shape \[W'\].
struct Work<T> {
    vertical: [Vec<T>; 2],
    horizontal: [Vec<T>; 2],
    before: Vec<T>,
    squares: Vec<T>,
}

impl<T: Real> Work<T> {
    fn new(stride: usize) -> Self {
        let edges = || [(); 2].map(|()| vec![T::zero(); 3 * stride]);
        let row = || vec![T::zero(); stride];
        Self { vertical: edges(), horizontal: edges(), before: row(), squares: row() }
    }
}

/// The contribution of row `i` of particles and row `i` of cells.
struct Row<'a, 'b, T> {
    trial: &'a Trial<'b, T>,
    i: usize,
    stored: Stored,
    work: &'a mut Work<T>,
}

impl<T: Real> WithSimd for Row<'_, '_, T> {
    type Output = EnergyTerms;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> EnergyTerms {
        let Self { trial, i, stored, work } = self;
        let Grid { h, w } = trial.grid;
        let Terms { vertical, horizontal, shear, vertical_bend, horizontal_bend } = trial.terms();
        let (vertical, horizontal) = (vertical.f64(), horizontal.f64());
        let Work { vertical: [v, next_v], horizontal: [e, next_e], before, squares } = work;
        let mut sums = Squares { simd, stored, squares };
        let factors = |element| trial.stiffness(i, element);
        let mut sum = particles::energy(trial, i);
        load(simd, trial, (i, 1, w - 1), stored, e);
        let damping = Damping::of(simd, trial, (i, 1, w - 1), stored, before);
        sum.stretch += horizontal * sums.of_lengths(e, damping, (w - 1, factors(Element::Right)));
        let straight = (w - 2, factors(Element::StraightRight));
        sum.bend += sums.of_angles(horizontal_bend, (&e[1..], e), straight);
        if i + 1 == h {
            return sum;
        }
        load(simd, trial, (i, w, w), stored, v);
        let damping = Damping::of(simd, trial, (i, w, w), stored, before);
        sum.stretch += vertical * sums.of_lengths(v, damping, (w, factors(Element::Down)));
        load(simd, trial, (i + 1, 1, w - 1), stored, next_e);
        for right in [false, true] {
            for (lower, e) in [(false, &*e), (true, &*next_e)] {
                let corners = (w - 1, factors(Element::corner(lower, right)));
                sum.shear += sums.of_angles(shear, (&v[usize::from(right)..], e), corners);
            }
        }
        if i + 2 == h {
            return sum;
        }
        load(simd, trial, (i + 1, w, w), stored, next_v);
        sum.bend += sums.of_angles(vertical_bend, (next_v, v), (w, factors(Element::StraightDown)));
        sum
    }
}

/// Sums of squares over the first edges, or pairs of edges, of a row, times their factors if there are any:
/// squared in the precision of the cloth, summed in double precision.
struct Squares<'a, T, S> {
    simd: S,
    stored: Stored,
    /// Shape \[W'\].
    squares: &'a mut [T],
}

impl<T: Real, S: Simd> Squares<'_, T, S> {
    /// Sums `(|e| - 1)^2`, and what the damping adds.
    #[inline(always)]
    fn of_lengths(
        &mut self,
        edges: &[T],
        damping: Option<Damping<'_, T>>,
        summed: (usize, Option<&[T]>),
    ) -> f64 {
        let Self { simd, stored, .. } = *self;
        let one = T::splat(simd, T::one());
        for k in 0..stored.count / width::<T, S>() {
            let place = k * width::<T, S>();
            let e = vector_at::<T, S>(edges, place, stored.stride);
            let length = T::sqrt_lanes(simd, dot::<T, S>(simd, e, e));
            self.keep(place, T::sub_lanes(simd, length, one));
            if let Some(damping) = damping {
                let square = &mut T::lanes_mut::<S>(&mut self.squares[place..])[0];
                *square = T::add_lanes(simd, *square, damping.energy(simd, place, length));
            }
        }
        self.sum(summed)
    }

    /// Sums the energies of the angles between u and w, with the angle `atan2(|u x w|, u . w)`, which unlike the arc
    /// cosine is accurate for small angles.
    #[inline(always)]
    fn of_angles(&mut self, angle: Angle<T>, (u, w): (&[T], &[T]), summed: (usize, Option<&[T]>)) -> f64 {
        let Self { simd, stored, .. } = *self;
        let rest = T::splat(simd, angle.rest);
        for k in 0..stored.count / width::<T, S>() {
            let place = k * width::<T, S>();
            let u = vector_at::<T, S>(u, place, stored.stride);
            let w = vector_at::<T, S>(w, place, stored.stride);
            let c = cross::<T, S>(simd, u, w);
            let sine = T::sqrt_lanes(simd, dot::<T, S>(simd, c, c));
            let excess = T::sub_lanes(simd, T::angle(simd, sine, dot::<T, S>(simd, u, w)), rest);
            self.keep(place, excess);
        }
        angle.factor.f64() * self.sum(summed)
    }

    #[inline(always)]
    fn keep(&mut self, place: usize, v: T::Lanes<S>) {
        T::lanes_mut::<S>(&mut self.squares[place..])[0] = T::mul_lanes(self.simd, v, v);
    }

    #[inline(always)]
    fn sum(&self, (len, factors): (usize, Option<&[T]>)) -> f64 {
        let mut sum = 0.0;
        match factors {
            None => {
                for square in &self.squares[..len] {
                    sum += square.f64();
                }
            }
            Some(factors) => {
                for (&square, &factor) in self.squares[..len].iter().zip(factors) {
                    sum += (square * factor).f64();
                }
            }
        }
        sum
    }
}
