//! Meshes that are a grid, whatever the order of their vertices.

use crate::cloth::Grid;
use std::collections::HashMap;

/// Returns the number of the vertex that is each particle of `grid`, shape [H, W], of so many `vertices` that these faces
/// join as the grid does, each cell one quadrilateral or two triangles; `None` if they do not. `uv`, of each vertex, tells
/// which end is which. Without it the faces turn as those of the grid do, and of the ways that are left the one is taken
/// whose particle (0, 0) is the first in the file.
pub(super) fn order(
    grid: Grid,
    vertices: usize,
    faces: &[Vec<usize>],
    uv: Option<&[[f64; 2]]>,
) -> Option<Vec<usize>> {
    if vertices != grid.particles() || faces.iter().any(|face| !(3..=4).contains(&face.len())) {
        return None;
    }
    let found = walk(grid, faces)?;
    let all = turned(grid, &found);
    let Some(uv) = uv else {
        let alike = all.into_iter().filter(|order| follows(grid, order, faces));
        return alike.min_by_key(|order| order[0]);
    };
    let wanted = grid.texture_coordinates();
    let error = |order: &Vec<usize>| -> f64 {
        let square = |(&vertex, [u, v]): (&usize, &[f32; 2])| {
            (uv[vertex][0] - f64::from(*u)).powi(2) + (uv[vertex][1] - f64::from(*v)).powi(2)
        };
        order.iter().zip(&wanted).map(square).sum()
    };
    all.into_iter()
        .map(|order| (error(&order), order))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, order)| order)
}

/// Returns an order and all those that it becomes by turning and mirroring the grid.
fn turned(grid: Grid, order: &[usize]) -> Vec<Vec<usize>> {
    let Grid { h, w } = grid;
    let along = |at: &dyn Fn(usize, usize) -> usize| {
        (0..grid.particles()).map(|p| order[at(p / w, p % w)]).collect::<Vec<_>>()
    };
    let mut all = vec![
        order.to_vec(),
        along(&|i, j| i * w + w - 1 - j),
        along(&|i, j| (h - 1 - i) * w + j),
        along(&|i, j| (h - 1 - i) * w + w - 1 - j),
    ];
    if h == w {
        let across = |order: &Vec<usize>| (0..h * w).map(|p| order[p % w * w + p / w]).collect();
        all.extend(all.iter().map(across).collect::<Vec<_>>());
    }
    all
}

/// Whether the faces turn as the grid's do in this order, judged by the one at its first cell.
fn follows(grid: Grid, order: &[usize], faces: &[Vec<usize>]) -> bool {
    // Around a cell: (0, 0), (1, 0), (1, 1), (0, 1).
    let cell = [0, grid.w, grid.w + 1, 1].map(|p| order[p]);
    let places = |face: &Vec<usize>| {
        face.iter().map(|vertex| cell.iter().position(|own| own == vertex)).collect::<Option<Vec<_>>>()
    };
    let Some(places) = faces.iter().find_map(places) else { return false };
    // Once around, the places rise but for one step.
    let rises = (0..places.len()).filter(|&k| places[(k + 1) % places.len()] > places[k]).count();
    rises + 1 == places.len()
}

/// The faces at each side that two vertices are the ends of.
struct Sides<'a> {
    faces: &'a [Vec<usize>],
    at: HashMap<[usize; 2], Vec<usize>>,
}

impl<'a> Sides<'a> {
    fn new(faces: &'a [Vec<usize>]) -> Self {
        let mut at: HashMap<_, Vec<usize>> = HashMap::new();
        for (k, face) in faces.iter().enumerate() {
            for (c, &a) in face.iter().enumerate() {
                let b = face[(c + 1) % face.len()];
                at.entry([a.min(b), a.max(b)]).or_default().push(k);
            }
        }
        Self { faces, at }
    }

    /// Returns the face at a side that is not `used`, if there is just one.
    fn next(&self, a: usize, b: usize, used: &[bool]) -> Option<usize> {
        let mut left = self.at.get(&[a.min(b), a.max(b)])?.iter().copied().filter(|&face| !used[face]);
        left.next().filter(|_| left.next().is_none())
    }

