//! The sheet's own axes at each particle, how far forces move it along them, and its edges.

use super::vector::{add, at, cross, dot, length, scaled, sub};
use crate::cloth::terms::Elastic;
use crate::cloth::{Grid, Mark, Material};
use crate::cpu::Real;
use crate::settings::{ARCHING, HANDLE_REACH, HANDLE_SHARE};

/// Vectors shorter than this have no direction.
const SHORTEST: f64 = 1e-12;

pub use crate::settings::AXES;

/// Sets `axes` [16, H, W] to three orthogonal vectors t_1, t_2 and n per particle at the positions `x + shift`, both
/// [3, H, W], a factor along the axes of the world, and the edges to (i+1, j) and to (i, j+1).
///
/// t_1 and t_2 span the tangent plane and are closest to the directions in which i and j grow; n is their normal. A
/// particle whose neighbours span no plane, or that the cloth doesn't have, gets the axes of the world.
///
/// A vector's length says how far a force takes the particle along it, compared with a flat sheet of its material. It is
/// `|t_1| = |t_2| = near`, the factor along the axes of the world, which is below 1 next to a handle. A curved sheet is an arch: with
/// the coefficients k of its stretch and the changes c_1 and c_2 from one edge to the next along either axis,
/// `|n| = near (1 + ARCHING (k_1 c_1^2 + k_2 c_2^2))^(-1/2)`.
///
/// An edge's vector is its direction times the root of its stiffness, so that a displacement d adds `(edge . d)^2 / 2` to the energy.
/// It is 0 if the cloth doesn't have the edge.
pub fn sheet_axes<T: Real>(
    (grid, marks): (Grid, &[Mark]),
    (material, damping): (Material, f64),
    x: &[T],
    shift: &[T],
    axes: &mut [T],
) {
    let (Grid { h, w }, n) = (grid, grid.particles());
    let between =
        |p: usize, q: usize| add(sub(at(x, n, q), at(x, n, p)), sub(at(shift, n, q), at(shift, n, p)));
    let elastic = Elastic::new(grid, material, damping);
    let stiffnesses = [elastic.vertical, elastic.horizontal].map(|edge| 2.0 * (1.0 + damping) * edge.factor);
    let arching = material.stretches().map(|k| T::of(ARCHING * k));
    for i in 0..h {
        for j in 0..w {
            let p = i * w + j;
            // The particle itself for a neighbour that the cloth doesn't have.
            let has = |q: usize| if marks[q].is_outside() { p } else { q };
            let below = has((i + 1).min(h - 1) * w + j);
            let right = has(i * w + (j + 1).min(w - 1));
            let u = [between(has(i.saturating_sub(1) * w + j), p), between(p, below)];
            let v = [between(has(i * w + j.saturating_sub(1)), p), between(p, right)];
            let [one, two] = tangents(add(u[0], u[1]), add(v[0], v[1]))
                .unwrap_or([[T::one(), T::zero(), T::zero()], [T::zero(), T::one(), T::zero()]]);
            let near = T::of(1.0 - HANDLE_SHARE * nearness(grid, marks, (i, j)));
            let arch = arching[0] * bend(u) + arching[1] * bend(v);
            let across = near / (T::one() + arch).sqrt();
            let stiff = |q: usize, stiffness: f64| {
                let factor = 0.5 * (marks[p].stiffness() + marks[q].stiffness());
                if marks[p].is_outside() { T::zero() } else { T::of((factor * stiffness).sqrt()) }
            };
            let edges = [(u[1], below, stiffnesses[0]), (v[1], right, stiffnesses[1])];
            let edges = edges.map(|(edge, q, stiffness)| {
                scaled(unit(edge).unwrap_or([T::zero(); 3]), stiff(q, stiffness))
            });
            let all = [scaled(one, near), scaled(two, near), scaled(cross(one, two), across)];
            for (c, &value) in
                all.as_flattened().iter().chain(&[near]).chain(edges.as_flattened()).enumerate()
            {
                axes[c * n + p] = value;
            }
        }
    }
}

/// Returns the square of the change from one edge to the next, 0 if one is missing (of length 0), or if it is not finite.
fn bend<T: Real>(edges: [[T; 3]; 2]) -> T {
    let change = sub(edges[1], edges[0]);
    let square = dot(change, change);
    let both = edges.iter().all(|&edge| length(edge) > T::zero());
    if both && square.is_finite() { square } else { T::zero() }
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
