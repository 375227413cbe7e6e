//! Host side of `shaders/cloth/couple_curvature.wgsl`.

use super::{Trial, curvature};
use crate::Result;
use crate::gpu::{Context, Schedule, Source, Tensor};
use crate::kernels::optim::directions;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "couple_curvature",
    wgsl: include_str!("../../../shaders/cloth/couple_curvature.wgsl"),
    appended: &[
        common::CLOTH,
        common::MARK,
        pieces::TRIAL,
        pieces::HINGE,
        pieces::PRODUCTS,
        pieces::PRODUCTS_PART,
    ],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    parts: u32,
    slot: u32,
}

/// Adds the second derivatives of couples to the quadratic model of the energy.
#[derive(Clone, Debug)]
pub struct CoupleCurvature {
    kernels: directions::ByCount,
}

impl CoupleCurvature {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernels: directions::ByCount::new(context, &SOURCE, &[])? })
    }

    /// Adds to `parts` [B, parts, 24], which hold those of the other terms ([`super::Curvature`]), the second
    /// derivatives of the couples of the `rest_angles` [B, n, 2] at `iterate.a` along `directions`
    /// ([`directions::shape`]), which are 0 at handles.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        trial: Trial<'_>,
        rest_angles: &Tensor,
        [directions, parts]: [&Tensor; 2],
    ) {
        let kernel = self.kernels.of(directions);
        let (grid, batch, iterate) = (trial.grid, trial.batch(), trial.iterate);
        let shape @ [_, groups, _] = curvature::parts_shape(batch, grid);
        assert_eq!(parts.shape(), shape);
        assert_eq!(rest_angles.shape(), [batch, grid.particles(), 2]);
        let params = Params {
            rows: size(grid.h),
            columns: size(grid.w),
            parts: size(groups),
            slot: size(directions::slot(directions, iterate)),
        };
        let (given, ..) = &iterate.given();
        let tensors =
            [trial.cloths, &iterate.marks, rest_angles, trial.x, &iterate.a, given, directions, parts];
        schedule.dispatch(kernel, &params, &tensors, [size(groups), size(batch), 1]);
    }
}
