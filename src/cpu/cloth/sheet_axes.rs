//! The sheet's own axes at each particle.

use super::vector::{add, at, cross, dot, length, scaled, sub};
use crate::cloth::{Grid, Mark};
use crate::cpu::Real;

/// Vectors shorter than this have no direction.
const SHORTEST: f64 = 1e-12;

/// Sets `axes` [6, H, W] to two orthonormal vectors t_1 and t_2 per particle that span the tangent plane at
/// the positions `x + shift`, both [3, H, W]: those closest to the directions in which i and j grow. A
/// particle whose neighbours span no plane, or that the cloth doesn't have, gets the x and the y axis.
pub fn sheet_axes<T: Real>((grid, marks): (Grid, &[Mark]), x: &[T], shift: &[T], axes: &mut [T]) {
    let (Grid { h, w }, n) = (grid, grid.particles());
    let between =
        |p: usize, q: usize| add(sub(at(x, n, q), at(x, n, p)), sub(at(shift, n, q), at(shift, n, p)));
    for i in 0..h {
        for j in 0..w {
            let p = i * w + j;
            // The particle itself for a neighbour that the cloth doesn't have.
            let has = |q: usize| if marks[q].is_outside() { p } else { q };
            let u = between(has(i.saturating_sub(1) * w + j), has((i + 1).min(h - 1) * w + j));
            let v = between(has(i * w + j.saturating_sub(1)), has(i * w + (j + 1).min(w - 1)));
            let [one, two] = tangents(u, v)
                .unwrap_or([[T::one(), T::zero(), T::zero()], [T::zero(), T::one(), T::zero()]]);
            for c in 0..3 {
                axes[c * n + p] = one[c];
                axes[(3 + c) * n + p] = two[c];
            }
        }
    }
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
