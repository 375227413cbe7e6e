//! The simulation: what is simulated ([`Model`], [`State`], [`Control`]) and what advances it.

mod grid;
mod model;

pub use grid::{Grid, MAX_GRID, MIN_GRID};
pub use model::{Air, Cloth, Control, Material, Model, State};
