//! Host side of `shaders/optim/sheet_steps.wgsl`.

use super::{Fields, Iterate, Reacting, directions};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::sheet_axes::AXES;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "sheet_steps",
    wgsl: include_str!("../../../shaders/optim/sheet_steps.wgsl"),
    appended: &[common::MARK, pieces::REACTING],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    slot: u32,
    room: u32,
}

/// Turns transforms that came back into the steps of a sheet.
#[derive(Clone, Debug)]
pub struct SheetSteps {
    kernel: Kernel,
}

impl SheetSteps {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets the spectral and the co-rotated slot of `directions` ([`directions::shape`]) from `y` ([`Fields::shape_of_all`]) and the
    /// `axes` [B, 16, n] of the sheet.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (iterate, axes, reacting): (&Iterate, &Tensor, &Reacting),
        [y, directions]: [&Tensor; 2],
    ) {
        let (samples, n) = iterate.samples_and_particles();
        let batch = samples / 3;
        assert_eq!((n, axes.shape()), (grid.particles(), &[batch, AXES, n][..]));
        assert_eq!(y.shape(), Fields::shape_of_all(batch, grid));
        let room = reacting.room(batch, n);
        let slot = directions::slot(directions, iterate);
        let params = Params { particles: size(n), slot: size(slot), room: size(room) };
        let Reacting { handles, fields } = reacting;
        let tensors = [&iterate.marks, axes, y, handles, fields, directions];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(n, batch));
    }
}
