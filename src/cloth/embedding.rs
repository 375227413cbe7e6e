//! Meshes that a cloth carries along.

use super::{Grid, Mask};
use crate::{Error, Result};
use num_traits::Float;

/// How far a place may lie off a row or column of the grid and still count as on it, in texture coordinates: more than
/// the six decimals that most programs write leave.
const ON_LINE: f64 = 1e-6;
/// How far beyond the cloth a vertex may lie \[edges\].
const REACH: f64 = 1.0;

/// Vertices that a cloth carries along: each lies in a cell of the grid and moves with its four corners.
///
/// Their places on the sheet are texture coordinates ([`Grid::texture_coordinates`]), and the interpolation is bilinear:
/// exact where the sheet is moved, turned, stretched or sheared evenly, continuous everywhere, and on a curved cloth a
/// facet for each cell. Finer detail comes from a finer grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Embedding {
    grid: Grid,
    /// Shape \[V\].
    cells: Vec<u32>,
    /// Shape [V, 2].
    weights: Vec<[f64; 2]>,
}

impl Embedding {
    /// Places a vertex at each pair (u, v), shape [V, 2], on the cloth that a mask leaves of the grid, or on the whole grid. One
    /// beyond the cloth, by one edge at most, takes the nearest place of it. Fails if one is farther away or not between 0
    /// and 1; `origin` names their source.
    pub fn new(grid: Grid, mask: Option<&Mask>, uv: &[[f32; 2]], origin: &str) -> Result<Self> {
        let places = uv.iter().enumerate().map(|(vertex, &[u, v])| {
            let invalid = |expected: &str| {
                Error::invalid(origin, format!("vertex {vertex}"), expected, format!("uv [{u}, {v}]"))
            };
            if ![u, v].iter().all(|c| (0.0..=1.0).contains(c)) {
                return Err(invalid("texture coordinates from 0 to 1"));
            }
            let at = [on_axis(u, grid.h), on_axis(v, grid.w)];
            place(grid, mask, at).ok_or_else(|| {
                invalid("texture coordinates on the cloth that the mask leaves, or an edge away")
            })
        });
        let (cells, weights) = places.collect::<Result<Vec<_>>>()?.into_iter().unzip();
        Ok(Self { grid, cells, weights })
    }

    /// Returns the grid that carries the vertices.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Returns the number of vertices (V).
    pub fn vertices(&self) -> usize {
        self.cells.len()
    }

    /// Returns the number `i W + j` of the first corner of each vertex's cell, whose others are (i, j + 1), (i + 1, j) and
    /// (i + 1, j + 1); shape \[V\].
    pub fn cells(&self) -> &[u32] {
        &self.cells
    }

    /// Returns where in its cell each vertex lies, from its first corner along i and along j, 0 to 1 each; shape [V, 2].
    pub fn weights(&self) -> &[[f64; 2]] {
        &self.weights
    }

    /// Returns the corners of the cell of a vertex and their weights, which add up to 1. Panics if there is no such vertex.
    pub fn corners(&self, vertex: usize) -> [(usize, f64); 4] {
        let (a, w, [s, t]) = (self.cells[vertex] as usize, self.grid.w, self.weights[vertex]);
        let (before, left) = (1.0 - s, 1.0 - t);
        [(a, before * left), (a + 1, before * t), (a + w, s * left), (a + w + 1, s * t)]
    }

    /// Returns the positions of the vertices, shape [V, 3], from those of the particles, shape [H W, 3]; likewise for
    /// velocities. Panics if there are not as many as the grid has.
    pub fn positions<T: Float>(&self, points: &[[T; 3]]) -> Vec<[T; 3]> {
        assert_eq!(points.len(), self.grid.particles(), "the particles of {}", self.grid);
        let wide = |p: usize| points[p].map(|x| x.to_f64().unwrap_or(f64::NAN));
        let position = |vertex: usize| {
            let [a, b, c, d] = self.corners(vertex).map(|(p, weight)| wide(p).map(|x| weight * x));
            std::array::from_fn(|k| super::cast((a[k] + b[k]) + (c[k] + d[k])))
        };
        (0..self.vertices()).map(position).collect()
    }
}

/// Returns where on an axis of `n` particles a texture coordinate lies \[edges\].
fn on_axis(u: f32, n: usize) -> f64 {
    let (edges, slack) = ((1.0 - f64::from(u)) * (n - 1) as f64, ON_LINE * (n - 1) as f64);
    if (edges - edges.round()).abs() <= slack { edges.round() } else { edges }
}

