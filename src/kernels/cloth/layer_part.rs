//! Host side of `shaders/cloth/layer_part.wgsl`.

use super::{Pairs, Trial};
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source};
use crate::kernels::{common, pieces, terms};

pub(crate) const SOURCE: Source = Source {
    name: "layer_part",
    wgsl: include_str!("../../../shaders/cloth/layer_part.wgsl"),
    appended: &[common::MARK, terms::CONTACT, pieces::BUCKET, pieces::PAIR],
};

/// Moves layers of a cloth away from each other.
#[derive(Clone, Debug)]
pub struct LayerPart {
    kernel: Kernel,
}

impl LayerPart {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Changes `iterate.a` by what `pairs` ask for in their `presses`.
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, pairs: &Pairs) {
        let (grid, batch) = (trial.grid, trial.batch());
        let params = pairs.params(grid);
        let Pairs { list_ends, lists, pairs, presses, .. } = pairs;
        let tensors = [&trial.iterate.marks, list_ends, lists, pairs, presses, &trial.iterate.a];
        schedule.dispatch(&self.kernel, &params, &tensors, self.kernel.spread(grid.particles(), batch));
    }
}
