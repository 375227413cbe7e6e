//! Tests of the CPU path; they need no adapter.

mod adjoint;
mod bodies;
mod checkpoint;
mod classical;
mod cloth;
#[path = "../cloths/mod.rs"]
mod cloths;
mod fft;
mod golden;
mod layers;
mod moduli;
mod network;
mod newton;
#[path = "../noise/mod.rs"]
mod noise;
mod reference;
mod repulsion;
mod rollout;
mod subspace;
mod terms;
mod update_rule;
mod wind;
