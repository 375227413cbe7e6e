//! Host side of `shaders/optim/extrapolate.wgsl`.

use super::{Iterate, directions};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, size};
use crate::settings::SMOOTHING;

pub(crate) const SOURCE: Source = Source {
    name: "extrapolate",
    wgsl: include_str!("../../../shaders/optim/extrapolate.wgsl"),
    appended: &[common::MARK],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    slot: u32,
}

/// Smooths the change of the accelerations from frame to frame, where a frame starts.
#[derive(Clone, Debug)]
pub struct Extrapolate {
    kernel: Kernel,
}

impl Extrapolate {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        let names = ["W0", "W1", "W2", "W3", "W4"];
        let constants: Vec<_> = names.into_iter().zip(SMOOTHING).collect();
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &constants)? })
    }

    /// Sets the co-rotated slot of `directions` ([`directions::shape`]) to the smooth part of the spectral one, in which
    /// particles of `iterate` that are not free have 0.
    pub fn push(&self, schedule: &mut Schedule, grid: Grid, iterate: &Iterate, directions: &Tensor) {
        let (samples, n) = iterate.samples_and_particles();
        assert_eq!(n, grid.particles());
        // Mirror images of mirror images are not looked for.
        assert!(grid.h.min(grid.w) >= SMOOTHING.len(), "a grid of {grid}");
        let slot = directions::slot(directions, iterate);
        let params = Params { rows: size(grid.h), columns: size(grid.w), slot: size(slot) };
        let tensors = [&iterate.marks, directions];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, samples / 3));
    }
}
