//! Vertices of a mesh that a cloth carries along.

use super::vertices::unit;
use crate::cloth::Embedding;
use crate::cpu::Real;

/// Returns the position and the unit normal of each vertex of a mesh, shape [V, 6], from those of the particles of the one
/// cloth that carries it, shape [H W, 6] ([`vertices`](super::vertices())). Both are interpolated in the vertex's cell; a normal
/// is zero if those around it vanish or cancel.
pub fn embed<T: Real>(embedding: &Embedding, interleaved: &[[T; 6]]) -> Vec<[T; 6]> {
    let vertex = |k: usize| {
        let mut sum = [T::zero(); 6];
        for (p, weight) in embedding.corners(k) {
            let weight = T::of(weight);
            sum.iter_mut().zip(interleaved[p]).for_each(|(sum, part)| *sum = *sum + weight * part);
        }
        let [x, y, z, a, b, c] = sum;
        let [a, b, c] = unit([a, b, c]);
        [x, y, z, a, b, c]
    };
    (0..embedding.vertices()).map(vertex).collect()
}
