//! Training on the CPU: the loss of a batch with its gradient, and the optimizer of the weights.

mod adamw;
mod loss;

pub use adamw::{AdamW, AdamWFactors, AdamWSettings};
pub use loss::{ClothLoss, Loss};
