//! How near the layers of a cloth come to each other: the paper's repulsion energy as a measure (sections 3.4
//! and 6.3.3).

use super::resampling::{Resampling, of_coarse_rows};
use crate::cloth::{Grid, Repulsion};
use kiddo::{ImmutableKdTree, SquaredEuclidean};

/// Distance below which particles repel each other [edges of the 32x32 grid].
const DELTA: f64 = 0.5;
/// Edges along the height of the 32x32 grid, whose edge is the unit of length whatever the actual grid.
const EDGES: f64 = 31.0;

/// Returns the repulsion energy (paper section 3.4): the sum of `-log(d^2 + 1e-8)` over ordered pairs of
/// particles at a distance d below `delta` that no edge of the triangulated grid joins. Lengths are in edges.
pub fn repulsion(points: &[[f64; 3]], faces: &[[u32; 3]], delta: f64) -> f64 {
    let mut joined = vec![Vec::new(); points.len()];
    for &[a, b, c] in faces {
        for (p, q) in [(a, b), (b, c), (c, a)] {
            joined[p as usize].push(q);
            joined[q as usize].push(p);
        }
    }
    let tree: ImmutableKdTree<f64, 3> = ImmutableKdTree::new_from_slice(points);
    let of = |(p, point): (usize, &[f64; 3])| {
        let near = tree.within_unsorted::<SquaredEuclidean>(point, delta * delta);
        let apart = |q: u64| q as usize != p && !joined[p].contains(&(q as u32));
        let pairs = near.into_iter().filter(|n| n.distance < delta * delta && apart(n.item));
        pairs.fold(0.0, |sum, n| sum - (n.distance + Repulsion::SOFTENING).ln())
    };
    // Not `sum`, which is -0 if there are no terms.
    points.iter().enumerate().map(of).fold(0.0, |sum, e| sum + e)
}

/// The repulsion measure on a grid. As in the authors' evaluation, frames are resampled to a grid of 32 rows,
/// whose edges are the unit of length: on a finer grid, particles are closer than the repulsion distance in
/// any fold, and on a coarser one there are few of them.
pub(super) struct LayerProximity {
    resampling: Resampling,
    faces: Vec<[u32; 3]>,
    unit_m: f64,
}

impl LayerProximity {
    /// Prepares the measure for a sheet on a grid with this side along the height \[m\].
    pub fn new(grid: Grid, side_m: f64) -> Self {
        let coarse = of_coarse_rows(grid);
        Self { resampling: Resampling::new(grid, coarse), faces: coarse.faces(), unit_m: side_m / EDGES }
    }

    /// Returns the energy of a frame with these positions \[m\].
    pub fn of(&self, points: &[[f64; 3]]) -> f64 {
        let scaled: Vec<[f64; 3]> =
            self.resampling.apply(points).into_iter().map(|p| p.map(|c| c / self.unit_m)).collect();
        repulsion(&scaled, &self.faces, DELTA)
    }
}

/// Returns the mean over frames, and the shares of frames above 0.1 and above 0.02.
pub(super) fn mean_and_fractions_above(of_frames: &[f64]) -> [f64; 3] {
    let mean =
        |of: &dyn Fn(f64) -> f64| of_frames.iter().map(|&r| of(r)).sum::<f64>() / of_frames.len() as f64;
    let above = |limit: f64| mean(&|r| if r > limit { 1.0 } else { 0.0 });
    [mean(&|r| r), above(0.1), above(0.02)]
}

#[cfg(test)]
mod tests {
    use super::mean_and_fractions_above;

    #[test]
    fn shares_are_of_frames_above_a_tenth_and_a_fiftieth() {
        let [mean, above, slightly] = mean_and_fractions_above(&[0.0, 0.05, 0.2]);
        assert!((mean - 0.25 / 3.0).abs() < 1e-12);
        assert_eq!((above, slightly), (1.0 / 3.0, 2.0 / 3.0));
    }
}
