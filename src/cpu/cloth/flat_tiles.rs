//! Tiles of a sheet that are so flat that nothing in them is near anything else in them.

use crate::cloth::Grid;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Rows and columns of a tile.
const TILE: usize = 8;
/// Rows and columns around a tile that are looked at with it.
const HALO: usize = 3;
/// Least distance in the grid \[edges\] of two of its parts that share no particle: from a corner to the diagonal across.
const LEAST: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Which tiles of a moving sheet, each with what is around it, keep all their parts apart.
///
/// With u and v along the mean edges of a tile, the sheet maps the rectangle of the grid into their plane, in each
/// triangle by a matrix J. If `d . J d >= l |d|^2` everywhere, then two points d apart in the grid stay `l |d|`
/// apart, since the rectangle is convex. J changes evenly while the particles move evenly: it suffices to look at
/// both ends of the way.
pub(super) struct FlatTiles {
    /// Which patches lie around each tile; `None` of one that is not flat.
    around: Vec<Option<Around>>,
    /// Tiles in a row.
    across: usize,
}

/// A rectangle of patches, which are named by their first particles.
#[derive(Clone, Debug)]
struct Around {
    rows: Range<usize>,
    columns: Range<usize>,
}

impl FlatTiles {
    /// Finds the tiles whose parts, if they share no particle, stay farther apart than `distance`, if the particles move
    /// evenly from `x` by `way`.
    pub fn new(grid: Grid, x: &[DVec3], way: &[DVec3], distance: f64) -> Self {
        let count = grid.h.div_ceil(TILE) * grid.w.div_ceil(TILE);
        let is_flat = |tile: usize| {
            let [rows, columns] = Self::rectangle(grid, tile);
            let at = |i: usize, j: usize| i * grid.w + j;
            let cells = || {
                let columns = columns.clone();
                rows.clone().flat_map(move |i| columns.clone().map(move |j| (i, j)))
            };
            // Along the rows and the columns of each triangle.
            let sides = |i: usize, j: usize| {
                let [p, q, r, s] = [at(i, j), at(i, j + 1), at(i + 1, j), at(i + 1, j + 1)];
                [[(r, s), (p, r)], [(p, q), (q, s)]]
            };
            let [u, v] = cells()
                .flat_map(|(i, j)| sides(i, j))
                .fold([DVec3::ZERO; 2], |[u, v], [(p, q), (r, s)]| [u + x[q] - x[p], v + x[s] - x[r]]);
            let (Some(u), Some(v)) = (u.try_normalize(), v.reject_from(u).try_normalize()) else {
                return false;
            };
            let least =
                cells().flat_map(|(i, j)| sides(i, j)).fold(f64::INFINITY, |least, [across, along]| {
                    let [across, along] =
                        [across, along].map(|(p, q)| (x[q] - x[p], x[q] + way[q] - x[p] - way[p]));
                    let before = least_stretch(u, v, across.0, along.0);
                    least.min(before.min(least_stretch(u, v, across.1, along.1)))
                });
            // Not a number is not flat.
            least * LEAST > distance
        };
        let around = |tile: usize| {
            // The last particles of the grid have no cells of their own.
            let patches = |cells: Range<usize>, len: usize| {
                let end = if cells.end + 1 == len { len } else { cells.end };
                cells.start..end
            };
            let [rows, columns] = Self::rectangle(grid, tile);
            is_flat(tile).then(|| Around { rows: patches(rows, grid.h), columns: patches(columns, grid.w) })
        };
        Self { around: (0..count).into_par_iter().map(around).collect(), across: grid.w.div_ceil(TILE) }
    }

    /// Returns the cells, by their first rows and columns, of a tile and around it.
    fn rectangle(grid: Grid, tile: usize) -> [Range<usize>; 2] {
        let across = grid.w.div_ceil(TILE);
        let range = |index: usize, len: usize| {
            (index * TILE).saturating_sub(HALO)..((index + 1) * TILE + HALO).min(len - 1)
        };
        [range(tile / across, grid.h), range(tile % across, grid.w)]
    }

    /// Returns tiles none of which is flat.
    #[cfg(test)]
    pub fn none(grid: Grid) -> Self {
        let across = grid.w.div_ceil(TILE);
        Self { around: vec![None; grid.h.div_ceil(TILE) * across], across }
    }

