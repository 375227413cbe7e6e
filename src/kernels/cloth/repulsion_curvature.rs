//! Host side of `shaders/cloth/repulsion_curvature.wgsl`.

use super::{Cells, Trial, curvature};
use crate::Result;
use crate::cloth;
use crate::gpu::{Context, Schedule, Source, Tensor};
use crate::kernels::optim::directions;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "repulsion_curvature",
    wgsl: include_str!("../../../shaders/cloth/repulsion_curvature.wgsl"),
    appended: &[
        common::CLOTH,
        common::CELL,
        common::JOINED,
        pieces::BUCKET,
        pieces::PRODUCTS,
        pieces::PRODUCTS_PART,
    ],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    buckets: u32,
    parts: u32,
    slot: u32,
}

/// Adds the second derivatives of the repulsion to the quadratic model of the energy.
#[derive(Clone, Debug)]
pub struct RepulsionCurvature {
    kernels: directions::ByCount,
}

impl RepulsionCurvature {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self {
            kernels: directions::ByCount::new(
                context,
                &SOURCE,
                &[("SOFTENING", cloth::Repulsion::SOFTENING)],
            )?,
        })
    }

    /// Adds to `parts` [B, parts, 24], which hold those of the other terms ([`super::Curvature`]), the second
    /// derivatives of the repulsion at `iterate.a` along `directions` ([`directions::shape`]), which are 0 at handles.
    /// `cells` are those of the particles there ([`super::Repulsion::cells`]). One dispatch.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        trial: Trial<'_>,
        cells: &Cells,
        [directions, parts]: [&Tensor; 2],
    ) {
        let kernel = self.kernels.of(directions);
        let Trial { grid, cloths, iterate, .. } = trial;
        let (batch, Cells { ends, sorted, .. }) = (trial.batch(), cells);
        let shape @ [_, groups, _] = curvature::parts_shape(batch, grid);
        assert_eq!((parts.shape(), sorted.shape()), (&shape[..], &[batch, grid.particles(), 4][..]));
        let params = Params {
            rows: size(grid.h),
            columns: size(grid.w),
            buckets: size(ends.shape()[1]),
            parts: size(groups),
            slot: size(directions::slot(directions, iterate)),
        };
        let tensors = [cloths, ends, sorted, directions, parts];
        schedule.dispatch(kernel, &params, &tensors, [size(groups), size(batch), 1]);
    }
}
