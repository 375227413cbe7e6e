//! Host side of `shaders/cloth/layer_force.wgsl`.

use super::force::{Force, Sums};
use super::{PairParams, Pairs, Trial};
use crate::Result;
use crate::gpu::{Context, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, terms};

pub(crate) const SOURCE: Source = Source {
    name: "layer_force",
    wgsl: include_str!("../../../shaders/cloth/layer_force.wgsl"),
    appended: &[common::MARK, terms::CONTACT, pieces::BUCKET, pieces::PAIR, pieces::POSITION_FORCE],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    of_pairs: PairParams,
    sums: Sums,
}

/// Sums the forces between the layers of a cloth, and their energy.
#[derive(Clone, Debug)]
pub struct LayerForce(Force);

impl LayerForce {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        Force::new(context, &SOURCE, &[]).map(Self)
    }

    /// Sets `iterate.total` to the external accelerations and those by `pairs`, from their `presses`, and the last number of
    /// each of the `parts` of the energy [B, parts, 8]. After a repulsion or contacts with bodies, which have set both, it
    /// adds. Panics if the iterate has no total.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        trial: Trial<'_>,
        after_others: bool,
        (pairs, parts): (&Pairs, &Tensor),
    ) {
        let (kernel, sums) = self.0.of(trial, after_others, parts);
        let params = Params { of_pairs: pairs.params(trial.grid), sums };
        let (given, ..) = &trial.iterate.given();
        let Pairs { list_ends, lists, pairs, presses, .. } = pairs;
        let tensors = [&trial.iterate.marks, list_ends, lists, pairs, presses, given, parts];
        schedule.dispatch(kernel, &params, &tensors, kernel.spread(trial.grid.particles(), trial.batch()));
    }
}