    /// Whether nothing in a rectangle of patches, each the parts in the cell behind its particle, is near anything in
    /// another one: the first lies in one tile, the other around that. Of both, `[[row, column]; 2]` are the first
    /// patch and the last one.
    #[inline]
    pub fn keep_apart(&self, one: [[usize; 2]; 2], other: [[usize; 2]; 2]) -> bool {
        let [first, last] = one.map(|[row, column]| [row / TILE, column / TILE]);
        let holds = |around: &Around| {
            let has =
                |[row, column]: [usize; 2]| around.rows.contains(&row) && around.columns.contains(&column);
            other.into_iter().all(has)
        };
        first == last && self.around[first[0] * self.across + first[1]].as_ref().is_some_and(holds)
    }
}

/// Returns the least `d . J d` of a unit vector d in the grid, where J takes a column of it to `across` and a row of
/// it to `along`, seen along u and v.
fn least_stretch(u: DVec3, v: DVec3, across: DVec3, along: DVec3) -> f64 {
    let (a, d) = (across.dot(u), along.dot(v));
    let b = 0.5 * (across.dot(v) + along.dot(u));
    0.5 * (a + d) - (0.25 * (a - d) * (a - d) + b * b).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid { h: 20, w: 30 };

    fn sheet(place: impl Fn(f64, f64) -> DVec3) -> Vec<DVec3> {
        (0..GRID.particles()).map(|p| place((p / GRID.w) as f64, (p % GRID.w) as f64)).collect()
    }

    fn tiles(place: impl Fn(f64, f64) -> DVec3, way: impl Fn(f64, f64) -> DVec3) -> FlatTiles {
        FlatTiles::new(GRID, &sheet(place), &sheet(way), 0.4)
    }

    fn flat(i: f64, j: f64) -> DVec3 {
        DVec3::new(j, 3.0, i)
    }

    #[test]
    fn flat_tiles_hold_what_is_around_them() {
        let still = tiles(flat, |_, _| DVec3::ZERO);
        assert!(still.around.iter().all(Option::is_some));
        // The second tile is that of the columns 8 to 15.
        let apart = |one: [usize; 2], other: [usize; 2]| still.keep_apart([one; 2], [other; 2]);
        assert!(apart([0, 9], [0, 5]) && apart([0, 9], [0, 18]) && apart([0, 9], [10, 9]));
        assert!(!apart([0, 9], [0, 4]) && !apart([0, 9], [0, 19]) && !apart([0, 9], [11, 9]));
        // At the borders there is nothing beyond.
        assert!(apart([0, 0], [0, 0]) && apart([18, 29], [19, 29]));
        // Of rectangles, all of the one in a tile and all of the other around it.
        let whole = [[0, 8], [7, 15]];
        assert!(still.keep_apart(whole, whole) && still.keep_apart(whole, [[0, 5], [10, 18]]));
        assert!(!still.keep_apart([[0, 8], [7, 16]], whole) && !still.keep_apart(whole, [[0, 4], [10, 18]]));
    }

    #[test]
    fn tiles_that_bend_or_move_too_much_are_not_flat() {
        // A cylinder, in which a tile and its surroundings turn by 14 edges over its radius.
        let rolled = |radius: f64| {
            move |i: f64, j: f64| DVec3::new(radius * (j / radius).cos(), radius * (j / radius).sin(), i)
        };
        let is_flat = |tiles: FlatTiles| tiles.around.iter().map(Option::is_some).collect::<Vec<_>>();
        let of = |radius| is_flat(tiles(rolled(radius), |_, _| DVec3::ZERO));
        assert!(of(9.0).iter().all(|flat| *flat), "{:?}", of(9.0));
        assert!(!of(3.0)[1]);
        // Collapsed at the end of the way, and somewhere between.
        assert!(!is_flat(tiles(flat, |_, j| DVec3::new(-0.9 * j, 0.0, 0.0)))[0]);
        assert!(!is_flat(tiles(flat, |_, j| DVec3::new(-1.5 * j, 0.0, 0.0)))[0]);
        assert!(is_flat(tiles(flat, |_, _| DVec3::new(5.0, 4.0, 3.0)))[0]);
        assert!(!is_flat(tiles(|i, _| DVec3::new(0.0, 0.0, i), |_, _| DVec3::ZERO))[0]);
        assert!(!is_flat(tiles(|_, _| DVec3::NAN, |_, _| DVec3::ZERO))[0]);
    }
}
