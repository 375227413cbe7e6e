//! Passes over the fields of a cloth, compiled for the widest registers of the machine. As in
//! [`crate::cpu::elementary`], they contain neither closures nor iterator adapters.

use crate::cpu::Real;
use pulp::{Arch, Simd, WithSimd};

/// What is done with the numbers of a field [n], or with the vectors of one [3, n].
pub(super) enum Pass<'a, T> {
    /// Multiplies a field [n] by factors.
    Multiply(&'a mut [T], &'a [T]),
    /// Adds this multiple of a field [n].
    Add(&'a mut [T], T, &'a [T]),
    /// Sets a field [n] to the opposite of another.
    Negate(&'a mut [T], &'a [T]),
    /// Sets a field [n] to the products of the vectors of another [3, n] with an axis.
    Project(&'a mut [T], [&'a [T]; 3], &'a [T]),
    /// Sets the vectors of a field [3, n] to multiples [n] of an axis.
    Along(&'a mut [T], [&'a [T]; 3], &'a [T]),
    /// Adds multiples [n] of an axis to the vectors of a field [3, n].
    AddAlong(&'a mut [T], [&'a [T]; 3], &'a [T]),
    /// Adds to forces [3, n] what the stretch answers to a step [3, n], given the edges from each particle to the one that is `next`
    /// later.
    Answer { forces: &'a mut [T], edges: [&'a [T]; 3], next: usize, step: &'a [T], memory: &'a mut [T] },
}

impl<T: Real> Pass<'_, T> {
    /// Does it. Panics if an operand is shorter than the field.
    pub fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Real> WithSimd for Pass<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        match self {
            Self::Multiply(field, factors) => {
                let factors = &factors[..field.len()];
                for k in 0..field.len() {
                    field[k] = field[k] * factors[k];
                }
            }
            Self::Add(field, factor, other) => {
                let other = &other[..field.len()];
                for k in 0..field.len() {
                    field[k] = field[k] + factor * other[k];
                }
            }
            Self::Negate(field, other) => {
                let other = &other[..field.len()];
                for k in 0..field.len() {
                    field[k] = -other[k];
                }
            }
            Self::Project(to, axis, field) => {
                let n = to.len();
                let ([x, y, z], [a, b, c]) = (components(field, n), slices(axis, n));
                for k in 0..n {
                    to[k] = x[k] * a[k] + y[k] * b[k] + z[k] * c[k];
                }
            }
            Self::Along(field, axis, factors) => {
                let n = factors.len();
                for component in 0..3 {
                    let (to, axis) = (&mut field[component * n..][..n], &axis[component][..n]);
                    for k in 0..n {
                        to[k] = factors[k] * axis[k];
                    }
                }
            }
            Self::AddAlong(field, axis, factors) => {
                let n = factors.len();
                for component in 0..3 {
                    let (to, axis) = (&mut field[component * n..][..n], &axis[component][..n]);
                    for k in 0..n {
                        to[k] = to[k] + factors[k] * axis[k];
                    }
                }
            }
            Self::Answer { forces, edges, next, step, memory } => {
                let n = memory.len();
                let (answers, count) = (&mut memory[..n - next], n - next);
                let [a, b, c] = slices(edges, count);
                let step = components(step, n);
                let [x, y, z] = slices(step, count);
                let [to_x, to_y, to_z] = [&step[0][next..], &step[1][next..], &step[2][next..]];
                let [to_x, to_y, to_z] = slices([to_x, to_y, to_z], count);
                for k in 0..count {
                    answers[k] = a[k] * (to_x[k] - x[k]) + b[k] * (to_y[k] - y[k]) + c[k] * (to_z[k] - z[k]);
                }
                for component in 0..3 {
                    let edges = &edges[component][..count];
                    let from = &mut forces[component * n..][..count];
                    for k in 0..count {
                        from[k] = from[k] + answers[k] * edges[k];
                    }
                    let to = &mut forces[component * n + next..][..count];
                    for k in 0..count {
                        to[k] = to[k] - answers[k] * edges[k];
                    }
                }
            }
        }
    }
}

/// Returns the components of a field [3, n].
#[inline(always)]
fn components<T>(field: &[T], n: usize) -> [&[T]; 3] {
    [&field[..n], &field[n..2 * n], &field[2 * n..3 * n]]
}

/// Returns the first numbers of each slice.
#[inline(always)]
fn slices<T>([x, y, z]: [&[T]; 3], count: usize) -> [&[T]; 3] {
    [&x[..count], &y[..count], &z[..count]]
}