    /// Returns the fourth corner of the cell with the sides a b and a c, and uses its faces.
    fn fourth(&self, [a, b, c]: [usize; 3], used: &mut [bool]) -> Option<usize> {
        let face = self.next(a, b, used)?;
        used[face] = true;
        let others = |face: usize, known: [usize; 2]| {
            self.faces[face].iter().copied().filter(move |vertex| !known.contains(vertex))
        };
        if self.faces[face].len() == 4 {
            let mut rest = others(face, [a, b]).filter(|&vertex| vertex != c);
            let fourth = rest.next()?;
            // It lies across from a.
            let place = |vertex: usize| self.faces[face].iter().position(|&own| own == vertex);
            return (rest.next().is_none() && place(a)?.abs_diff(place(fourth)?) == 2).then_some(fourth);
        }
        let third = others(face, [a, b]).next()?;
        let (fourth, second) = if third == c {
            let second = self.next(b, c, used)?;
            (others(second, [b, c]).next()?, second)
        } else {
            let second = self.next(a, c, used)?;
            (others(second, [a, c]).next().filter(|&vertex| vertex == third)?, second)
        };
        used[second] = true;
        (self.faces[second].len() == 3).then_some(fourth)
    }
}

/// Returns the vertices in some order in which the faces are the cells of the grid.
fn walk(grid: Grid, faces: &[Vec<usize>]) -> Option<Vec<usize>> {
    let sides = Sides::new(faces);
    let border = border(&sides)?;
    let around = 2 * (grid.h - 1) + 2 * (grid.w - 1);
    if border.len() != around {
        return None;
    }
    let mut count: HashMap<usize, usize> = HashMap::new();
    faces.iter().flatten().for_each(|&vertex| *count.entry(vertex).or_default() += 1);
    // A corner belongs to one quadrilateral or to at most two triangles.
    let is_corner = |vertex: usize| count[&vertex] <= 2;
    let starts = (0..around).filter(|&k| is_corner(border[k]));
    for start in starts {
        for forwards in [true, false] {
            let at = |k: usize| border[(start + if forwards { k } else { around - k % around }) % around];
            if let Some(order) = rows(grid, &sides, &at) {
                return Some(order);
            }
        }
    }
    None
}

/// Walks along the rows, the first of which and the first column are on the border, `at` so many steps from their corner.
fn rows(grid: Grid, sides: &Sides, at: &dyn Fn(usize) -> usize) -> Option<Vec<usize>> {
    let Grid { h, w } = grid;
    let around = 2 * (h - 1) + 2 * (w - 1);
    let mut used = vec![false; sides.faces.len()];
    let mut order: Vec<usize> = (0..w).map(at).collect();
    for i in 1..h {
        order.push(at(around - i));
        for j in 1..w {
            let (a, c) = ((i - 1) * w + j - 1, i * w + j - 1);
            let fourth = sides.fourth([order[a], order[a + 1], order[c]], &mut used)?;
            // The last column and the last row are on the border, too.
            let expected = if j + 1 == w {
                Some(at(w - 1 + i))
            } else if i + 1 == h {
                Some(at(around - i - j))
            } else {
                None
            };
            if expected.is_some_and(|expected| expected != fourth) {
                return None;
            }
            order.push(fourth);
        }
    }
    let mut seen = vec![false; order.len()];
    let once = order.iter().all(|&vertex| vertex < seen.len() && !std::mem::replace(&mut seen[vertex], true));
    (once && used.iter().all(|&used| used)).then_some(order)
}

