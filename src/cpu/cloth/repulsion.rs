//! The repulsion between nearby particles, which keeps the layers of a cloth apart (paper section 3.4).

use super::Trial;
use super::cells::{Cells, Placed, Walk};
use super::hessian::{Block, Coupling, Projection};
use super::vector::{add, at, dot, scaled, sub};
use crate::cloth::{Grid, Repulsion};
use crate::cpu::Real;
use crate::sim::MAX_DIRECTIONS;
use rayon::prelude::*;

/// Number of particles per task.
const TASK: usize = 1024;

/// Sets `total_acceleration` [3, H, W] to the external accelerations of a trial plus those of the repulsion,
/// and returns the repulsion's energy.
///
/// With strength k and distance delta, the energy is `-k / (H W)` times the sum of
/// `log((d^2 + 1e-8) / (delta^2 + 1e-8))` over ordered pairs of particles at a distance d < delta that no edge of
/// the triangulated grid joins. The paper's term is `log(d^2 + 1e-8)`, which has the same gradient, but jumps
/// where a pair enters the range; this one begins at 0 there.
///
/// It depends on positions alone, so its gradient with respect to the acceleration of a free particle of mass m is
/// that of a force, the acceleration `4 k / m sum (x_p - x_q) / (d^2 + 1e-8)`. Handles repel others, but are not
/// accelerated themselves.
pub fn repulsion<T: Real>(trial: &Trial<'_, T>, repulsion: Repulsion, total_acceleration: &mut [T]) -> f64 {
    let (grid, n) = (trial.grid, trial.grid.particles());
    let strength = repulsion.strength;
    let range = Range::<T>::of(grid, repulsion);
    let of_particle = |walk: &mut Walk<'_, T>, own: &Placed<T>| {
        let (mut sum, mut energy, p) = ([T::zero(); 3], 0.0, own.particle);
        range.pairs(walk, own, |_, difference, square| {
            sum = add(sum, scaled(difference, square.recip()));
            energy -= (square / range.limit).f64().ln();
        });
        let f = at(trial.f, n, p);
        let factor = T::of(4.0 * strength / trial.marks[p].mass());
        (p, if trial.marks[p].is_free() { add(f, scaled(sum, factor)) } else { f }, energy)
    };
    let mut energy = 0.0;
    for (p, acceleration, of_particle) in range.of_particles(trial, of_particle) {
        [total_acceleration[p], total_acceleration[n + p], total_acceleration[2 * n + p]] = acceleration;
        energy += of_particle;
    }
    strength / n as f64 * energy
}

/// Returns the repulsion's second derivatives `p_i . (d2E/da2) p_j` along `directions` [K, 3, H, W], which are 0 at
/// handles; 0 past K.
///
/// With the difference r of two particles, `s = r.r + 1e-8` and the differences q_i of the directions there, an
/// ordered pair adds `2 k / (H W) (2 (r.q_i) (r.q_j) / s^2 - q_i.q_j / s)`: it is convex along r and concave across.
pub fn repulsion_curvature<T: Real>(
    trial: &Trial<'_, T>,
    repulsion: Repulsion,
    directions: &[T],
) -> [[f64; MAX_DIRECTIONS]; MAX_DIRECTIONS] {
    let (grid, n) = (trial.grid, trial.grid.particles());
    let count = directions.len() / (3 * n);
    let mut curvature = [[0.0; MAX_DIRECTIONS]; MAX_DIRECTIONS];
    if count == 0 {
        return curvature;
    }
    let range = Range::<T>::of(grid, repulsion);
    let of_particle = |walk: &mut Walk<'_, T>, own: &Placed<T>| {
        let mut sums = [[0.0; MAX_DIRECTIONS]; MAX_DIRECTIONS];
        range.pairs(walk, own, |q, difference, square| {
            // Once for both orders.
            if q < own.particle {
                return;
            }
            let inverse = square.recip();
            let unit = scaled(difference, inverse);
            let mut along = [T::zero(); MAX_DIRECTIONS];
            let mut changes = [[T::zero(); 3]; MAX_DIRECTIONS];
            for (i, p) in directions.chunks_exact(3 * n).enumerate() {
                changes[i] = sub(at(p, n, own.particle), at(p, n, q));
                along[i] = dot(unit, changes[i]);
            }
            for i in 0..count {
                for j in i..count {
                    let convex = along[i] * along[j];
                    sums[i][j] += (convex + convex - inverse * dot(changes[i], changes[j])).f64();
                }
            }
        });
        sums
    };
    let factor = 4.0 * repulsion.strength / n as f64;
    for sums in range.of_particles(trial, of_particle) {
        for i in 0..count {
            for j in i..count {
                curvature[i][j] += factor * sums[i][j];
                curvature[j][i] = curvature[i][j];
            }
        }
    }
    curvature
}

