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
use super::rows::{at, width};
use super::{Hessian, Trial, vector};
use crate::cloth::{EnergyTerms, Grid};
use crate::cpu::Real;
use pulp::Simd;

/// Returns the energies of row `i`, summed in double precision.
#[inline(always)]
pub(super) fn energy<T: Real>(trial: &Trial<'_, T>, i: usize) -> EnergyTerms {
    let Grid { h, w } = trial.grid;
    let n = h * w;
    let mut sum = EnergyTerms::default();
    for j in 0..w {
        let mass = trial.grid.mass(i, j) / n as f64;
        let (a, f) = (vector::at(trial.a, n, i * w + j), vector::at(trial.f, n, i * w + j));
        sum.inertia += 0.5 * mass * vector::dot(a, a).f64();
        sum.external -= mass * vector::dot(a, f).f64();
    }
    sum
}

/// The gradient of one component of one row of particles.
pub(super) struct GradientRow<'a, T> {
    grid: Grid,
    /// Number of the row.
    i: usize,
    /// Components of the accelerations, shape \[W\].
    a: &'a [T],
    /// Components of the external accelerations, shape \[W\].
    f: &'a [T],
    /// Mass over H W of a particle inside the row.
    mass: T,
}

impl<'a, T: Real> GradientRow<'a, T> {
    /// Returns row number `row`, counted through all components.
    #[inline(always)]
    pub fn new(trial: &Trial<'a, T>, row: usize) -> Self {
        let grid @ Grid { h, w } = trial.grid;
        let i = row % h;
        // Twice that of a particle at the end of the row.
        let mass = T::of(2.0 * grid.mass(i, 0) / (h * w) as f64);
        Self { grid, i, a: &trial.a[row * w..][..w], f: &trial.f[row * w..][..w], mass }
    }

    /// Returns `sum` plus the gradient of the particles from `place` on, as if all were inside the row.
    #[inline(always)]
    pub fn plus<S: Simd>(&self, simd: S, place: usize, sum: T::Lanes<S>) -> T::Lanes<S> {
        let a = T::load_partial(simd, &self.a[place..]);
        let f = T::load_partial(simd, &self.f[place..]);
        T::fma(simd, T::splat(simd, self.mass), T::sub_lanes(simd, a, f), sum)
    }

    /// Takes back what [`GradientRow::plus`] added too much at the ends of the row: those particles have half the mass.
    #[inline(always)]
    pub fn correct_ends(&self, grad: &mut [T]) {
        let half = self.mass * T::of(0.5);
        for j in [0, grad.len() - 1] {
            grad[j] = grad[j] - half * (self.a[j] - self.f[j]);
        }
    }

    /// Returns the gradient of particle `j` of the row by itself.
    #[inline(always)]
    pub fn alone(&self, j: usize) -> T {
        T::of(self.grid.mass(self.i, j) / self.grid.particles() as f64) * (self.a[j] - self.f[j])
    }
}

/// Sums over rows of particles along K directions.
#[derive(Clone, Copy)]
pub(super) struct Directions<'a, T> {
    /// [`masses`], shape \[W'\].
    pub masses: &'a [T],
    /// Shape [K, 3, H, W].
    pub fields: &'a [T],
    /// The gradient of the energy, shape [3, H, W].
    pub grad: &'a [T],
}

/// Returns the masses of the particles of an inner row over H W, zero past the row, shape \[len\].
pub(super) fn masses<T: Real>(grid: Grid, len: usize) -> Vec<T> {
    let mass = |j: usize| if j < grid.w { 2.0 * grid.mass(0, j) / grid.particles() as f64 } else { 0.0 };
    (0..len).map(|j| T::of(mass(j))).collect()
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
        let Self { masses, fields, grad } = self;
        let Grid { h, w } = trial.grid;
        let half = T::splat(simd, T::of(0.5));
        // Particles of the first and the last row have half the mass of the others.
        let of_row = T::splat(simd, T::of(if i == 0 || i + 1 == h { 0.5 } else { 1.0 }));
        for component in 0..3 {
            let row = (component * h + i) * w;
            let (a, f) = (&trial.a[row..][..w], &trial.f[row..][..w]);
            for register in 0..w.div_ceil(width::<T, S>()) {
                let place = register * width::<T, S>();
                let mass = T::mul_lanes(simd, of_row, at::<T, S>(masses, place));
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
    let grid = trial.grid;
    let mass = grid.mass(p / grid.w, p % grid.w) / grid.particles() as f64;
    for c in 0..3 {
        *hessian.at_mut((p, c), (p, c)) += mass;
    }
}
