//! Host side of `shaders/optim/step_across.wgsl`.

use super::{Fields, Iterate, Reacting, directions};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::sheet_axes::AXES;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "step_across",
    wgsl: include_str!("../../../shaders/optim/step_across.wgsl"),
    appended: &[common::MARK, pieces::REACTING],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    slot: u32,
    room: u32,
}

/// Takes the steps in space and across the sheet, and finds what they leave to be done along it.
#[derive(Clone, Debug)]
pub struct StepAcross {
    kernel: Kernel,
}

impl StepAcross {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets the spectral slot of `directions` ([`directions::shape`]), the step across in the co-rotated one, and `rest` [B, 3, n], the
    /// gradient after that step, from `y` ([`Fields::SpaceAndNormal`]) and the `axes` [B, 16, n] of the sheet.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (iterate, axes, reacting): (&Iterate, &Tensor, &Reacting),
        y: &Tensor,
        [directions, rest]: [&Tensor; 2],
    ) {
        let (samples, n) = iterate.samples_and_particles();
        let batch = samples / 3;
        assert_eq!((n, axes.shape()), (grid.particles(), &[batch, AXES, n][..]));
        assert_eq!((y.shape(), rest.len()), (&Fields::SpaceAndNormal.shape(batch, grid)[..], samples * n));
        let room = reacting.room(batch, n);
        let slot = directions::slot(directions, iterate);
        let params = Params { rows: size(grid.h), columns: size(grid.w), slot: size(slot), room: size(room) };
        let Reacting { handles, fields } = reacting;
        let tensors = [&iterate.grad, &iterate.marks, axes, y, handles, fields, directions, rest];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, batch));
    }
}
