//! Neural cloth on the GPU.

pub mod cpu;
mod error;
pub mod gpu;
pub mod io;
pub mod kernels;
pub mod network;
pub mod render;
pub mod scene;
pub mod sim;
pub mod verify;

pub use error::{Error, Result};
pub use wgpu;
