//! The cloth on the CPU: energies, their gradient, wind and the end of a frame, for one cloth at a time (paper section 3).

mod energy;
mod gradient;
mod integrate;
mod stretch;
mod vector;
mod wind;

pub use energy::energy;
pub use gradient::{GradientRows, gradient};
pub use integrate::{Frame, end_frame, trial_positions};
pub use stretch::stretch;
pub use wind::add_wind;

use super::Real;
use crate::sim::{Grid, Material};
use vector::{at, sub};

/// One cloth at a trial acceleration: all that its energy depends on.
#[derive(Clone, Copy)]
pub struct Trial<'a, T> {
    /// The grid.
    pub grid: Grid,
    /// Energy coefficients.
    pub material: Material,
    /// Trial positions [edges], shape [3, H, W].
    pub x: &'a [T],
    /// Trial accelerations [edges / frame^2], shape [3, H, W].
    pub a: &'a [T],
    /// External accelerations [edges / frame^2], shape [3, H, W].
    pub f: &'a [T],
    /// Handle slots, shape [H, W]: 0 for a free particle, see [`crate::sim::Model::handle_slots`].
    pub slots: &'a [u32],
}

impl<T: Real> Trial<'_, T> {
    /// The edge from particle (i, j) to (i+1, j).
    #[inline(always)]
    fn vertical(&self, i: usize, j: usize) -> [T; 3] {
        let (n, w) = (self.grid.particles(), self.grid.w);
        sub(at(self.x, n, (i + 1) * w + j), at(self.x, n, i * w + j))
    }

    /// The edge from particle (i, j) to (i, j+1).
    #[inline(always)]
    fn horizontal(&self, i: usize, j: usize) -> [T; 3] {
        let (n, w) = (self.grid.particles(), self.grid.w);
        sub(at(self.x, n, i * w + j + 1), at(self.x, n, i * w + j))
    }

    /// Factors of one vertical edge, one horizontal edge, one corner angle and one bend angle.
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

/// The coefficients of a material over the number of terms that they are the mean of.
struct Factors<T> {
    vertical: T,
    horizontal: T,
    shear: T,
    bend: T,
}
