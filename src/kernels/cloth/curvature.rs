//! Host side of `shaders/cloth/curvature.wgsl`.

use super::{Trial, gradient};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::optim::directions;
use crate::kernels::{common, pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "curvature",
    wgsl: include_str!("../../../shaders/cloth/curvature.wgsl"),
    appended: &[
        common::CLOTH,
        common::MARK,
        common::OFFSET,
        terms::PARTICLE,
        terms::EDGE,
        terms::ANGLE,
        pieces::PRODUCTS,
    ],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    parts: u32,
    slot: u32,
    first_external: u32,
    zero: u32,
}

/// Computes the quadratic model of the energy in the span of a few directions, and the energy.
#[derive(Clone, Debug)]
pub struct Curvature {
    energy: Kernel,
    along: directions::ByCount,
}

/// Number of values in a part.
pub const VALUES: usize = 24;

/// Returns the shape of the parts in which the model of each of `batch` cloths is summed, [B, parts, 24].
pub fn parts_shape(batch: usize, grid: Grid) -> [usize; 3] {
    [batch, gradient::parts(grid), VALUES]
}

impl Curvature {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let energy = Kernel::new(context, &SOURCE, 0, &[("K", 0.0)])?;
        Ok(Self { energy, along: directions::ByCount::new(context, &SOURCE, &[])? })
    }

    /// Sets `parts` [B, parts, 24] at `iterate.a`, which like all `directions` ([`directions::shape`]) is 0
    /// at handles. Expects the gradient there in `iterate.grad`. The repulsion is left out.
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, [directions, parts]: [&Tensor; 2]) {
        Self::push_kernel(self.along.of(directions), schedule, trial, [directions, parts]);
    }

    /// Sets the energy in `parts` as [`Curvature::push`] does, and all else to 0.
    pub fn push_energy(&self, schedule: &mut Schedule, trial: Trial<'_>, tensors: [&Tensor; 2]) {
        Self::push_kernel(&self.energy, schedule, trial, tensors);
    }

    fn push_kernel(
        kernel: &Kernel,
        schedule: &mut Schedule,
        trial: Trial<'_>,
        [directions, parts]: [&Tensor; 2],
    ) {
        let Trial { grid, cloths, x, iterate } = trial;
        let batch = trial.batch();
        let shape @ [_, count, _] = parts_shape(batch, grid);
        assert_eq!(parts.shape(), shape);
        let (given, external, _) = &iterate.given();
        let params = Params {
            rows: size(grid.h),
            columns: size(grid.w),
            parts: size(count),
            slot: size(directions::slot(directions, iterate)),
            first_external: size(*external),
            zero: 0,
        };
        let tensors = [cloths, &iterate.marks, &iterate.a, given, x, &iterate.grad, directions, parts];
        schedule.dispatch(kernel, &params, &tensors, [size(count), size(batch), 1]);
    }
}
