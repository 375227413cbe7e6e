//! The energy of a cloth at a trial acceleration (paper section 3.2): the vectorised form of the energies in
//! [`terms`](crate::cloth::terms), checked against the plain one.

use super::cut::Element;
use super::rows::{Stored, cross, dot, load, vector_at, width};
use super::{Angle, Factors, Trial, particles};
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

/// Edges of a row and of the next one, shape [3, W'], and the squares to be summed, shape \[W'\].
struct Work<T> {
    vertical: [Vec<T>; 2],
    horizontal: [Vec<T>; 2],
    squares: Vec<T>,
}

impl<T: Real> Work<T> {
    fn new(stride: usize) -> Self {
        let edges = || [(); 2].map(|()| vec![T::zero(); 3 * stride]);
        Self { vertical: edges(), horizontal: edges(), squares: vec![T::zero(); stride] }
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
        let Factors { vertical, horizontal, shear, bend } = trial.factors();
        let (vertical, horizontal) = (vertical.f64(), horizontal.f64());
        let Work { vertical: [v, next_v], horizontal: [e, next_e], squares } = work;
        let mut sums = Squares { simd, stored, squares };
        let has = |element| trial.cut.map(|cut| cut.row(i, element));
        let mut sum = particles::energy(trial, i);
        load(simd, trial, (i, 1, w - 1), stored, e);
        sum.stretch += horizontal * sums.of_lengths(e, (w - 1, has(Element::Right)));
        sum.bend += sums.of_angles(bend, (&e[1..], e), (w - 2, has(Element::StraightRight)));
        if i + 1 == h {
            return sum;
        }
        load(simd, trial, (i, w, w), stored, v);
        sum.stretch += vertical * sums.of_lengths(v, (w, has(Element::Down)));
        load(simd, trial, (i + 1, 1, w - 1), stored, next_e);
        for right in [false, true] {
            for (lower, e) in [(false, &*e), (true, &*next_e)] {
                let corners = (w - 1, has(Element::corner(lower, right)));
                sum.shear += sums.of_angles(shear, (&v[usize::from(right)..], e), corners);
            }
        }
        if i + 2 == h {
            return sum;
        }
        load(simd, trial, (i + 1, w, w), stored, next_v);
        sum.bend += sums.of_angles(bend, (next_v, v), (w, has(Element::StraightDown)));
        sum
    }
}

/// Sums of squares over the first edges, or pairs of edges, of a row, or those of them that a factor of 1 says the cloth has:
/// squared in the precision of the cloth, summed in double precision.
struct Squares<'a, T, S> {
    simd: S,
    stored: Stored,
    /// Shape \[W'\].
    squares: &'a mut [T],
}

impl<T: Real, S: Simd> Squares<'_, T, S> {
    /// Sums `(|e| - 1)^2`.
    #[inline(always)]
    fn of_lengths(&mut self, edges: &[T], summed: (usize, Option<&[T]>)) -> f64 {
        let Self { simd, stored, .. } = *self;
        let one = T::splat(simd, T::one());
        for k in 0..stored.count / width::<T, S>() {
            let place = k * width::<T, S>();
            let e = vector_at::<T, S>(edges, place, stored.stride);
            let length = T::sqrt_lanes(simd, dot::<T, S>(simd, e, e));
            self.keep(place, T::sub_lanes(simd, length, one));
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
    fn sum(&self, (len, has): (usize, Option<&[T]>)) -> f64 {
        let mut sum = 0.0;
        match has {
            None => {
                for square in &self.squares[..len] {
                    sum += square.f64();
                }
            }
            Some(has) => {
                for (&square, &has) in self.squares[..len].iter().zip(has) {
                    sum += (square * has).f64();
                }
            }
        }
        sum
    }
}
