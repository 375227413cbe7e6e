//! The particle grid of a cloth.

use crate::{Error, Result};

/// A grid of `h * w` particles: `i` runs along the height, `j` along the width. Particle `(i, j)` has number
/// `i * w + j`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Grid {
    /// Particles along the height (H).
    pub h: usize,
    /// Particles along the width (W).
    pub w: usize,
}

/// The smallest height and width that can represent the network's 8 x 5 Fourier modes (section 4).
pub const MIN_GRID: usize = 8;
/// The largest height and width, which keeps particle numbers well inside 32 bits.
pub const MAX_GRID: usize = 4096;

impl Grid {
    /// Returns a grid of `h * w` particles. Fails unless both are in the range [`MIN_GRID`] to [`MAX_GRID`];
    /// `origin` names the source of the sizes in the error.
    pub fn new(h: usize, w: usize, origin: &str) -> Result<Self> {
        for (name, n) in [("grid height", h), ("grid width", w)] {
            if !(MIN_GRID..=MAX_GRID).contains(&n) {
                let expected = format!("{MIN_GRID} to {MAX_GRID} particles");
                return Err(Error::invalid(origin, name, expected, n));
            }
        }
        Ok(Self { h, w })
    }

    /// Returns the number of particles, `H W`.
    pub fn particles(&self) -> usize {
        self.h * self.w
    }

    /// Returns the mass of particle `(i, j)` in grid units: 1 inside, 1/2 on the border, 1/4 in the corners.
    /// The masses of a grid add up to `(H - 1)(W - 1)`, the number of cells.
    pub fn mass(&self, i: usize, j: usize) -> f64 {
        let edge = |k: usize, n: usize| if k == 0 || k + 1 == n { 0.5 } else { 1.0 };
        edge(i, self.h) * edge(j, self.w)
    }

    /// Returns the sheet's width divided by its height.
    pub(crate) fn aspect(&self) -> f64 {
        (self.w - 1) as f64 / (self.h - 1) as f64
    }

    /// Whether two particles are the same, or joined by an edge of the triangulated grid ([`Grid::faces`]).
    pub(crate) fn joined(&self, p: usize, q: usize) -> bool {
        let last = p.max(q);
        match p.abs_diff(q) {
            0 => true,
            n if n == self.w => true,
            // Along a row or a diagonal, unless it wraps from the end of one row to the beginning of another.
            n if n == 1 || n == self.w + 1 => !last.is_multiple_of(self.w),
            _ => false,
        }
    }

    /// Returns the rest position of particle `p`, flat and unstretched \[edges\], z up:
    /// `(j, i - (H-1)/2, 0)`.
    pub(crate) fn rest(&self, p: usize) -> [f64; 3] {
        [(p % self.w) as f64, (p / self.w) as f64 - (self.h - 1) as f64 / 2.0, 0.0]
    }

    /// Returns the triangles as particle numbers: two per cell, cut along the diagonal (i, j) - (i+1, j+1).
    /// They turn counter-clockwise seen from the side of the normals, which is the lower side of a flat sheet
    /// at its start.
    pub fn faces(&self) -> Vec<[u32; 3]> {
        self.iter_faces().collect()
    }

    /// Returns a triangle of [`Grid::faces`] by its index.
    pub(crate) fn face(&self, face: usize) -> [usize; 3] {
        let cell = face / 2;
        let a = cell / (self.w - 1) * self.w + cell % (self.w - 1);
        let c = a + self.w + 1;
        if face.is_multiple_of(2) { [a, a + self.w, c] } else { [a, c, a + 1] }
    }

    /// Returns the index of the first triangle of the cell behind a particle, which must not be on the far borders.
    pub(crate) fn first_face(&self, p: usize) -> usize {
        2 * (p / self.w * (self.w - 1) + p % self.w)
    }

    /// Returns the triangle across a side of another, which leads from its corner `side` to the next, and its corner that
    /// they don't share; `None` on the border.
    pub(crate) fn across(&self, face: usize, side: usize) -> Option<(usize, usize)> {
        let cell = face / 2;
        let (i, j) = (cell / (self.w - 1), cell % (self.w - 1));
        let a = i * self.w + j;
        match (face.is_multiple_of(2), side) {
            (true, 0) => (j > 0).then(|| (face - 1, a - 1)),
            (true, 1) => (i + 2 < self.h).then(|| (face + 2 * (self.w - 1) + 1, a + 2 * self.w + 1)),
            (true, _) => Some((face + 1, a + 1)),
            (false, 0) => Some((face - 1, a + self.w)),
            (false, 1) => (j + 2 < self.w).then(|| (face + 1, a + self.w + 2)),
            (false, _) => (i > 0).then(|| (face - 2 * (self.w - 1) - 1, a - self.w)),
        }
    }

