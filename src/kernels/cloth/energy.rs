//! Host side of `shaders/cloth/energy.wgsl`.

use super::Trial;
use super::energy_sum::TERMS;
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "energy",
    wgsl: include_str!("../../../shaders/cloth/energy.wgsl"),
    appended: &[
        common::CLOTH,
        common::MARK,
        common::OFFSET,
        terms::PARTICLE,
        terms::EDGE,
        terms::ANGLE,
        pieces::TRIAL,
        pieces::HINGE,
        pieces::HINGE_ENERGY,
    ],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    groups: u32,
    first_external: u32,
    has_rest_angles: u32,
    zero: u32,
}

/// Computes the energy terms, summed over each workgroup.
#[derive(Clone, Debug)]
pub struct Energy {
    kernel: Kernel,
}

/// Number of particles in a part: those of a workgroup.
const PART: usize = 64;

/// Returns the shape of the parts in which the energy of each of `batch` cloths is summed, [B, parts, 8].
pub fn parts_shape(batch: usize, grid: Grid) -> [usize; 3] {
    [batch, grid.particles().div_ceil(PART), TERMS]
}

impl Energy {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `parts` [B, parts, 8] at `iterate.a`. `rest_angles` [B, n, 2] are those of cloths that are not flat at rest.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        trial: Trial<'_>,
        rest_angles: Option<&Tensor>,
        parts: &Tensor,
    ) {
        let Trial { grid, cloths, x, iterate } = trial;
        let batch = trial.batch();
        let shape @ [_, groups, _] = parts_shape(batch, grid);
        assert_eq!(parts.shape(), shape);
        let (given, external, _) = &iterate.given();
        let params = Params {
            rows: size(grid.h),
            columns: size(grid.w),
            groups: size(groups),
            first_external: size(*external),
            has_rest_angles: rest_angles.is_some().into(),
            zero: 0,
        };
        // Others are not read.
        let rest_angles = rest_angles.unwrap_or(&iterate.marks);
        let tensors = [cloths, &iterate.marks, &iterate.a, given, x, rest_angles, parts];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(grid.particles(), batch));
    }
}
