//! The network as data: its sizes ([`Config`]), its weights ([`Weights`]) and the files that hold them; and its forward
//! ([`Forward`]) and backward pass ([`Backward`]) as dispatches. What the CPU does in their place is in [`crate::cpu::operator`].

mod backward;
mod checkpoint;
mod forward;
mod joined;
mod parameters;
mod plan;
pub mod tables;
mod weights;

pub use backward::{Backward, Transposed};
pub use checkpoint::{Checkpoint, Description, TensorSummary};
pub use forward::{Forward, Head};
pub use parameters::{Layout, Parameters};
pub use plan::{Keep, Plan};
pub use weights::{Block, Config, Dense, Weights};
