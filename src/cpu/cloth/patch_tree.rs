//! A tree of boxes over the grid of a moving sheet, in which the patches that may meet are found.

use super::flat_tiles::FlatTiles;
use crate::cloth::{Bounds, Grid};
use rayon::prelude::*;

/// Pairs of nodes that are enough to share the work between threads.
const TASKS: usize = 128;

/// Boxes around patches, around squares of four of them, of sixteen, and so on up to the whole sheet. A patch is a
/// particle with the cell behind it.
pub(super) struct PatchTree {
    /// From patches to the whole.
    levels: Vec<Level>,
}

struct Level {
    rows: usize,
    columns: usize,
    boxes: Vec<Bounds>,
    /// Whether any patch in a node is looked for.
    wanted: Vec<bool>,
}

/// A square of `2^level` rows and columns of patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Node {
    level: usize,
    row: usize,
    column: usize,
}

impl PatchTree {
    /// Builds the tree over the boxes of patches, [H, W]; a patch that is nowhere has a box that meets none. Pairs
    /// are found of which at least one is `wanted`.
    pub fn new(grid: Grid, boxes: Vec<Bounds>, wanted: Vec<bool>) -> Self {
        let mut levels = vec![Level { rows: grid.h, columns: grid.w, boxes, wanted }];
        while let Some(Level { rows, columns, boxes, wanted }) =
            levels.last().filter(|level| level.boxes.len() > 1)
        {
            let (rows, columns, across) = (rows.div_ceil(2), columns.div_ceil(2), *columns);
            let below = |node: usize| {
                let (row, column) = (node / columns * 2, node % columns * 2);
                let has = [true, column + 1 < across, row * across + across < boxes.len()];
                let first = row * across + column;
                [
                    (first, true),
                    (first + 1, has[1]),
                    (first + across, has[2]),
                    (first + across + 1, has[1] && has[2]),
                ]
                .into_iter()
                .filter_map(|(at, has)| has.then_some(at))
            };
            let level = Level {
                rows,
                columns,
                boxes: (0..rows * columns)
                    .map(|node| below(node).fold(Bounds::NONE, |all, at| all.with(&boxes[at])))
                    .collect(),
                wanted: (0..rows * columns).map(|node| below(node).any(|at| wanted[at])).collect(),
            };
            levels.push(level);
        }
        Self { levels }
    }

    /// Shows each pair of patches whose boxes meet once, by their numbers, to one of the states that `init` makes,
    /// until `show` returns false. Leaves out what `tiles` keep apart. Returns the states, in an order that does not
    /// depend on threads.
    pub fn visit<S: Send>(
        &self,
        tiles: &FlatTiles,
        init: impl Fn() -> S + Sync,
        show: impl Fn(&mut S, [usize; 2]) -> bool + Sync,
    ) -> Vec<S> {
        let root = Node { level: self.levels.len() - 1, row: 0, column: 0 };
        // A single patch has none beside it.
        let mut tasks = if root.level == 0 { Vec::new() } else { vec![[root; 2]] };
        while tasks.len() < TASKS && tasks.iter().any(|pair| pair[0].level > 0) {
            let mut parts = Vec::new();
            tasks.into_iter().for_each(|pair| self.split(pair, tiles, &mut parts));
            tasks = parts;
        }
        let run = |pair: [Node; 2]| {
            let (mut state, mut left) = (init(), vec![pair]);
            while let Some(pair) = left.pop() {
                if pair[0].level > 0 {
                    self.split(pair, tiles, &mut left);
                } else if !show(&mut state, pair.map(|node| self.index(node))) {
                    break;
                }
            }
            state
        };
        tasks.into_par_iter().map(run).collect()
    }

    /// Appends the pairs of the parts of a pair that may hold patches that meet: of a patch, none.
    fn split(&self, [one, other]: [Node; 2], tiles: &FlatTiles, parts: &mut Vec<[Node; 2]>) {
        if one.level == 0 {
            return;
        }
        let level = &self.levels[one.level - 1];
        let of = |node: Node| {
            [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(i, j)| {
                let (row, column) = (2 * node.row + i, 2 * node.column + j);
                let node = Node { level: node.level - 1, row, column };
                (row < level.rows && column < level.columns).then_some(node)
            })
        };
        let (ones, others) = (of(one), of(other));
        for (k, a) in ones.into_iter().enumerate() {
            let Some(a) = a else { continue };
            // Each pair of parts of one node once.
            let first = if one == other { k } else { 0 };
            for b in others[first..].iter().flatten() {
                let [p, q] = [a, *b].map(|node| self.index(node));
                let may = if a == *b { a.level > 0 } else { level.boxes[p].meets(&level.boxes[q]) };
                if may && (level.wanted[p] || level.wanted[q]) && !tiles.keep_apart(a.patches(), b.patches())
                {
                    parts.push([a, *b]);
                }
            }
        }
    }

    /// Returns where a node is in its level.
    fn index(&self, node: Node) -> usize {
        node.row * self.levels[node.level].columns + node.column
    }
}

impl Node {
    /// Returns the rows and columns of its first patch and of its last one, which may lie beyond the grid.
    fn patches(self) -> [[usize; 2]; 2] {
        let size = 1 << self.level;
        let first = [self.row * size, self.column * size];
        [first, first.map(|at| at + size - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use std::collections::BTreeSet;

    #[test]
    fn all_pairs_of_boxes_that_meet_are_shown_once() {
        for (h, w) in [(1, 1), (1, 7), (9, 5), (16, 16), (23, 40)] {
            let grid = Grid { h, w };
            // No order in space at all, and some patches nowhere.
            let box_of = |p: usize| {
                let at = |k: usize| ((p * 7919 + k * 104_729) % 997) as f64 / 100.0;
                let low = DVec3::new(at(0), at(1), at(2));
                if p % 11 == 3 { Bounds::NONE } else { Bounds { low, high: low + 2.0 } }
            };
            let boxes: Vec<Bounds> = (0..grid.particles()).map(box_of).collect();
            for every in [1, 5] {
                let wanted: Vec<bool> = (0..grid.particles()).map(|p| p % every == 0).collect();
                let of = |p: usize, q: usize| (wanted[p] || wanted[q]) && boxes[p].meets(&boxes[q]);
                let truth: BTreeSet<[usize; 2]> = (0..grid.particles())
                    .flat_map(|p| (0..p).map(move |q| [q, p]))
                    .filter(|&[q, p]| of(p, q))
                    .collect();
                let tree = PatchTree::new(grid, boxes.clone(), wanted.clone());
                let show = |found: &mut Vec<[usize; 2]>, [p, q]: [usize; 2]| {
                    found.push([p.min(q), p.max(q)]);
                    true
                };
                let found = tree.visit(&FlatTiles::none(grid), Vec::new, show).concat();
                assert_eq!(found.len(), truth.len(), "{h}x{w}, every {every}");
                assert_eq!(found.into_iter().collect::<BTreeSet<_>>(), truth, "{h}x{w}, every {every}");
            }
        }
    }
}