/// Returns the first corner of the cell of a place (i, j), in edges, and where in it that is; `None` if it is farther than
/// [`REACH`] from the cloth.
fn place(grid: Grid, mask: Option<&Mask>, at: [f64; 2]) -> Option<(u32, [f64; 2])> {
    let Grid { h, w } = grid;
    let own = [at[0].min((h - 2) as f64) as usize, at[1].min((w - 2) as f64) as usize];
    let is_whole = |[i, j]: [usize; 2]| {
        let a = i * w + j;
        mask.is_none_or(|mask| [a, a + 1, a + w, a + w + 1].iter().all(|&p| mask.contains(p)))
    };
    let within =
        |[i, j]: [usize; 2]| [(at[0] - i as f64).clamp(0.0, 1.0), (at[1] - j as f64).clamp(0.0, 1.0)];
    let found = |cell: [usize; 2]| ((cell[0] * w + cell[1]) as u32, within(cell));
    if is_whole(own) {
        return Some(found(own));
    }
    // Two cells on, one may be an edge away.
    let reach = |own: usize, n: usize| own.saturating_sub(2)..=(own + 2).min(n - 2);
    let near = reach(own[0], h).flat_map(|i| reach(own[1], w).map(move |j| [i, j]));
    let distance = |cell: [usize; 2]| {
        let [s, t] = within(cell);
        (at[0] - cell[0] as f64 - s).hypot(at[1] - cell[1] as f64 - t)
    };
    let near = near.filter(|&cell| is_whole(cell)).map(|cell| (distance(cell), cell));
    let (away, cell) = near.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (away <= REACH).then(|| found(cell))
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid { h: 9, w: 14 };

    /// Numbers between 0 and 1 without a pattern.
    fn numbers(count: usize) -> impl Iterator<Item = f32> {
        (1..=count).map(|k| (k as f64 * 0.754_877_666).fract() as f32)
    }

    fn scattered(count: usize) -> Vec<[f32; 2]> {
        let all: Vec<f32> = numbers(2 * count).collect();
        (0..count).map(|k| [all[k], (all[count + k] + 7.31 * all[k]).fract()]).collect()
    }

    #[test]
    fn the_grid_itself_is_reproduced_to_the_bits() {
        for grid in [GRID, Grid { h: 128, w: 97 }, Grid { h: 8, w: 1000 }] {
            let points: Vec<[f32; 3]> =
                (0..grid.particles()).map(|p| [p as f32 * 0.37, (p as f32).sin(), -0.1]).collect();
            let exact = grid.texture_coordinates();
            // As programs write them.
            let printed: Vec<[f32; 2]> =
                exact.iter().map(|uv| uv.map(|c| format!("{c:.6}").parse().unwrap())).collect();
            for uv in [exact, printed] {
                let embedding = Embedding::new(grid, None, &uv, "a test").unwrap();
                assert_eq!(embedding.positions(&points), points, "{grid}");
            }
        }
    }

    #[test]
    fn affine_maps_are_exact() {
        let uv = scattered(500);
        let embedding = Embedding::new(GRID, None, &uv, "a test").unwrap();
        let flat = |i: f64, j: f64| [j, i, 0.0];
        let sheared = |i: f64, j: f64| [1.2 * j + 0.7 * i - 3.0, 0.8 * i - 0.1 * j, 0.5 * i + 0.3 * j];
        for map in [&flat as &dyn Fn(f64, f64) -> [f64; 3], &sheared] {
            let particle = |p: usize| map((p / GRID.w) as f64, (p % GRID.w) as f64);
            let points: Vec<_> = (0..GRID.particles()).map(particle).collect();
            for (found, uv) in embedding.positions(&points).iter().zip(&uv) {
                let [u, v] = uv.map(f64::from);
                let expected = map((1.0 - u) * 8.0, (1.0 - v) * 13.0);
                (0..3).for_each(|c| assert!((found[c] - expected[c]).abs() < 1e-6, "{found:?} {expected:?}"));
            }
        }
        for vertex in 0..uv.len() {
            let weights = embedding.corners(vertex).map(|(_, weight)| weight);
            assert!(weights.iter().all(|w| *w >= 0.0) && (weights.iter().sum::<f64>() - 1.0).abs() < 1e-15);
        }
    }

    #[test]
    fn vertices_beyond_a_mask_take_the_nearest_cell() {
        // Rows 0 to 4 are there.
        let wanted: Vec<bool> = (0..GRID.particles()).map(|p| p / GRID.w < 5).collect();
        let mask = Mask::new(GRID, &wanted, "a test").unwrap();
        let embed = |i: f64| {
            let uv = [[(1.0 - i / 8.0) as f32, 0.45]];
            Embedding::new(GRID, Some(&mask), &uv, "mesh.obj")
        };
        for (i, row, s) in [(3.5, 3, 0.5), (4.0, 3, 1.0), (4.9, 3, 1.0), (5.0, 3, 1.0)] {
            let found = embed(i).unwrap();
            assert_eq!((found.cells()[0] as usize / GRID.w, found.weights()[0][0]), (row, s), "{i}");
        }
        let error = embed(5.25).unwrap_err().to_string();
        assert!(
            error.contains("mesh.obj: vertex 0") && error.contains("found uv [0.34375, 0.45]"),
            "{error}"
        );
    }

    #[test]
    fn places_off_the_sheet_are_refused() {
        for wrong in [[1.5, 0.5], [0.5, -0.1], [f32::NAN, 0.5]] {
            let error = Embedding::new(GRID, None, &[[0.5; 2], wrong], "a test").unwrap_err().to_string();
            assert!(
                error.contains("vertex 1: expected texture coordinates from 0 to 1, found uv ["),
                "{error}"
            );
        }
    }
}
