//! The cloth on the CPU: energies, their gradient, wind and the end of a frame, for one cloth at a time
//! (paper section 3).
//!
//! [`energy()`], [`gradient()`], [`local_model`] and [`Hessian`] are vectorised along rows, with their sums in another order
//! each. What they sum is defined in [`terms`](crate::cloth::terms), and [`plain_total`] sums it plainly: the tests check
//! the vectorised forms against it.

mod cells;
mod curvature;
mod energy;
mod gradient;
mod hessian;
mod integrate;
mod particles;
mod plain;
mod repulsion;
mod rows;
mod sheet_axes;
mod stretch;
mod vector;
mod vertices;
mod wind;

pub use cells::{Cells, Placed, Walk};
pub use curvature::{CurvatureRows, LocalModel, local_model};
pub use energy::energy;
pub use gradient::{GradientRows, gradient};
pub use hessian::{AFTER, Block, Hessian, Projection, neighbours};
pub use integrate::{Frame, end_frame, shifts};
pub(super) use particles::add_own_block;
pub use plain::{PlainTotal, plain_total};
pub use repulsion::repulsion;
pub use sheet_axes::sheet_axes;
pub use stretch::stretch;
pub use vertices::vertices;
pub use wind::add_wind;

use super::Real;
use crate::cloth::{Grid, Material};
use vector::{add, at, sub};

/// One cloth at a trial acceleration: everything that its energy depends on.
#[derive(Clone, Copy)]
pub struct Trial<'a, T> {
    /// The grid.
    pub grid: Grid,
    /// Energy coefficients.
    pub material: Material,
    /// Positions at the start of the frame \[edges\], shape [3, H, W].
    pub x: &'a [T],
    /// Displacements of the trial \[edges\], shape [3, H, W]. They are kept separate from `x`: in single
    /// precision a sum would round an edge by the size of the coordinates, and the stiff edges would turn
    /// that into noise in the gradient.
    pub shift: &'a [T],
    /// Trial accelerations [edges / frame^2], shape [3, H, W].
    pub a: &'a [T],
    /// External accelerations [edges / frame^2], shape [3, H, W].
    pub f: &'a [T],
    /// Handle slots, shape [H, W]: 0 for a free particle, see [`crate::cloth::Model::handle_slots`].
    pub slots: &'a [u32],
}

impl<T: Real> Trial<'_, T> {
    /// Returns the edge from particle (i, j) to (i+1, j).
    #[inline(always)]
    fn vertical(&self, i: usize, j: usize) -> [T; 3] {
        self.edge(i * self.grid.w + j, (i + 1) * self.grid.w + j)
    }

    /// Returns the edge from particle (i, j) to (i, j+1).
    #[inline(always)]
    fn horizontal(&self, i: usize, j: usize) -> [T; 3] {
        self.edge(i * self.grid.w + j, i * self.grid.w + j + 1)
    }

    /// Returns the vector from particle p to q at the trial acceleration.
    #[inline(always)]
    fn edge(&self, p: usize, q: usize) -> [T; 3] {
        let n = self.grid.particles();
        add(sub(at(self.x, n, q), at(self.x, n, p)), sub(at(self.shift, n, q), at(self.shift, n, p)))
    }

    /// Returns the factors of one vertical edge, one horizontal edge, one corner angle and one bend angle.
    fn factors(&self) -> Factors<T> {
        let Grid { h, w } = self.grid;
        let Material { stretch, shear, bend } = self.material;
        Factors {
            vertical: T::of(stretch / ((h - 1) * w) as f64),
            horizontal: T::of(stretch / (h * (w - 1)) as f64),
            shear: T::of(shear / (h * w) as f64),
            bend: T::of(bend / (h * w) as f64),
        }
    }
}

/// The coefficients of a material, divided by the number of terms that they average over.
struct Factors<T> {
    vertical: T,
    horizontal: T,
    shear: T,
    bend: T,
}