    /// Returns the corners of the cell of a triangle.
    pub(crate) fn cell_of(&self, face: usize) -> [usize; 4] {
        let a = self.face(face)[0];
        [a, a + 1, a + self.w, a + self.w + 1]
    }

    /// Iterates over the particles that an edge of the triangles joins to `p`.
    pub(crate) fn ring(self, p: usize) -> impl Iterator<Item = usize> {
        let (i, j, w) = (p / self.w, p % self.w, self.w);
        let (up, down, left, right) = (i > 0, i + 1 < self.h, j > 0, j + 1 < w);
        let joined = [
            (up && left).then(|| p - w - 1),
            up.then(|| p - w),
            left.then(|| p - 1),
            right.then(|| p + 1),
            down.then(|| p + w),
            (down && right).then(|| p + w + 1),
        ];
        joined.into_iter().flatten()
    }

    /// Returns the texture coordinates of the particles: `u = 1 - i / (H - 1)`, `v = 1 - j / (W - 1)`. An
    /// image appears upright on a sheet that hangs from the edge j = 0, and unmirrored on the side of the
    /// normals.
    pub fn texture_coordinates(&self) -> Vec<[f32; 2]> {
        let part = |k: usize, n: usize| 1.0 - k as f32 / (n.max(2) - 1) as f32;
        (0..self.particles()).map(|p| [part(p / self.w, self.h), part(p % self.w, self.w)]).collect()
    }

    /// Iterates over the triangles of [`Grid::faces`].
    pub(crate) fn iter_faces(self) -> impl Iterator<Item = [u32; 3]> {
        let at = move |i: usize, j: usize| (i * self.w + j) as u32;
        let cell = move |i: usize, j: usize| {
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            [[a, b, c], [a, c, d]]
        };
        (0..self.h.saturating_sub(1))
            .flat_map(move |i| (0..self.w.saturating_sub(1)).flat_map(move |j| cell(i, j)))
    }
}

impl std::fmt::Display for Grid {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.h, self.w)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textures_turn_as_triangles_do() {
        let grid = Grid { h: 4, w: 7 };
        let uv = grid.texture_coordinates();
        for face in grid.faces() {
            let [a, b, c] = face.map(|k| glam::Vec2::from(uv[k as usize]));
            assert!((b - a).perp_dot(c - a) > 0.0, "{face:?}");
        }
        // Upper left, upper right and lower left on a sheet that hangs from j = 0.
        assert_eq!((uv[3 * 7], uv[0], uv[3 * 7 + 6]), ([0.0, 1.0], [1.0, 1.0], [0.0, 0.0]));
    }

    #[test]
    fn masses_add_up_to_the_cells() {
        let g = Grid { h: 9, w: 12 };
        let total: f64 = (0..g.h).flat_map(|i| (0..g.w).map(move |j| g.mass(i, j))).sum();
        assert_eq!(total, 88.0);
        assert_eq!((g.mass(0, 0), g.mass(0, 5), g.mass(4, 5)), (0.25, 0.5, 1.0));
    }

    #[test]
    fn faces_cut_each_cell_once() {
        let faces = Grid { h: 3, w: 2 }.faces();
        assert_eq!(faces, [[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]]);
    }

    #[test]
    fn triangles_know_their_neighbours() {
        let grid = Grid { h: 4, w: 5 };
        let faces = grid.faces().into_iter().map(|face| face.map(|p| p as usize)).collect::<Vec<_>>();
        for (k, face) in faces.iter().enumerate() {
            assert_eq!(grid.face(k), *face);
            for side in 0..3 {
                let ends = [face[side], face[(side + 1) % 3]];
                let other =
                    faces.iter().enumerate().find(|(n, f)| *n != k && ends.iter().all(|p| f.contains(p)));
                let across =
                    other.map(|(n, f)| (n, *f.iter().find(|p| !ends.contains(p)).expect("a third corner")));
                assert_eq!(grid.across(k, side), across, "face {k}, side {side}");
            }
        }
    }

    #[test]
    fn rings_are_the_joined_particles() {
        let grid = Grid { h: 4, w: 5 };
        for p in 0..grid.particles() {
            let joined = (0..grid.particles()).filter(|&q| q != p && grid.joined(p, q));
            assert_eq!(grid.ring(p).collect::<Vec<_>>(), joined.collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_edges_of_the_faces_join() {
        let grid = Grid { h: 4, w: 5 };
        let mut joined = vec![vec![false; grid.particles()]; grid.particles()];
        (0..grid.particles()).for_each(|p| joined[p][p] = true);
        for face in grid.faces() {
            face.iter().for_each(|&p| face.iter().for_each(|&q| joined[p as usize][q as usize] = true));
        }
        for (p, joined) in joined.iter().enumerate() {
            for (q, &joined) in joined.iter().enumerate() {
                assert_eq!(grid.joined(p, q), joined, "{p} and {q}");
            }
        }
    }
}
