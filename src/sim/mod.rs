//! The simulation on a device: the [`Optimizer`] that advances the cloths, and a [`Solver`] that records frames
//! into the caller's encoder. [`crate::cpu::Solver`] is its counterpart without a GPU.

mod learned;
mod memory;
mod method;
mod optimizer;
mod solver;
mod stats;
mod tune;
mod vertices;

pub use crate::settings::{AdamSettings, LbfgsSettings};
pub(crate) use learned::Learned;
pub use memory::Memory;
pub use optimizer::{Direction, Initial, Length, MAX_DIRECTIONS, Optimizer};
pub use solver::{INITIAL_SCALE, Solver};
pub use stats::{FrameStats, IterationLog, StepCounts};
pub use tune::tune;
pub use vertices::Vertices;
