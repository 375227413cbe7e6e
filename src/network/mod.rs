//! The network: its sizes ([`Config`]), weights ([`Weights`]) and checkpoint files, and its forward
//! ([`Forward`]) and backward passes ([`Backward`]) as dispatches. Their CPU counterparts are in
//! [`crate::cpu::operator`].

mod backward;
mod checkpoint;
mod forward;
mod fused;
mod parameters;
mod plan;
pub mod tables;
mod weights;

pub use backward::{Backward, TransposedWeights};
pub use checkpoint::{Checkpoint, Description, TensorSummary};
pub use forward::{Forward, Head};
pub use parameters::{Layout, Parameters};
pub use plan::{Keep, Plan};
pub use weights::{Block, Config, Dense, Weights};