/// Returns the vertices around the mesh, if it has one border that passes each of them once.
fn border(sides: &Sides) -> Option<Vec<usize>> {
    let mut next: HashMap<usize, Vec<usize>> = HashMap::new();
    let mut first = usize::MAX;
    for (&[a, b], faces) in &sides.at {
        match faces.len() {
            1 => {
                next.entry(a).or_default().push(b);
                next.entry(b).or_default().push(a);
                first = first.min(a);
            }
            2 => {}
            _ => return None,
        }
    }
    if next.is_empty() || next.values().any(|ends| ends.len() != 2) {
        return None;
    }
    let mut around = vec![first];
    let (mut before, mut at) = (first, *next[&first].iter().min()?);
    while at != first {
        around.push(at);
        let ends = &next[&at];
        (before, at) = (at, if ends[0] == before { ends[1] } else { ends[0] });
    }
    (around.len() == next.len()).then_some(around)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers of the particles in another order.
    fn shuffled(n: usize) -> Vec<usize> {
        let mut numbers: Vec<usize> = (0..n).collect();
        let mut state = 12345u64;
        for k in (1..n).rev() {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            numbers.swap(k, (state >> 33) as usize % (k + 1));
        }
        numbers
    }

    /// The cells of a grid, cut as asked: 0 not at all, 1 as [`Grid::faces`] are, 2 the other way, 3 by turns, 4 all of these.
    fn cells(grid: Grid, cut: usize) -> Vec<Vec<usize>> {
        let w = grid.w;
        let starts = (0..grid.h - 1).flat_map(|i| (0..w - 1).map(move |j| (i, j)));
        let cell = |(i, j): (usize, usize)| {
            let [a, b, c, d] = [i * w + j, (i + 1) * w + j, (i + 1) * w + j + 1, i * w + j + 1];
            match if cut == 3 {
                1 + (i + j) % 2
            } else if cut == 4 {
                (3 * i + 5 * j) % 7 % 3
            } else {
                cut
            } {
                0 => vec![vec![a, b, c, d]],
                1 => vec![vec![a, b, c], vec![a, c, d]],
                _ => vec![vec![a, b, d], vec![d, b, c]],
            }
        };
        starts.flat_map(cell).collect()
    }

    #[test]
    fn grids_in_any_order_are_recognised() {
        for (grid, cut) in [(9, 14), (14, 9), (8, 8), (9, 10)]
            .into_iter()
            .flat_map(|(h, w)| (0..5).map(move |cut| (Grid { h, w }, cut)))
        {
            // Vertex numbers of the particles.
            let numbers = shuffled(grid.particles());
            let faces = cells(grid, cut).into_iter().map(|face| face.iter().map(|&p| numbers[p]).collect());
            let mut faces: Vec<Vec<usize>> = faces.collect();
            let by = shuffled(faces.len());
            faces = by.iter().map(|&k| faces[k].clone()).collect();
            let mut uv = vec![[0.0; 2]; numbers.len()];
            grid.texture_coordinates().iter().zip(&numbers).for_each(|(at, &k)| uv[k] = at.map(f64::from));
            assert_eq!(order(grid, numbers.len(), &faces, Some(&uv)), Some(numbers.clone()), "{grid}, {cut}");

            // Without texture coordinates the sheet may be turned, but not over.
            let found = order(grid, numbers.len(), &faces, None).unwrap();
            let n = numbers.len();
            let reversed: Vec<usize> = numbers.iter().rev().copied().collect();
            if grid.h != grid.w {
                let first = if numbers[0] < numbers[n - 1] { &numbers } else { &reversed };
                assert_eq!(found, *first, "{grid}, {cut}");
            }
            // Mirrored, it is the other two.
            faces.iter_mut().for_each(|face| face.reverse());
            let found = order(grid, n, &faces, None).unwrap();
            if grid.h != grid.w {
                assert!(found != numbers && found != reversed, "{grid}, {cut}");
            }
        }
    }

    #[test]
    fn what_is_no_grid_is_none() {
        let grid = Grid { h: 9, w: 14 };
        let faces = cells(grid, 4);
        let none = |faces: &[Vec<usize>]| assert_eq!(order(grid, grid.particles(), faces, None), None);
        none(&faces[1..]);
        none(&[&faces[..], &faces[..1]].concat());
        none(&cells(Grid { h: 7, w: 18 }, 0));
        none(&[]);
        let mut wrong = cells(grid, 0);
        wrong[20].swap(0, 1);
        none(&wrong);
        // Two vertices that change places in one face.
        let mut wrong = cells(grid, 1);
        wrong[31][0] += 1;
        none(&wrong);
    }
}
