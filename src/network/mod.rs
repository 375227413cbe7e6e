//! The network as data: its sizes ([`Config`]), its weights ([`Weights`]) and the files that hold them; and its forward
//! pass as dispatches ([`Forward`]).

mod checkpoint;
mod forward;
pub mod tables;
mod weights;

pub use checkpoint::{Checkpoint, Description, TensorSummary};
pub use forward::{Forward, Keep};
pub use weights::{Block, Config, Dense, Weights};
