//! Neural cloth on the GPU.

pub mod cpu;
mod error;
pub mod network;
pub mod sim;

pub use error::{Error, Result};
