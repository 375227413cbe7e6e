//! Tests that run on an adapter, any adapter: a software one is enough. Without one they fail and say how to get one.
//!
//! `parity` compares each shader with the CPU path or with plain formulas in double precision, `forward` the network, `solver`
//! whole frames; `kernels` reads the WGSL files themselves and needs no adapter.

mod common;
mod forward;
mod kernels;
mod parity;
mod solver;
