//! What a particle adds to the energy by itself, its inertia and its external work: the vectorised forms of
//! [`Particle`](crate::cloth::terms::Particle), checked against the plain definition.
//!
//! The sums over a cloth ([`energy`](super::energy()), [`gradient`](super::gradient()),
//! [`local_model`](super::local_model) and Newton's Hessian) call these for each row or particle, so another term of
//! single particles is added here alone.
#![expect(
    clippy::needless_range_loop,
    reason = "iterator adapters would not be compiled for the registers, see `rows`"
)]

use super::curvature::{EXTERNAL, INERTIA, Sums, pair};
use super::rows::width;
use super::{Hessian, Trial, vector};
use crate::cloth::{EnergyTerms, Grid, Mark};
use crate::cpu::Real;
use pulp::Simd;

/// Returns the energies of row `i`, summed in double precision.
#[inline(always)]
pub(super) fn energy<T: Real>(trial: &Trial<'_, T>, i: usize) -> EnergyTerms {
    let Grid { h, w } = trial.grid;
    let n = h * w;
    let mut sum = EnergyTerms::default();
    for j in 0..w {
        let mass = trial.marks[i * w + j].mass() / n as f64;
        let (a, f) = (vector::at(trial.a, n, i * w + j), vector::at(trial.f, n, i * w + j));
        sum.inertia += 0.5 * mass * vector::dot(a, a).f64();
        sum.external -= mass * vector::dot(a, f).f64();
    }
    sum
}

/// The gradient of one component of one row of particles.
pub(super) struct GradientRow<'a, T> {
    /// Components of the accelerations, shape \[W\].
    a: &'a [T],
    /// Components of the external accelerations, shape \[W\].
    f: &'a [T],
    /// Masses over H W, shape \[W\].
    masses: &'a [T],
}

impl<'a, T: Real> GradientRow<'a, T> {
    /// Returns row number `row`, counted through all components.
    #[inline(always)]
    pub fn new(trial: &Trial<'a, T>, row: usize) -> Self {
        let Grid { h, w } = trial.grid;
        let masses = &trial.masses[row % h * w..][..w];
        Self { a: &trial.a[row * w..][..w], f: &trial.f[row * w..][..w], masses }
    }

    /// Returns `sum` plus the gradient of the particles from `place` on.
    #[inline(always)]
    pub fn plus<S: Simd>(&self, simd: S, place: usize, sum: T::Lanes<S>) -> T::Lanes<S> {
        let a = T::load_partial(simd, &self.a[place..]);
        let f = T::load_partial(simd, &self.f[place..]);
        T::fma(simd, T::load_partial(simd, &self.masses[place..]), T::sub_lanes(simd, a, f), sum)
    }

    /// Returns the gradient of particle `j` of the row by itself.
    #[inline(always)]
    pub fn alone(&self, j: usize) -> T {
        self.masses[j] * (self.a[j] - self.f[j])
    }
}

/// Sums over rows of particles along K directions.
#[derive(Clone, Copy)]
pub(super) struct Directions<'a, T> {
    /// Shape [K, 3, H, W].
    pub fields: &'a [T],
    /// The gradient of the energy, shape [3, H, W].
    pub grad: &'a [T],
}

/// Returns the masses of particles over the number of particles of the grid, of each of their cloths.
pub fn masses<T: Real>(grid: Grid, marks: &[Mark]) -> Vec<T> {
    marks.iter().map(|mark| T::of(mark.mass() / grid.particles() as f64)).collect()
}

impl<T: Real> Directions<'_, T> {
    /// Adds the energies of row `i` and their second derivatives along the directions. In the same pass, also the
    /// products of the directions with each other and with the gradient.
    #[inline(always)]
    pub fn add_row<S: Simd, const K: usize>(
        self,
        simd: S,
        trial: &Trial<'_, T>,
        i: usize,
        sums: &mut Sums<T::Lanes<S>>,
    ) {
        let Self { fields, grad } = self;
        let Grid { h, w } = trial.grid;
        let half = T::splat(simd, T::of(0.5));
        let masses = &trial.masses[i * w..][..w];
        for component in 0..3 {
            let row = (component * h + i) * w;
            let (a, f) = (&trial.a[row..][..w], &trial.f[row..][..w]);
            for register in 0..w.div_ceil(width::<T, S>()) {
                let place = register * width::<T, S>();
                let mass = T::load_partial(simd, &masses[place..]);
                let (a, f) = (T::load_partial(simd, &a[place..]), T::load_partial(simd, &f[place..]));
                let force = T::mul_lanes(simd, mass, a);
                let energies = &mut sums.energies;
                energies[INERTIA] = T::fma(simd, T::mul_lanes(simd, half, force), a, energies[INERTIA]);
                energies[EXTERNAL] = T::sub_lanes(simd, energies[EXTERNAL], T::mul_lanes(simd, force, f));
                if K == 0 {
                    continue;
                }
                let g = T::load_partial(simd, &grad[row + place..][..w - place]);
                let mut p = [g; K];
                for (k, p) in p.iter_mut().enumerate() {
                    *p = T::load_partial(simd, &fields[3 * k * h * w + row + place..][..w - place]);
                }
                for i in 0..K {
                    sums.slopes[i] = T::fma(simd, p[i], g, sums.slopes[i]);
                    sums.squares[i] = T::fma(simd, p[i], p[i], sums.squares[i]);
                    let force = T::mul_lanes(simd, mass, p[i]);
                    for j in i..K {
                        sums.pairs[pair(i, j)] = T::fma(simd, force, p[j], sums.pairs[pair(i, j)]);
                    }
                }
            }
        }
    }
}

/// Adds the second derivatives with respect to the acceleration of particle `p` to its own block of the Hessian.
pub(in crate::cpu) fn add_own_block(trial: &Trial<'_, f64>, p: usize, hessian: &mut Hessian) {
    let mass = trial.marks[p].mass() / trial.grid.particles() as f64;
    for c in 0..3 {
        *hessian.at_mut((p, c), (p, c)) += mass;
    }
}
