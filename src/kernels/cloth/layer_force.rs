//! Host side of `shaders/cloth/layer_force.wgsl`.

use super::{PairParams, Pairs, Trial, energy};
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "layer_force",
    wgsl: include_str!("../../../shaders/cloth/layer_force.wgsl"),
    appended: &[common::MARK, terms::CONTACT, pieces::BUCKET, pieces::PAIR, pieces::POSITION_ENERGY],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    of_pairs: PairParams,
    groups: u32,
    first_source: u32,
    first_total: u32,
}

/// Sums the forces between the layers of a cloth, and their energy.
#[derive(Clone, Debug)]
pub struct LayerForce {
    alone: Kernel,
    after_others: Kernel,
}

impl LayerForce {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel = |sets: f64| Kernel::new(context, &SOURCE, 0, &[("SETS", sets)]);
        Ok(Self { alone: kernel(1.0)?, after_others: kernel(0.0)? })
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
        let (grid, batch) = (trial.grid, trial.batch());
        let shape @ [_, groups, _] = energy::parts_shape(batch, grid);
        assert_eq!(parts.shape(), shape);
        let (given, external, total) = &trial.iterate.given();
        let total = total.expect("the iterate has a total");
        let params = Params {
            of_pairs: pairs.params(grid),
            groups: size(groups),
            first_source: size(if after_others { total } else { *external }),
            first_total: size(total),
        };
        let kernel = if after_others { &self.after_others } else { &self.alone };
        let Pairs { list_ends, lists, pairs, presses, .. } = pairs;
        let tensors = [&trial.iterate.marks, list_ends, lists, pairs, presses, given, parts];
        schedule.dispatch(kernel, &params, &tensors, kernel.spread(grid.particles(), batch));
    }
}
