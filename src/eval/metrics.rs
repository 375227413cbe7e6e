//! Distances between simulated and true cloths (paper section 4.1).

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// A cloth as triangles: vertices \[m\] and the numbers of each triangle's corners.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Vertices \[m\].
    pub points: &'a [[f64; 3]],
    /// Triangles.
    pub faces: &'a [[u32; 3]],
}

impl Surface<'_> {
    /// `count` points, uniform by area, those of one triangle after those of another; the same for the same seed.
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
            // The square root makes the density the same from the corner to the opposite side.
            let (across, along) = (random.random::<f64>().sqrt(), random.random::<f64>());
            let at = |k: usize| a[k] + across * ((1.0 - along) * (b[k] - a[k]) + along * (c[k] - a[k]));
            (face, std::array::from_fn(at))
        };
        let mut points: Vec<(usize, [f64; 3])> = (0..count).map(|_| point()).collect();
        // What is looked up near the last point is in the cache still.
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

/// The mean squared distance from each point of `from` to the nearest point of `to` [m^2].
fn mean_nearest(from: &[[f64; 3]], to: &[[f64; 3]]) -> f64 {
    let tree: ImmutableKdTree<f64, 3> = ImmutableKdTree::new_from_slice(to);
    from.iter().map(|p| tree.nearest_one::<SquaredEuclidean>(p).distance).sum::<f64>() / from.len() as f64
}

/// The Chamfer distance of two clouds: mean squared distances to the nearest point of the other, both directions added
/// [m^2].
pub fn chamfer(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    mean_nearest(a, b) + mean_nearest(b, a)
}

/// The error of vertices relative to the truth: `|found - truth| / |truth|`, norms over all coordinates of a frame.
pub fn relative_error(found: &[[f64; 3]], truth: &[[f64; 3]]) -> f64 {
    assert_eq!(found.len(), truth.len(), "as many vertices");
    let squares = |points: &mut dyn Iterator<Item = f64>| points.map(|v| v * v).sum::<f64>();
    let pairs = found.as_flattened().iter().zip(truth.as_flattened());
    let apart = squares(&mut pairs.map(|(f, t)| f - t));
    (apart / squares(&mut truth.as_flattened().iter().copied())).sqrt()
}
