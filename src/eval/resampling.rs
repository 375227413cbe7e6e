//! Frames carried from one grid to another, for comparison.

use crate::sim::{Grid, MIN_GRID};

/// Rows of the grids on which `interpolation` works out accelerations and repulsion is judged: those of the paper's training.
const COARSE_ROWS: usize = 32;

/// The grid on which `interpolation` works out the accelerations of another, and repulsion is judged: of the same shape with
/// 32 rows; a coarser one is its own.
pub fn coarse(grid: Grid) -> Grid {
    if grid.h <= COARSE_ROWS {
        return grid;
    }
    let edges = (grid.w - 1) as f64 * (COARSE_ROWS - 1) as f64 / (grid.h - 1) as f64;
    Grid { h: COARSE_ROWS, w: (edges.round() as usize + 1).max(MIN_GRID) }
}

/// Carries positions from one grid to the places of another's particles, bilinearly, corners on corners.
pub(super) struct Resampling {
    from: Grid,
    /// First particle of the cell of each place, and where in the cell it is.
    places: Vec<(usize, [f64; 2])>,
}

impl Resampling {
    /// From the particles of `from` to the places of those of `to`.
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

    /// Positions at the places, from those of the particles.
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
