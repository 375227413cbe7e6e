//! Stretch of edges that no handle pulls directly.

use crate::cloth::Model;

/// The edges of one cloth that are more than H/10 edges away from each of its handles. Next to a handle that
/// carries half of the sheet, an edge on a fine grid rightly doubles its length; away from handles, none
/// should.
pub struct FreeEdges {
    /// The two particles of each edge.
    edges: Vec<[usize; 2]>,
}

impl FreeEdges {
    /// Finds the free edges of cloth `index` of the model. The distance from a handle is counted in edges of
    /// the grid, from the nearer end.
    pub fn new(model: &Model, index: usize) -> Self {
        let grid = model.grid;
        let (h, w) = (grid.h, grid.w);
        let cloth = &model.cloths[index];
        let distances = distances(h, w, &cloth.handles);
        let down = (0..(h - 1) * w).map(|p| [p, p + w]);
        let across = (0..h * w).filter(|p| p % w + 1 < w).map(|p| [p, p + 1]);
        let free =
            |edge: &[usize; 2]| edge.iter().all(|&p| distances[p] as usize > h / 10 && cloth.contains(p));
        Self { edges: down.chain(across).filter(free).collect() }
    }

    /// Returns the largest `|edge| - 1` for positions `x` [3, H, W] in edges; NaN if the length of an edge is
    /// NaN, and 0 if no edge is free.
    pub fn largest<T: Copy + Into<f64>>(&self, x: &[T]) -> f64 {
        let n = x.len() / 3;
        let length = |&[p, q]: &[usize; 2]| {
            let square = |c: usize| (x[c * n + q].into() - x[c * n + p].into()).powi(2);
            (square(0) + square(1) + square(2)).sqrt()
        };
        // `f64::max` would ignore NaN.
        let largest = self.edges.iter().map(length).reduce(|a, b| if a > b || a.is_nan() { a } else { b });
        largest.map_or(0.0, |length| length - 1.0)
    }
}

/// Returns the number of edges from each particle to the nearest handle; `u32::MAX` without handles.
fn distances(h: usize, w: usize, handles: &[usize]) -> Vec<u32> {
    let mut distances = vec![u32::MAX; h * w];
    handles.iter().for_each(|&p| distances[p] = 0);
    // Along a shortest way, first from above and from the left, then from below and from the right.
    let closer = |distances: &mut [u32], p: usize, q: usize| {
        distances[p] = distances[p].min(distances[q].saturating_add(1));
    };
    for p in 0..h * w {
        if p >= w {
            closer(&mut distances, p, p - w);
        }
        if p % w > 0 {
            closer(&mut distances, p, p - 1);
        }
    }
    for p in (0..h * w).rev() {
        if p + w < h * w {
            closer(&mut distances, p, p + w);
        }
        if p % w + 1 < w {
            closer(&mut distances, p, p + 1);
        }
    }
    distances
}

#[cfg(test)]
mod tests {
    use super::{FreeEdges, distances};
    use crate::scene::{Scene, Start};

    #[test]
    fn distances_are_those_to_the_nearest_handle() {
        let (h, w, handles) = (7, 9, [3, 40, 58]);
        for (p, &found) in distances(h, w, &handles).iter().enumerate() {
            let from = |&q: &usize| (p / w).abs_diff(q / w) + (p % w).abs_diff(q % w);
            assert_eq!(Some(found as usize), handles.iter().map(from).min(), "{p}");
        }
        assert!(distances(h, w, &[]).iter().all(|&d| d == u32::MAX));
    }

    #[test]
    fn edges_next_to_a_handle_do_not_count() {
        let setup = Scene { start: Start::Flat, ..Scene::default() }.setup().unwrap();
        let edges = FreeEdges::new(&setup.model, 0);
        let n = setup.model.grid.particles();
        let mut x = setup.start.x.clone();
        assert!(edges.largest(&x).abs() < 1e-12);
        // Handle (0, 0): particles (0, 1) to (0, 3) are at most H/10 = 3 edges away, (0, 5) is not.
        x[3] += 0.5;
        assert!(edges.largest(&x).abs() < 1e-12);
        x[5] -= 0.5;
        assert!((edges.largest(&x) - 0.5).abs() < 1e-12);
        // A particle of the last row has one edge along the height.
        let mut sheared = setup.start.x.clone();
        let last_row = |c: usize| c * n + 31 * 32 + 20;
        let up = [0, 1, 2].map(|c| sheared[last_row(c)] - sheared[last_row(c) - 32]);
        (0..3).for_each(|c| sheared[last_row(c)] += 0.5 * up[c]);
        assert!((edges.largest(&sheared) - 0.5).abs() < 1e-12);
        x[n + 20] = f64::NAN;
        assert!(edges.largest(&x).is_nan());
    }
}
