//! The network as data: its sizes ([`Config`]), its weights ([`Weights`]) and the files that hold them.

mod weights;

pub use weights::{Block, Config, Dense, Weights};
