//! The repulsion between nearby particles, which keeps the layers of a cloth apart (paper section 3.4).

use super::Trial;
use super::hessian::{Block, Coupling, Projection};
use super::near_pairs::NearPairs;
use super::vector::{add, at, dot, scaled, sub};
use crate::cloth::Repulsion;
use crate::cpu::Real;
use crate::sim::MAX_DIRECTIONS;
use rayon::prelude::*;
use std::borrow::Cow;

/// Fewest particles that are worth waking a thread for.
const ALONE: usize = 512;

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
    let n = trial.grid.particles();
    let strength = repulsion.strength;
    let range = Range::of(trial, repulsion);
    let of_particle = |p: usize| {
        let (mut sum, mut energy) = ([T::zero(); 3], 0.0);
        range.pairs(p, |_, difference, square| {
            sum = add(sum, scaled(difference, square.recip()));
            energy -= (square / range.limit).f64().ln();
        });
        let f = at(trial.f, n, p);
        let factor = T::of(4.0 * strength / trial.marks[p].mass());
        (if trial.marks[p].is_free() { add(f, scaled(sum, factor)) } else { f }, energy)
    };
    let mut energy = 0.0;
    for (p, (acceleration, of_particle)) in range.of_particles(of_particle).into_iter().enumerate() {
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
    let n = trial.grid.particles();
    let count = directions.len() / (3 * n);
    let mut curvature = [[0.0; MAX_DIRECTIONS]; MAX_DIRECTIONS];
    if count == 0 {
        return curvature;
    }
    let range = Range::of(trial, repulsion);
    let of_particle = |own: usize| {
        let mut sums = [[0.0; MAX_DIRECTIONS]; MAX_DIRECTIONS];
        range.pairs(own, |q, difference, square| {
            // Once for both orders.
            if q < own {
                return;
            }
            let inverse = square.recip();
            let unit = scaled(difference, inverse);
            let mut along = [T::zero(); MAX_DIRECTIONS];
            let mut changes = [[T::zero(); 3]; MAX_DIRECTIONS];
            for (i, p) in directions.chunks_exact(3 * n).enumerate() {
                changes[i] = sub(at(p, n, own), at(p, n, q));
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
    for sums in range.of_particles(of_particle) {
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
    let range = Range::of(trial, repulsion);
    let factor = 4.0 * repulsion.strength / trial.grid.particles() as f64;
    let of_particle = |p: usize| {
        let mut pairs = Vec::new();
        range.pairs(p, |q, difference, square| {
            let length = dot(difference, difference).sqrt();
            if q > p {
                let inverse = if length > 0.0 { length.recip() } else { 0.0 };
                pairs.push(RepellingPair {
                    p,
                    q,
                    along: factor * (2.0 * length * length / square - 1.0) / square,
                    across: -factor / square,
                    unit: scaled(difference, inverse),
                });
            }
        });
        pairs
    };
    range.of_particles(of_particle).into_iter().flatten().collect()
}

/// Which particles repel each other.
struct Range<'a, T: Real> {
    /// Where they are \[edges\].
    places: Vec<[T; 3]>,
    /// Those that may be near each other.
    near: Cow<'a, NearPairs<T>>,
    /// The distance below which they repel each other \[edges\].
    distance: T,
    softening: T,
    /// Its square, softened.
    limit: T,
}

impl<'a, T: Real> Range<'a, T> {
    /// Finds those of a trial, unless it has them already.
    fn of(trial: &Trial<'a, T>, repulsion: Repulsion) -> Self {
        let (distance, softening) = (T::of(repulsion.distance), T::of(Repulsion::SOFTENING));
        let places = NearPairs::places(trial.marks, trial.x, trial.shift);
        let near = match trial.near.filter(|near| near.are_within(distance)) {
            Some(near) => Cow::Borrowed(near),
            None => {
                let mut near = NearPairs::default();
                near.update(trial.grid, &places, distance);
                Cow::Owned(near)
            }
        };
        Self { places, near, distance, softening, limit: distance * distance + softening }
    }

    /// Calls `of_particle` for each particle, and returns what it returns, in the order of the particles.
    fn of_particles<R: Send>(&self, of_particle: impl Fn(usize) -> R + Send + Sync) -> Vec<R> {
        (0..self.places.len()).into_par_iter().with_min_len(ALONE).map(of_particle).collect()
    }

    /// Calls `of_pair` for each particle that repels particle `p`, with its number, the difference to `p` and that
    /// squared and softened.
    fn pairs(&self, p: usize, mut of_pair: impl FnMut(usize, [T; 3], T)) {
        for q in self.near.of(p).iter().map(|&q| q as usize) {
            let difference = sub(self.places[p], self.places[q]);
            let square = dot(difference, difference);
            if square < self.distance * self.distance {
                of_pair(q, difference, square + self.softening);
            }
        }
    }
}
