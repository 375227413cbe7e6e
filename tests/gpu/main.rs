//! Tests that run on an adapter; a software one is enough. Without one they fail and say how to get one.
//!
//! `parity` compares each shader with the CPU path, or with plain formulas in double precision. `forward` and
//! `backward` cover the network, `solver` whole frames, `repelling` frames with repulsion, `touching` those of
//! cloths that touch themselves, `folding` those of cloths that are not flat at rest, `limits` sizes beyond what a device takes at once, `train` training steps, `control` what
//! a host changes between frames, `vertices` the vertex buffer, `order` that it does not matter which invocation runs
//! first, and `work` what is counted of dispatches without running them. The WGSL files themselves are checked in `src/kernels/tests.rs`, which needs no adapter.

mod backward;
mod bodies;
#[path = "../cloths/mod.rs"]
mod cloths;
mod common;
mod control;
mod folding;
mod forward;
mod limits;
#[path = "../noise/mod.rs"]
mod noise;
mod order;
mod parity;
mod repelling;
mod solver;
mod touching;
mod train;
mod vertices;
mod work;
