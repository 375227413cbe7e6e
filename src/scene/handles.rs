//! The choice of handles.

use crate::cloth::Grid;
use crate::{Error, Result};
use std::collections::HashMap;
use std::hash::Hash;

/// A named arrangement of one or two handles. `h0` and `h1` are the first and the second handle, as in the
/// names of rotations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Placement {
    /// `corners`: the corners of the side j = 0; h0 = (H-1, 0), h1 = (0, 0).
    Corners,
    /// `diagonal`: opposite corners; h0 = (H-1, W-1), h1 = (0, 0).
    Diagonal,
    /// `mid-edge`: the midpoints of the two sides along the width; h0 = (H-1, W/2), h1 = (0, W/2).
    MidEdge,
    /// `corner-center`: h0 = (H-1, 0), h1 = (H/2, W/2).
    CornerCenter,
    /// `single-mid-edge`: the midpoint of the side j = 0, (H/2, 0).
    SingleMidEdge,
    /// `single-center`: (H/2, W/2).
    SingleCenter,
    /// `single-corner`: (H-1, 0).
    SingleCorner,
}

impl Placement {
    /// All placements.
    pub const ALL: [Placement; 7] = [
        Placement::Corners,
        Placement::Diagonal,
        Placement::MidEdge,
        Placement::CornerCenter,
        Placement::SingleMidEdge,
        Placement::SingleCenter,
        Placement::SingleCorner,
    ];

    /// Returns the name in a scene file.
    pub fn name(self) -> &'static str {
        match self {
            Placement::Corners => "corners",
            Placement::Diagonal => "diagonal",
            Placement::MidEdge => "mid-edge",
            Placement::CornerCenter => "corner-center",
            Placement::SingleMidEdge => "single-mid-edge",
            Placement::SingleCenter => "single-center",
            Placement::SingleCorner => "single-corner",
        }
    }

    /// Returns the placement called `name`; `origin` is the file or option that the name comes from.
    pub fn named(name: &str, origin: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|p| p.name() == name);
        let known = Self::ALL.map(Self::name);
        found.ok_or_else(|| Error::unknown(origin, "handle placement", name, known))
    }

    /// Returns the particle numbers of the handles on a grid, in order.
    pub(super) fn particles(self, grid: Grid) -> Vec<usize> {
        self.cells(grid).into_iter().map(|[i, j]| i * grid.w + j).collect()
    }

    /// Returns the handles on a grid, in order.
    fn cells(self, grid: Grid) -> Vec<[usize; 2]> {
        let (top, right) = (grid.h - 1, grid.w - 1);
        let (i, j) = (grid.h / 2, grid.w / 2);
        match self {
            Placement::Corners => vec![[top, 0], [0, 0]],
            Placement::Diagonal => vec![[top, right], [0, 0]],
            Placement::MidEdge => vec![[top, j], [0, j]],
            Placement::CornerCenter => vec![[top, 0], [i, j]],
            Placement::SingleMidEdge => vec![[i, 0]],
            Placement::SingleCenter => vec![[i, j]],
            Placement::SingleCorner => vec![[top, 0]],
        }
    }
}

/// The handles of a scene, in the order used by motions and recordings.
#[derive(Clone, Debug, PartialEq)]
pub enum Handles {
    /// A named placement.
    Placement(Placement),
    /// Particles by their indices (i, j).
    Cells(Vec<[usize; 2]>),
    /// Particles by their number `i W + j`.
    Vertices(Vec<usize>),
}

impl Handles {
    /// Returns the particle numbers of the handles on `grid`. Fails if a handle lies outside the grid or is
    /// listed twice.
    pub fn on(&self, grid: Grid, origin: &str) -> Result<Vec<usize>> {
        let at = |[i, j]: [usize; 2]| i * grid.w + j;
        let particles: Vec<usize> = match self {
            Handles::Placement(placement) => placement.particles(grid),
            Handles::Cells(cells) => {
                if let Some(k) = cells.iter().position(|c| c[0] >= grid.h || c[1] >= grid.w) {
                    let expected = format!("i below {} and j below {}", grid.h, grid.w);
                    let found = format!("[{}, {}]", cells[k][0], cells[k][1]);
                    return Err(Error::invalid(origin, format!("handles[{k}]"), expected, found));
                }
                cells.iter().copied().map(at).collect()
            }
            Handles::Vertices(vertices) => vertices.clone(),
        };
        let mut seen = vec![false; grid.particles()];
        for (k, &p) in particles.iter().enumerate() {
            let field = || format!("handles[{k}]");
            match seen.get_mut(p) {
                None => {
                    let expected = format!("a vertex below {} ({grid})", grid.particles());
                    return Err(Error::invalid(origin, field(), expected, p));
                }
                Some(true) => {
                    let found = format!("({}, {}) again", p / grid.w, p % grid.w);
                    return Err(Error::invalid(origin, field(), "a handle that is not yet listed", found));
                }
                Some(first) => *first = true,
            }
        }
        Ok(particles)
    }

    /// Returns the same places of the sheet on another grid: each listed handle moves to the nearest
    /// particle. With `merge`, handles that land on the same particle become one. Also returns the new number of each handle.
    pub(super) fn regrid(&self, from: Grid, to: Grid, merge: bool) -> (Self, Vec<usize>) {
        // Exact, in integer arithmetic: round(k (n' - 1) / (n - 1)).
        let move_to = |k: usize, n: usize, m: usize| (2 * k.min(n) * (m - 1) + n - 1) / (2 * (n - 1));
        let cell = |[i, j]: [usize; 2]| [move_to(i, from.h, to.h), move_to(j, from.w, to.w)];
        match self {
            Handles::Placement(placement) => {
                (Handles::Placement(*placement), (0..placement.particles(to).len()).collect())
            }
            Handles::Cells(cells) => {
                let (cells, numbers) = moved(cells.iter().copied().map(cell), merge);
                (Handles::Cells(cells), numbers)
            }
            Handles::Vertices(vertices) => {
                let cells = vertices.iter().map(|p| cell([p / from.w, p % from.w]));
                let (vertices, numbers) = moved(cells.map(|[i, j]| i * to.w + j), merge);
                (Handles::Vertices(vertices), numbers)
            }
        }
    }
}

/// Collects `places`, each only once if `once` is set, and where among them each of the given ones is.
fn moved<T: Copy + Eq + Hash>(places: impl Iterator<Item = T>, once: bool) -> (Vec<T>, Vec<usize>) {
    let (mut kept, mut numbers, mut first) = (Vec::new(), Vec::new(), HashMap::new());
    for place in places {
        let number = if once { *first.entry(place).or_insert(kept.len()) } else { kept.len() };
        if number == kept.len() {
            kept.push(place);
        }
        numbers.push(number);
    }
    (kept, numbers)
}
