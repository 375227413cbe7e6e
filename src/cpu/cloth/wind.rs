//! Air drag on the cells of a cloth.

use super::vector::{at, cross, dot, length, scaled, sub};
use crate::cloth::{Air, Grid, Mark};
use crate::cpu::Real;

/// Adds to the accelerations `f` [3, H, W] the effect of air that moves with velocity `wind` [edges / frame]
/// on a cloth with these `marks` [H, W], positions `x` and velocities `v`, shape [3, H, W].
///
/// With the vector area of a cell (half the cross product of its diagonals: the same for both ways to cut it), its
/// size A and unit normal n, and `v_rel = wind - mean velocity of the corners`, the force on the cell is
/// `density A |v_n| v_n n + drag A (v_rel - v_n n)` with `v_n = n . v_rel`. Each corner carries a quarter of it, as it
/// carries a quarter of the cell's mass, so that uniform wind moves a flat sheet uniformly.
///
/// The force is that at the end of the frame: `v_n` divided by `1 + density A |v_n|`, and the part along the cell by
/// `1 + drag A` (a cell has mass 1), which is the velocity of a free cell after an implicit step. So the air never
/// turns a motion round, however light or fast the cloth.
pub fn add_wind<T: Real>(
    (grid, marks): (Grid, &[Mark]),
    air: Air,
    wind: [T; 3],
    (x, v): (&[T], &[T]),
    f: &mut [T],
) {
    if air == Air::default() {
        return;
    }
    let Grid { h, w } = grid;
    let n = h * w;
    let (density, drag, quarter) = (T::of(air.density), T::of(air.drag), T::of(0.25));
    for i in 0..h - 1 {
        for j in 0..w - 1 {
            let corners = [i * w + j, i * w + j + 1, (i + 1) * w + j, (i + 1) * w + j + 1];
            if !marks[corners[0]].begins_cell() {
                continue;
            }
            let [a, b, c, d] = corners.map(|p| at(x, n, p));
            let normal = cross(sub(d, a), sub(b, c));
            let double_area = length(normal);
            if double_area == T::zero() {
                continue;
            }
            let normal = scaled(normal, double_area.recip());
            let [a, b, c, d] = corners.map(|p| at(v, n, p));
            let mean = |k: usize| ((a[k] + d[k]) + (b[k] + c[k])) * quarter;
            let relative = sub(wind, [mean(0), mean(1), mean(2)]);
            let speed = dot(normal, relative);
            let area = double_area * T::of(0.5);
            let pressure = density * area * speed.abs();
            let friction = drag * area;
            let pressure = pressure / (T::one() + pressure) * speed;
            let friction = friction / (T::one() + friction);
            for p in corners {
                let share = quarter / T::of(marks[p].mass());
                for k in 0..3 {
                    let push = pressure * normal[k] + friction * (relative[k] - speed * normal[k]);
                    f[k * n + p] = f[k * n + p] + share * push;
                }
            }
        }
    }
}
