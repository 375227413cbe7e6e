//! Resampling of frames from one grid to another, for comparison.

use crate::cloth::{Grid, MIN_GRID};

/// Rows of the grids on which `interpolation` computes accelerations and repulsion is measured: those of the
/// paper's training.
const COARSE_ROWS: usize = 32;

/// Returns the grid on which `interpolation` computes the accelerations for another: of the same shape with 32
/// rows, or `grid` itself if it has no more rows.
pub fn coarse(grid: Grid) -> Grid {
    if grid.h <= COARSE_ROWS { grid } else { of_coarse_rows(grid) }
}

/// Returns the grid of the same shape with 32 rows, on which repulsion is measured.
pub(super) fn of_coarse_rows(grid: Grid) -> Grid {
    let edges = (grid.w - 1) as f64 * (COARSE_ROWS - 1) as f64 / (grid.h - 1) as f64;
    Grid { h: COARSE_ROWS, w: (edges.round() as usize + 1).max(MIN_GRID) }
}

/// Bilinear interpolation from one grid to the particles of another, corners aligned.
pub(super) struct Resampling {
    from: Grid,
    /// For each target particle, the first particle of the cell around it and its position in the cell.
    places: Vec<(usize, [f64; 2])>,
}

impl Resampling {
    /// Builds the interpolation from the particles of `from` to those of `to`.
    pub fn new(from: Grid, to: Grid) -> Self {
        let place = |k: usize, n: usize, m: usize| {
            let at = (k * (n - 1)) as f64 / (m - 1) as f64;
            let cell = (at as usize).min(n - 2);
            (cell, at - cell as f64)
        };
        let particle = |p: usize| {
            let (i, down) = place(p / to.w, from.h, to.h);
            let (j, across) = place(p % to.w, from.w, to.w);
            (i * from.w + j, [down, across])
        };
        Self { from, places: (0..to.particles()).map(particle).collect() }
    }

    /// Returns the positions of the particles of `to`, given those of `from`.
    pub fn apply(&self, points: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let w = self.from.w;
        let mix = |a: [f64; 3], b: [f64; 3], t: f64| std::array::from_fn(|c| a[c] + t * (b[c] - a[c]));
        let at = |&(p, [down, across]): &(usize, [f64; 2])| {
            let upper = mix(points[p], points[p + 1], across);
            let lower = mix(points[p + w], points[p + w + 1], across);
            mix(upper, lower, down)
        };
        self.places.iter().map(at).collect()
    }
}
