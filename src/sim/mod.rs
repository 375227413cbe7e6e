//! The simulation: the cloths and their inputs ([`Model`], [`State`], [`Control`]), the [`Optimizer`] that
//! advances them, a [`Solver`] that records GPU frames into the caller's encoder, and a [`Simulator`] that
//! runs on any device and reads back.

mod grid;
mod learned;
mod model;
mod optimizer;
mod rule;
mod simulator;
mod solver;
mod stats;
mod tune;
mod vertices;

pub use grid::{Grid, MAX_GRID, MIN_GRID};
pub(crate) use learned::Learned;
pub(crate) use model::cast;
pub use model::{Air, Cloth, Control, Material, Model, Repulsion, State};
pub use optimizer::Optimizer;
pub use simulator::{Device, Frame, Simulator};
pub use solver::{INITIAL_SCALE, Solver, SolverOptions};
pub use stats::{EnergyTerms, FrameStats, Iterations};
pub use tune::tune;
pub use vertices::{VertexView, Vertices};
