//! Host side of `shaders/cloth/layer_motion.wgsl`.

use super::Trial;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::optim::Iterate;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "layer_motion",
    wgsl: include_str!("../../../shaders/cloth/layer_motion.wgsl"),
    appended: &[common::CLOTH, common::MARK, common::CELL, pieces::PATCH],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
}

/// The way on which the parts of a cloth are searched that may touch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// That by the velocities, before the frame's accelerations are known: all particles are searched.
    Predicted,
    /// That which the frame took: those that left the predicted one are.
    Taken,
}

/// Prepares the search for what a cloth may touch of itself.
#[derive(Clone, Debug)]
pub struct LayerMotion {
    predicted: Kernel,
    taken: Kernel,
}

impl LayerMotion {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel = |ends: f64| Kernel::new(context, &SOURCE, 0, &[("ENDS", ends)]);
        Ok(Self { predicted: kernel(0.0)?, taken: kernel(1.0)? })
    }

    /// Sets `motion` [B, n, 8] and `extents` [B, 4].
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, way: Way, [motion, extents]: [&Tensor; 2]) {
        let (grid, batch) = (trial.grid, trial.batch());
        assert_eq!([motion, extents].map(Tensor::len), [8 * batch * grid.particles(), 4 * batch]);
        let kernel = match way {
            Way::Predicted => &self.predicted,
            Way::Taken => &self.taken,
        };
        let params = Params { rows: size(grid.h), columns: size(grid.w) };
        let Iterate { marks, base, a, .. } = trial.iterate;
        let tensors = [trial.cloths, marks, trial.x, base, a, motion, extents];
        schedule.dispatch(kernel, &params, &tensors, [size(batch), 1, 1]);
    }
}
