//! How good a simulation is: measures of its frames.

mod stretch;

pub use stretch::{FreeEdges, STRETCH_LIMIT};
