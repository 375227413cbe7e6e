//! Host side of `shaders/cloth/couple.wgsl`.

use super::Trial;
use super::force::{Force, Sums};
use crate::Result;
use crate::gpu::{Context, Schedule, Source, Tensor};
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
        pieces::POSITION_FORCE,
    ],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    sums: Sums,
}

/// Computes the accelerations by couples, and their energy.
#[derive(Clone, Debug)]
pub struct Couple(Force);

impl Couple {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        Force::new(context, &SOURCE, &[]).map(Self)
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
        let (grid, batch, iterate) = (trial.grid, trial.batch(), trial.iterate);
        assert_eq!(rest_angles.shape(), [batch, grid.particles(), 2]);
        let (kernel, sums) = self.0.of(trial, after_others, parts);
        let params = Params { rows: size(grid.h), columns: size(grid.w), sums };
        let (given, ..) = &iterate.given();
        let tensors = [trial.cloths, &iterate.marks, rest_angles, trial.x, &iterate.a, given, parts];
        schedule.dispatch(kernel, &params, &tensors, kernel.spread(grid.particles(), batch));
    }
}
