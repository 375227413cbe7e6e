//! The repulsion between nearby particles, which keeps the layers of a cloth apart (paper section 3.4).

use super::Trial;
use super::cells::{Cells, Placed, Walk};
use super::vector::{add, at, dot, scaled, sub};
use crate::cloth::Repulsion;
use crate::cpu::Real;
use rayon::prelude::*;

/// Number of particles per task.
const TASK: usize = 1024;

/// Sets `total_acceleration` [3, H, W] to the external accelerations of a trial plus those of the repulsion,
/// and returns the repulsion's energy.
///
/// With strength k and distance delta, the energy is `-k / (H W)` times the sum of `log(d^2 + 1e-8)` over
/// ordered pairs of particles at a distance d < delta that no edge of the triangulated grid joins. It depends
/// on positions alone, so its gradient with respect to the acceleration of a free particle of mass m is that
/// of a force, the acceleration `4 k / m sum (x_p - x_q) / (d^2 + 1e-8)`. Handles repel others, but are not
/// accelerated themselves.
pub fn repulsion<T: Real>(trial: &Trial<'_, T>, repulsion: Repulsion, total_acceleration: &mut [T]) -> f64 {
    let (grid, n) = (trial.grid, trial.grid.particles());
    let Repulsion { strength, distance } = repulsion;
    let (distance, softening) = (T::of(distance), T::of(Repulsion::SOFTENING));
    let cells = Cells::new(trial, distance);
    let of_particle = |walk: &mut Walk<'_, T>, own: &Placed<T>| {
        let (mut sum, mut energy, p) = ([T::zero(); 3], 0.0, own.particle);
        let around = own.is_within_reach().then(|| walk.around(own));
        for other in around.into_iter().flatten() {
            let difference = sub(own.place, other.place);
            let square = dot(difference, difference);
            if square < distance * distance && !grid.joined(p, other.particle) {
                let square = square + softening;
                sum = add(sum, scaled(difference, square.recip()));
                energy -= square.f64().ln();
            }
        }
        let f = at(trial.f, n, p);
        let factor = T::of(4.0 * strength / grid.mass(p / grid.w, p % grid.w));
        (p, if trial.slots[p] == 0 { add(f, scaled(sum, factor)) } else { f }, energy)
    };
    let of_task = |task: &[Placed<T>]| {
        let mut walk = cells.walk(&task[0]);
        task.iter().map(|own| of_particle(&mut walk, own)).collect()
    };
    let tasks: Vec<Vec<_>> = cells.sorted().par_chunks(TASK).map(of_task).collect();
    let mut energy = 0.0;
    for (p, acceleration, of_particle) in tasks.into_iter().flatten() {
        [total_acceleration[p], total_acceleration[n + p], total_acceleration[2 * n + p]] = acceleration;
        energy += of_particle;
    }
    strength / n as f64 * energy
}
