//! Vertices for rendering: positions and smooth normals.

use super::vector::{add, at, cross, length, scaled, sub};
use crate::cloth::VertexView;
use crate::cpu::Real;

/// Returns the position and the unit normal of each particle of one cloth, shape [H W, 6], from positions `x`
/// \[edges\] and velocities `v` [edges / frame], shape [3, H, W]. A normal has the direction of the
/// area-weighted mean over the adjacent ones of the cloth's triangles, `faces`; it is zero if that mean is zero.
pub fn vertices<T: Real>(faces: &[[u32; 3]], view: &VertexView, x: &[T], v: &[T]) -> Vec<[T; 6]> {
    let n = x.len() / 3;
    let transform = view.transform.map(|row| row.map(|c| T::of(c.into())));
    let back = T::of(1.0 - f64::from(view.time));
    let position = |p: usize| {
        let [x, y, z] = sub(at(x, n, p), scaled(at(v, n, p), back));
        transform.map(|[a, b, c, d]| a * x + b * y + c * z + d)
    };
    let positions: Vec<[T; 3]> = (0..n).map(position).collect();
    let mut normals = vec![[T::zero(); 3]; n];
    for face in faces {
        let face = face.map(|p| p as usize);
        let [p, q, r] = face.map(|p| positions[p]);
        let area = cross(sub(q, p), sub(r, p));
        face.iter().for_each(|&p| normals[p] = add(normals[p], area));
    }
    let vertex = |([x, y, z], normal): ([T; 3], [T; 3])| {
        let [a, b, c] = unit(normal);
        [x, y, z, a, b, c]
    };
    positions.into_iter().zip(normals).map(vertex).collect()
}

/// Returns the unit vector along another; zero if that is zero.
pub(super) fn unit<T: Real>(v: [T; 3]) -> [T; 3] {
    // Scaled first, so that no square underflows.
    let size = v.iter().fold(T::zero(), |most, c| most.max(c.abs()));
    if size > T::zero() {
        let v = scaled(v, size.recip());
        scaled(v, length(v).recip())
    } else {
        [T::zero(); 3]
    }
}
