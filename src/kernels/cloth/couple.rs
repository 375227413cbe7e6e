//! Host side of `shaders/cloth/couple.wgsl`.

use super::{Trial, energy};
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "couple",
    wgsl: include_str!("../../../shaders/cloth/couple.wgsl"),
    appended: &[
        common::CLOTH,
        common::MARK,
        terms::ANGLE,
        pieces::TRIAL,
        pieces::HINGE,
        pieces::HINGE_ENERGY,
        pieces::POSITION_ENERGY,
    ],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    groups: u32,
    first_source: u32,
    first_total: u32,
}

/// Computes the accelerations by couples, and their energy.
#[derive(Clone, Debug)]
pub struct Couple {
    alone: Kernel,
    after_others: Kernel,
}

impl Couple {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel = |sets: f64| Kernel::new(context, &SOURCE, 0, &[("SETS", sets)]);
        Ok(Self { alone: kernel(1.0)?, after_others: kernel(0.0)? })
    }

    /// Sets `iterate.total` at `iterate.a` to the external accelerations and those by the couples of the
    /// `rest_angles` [B, n, 2], and the last number of each of the `parts` of the energy [B, parts, 8]. After others,
    /// which have set both, it adds. Panics if the iterate has no total.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        trial: Trial<'_>,
        after_others: bool,
        [rest_angles, parts]: [&Tensor; 2],
    ) {
        let (grid, batch) = (trial.grid, trial.batch());
        let shape @ [_, groups, _] = energy::parts_shape(batch, grid);
        assert_eq!(parts.shape(), shape);
        assert_eq!(rest_angles.shape(), [batch, grid.particles(), 2]);
        let (given, external, total) = &trial.iterate.given();
        let total = total.expect("the iterate has a total");
        let params = Params {
            rows: size(grid.h),
            columns: size(grid.w),
            groups: size(groups),
            first_source: size(if after_others { total } else { *external }),
            first_total: size(total),
        };
        let kernel = if after_others { &self.after_others } else { &self.alone };
        let iterate = trial.iterate;
        let tensors = [trial.cloths, &iterate.marks, rest_angles, trial.x, &iterate.a, given, parts];
        schedule.dispatch(kernel, &params, &tensors, kernel.spread(grid.particles(), batch));
    }
}
