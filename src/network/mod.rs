//! The network as data: its sizes ([`Config`]), its weights ([`Weights`]) and the files that hold them.

mod checkpoint;
mod weights;

pub use checkpoint::{Checkpoint, Description, TensorSummary};

pub use weights::{Block, Config, Dense, Weights};
