//! Neural cloth on the GPU.

mod error;
pub mod io;
pub mod network;
pub mod render;
pub mod sim;

pub use error::{Error, Result};
