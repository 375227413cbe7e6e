//! Host side of `shaders/cloth/layer_axes.wgsl`.

use super::sheet_axes::AXES;
use super::{Pairs, Trial};
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{pieces, terms};
use crate::settings::HOLDING;

pub(crate) const SOURCE: Source = Source {
    name: "layer_axes",
    wgsl: include_str!("../../../shaders/cloth/layer_axes.wgsl"),
    appended: &[terms::CONTACT, pieces::BUCKET, pieces::PAIR, pieces::ACROSS],
};

/// Shortens the axes of the sheet at the particles that other layers of the cloth hold.
#[derive(Clone, Debug)]
pub struct LayerAxes {
    kernel: Kernel,
}

impl LayerAxes {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[("HOLDING", HOLDING)])? })
    }

    /// Shortens `axes` [B, 16, n] by what `pairs` resist at `iterate.a`.
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, pairs: &Pairs, axes: &Tensor) {
        let (grid, batch) = (trial.grid, trial.batch());
        assert_eq!(axes.shape(), [batch, AXES, grid.particles()]);
        let (given, ..) = &trial.iterate.given();
        let tensors = [&pairs.list_ends, &pairs.lists, &pairs.pairs, &trial.iterate.a, given, axes];
        let spread = self.kernel.spread(grid.particles(), batch);
        schedule.dispatch(&self.kernel, &pairs.params(grid), &tensors, spread);
    }
}
