//! Host side of `shaders/cloth/layer_press.wgsl`.

use super::{Pairs, Trial};
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source};
use crate::kernels::{common, pieces, terms};

pub(crate) const SOURCE: Source = Source {
    name: "layer_press",
    wgsl: include_str!("../../../shaders/cloth/layer_press.wgsl"),
    appended: &[common::MARK, terms::CONTACT, pieces::PAIR, pieces::PAIRS_OF, pieces::ACROSS],
};

/// Computes what each pair of parts of a cloth does.
#[derive(Clone, Debug)]
pub struct LayerPress {
    forces: Kernel,
    ways_out: Kernel,
    slips_back: Kernel,
}

/// What a pair tells its particles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tells {
    /// The derivative of its energy.
    Forces,
    /// How to leave what is too near.
    WaysOut,
    /// How to take back the slip of those that stick.
    SlipsBack,
}

impl LayerPress {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel = |moves: f64| Kernel::new(context, &SOURCE, 0, &[("MOVES", moves)]);
        Ok(Self { forces: kernel(0.0)?, ways_out: kernel(1.0)?, slips_back: kernel(2.0)? })
    }

    /// Sets the `presses` of `pairs` at `iterate.a`.
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, pairs: &Pairs, tells: Tells) {
        let (grid, batch) = (trial.grid, trial.batch());
        let kernel = match tells {
            Tells::Forces => &self.forces,
            Tells::WaysOut => &self.ways_out,
            Tells::SlipsBack => &self.slips_back,
        };
        let (given, ..) = &trial.iterate.given();
        let tensors =
            [&trial.iterate.marks, &pairs.ends, &pairs.pairs, &trial.iterate.a, given, &pairs.presses];
        schedule.dispatch(kernel, &pairs.params(grid), &tensors, kernel.spread(grid.particles(), batch));
    }
}
