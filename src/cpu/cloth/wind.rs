//! Air drag on the triangles of a cloth.

use super::vector::{at, cross, dot, length, scaled, sub};
use crate::cloth::{Air, Grid};
use crate::cpu::Real;

/// Adds to the accelerations `f` [3, H, W] the effect of air that moves with velocity `wind` [edges / frame]
/// on a cloth with positions `x` and velocities `v`, shape [3, H, W].
///
/// Per triangle, with the unit normal n and `v_rel = wind - mean velocity of the corners`, the force is
/// `density area |n . v_rel| (n . v_rel) n + drag area (v_rel - (n . v_rel) n)`, one third of it on each
/// corner.
pub fn add_wind<T: Real>(grid: Grid, air: Air, wind: [T; 3], (x, v): (&[T], &[T]), f: &mut [T]) {
    if air == Air::default() {
        return;
    }
    let n = grid.particles();
    let (density, drag, third) = (T::of(air.density), T::of(air.drag), T::of(1.0 / 3.0));
    for corners in grid.iter_faces() {
        let [a, b, c] = corners.map(|p| at(x, n, p as usize));
        let normal = cross(sub(b, a), sub(c, a));
        let double_area = length(normal);
        if double_area == T::zero() {
            continue;
        }
        let normal = scaled(normal, double_area.recip());
        let velocities = corners.map(|p| at(v, n, p as usize));
        let mean = |k: usize| (velocities[0][k] + velocities[1][k] + velocities[2][k]) * third;
        let relative = sub(wind, [mean(0), mean(1), mean(2)]);
        let speed = dot(normal, relative);
        let share = double_area * T::of(0.5) * third;
        for p in corners {
            let p = p as usize;
            let per_mass = share / T::of(grid.mass(p / grid.w, p % grid.w));
            for k in 0..3 {
                let along = density * speed.abs() * speed * normal[k];
                let across = drag * (relative[k] - speed * normal[k]);
                f[k * n + p] = f[k * n + p] + per_mass * (along + across);
            }
        }
    }
}
