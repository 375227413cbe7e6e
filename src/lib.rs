//! Neural cloth on the GPU.

mod error;
pub mod gpu;
pub mod kernels;
pub mod network;
pub mod scene;
pub mod sim;

pub use error::{Error, Result};
