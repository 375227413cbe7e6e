//! The sheet's own axes at each particle, and how stiff it is along them.

use super::vector::{add, at, cross, dot, length, scaled, sub};
use crate::cloth::{Grid, Mark, Material};
use crate::cpu::Real;
use crate::settings::{HANDLE_REACH, HANDLE_SHARE};

/// Vectors shorter than this have no direction.
const SHORTEST: f64 = 1e-12;

pub use crate::settings::AXES;

/// Sets `axes` [10, H, W] to three orthogonal vectors t_1, t_2 and n per particle at the positions `x + shift`, both
/// [3, H, W], and a factor along the axes of the world.
///
/// t_1 and t_2 span the tangent plane and are closest to the directions in which i and j grow; n is their normal. A
/// particle whose neighbours span no plane, or that the cloth doesn't have, gets the axes of the world.
///
/// A vector's length says how far a force takes the particle along it, compared with a flat sheet of its material. With the mean
/// strains e_1 and e_2 of its edges along either axis and k the coefficients of the stretch,
/// `|t_1| = near (1 + 2 k_1 max(e_1, 0))^(-1/2) / (1 + 2 k_2 max(-e_2, 0))`, t_2 likewise, and `|n| = near`, the factor along the axes
/// of the world. It is below 1 next to a handle, because a cosine transform does not know that handles stay where they are.
pub fn sheet_axes<T: Real>(
    (grid, marks, material): (Grid, &[Mark], Material),
    x: &[T],
    shift: &[T],
    axes: &mut [T],
) {
    let (Grid { h, w }, n) = (grid, grid.particles());
    let between =
        |p: usize, q: usize| add(sub(at(x, n, q), at(x, n, p)), sub(at(shift, n, q), at(shift, n, p)));
    let twice = material.stretches().map(|k| T::of(2.0 * k));
    for i in 0..h {
        for j in 0..w {
            let p = i * w + j;
            // The particle itself for a neighbour that the cloth doesn't have.
            let has = |q: usize| if marks[q].is_outside() { p } else { q };
            let u = [has(i.saturating_sub(1) * w + j), has((i + 1).min(h - 1) * w + j)];
            let v = [has(i * w + j.saturating_sub(1)), has(i * w + (j + 1).min(w - 1))];
            let edges = |[before, behind]: [usize; 2]| [between(before, p), between(p, behind)];
            let (u, v) = (edges(u), edges(v));
            let [one, two] = tangents(add(u[0], u[1]), add(v[0], v[1]))
                .unwrap_or([[T::one(), T::zero(), T::zero()], [T::zero(), T::one(), T::zero()]]);
            let forces = [twice[0] * strain(u), twice[1] * strain(v)];
            let near = T::of(1.0 - HANDLE_SHARE * nearness(grid, marks, (i, j)));
            let lengths =
                [(0, 1), (1, 0)].map(|(own, other)| near * length_along(forces[own], forces[other]));
            let all = [scaled(one, lengths[0]), scaled(two, lengths[1]), scaled(cross(one, two), near)];
            for (c, &value) in all.as_flattened().iter().enumerate() {
                axes[c * n + p] = value;
            }
            axes[9 * n + p] = near;
        }
    }
}

/// Returns the mean strain of two edges, of which one or both may be missing (of length 0).
fn strain<T: Real>(edges: [[T; 3]; 2]) -> T {
    let lengths = edges.map(length).into_iter().filter(|&length| length > T::zero());
    let (sum, count) = lengths.fold((T::zero(), 0.0), |(sum, count), l| (sum + l - T::one(), count + 1.0));
    let mean = sum / T::of(f64::max(count, 1.0));
    if mean.is_finite() { mean } else { T::zero() }
}

/// Returns the length of an axis, given `2 k e` along it and along the other one.
fn length_along<T: Real>(own: T, other: T) -> T {
    let (stretched, compressed) = (own.max(T::zero()), (-other).max(T::zero()));
    ((T::one() + stretched).sqrt() * (T::one() + compressed)).recip()
}

/// Returns `1 / (1 + d)` for the distance d [edges of the grid] of the nearest handle, 0 if there is none within
/// [`HANDLE_REACH`] rows and columns.
fn nearness(grid: Grid, marks: &[Mark], (i, j): (usize, usize)) -> f64 {
    let range = |at: usize, count: usize| at.saturating_sub(HANDLE_REACH)..(at + HANDLE_REACH + 1).min(count);
    let mut nearest = usize::MAX;
    for k in range(i, grid.h) {
        for l in range(j, grid.w) {
            if marks[k * grid.w + l].is_handle() {
                nearest = nearest.min(i.abs_diff(k).pow(2) + j.abs_diff(l).pow(2));
            }
        }
    }
    if nearest == usize::MAX { 0.0 } else { (1.0 + (nearest as f64).sqrt()).recip() }
}

/// Returns the orthonormal pair in the plane of u and v that is closest to both: it makes equal angles with them.
fn tangents<T: Real>(u: [T; 3], v: [T; 3]) -> Option<[[T; 3]; 2]> {
    let (u, v) = (unit(u)?, unit(v)?);
    let s = unit(add(u, v))?;
    // In the plane and orthogonal to s, towards u.
    let d = sub(u, scaled(s, dot(u, s)));
    let d = unit(d).filter(|_| length(cross(u, v)).f64() > SHORTEST)?;
    let half = T::of(std::f64::consts::FRAC_1_SQRT_2);
    Some([scaled(add(s, d), half), scaled(sub(s, d), half)])
}

fn unit<T: Real>(u: [T; 3]) -> Option<[T; 3]> {
    let length = length(u);
    (length.f64() > SHORTEST && length.is_finite()).then(|| scaled(u, length.recip()))
}