/// Two particles that repel each other, and the second derivatives of their energy with respect to the difference of
/// their positions: the same along every direction across it, and another along it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RepellingPair {
    /// The particle with the smaller number.
    pub p: usize,
    /// The other one.
    pub q: usize,
    along: f64,
    across: f64,
    unit: [f64; 3],
}

impl RepellingPair {
    /// Returns the second derivatives.
    pub fn coupling(&self, projection: Projection) -> Coupling {
        let block = self.block(projection);
        Coupling { particles: [self.p, self.q, self.p, self.q], weights: [1.0, -1.0, 0.0, 0.0], block }
    }

    /// Returns the second derivatives with respect to the difference.
    pub fn block(&self, Projection(share): Projection) -> Block {
        let of = |value: f64| value - share * value.min(0.0);
        let (across, along) = (of(self.across), of(self.along));
        let u = self.unit;
        [0, 1, 2]
            .map(|r| [0, 1, 2].map(|c| (along - across) * u[r] * u[c] + if r == c { across } else { 0.0 }))
    }
}

/// Returns the pairs of particles that repel each other at a trial, in a fixed order.
pub fn repelling_pairs(trial: &Trial<'_, f64>, repulsion: Repulsion) -> Vec<RepellingPair> {
    let range = Range::of(trial.grid, repulsion);
    let factor = 4.0 * repulsion.strength / trial.grid.particles() as f64;
    let of_particle = |walk: &mut Walk<'_, f64>, own: &Placed<f64>| {
        let mut pairs = Vec::new();
        range.pairs(walk, own, |q, difference, square| {
            let length = dot(difference, difference).sqrt();
            if q > own.particle {
                let inverse = if length > 0.0 { length.recip() } else { 0.0 };
                pairs.push(RepellingPair {
                    p: own.particle,
                    q,
                    along: factor * (2.0 * length * length / square - 1.0) / square,
                    across: -factor / square,
                    unit: scaled(difference, inverse),
                });
            }
        });
        pairs
    };
    range.of_particles(trial, of_particle).flatten().collect()
}

/// Which particles repel each other.
struct Range<T> {
    grid: Grid,
    /// The distance below which they do \[edges\].
    distance: T,
    softening: T,
    /// Its square, softened.
    limit: T,
}

impl<T: Real> Range<T> {
    fn of(grid: Grid, repulsion: Repulsion) -> Self {
        let (distance, softening) = (T::of(repulsion.distance), T::of(Repulsion::SOFTENING));
        Self { grid, distance, softening, limit: distance * distance + softening }
    }

    /// Calls `of_particle` for each particle of a trial, in a fixed order, and returns what it returns.
    fn of_particles<R: Send>(
        &self,
        trial: &Trial<'_, T>,
        of_particle: impl Fn(&mut Walk<'_, T>, &Placed<T>) -> R + Sync,
    ) -> impl Iterator<Item = R> {
        let cells = Cells::new(trial, self.distance);
        let of_task = |task: &[Placed<T>]| {
            let mut walk = cells.walk(&task[0]);
            task.iter().map(|own| of_particle(&mut walk, own)).collect()
        };
        let tasks: Vec<Vec<R>> = cells.sorted().par_chunks(TASK).map(of_task).collect();
        tasks.into_iter().flatten()
    }

    /// Calls `of_pair` for each particle that repels `own`, with its number, the difference to `own` and that
    /// squared and softened.
    fn pairs(&self, walk: &mut Walk<'_, T>, own: &Placed<T>, mut of_pair: impl FnMut(usize, [T; 3], T)) {
        let around = own.is_within_reach().then(|| walk.around(own));
        for other in around.into_iter().flatten() {
            let difference = sub(own.place, other.place);
            let square = dot(difference, difference);
            if square < self.distance * self.distance && !self.grid.joined(own.particle, other.particle) {
                of_pair(other.particle, difference, square + self.softening);
            }
        }
    }
}
