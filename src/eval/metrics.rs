//! Distances between simulated and true cloths (paper sections 4.1 and 6.1).

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// A cloth as a triangle mesh.
#[derive(Clone, Copy, Debug)]
pub struct TriangleMesh<'a> {
    /// Vertices \[m\].
    pub points: &'a [[f64; 3]],
    /// Vertex numbers of the corners of each triangle.
    pub faces: &'a [[u32; 3]],
}

impl TriangleMesh<'_> {
    /// Samples `count` points uniformly by area, grouped by triangle. The same seed gives the same points.
    /// Panics if there are no faces, or if one has a vertex that does not exist.
    pub fn sample(&self, count: usize, seed: u64) -> Vec<[f64; 3]> {
        let mut until = Vec::with_capacity(self.faces.len());
        let mut sum = 0.0;
        for face in self.faces {
            sum += self.area(face);
            until.push(sum);
        }
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut point = || {
            let at = sum * random.random::<f64>();
            let face = until.partition_point(|&until| until <= at).min(self.faces.len() - 1);
            let [a, b, c] = self.corners(&self.faces[face]);
            // The square root makes the density uniform from the corner to the opposite side.
            let (across, along) = (random.random::<f64>().sqrt(), random.random::<f64>());
            let at = |k: usize| a[k] + across * ((1.0 - along) * (b[k] - a[k]) + along * (c[k] - a[k]));
            (face, std::array::from_fn(at))
        };
        let mut points: Vec<(usize, [f64; 3])> = (0..count).map(|_| point()).collect();
        // Sorted by triangle, consecutive points are close together, so their lookups hit the cache.
        points.sort_by_key(|&(face, _)| face);
        points.into_iter().map(|(_, point)| point).collect()
    }

    fn corners(&self, face: &[u32; 3]) -> [[f64; 3]; 3] {
        face.map(|k| self.points[k as usize])
    }

    fn area(&self, face: &[u32; 3]) -> f64 {
        let [a, b, c] = self.corners(face);
        let side = |p: [f64; 3]| [p[0] - a[0], p[1] - a[1], p[2] - a[2]];
        let (u, v) = (side(b), side(c));
        let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        0.5 * cross.iter().map(|c| c * c).sum::<f64>().sqrt()
    }
}

/// Returns the mean squared distance from the points of `from` to the nearest point of `to` [m^2].
fn mean_nearest(from: &[[f64; 3]], to: &[[f64; 3]]) -> f64 {
    let tree: ImmutableKdTree<f64, 3> = ImmutableKdTree::new_from_slice(to);
    from.iter().map(|p| tree.nearest_one::<SquaredEuclidean>(p).distance).sum::<f64>() / from.len() as f64
}

/// Returns the Chamfer distance of two point clouds: the mean squared distance to the nearest point of the
/// other cloud, summed over both directions [m^2].
pub fn chamfer(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    mean_nearest(a, b) + mean_nearest(b, a)
}

/// Returns the error of vertices relative to the truth: `|found - truth| / |truth|`, with norms over all
/// coordinates of a frame. Panics if the numbers of vertices differ.
pub fn relative_error(found: &[[f64; 3]], truth: &[[f64; 3]]) -> f64 {
    assert_eq!(found.len(), truth.len(), "as many vertices");
    let squares = |points: &mut dyn Iterator<Item = f64>| points.map(|v| v * v).sum::<f64>();
    let pairs = found.as_flattened().iter().zip(truth.as_flattened());
    let apart = squares(&mut pairs.map(|(f, t)| f - t));
    (apart / squares(&mut truth.as_flattened().iter().copied())).sqrt()
}
