//! Vertices for rendering: positions and smooth normals.

use crate::cpu::Real;
use crate::sim::{Grid, VertexView};

/// Returns the position and the unit normal of each particle of one cloth, shape [H W, 6], from positions `x`
/// \[edges\] and velocities `v` [edges / frame], shape [3, H, W]. A normal has the direction of the
/// area-weighted mean over the adjacent triangles ([`Grid::faces`]); it is zero if that mean is zero.
pub fn vertices<T: Real>(grid: Grid, view: &VertexView, x: &[T], v: &[T]) -> Vec<[T; 6]> {
    let n = grid.particles();
    let transform = view.transform.map(|row| row.map(|c| T::of(c.into())));
    let back = T::of(1.0 - f64::from(view.time));
    let position = |p: usize| {
        let moved = [0, 1, 2].map(|c| x[c * n + p] - back * v[c * n + p]);
        transform.map(|[a, b, c, d]| a * moved[0] + b * moved[1] + c * moved[2] + d)
    };
    let positions: Vec<[T; 3]> = (0..n).map(position).collect();
    let mut normals = vec![[T::zero(); 3]; n];
    for face in grid.iter_faces() {
        let [p, q, r] = face.map(|p| positions[p as usize]);
        let (u, w) = ([0, 1, 2].map(|c| q[c] - p[c]), [0, 1, 2].map(|c| r[c] - p[c]));
        let area = [0, 1, 2].map(|c| {
            let (d, e) = ((c + 1) % 3, (c + 2) % 3);
            u[d] * w[e] - u[e] * w[d]
        });
        for p in face {
            (0..3).for_each(|c| normals[p as usize][c] = normals[p as usize][c] + area[c]);
        }
    }
    let unit = |normal: [T; 3]| {
        let size = normal.iter().fold(T::zero(), |most, c| most.max(c.abs()));
        let scaled = normal.map(|c| if size > T::zero() { c / size } else { T::zero() });
        let length = scaled.iter().map(|&c| c * c).sum::<T>().sqrt();
        scaled.map(|c| if length > T::zero() { c / length } else { c })
    };
    let both = positions.into_iter().zip(normals);
    both.map(|([x, y, z], normal)| (unit(normal), [x, y, z]))
        .map(|([a, b, c], [x, y, z])| [x, y, z, a, b, c])
        .collect()
}
