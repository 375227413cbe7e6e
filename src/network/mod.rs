//! The network as data: its sizes ([`Config`]), its weights ([`Weights`]) and the files that hold them.

mod forward;
pub mod tables;
mod weights;

pub use forward::{Forward, Keep};
pub use weights::{Block, Config, Dense, Weights};
