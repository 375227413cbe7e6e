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
mod masks;
mod moduli;
mod network;
mod newton;
#[path = "../noise/mod.rs"]
mod noise;
mod reference;
mod repulsion;
mod rest_angles;
mod rollout;
mod subspace;
mod terms;
mod update_rule;
mod wind;

use fnopt::cloth::{Cloth, Grid, Mark, Model};

/// Returns what the particles of a full rectangle with these handles are.
fn marks_of(grid: Grid, handles: &[usize]) -> Vec<Mark> {
    Model { grid, cloths: vec![Cloth { handles: handles.to_vec(), ..Cloth::default() }] }.marks()
}
